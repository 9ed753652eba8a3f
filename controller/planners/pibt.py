"""PIBT: priority inheritance with backtracking (Okumura, Machida, Defago and Tamura 2019, 2022), one move at a time.

In order of priority, each agent takes its best free neighbour vertex. An agent standing there inherits the priority and
must move on first. If it has nowhere to go, the first agent tries another neighbour (backtracking).
An agent's priority grows while it is on its way to its goal, and is reset at the goal.

Departures from the paper, for garages. No ring of agents moves on as a whole (three or more, each into the place of
the next one), since bodies can't. A dead end is reserved as one: the neck of the goal's dead end (the aisle vertex of a
slot) is entered only together with everything between it and the goal, so that no agent waits at the neck for another
that has to come out over it. An agent that acts, or drives for longer than two moves, stands. Durations are put in
afterwards: an agent enters a vertex that is left in the same plan when it has been left.

Guarantee: moves are free of conflicts with each other, and with ``fixed`` up to the window. The paper's guarantee, that
every agent reaches its goal, needs a ring through every edge: in dead ends and single corridors it is lost, and agents
may push each other to and fro, which is for deadlock handling to see. Limits: plans one move, so it needs a window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.distances import Distances, settle
from controller.search.field import Field
from controller.search.space import Lanes, Space
from controller.types import (
    FOREVER,
    NEVER,
    AgvNumber,
    Counters,
    Motion,
    Path,
    PlanAgent,
    PlanningProblem,
    PlanResult,
    Status,
)
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import Vertex

#: Instead of a vertex or an agent.
NOBODY = -1


class Moves(NamedTuple):
    """One move of all agents, while it is put together.

    Attributes:
        now, next: vertex of each agent now and after the move (-1: not settled), shape (a,).
        occupant, taker: agent that is at each vertex now, and that will be there, -1 for none, shape (n,).
        ranked: vertices each agent may go to, the best first, -1 behind the last, shape (a, d).
        goals: shape (a,).
        outward: next vertex on the way out of a dead end, -1 outside of dead ends, shape (n,).
        chain, tried: room for agents that inherit a priority, and for how many places each has tried, shape (a,).
        keys: room for the keys of one agent's ranking, shape (d,).
    """

    now: IntArray
    next: IntArray
    occupant: IntArray
    taker: IntArray
    ranked: IntArray
    goals: IntArray
    outward: IntArray
    chain: IntArray
    tried: IntArray
    keys: NDArray[np.int64]


class Pibt:
    """The planner, with the search memory it keeps between calls."""

    def __init__(self, space: Space) -> None:
        self.distances = Distances(space)
        self.outward = dead_ends(space)
        self._waited: dict[AgvNumber, tuple[Vertex, int]] = {}
        self._reach = 2 * int(space.lanes.edge_steps.max(initial=1))

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan one move for all agents of a problem.

        Returns:
            SOLVED with paths of at most one move.
        """
        self.distances.counters[:] = 0
        self.distances.update(problem.blocked)
        agents = sorted(problem.agents, key=lambda agent: (-self._on_its_way(agent), -agent.priority, agent.agv))
        closed, free_at = obstacles(problem)
        moves = start_moves(agents, self.outward, self.distances)
        for i, agent in enumerate(agents):
            if not self._moves(problem, agent):
                stand(i, moves)
        rank_all(agents, moves, self.distances, closed)
        one_move(np.arange(len(agents), dtype=np.int32), moves)
        paths = _timed(problem, agents, moves, free_at)
        return PlanResult(Status.SOLVED, paths, counters=Counters(*self.distances.counters.tolist()))

    def _on_its_way(self, agent: PlanAgent) -> int:
        """Planning calls since the agent got its goal; 0 at the goal."""
        goal, calls = self._waited.get(agent.agv, (agent.goal, 0))
        calls = 0 if agent.goal in (agent.vertex,) or agent.goal != goal else calls + 1
        self._waited[agent.agv] = (agent.goal, calls)
        return calls

    def _moves(self, problem: PlanningProblem, agent: PlanAgent) -> bool:
        """Whether the agent can be planned, or asked to make room, now."""
        return agent.ready_step == 0 or (not problem.motion.following and agent.ready_step <= self._reach)


def dead_ends(space: Space) -> IntArray:
    """For each vertex of a dead end the next one on the way out; -1 elsewhere, shape (n,).

    A dead end is a line of vertices from one with a single neighbour up to the neck, the first with three or more.
    """
    lanes = space.lanes
    n = len(lanes.xy)
    near: list[set[int]] = [set() for _ in range(n)]
    for u, v in zip(lanes.tail.tolist(), lanes.head.tolist(), strict=True):
        near[u].add(v)
        near[v].add(u)
    outward = np.full(n, NOBODY, dtype=np.int32)
    for end in range(n):
        if len(near[end]) == 1:
            line = [end, *near[end]]
            while len(near[line[-1]]) == 2:
                line += near[line[-1]] - {line[-2]}
            if len(near[line[-1]]) > 2:
                outward[line[:-1]] = line[1:]
    return outward


def obstacles(problem: PlanningProblem) -> tuple[NDArray[np.uint8], dict[Vertex, int]]:
    """Vertices closed by fixed paths, and from when on those are free where somebody is just about to leave."""
    closed = problem.blocked.copy()
    free_at: dict[Vertex, int] = {}
    for path in problem.fixed:
        if len(path.vertices) == 1 and path.until < problem.window_steps:
            v = path.vertices[0]
            free_at[v] = max(path.until, free_at.get(v, 0))
        else:
            closed[list(path.vertices)] = 2
    return closed, free_at


def no_moves(now: IntArray, goals: IntArray, outward: IntArray, lanes: Lanes) -> Moves:
    """Room for a move of agents at ``now``; nothing is ranked or settled, and the vertices say nobody is there."""
    a, n = len(now), len(outward)
    degree = int(np.diff(lanes.first_out).max(initial=0))
    next_, occupant, taker = (np.full(size, NOBODY, dtype=np.int32) for size in (a, n, n))
    ranked = np.full((a, degree + 1), NOBODY, dtype=np.int32)
    chain, tried = (np.zeros(a, dtype=np.int32) for _ in range(2))
    return Moves(
        now, next_, occupant, taker, ranked, goals, outward, chain, tried, np.zeros(degree + 1, dtype=np.int64)
    )


def start_moves(agents: Sequence[PlanAgent], outward: IntArray, distances: Distances) -> Moves:
    """No move settled yet; agents in order of priority."""
    now = np.array([agent.vertex for agent in agents], dtype=np.int32)
    goals = np.array([agent.goal for agent in agents], dtype=np.int32)
    moves = no_moves(now, goals, outward, distances.space.lanes)
    moves.occupant[now] = np.arange(len(agents))
    return moves


def stand(i: int, moves: Moves) -> None:
    """Settle that an agent stays where it is."""
    moves.next[i] = moves.now[i]
    moves.taker[moves.now[i]] = i


def rank_all(agents: Sequence[PlanAgent], moves: Moves, distances: Distances, closed: NDArray[np.uint8]) -> None:
    """Rank what each agent without a settled move may do, by steps to the goal with turns; closed vertices are out."""
    d = distances
    for i, agent in enumerate(agents):
        if moves.next[i] == NOBODY:
            field = d.field(agent.goal, agent.loaded, agent.vertex)
            _rank(
                i, agent.in_edge, int(agent.loaded), moves, closed, field, d.space.lanes, d.blocked, d.counters
            )  # fmt: skip


@kernel
def _rank(
    i: int, in_edge: int, loaded: int, moves: Moves, closed: NDArray[np.uint8], field: Field, lanes: Lanes,
    blocked: NDArray[np.uint8], counters: NDArray[np.int64],
) -> None:  # fmt: skip
    """Rank an agent's neighbours by cost, of equal ones the empty ones first; to stay comes behind the best."""
    v, goal, row, keys, occupant = moves.now[i], moves.goals[i], moves.ranked[i], moves.keys, moves.occupant
    size = 0
    here = 0 if v == goal else FOREVER
    for e in range(lanes.first_out[v], lanes.first_out[v + 1]):
        w = lanes.head[e]
        if closed[w] == 2 or (closed[w] and w != goal):
            continue
        turn = 0
        if in_edge >= 0:
            turn = lanes.turn_steps[loaded, lanes.first_transition[in_edge] + e - lanes.first_out[v]]
        if turn >= NEVER:
            continue
        cost = turn + lanes.edge_steps[loaded, e]
        if w != goal:
            cost = min(FOREVER, cost + settle(e, field, lanes, blocked, counters))
        here = min(here, cost)
        insert(w, 2 * cost + (1 if occupant[w] != NOBODY else 0), size, row, keys)
        size += 1
    insert(v, 2 * here + (0 if v == goal else 2), size, row, keys)


@kernel
def insert(v: int, key: int, size: int, row: IntArray, keys: NDArray[np.int64]) -> None:
    """Put a vertex into the first ``size`` places of a ranking, behind those with the same key."""
    k = size
    while k > 0 and keys[k - 1] > key:
        keys[k], row[k] = keys[k - 1], row[k - 1]
        k -= 1
    keys[k], row[k] = key, v


@kernel
def one_move(order: IntArray, moves: Moves) -> None:
    """Settle the moves that are still open, in this order."""
    for i in order:
        if moves.next[i] == NOBODY:
            _settle(i, moves)


@kernel
def _settle(root: int, moves: Moves) -> None:
    """PIBT(a_i) of the paper, with a chain of the agents that inherit a priority instead of recursion."""
    now, next_, occupant, taker, chain = moves.now, moves.next, moves.occupant, moves.taker, moves.chain
    moves.tried[:] = 0
    chain[0], size = root, 1
    while size > 0:
        i = chain[size - 1]
        v = _next_place(i, moves)
        if v != NOBODY:
            next_[i] = v
            taker[v] = i
            _reserve_beyond(i, v, i, moves)
            j = occupant[v]
            if j == NOBODY or next_[j] != NOBODY:
                return
            chain[size] = j
            size += 1
        else:  # the agent stays, and the agent that wanted its place tries another one
            next_[i] = now[i]
            taker[now[i]] = i
            size -= 1
            if size > 0:
                _reserve_beyond(chain[size - 1], now[i], NOBODY, moves)


@kernel
def _next_place(i: int, moves: Moves) -> int:
    """The best place not tried yet that is left; ``NOBODY`` if there is none."""
    tried = moves.tried
    while tried[i] < moves.ranked.shape[1]:
        v = moves.ranked[i, tried[i]]
        tried[i] += 1
        if v == NOBODY:
            break
        if moves.taker[v] == NOBODY and _may_enter(i, v, moves) and not closes_ring(i, v, moves):
            return int(v)
    return NOBODY


@kernel
def _enters_dead_end(i: int, v: int, moves: Moves) -> bool:
    """Whether ``v`` is the neck of the dead end of the own goal, or further in, and the agent comes from outside."""
    w = moves.goals[i]
    while w != v:
        if w == moves.now[i] or moves.outward[w] == NOBODY:
            return False
        w = moves.outward[w]
    return bool(v != moves.now[i])


@kernel
def _may_enter(i: int, v: int, moves: Moves) -> bool:
    """Not into the dead end of the own goal, or its neck, while another agent is in it further on."""
    if _enters_dead_end(i, v, moves):
        w = moves.goals[i]
        while w != v:
            if moves.occupant[w] != NOBODY or moves.taker[w] != NOBODY:
                return False
            w = moves.outward[w]
    return True


@kernel
def _reserve_beyond(i: int, v: int, taker: int, moves: Moves) -> None:
    """Reserve ``v`` and the dead end of the goal beyond it; for no agent, give them back."""
    if _enters_dead_end(i, v, moves):
        w = moves.goals[i]
        while w != v:
            moves.taker[w] = taker
            w = moves.outward[w]


@kernel
def closes_ring(i: int, v: int, moves: Moves) -> bool:
    """Whether the agents that move on from ``v`` form a ring with ``i``; a ring of two is a swap."""
    j = moves.occupant[v]
    while j != NOBODY and j != i and moves.next[j] != NOBODY:
        v = moves.next[j]
        if v == moves.now[j]:
            return False
        if v == moves.now[i]:
            return True
        j = moves.occupant[v]
    return False


def _timed(
    problem: PlanningProblem, agents: Sequence[PlanAgent], moves: Moves, free_at: Mapping[Vertex, int]
) -> dict[AgvNumber, Path]:
    """Put durations in: an agent that enters a vertex waits for the agent that leaves it."""
    graph, motion = problem.graph, problem.motion
    paths: dict[AgvNumber, Path] = {}
    stack = list(range(len(agents)))[::-1]
    while stack:
        agent = agents[stack[-1]]
        u, w = Vertex(int(moves.now[stack[-1]])), Vertex(int(moves.next[stack[-1]]))
        ahead = int(moves.occupant[w])
        if agent.agv in paths:
            stack.pop()
        elif u == w:
            paths[agent.agv] = Path(agent.agv, (u,), (0,), (), problem.window_steps)
        elif ahead != NOBODY and agents[ahead].agv not in paths:
            stack.append(ahead)
        else:
            edge = graph.edge_index[u, w]
            turn = 0 if agent.turned_to == w else motion.turn(graph, agent.in_edge, edge, agent.loaded)
            drive = int(motion.edge_steps[int(agent.loaded), edge])
            free = paths[agents[ahead].agv].arrive[-1] if ahead != NOBODY else 0
            free = max(free, free_at.get(w, 0))
            leave = max(agent.ready_step + turn, free - drive if motion.following else free)
            until = max(leave + drive, problem.window_steps)
            paths[agent.agv] = Path(agent.agv, (u, w), (0, leave + drive), (leave,), until)
    return {agent.agv: paths[agent.agv] for agent in problem.agents}


def make_pibt(graph: Graph, motion: Motion, options: None = None) -> Pibt:
    """A PIBT planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: none.

    Returns:
        The planner; call it with a problem.
    """
    return Pibt(Space(graph, motion))
