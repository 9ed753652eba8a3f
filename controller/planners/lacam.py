"""LaCAM* (Okumura 2023, "LaCAM" and "Improving LaCAM"): lazy search over configurations, with PIBT as their generator.

A configuration says where every agent is; a move leads to the next one. The search goes depth first: PIBT proposes the
next configuration, and each time the search comes back to one, a further constraint (who has to go where) makes PIBT
propose another. Once the goals are reached the rest of the effort improves the plan, as costs are passed on between
configurations that are known already. Moves last one unit in the search; afterwards each agent's way and the order of
visits at each vertex are given their earliest times with turns, loads and lengths.

Guarantee: without a limit the search is complete for moves that are no rings, and the plan tends to the least sum of
moves. Limits: effort is counted in configurations proposed (``LacamOptions.proposals``), never in seconds, so equal
problems have equal plans. Vertices of ``fixed`` paths are closed, however soon they are left, but for those that are
about to be left by somebody driving: meant for groups that stand, and for starts. The search does not know of bends
too sharp to drive; a plan that needs one counts as none.

Departures from the papers: rings don't move on as a whole, see ``pibt``. An agent whose goal can't be reached, or is
that of one with a higher priority, may end anywhere. Ties are broken by numbers that depend on the problem's seed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.planners.pibt import NOBODY, Moves, closes_ring, dead_ends, insert, no_moves, obstacles, one_move
from controller.search.space import Lanes, Space
from controller.types import (
    FOREVER,
    NEVER,
    NO_AGV,
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
from sumo_nets.numbering import NO_VERTEX, Vertex

#: Weight of one move when places are ranked; smaller amounts break ties.
_UNIT = 16


@dataclass(frozen=True, slots=True)
class LacamOptions:
    """Options of LaCAM*.

    Attributes:
        proposals: configurations that PIBT may propose in one call.
        improve: after the first plan, at most so many times the proposals it took go into improving it.
    """

    proposals: int = field(default=5000, metadata={"least": 1})
    improve: float = 1.0


class _Constraint(NamedTuple):
    """Who has to go where: one agent each, those of ``parent`` included."""

    parent: _Constraint | None = None
    agent: int = NOBODY
    vertex: Vertex = NO_VERTEX
    depth: int = 0


@dataclass(slots=True, eq=False)
class _Node:
    """A configuration of the search.

    Attributes:
        Q: vertex of each agent.
        order: agents by priority; constraints are added in this order.
        rank: priority of each agent: moves since it was last at its goal, and a fraction.
        g: cost of the way here.
        h: bound below the cost to the goals.
        parent: the configuration before this one.
        neighbours: configurations that follow this one, as found so far.
        tree: constraints not tried yet.
    """

    Q: IntArray
    order: IntArray
    rank: NDArray[np.float64]
    g: int
    h: int
    parent: _Node | None
    neighbours: dict[bytes, _Node] = field(default_factory=dict)
    tree: deque[_Constraint] = field(default_factory=lambda: deque([_Constraint()]))


class Lacam:
    """The planner.

    Args:
        space: the garage.
        options: see ``LacamOptions``.
    """

    def __init__(self, space: Space, options: LacamOptions) -> None:
        self.options = options
        self._space = space
        self._outward = dead_ends(space)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem, each to its goal.

        Returns:
            SOLVED; without a window TIMEOUT when the proposals did not suffice, or the plan has a bend too sharp to
            drive, and INFEASIBLE when some goal can't be reached, both without paths. With a window those that come
            nearest to the goals are SOLVED.
        """
        result = self.resolve(problem)
        if result.status is Status.PARTIAL:
            windowed = problem.window_steps < FOREVER
            return PlanResult(Status.SOLVED, result.paths, {}, result.counters) if windowed else _none(result)
        return result

    def resolve(self, problem: PlanningProblem, leader: AgvNumber = NO_AGV) -> PlanResult:
        """The same for a deadlocked group.

        Args:
            problem: of the group; its members are the agents.
            leader: the only one that has to come to its goal, which is far easier to find; ``NO_AGV``: all have to.

        Returns:
            As ``__call__``, but PARTIAL, with paths for all agents, if some may end elsewhere: ``failed`` names them.
        """
        search = _Search(problem, self._space, self._outward, self.options, leader)
        status = search.run()
        counters = Counters(expanded=search.proposals, generated=len(search.known), valid=len(search.known))
        windowed = problem.window_steps < FOREVER
        if status is not Status.SOLVED and not windowed:
            return PlanResult(status, {}, {}, counters)
        paths = timed_paths(problem, search.agents, search.configurations(), search.free_at)
        if any(path.arrive[-1] >= NEVER for path in paths.values()):
            return PlanResult(Status.TIMEOUT, {}, {}, counters)
        elsewhere = dict.fromkeys(search.elsewhere, NO_AGV)
        return PlanResult(Status.PARTIAL if elsewhere else Status.SOLVED, paths, elsewhere, counters)


def _none(result: PlanResult) -> PlanResult:
    return PlanResult(Status.INFEASIBLE, {}, {}, result.counters)


class _Search:
    """The search of one call. Index ``i`` of an agent is its place in ``agents``, the highest priority first."""

    def __init__(
        self, problem: PlanningProblem, space: Space, outward: IntArray, options: LacamOptions, leader: AgvNumber
    ) -> None:
        self.agents = sorted(problem.agents, key=lambda agent: (agent.agv != leader, -agent.priority, agent.agv))
        self.options = options
        self.lanes = space.lanes
        self.closed, self.free_at = obstacles(problem)
        self.proposals = 0
        self.known: dict[bytes, _Node] = {}
        self.goal: _Node | None = None
        self.seed = problem.seed
        self._successors = problem.graph.successors
        self._places_known: dict[tuple[int, Vertex], list[Vertex]] = {}
        self._goals, self.elsewhere, self.distance = self._aims()
        self._leads, self._hopeless = leader != NO_AGV, leader in self.elsewhere
        #: Moves left of the agents that have to come to their goals. The others need not arrive.
        self._left = self.distance
        if self._leads:
            self._left = np.zeros_like(self.distance)
            self._left[0] = self.distance[0]
            self.elsewhere = [agent.agv for agent in self.agents[1:]]
        starts = np.array([agent.vertex for agent in self.agents], dtype=np.int32)
        self._moves = no_moves(starts, self._goals, outward, self.lanes)
        self.start = self._node(starts.copy(), None)
        self._nearest = self.start

    def _aims(self) -> tuple[IntArray, list[AgvNumber], IntArray]:
        """Goals, AGVs that may end anywhere, and moves from each vertex to each agent's goal (all 0 for those)."""
        goals = np.array([agent.goal for agent in self.agents], dtype=np.int32)
        distance = np.zeros((len(self.agents), len(self.closed)), dtype=np.int32)
        elsewhere = []
        for i, agent in enumerate(self.agents):
            _fill_distances(agent.goal, self.closed, self.lanes, distance[i])
            taken = self.closed[agent.goal] == 2 and agent.goal != agent.vertex
            if taken or agent.goal in goals[:i] or distance[i, agent.vertex] >= FOREVER:
                distance[i] = 0
                elsewhere.append(agent.agv)
        return goals, elsewhere, distance

    def run(self) -> Status:
        """Search until the goals are reached and the effort for improvement is spent, or there is nothing left."""
        OPEN = [] if self._hopeless else [self.start]
        budget = self.options.proposals
        while OPEN and self.proposals < budget:
            N = OPEN[-1]
            if self.goal is None and N.h == 0:
                self.goal = N
                budget = min(budget, self.proposals + int(self.options.improve * self.proposals))
            if (self.goal is not None and N.g + N.h >= self.goal.g) or not N.tree:
                OPEN.pop()
                continue
            Q = self._propose(N, N.tree.popleft())
            if Q is None:
                continue
            known = self.known.get(Q.tobytes())
            if known is None:
                OPEN.append(self._node(Q, N))
            else:
                N.neighbours[Q.tobytes()] = known
                self._pass_on(N, OPEN)
                OPEN.append(known)
        if self.goal is not None:
            return Status.SOLVED
        return Status.TIMEOUT if OPEN else Status.INFEASIBLE

    def _node(self, Q: IntArray, parent: _Node | None) -> _Node:
        away = self.distance[np.arange(len(Q)), Q]
        h = int(self._left[np.arange(len(Q)), Q].sum())
        if parent is None:
            rank = away / (1.0 + away.max(initial=0))
            if self._leads:
                rank[0] = FOREVER  # no agent overtakes the leader
            g = 0
        else:
            rank = np.where(away == 0, parent.rank % 1.0, parent.rank + 1.0)
            g = parent.g + self._cost(parent.Q, Q)
        node = _Node(Q, np.argsort(-rank, kind="stable").astype(np.int32), rank, g, h, parent)
        self.known[Q.tobytes()] = node
        if parent is not None:
            parent.neighbours[Q.tobytes()] = node
        if parent is None or h < self._nearest.h:
            self._nearest = node
        return node

    def _cost(self, Q_from: IntArray, Q_to: IntArray) -> int:
        return int(_moves_paid(Q_from, Q_to, self._left))

    def _propose(self, N: _Node, C: _Constraint) -> IntArray | None:
        """The next configuration under a constraint, whose own children are put on the tree; None if impossible."""
        if C.depth < len(self.agents):
            i = int(N.order[C.depth])
            N.tree.extend(_Constraint(C, i, v, C.depth + 1) for v in self._places(i, Vertex(int(N.Q[i]))))
        self.proposals += 1
        told = []
        while C.parent is not None:
            told.append((C.agent, C.vertex))
            C = C.parent
        salt = self.seed * 7919 + self.proposals
        moves, pairs = self._moves, np.array(told, dtype=np.int32).reshape(-1, 2)
        possible = _settle(N.Q, N.order, pairs, moves, self.distance, self.closed, self.lanes, salt)
        return moves.next.copy() if possible else None

    def _places(self, i: int, here: Vertex) -> list[Vertex]:
        """Where an agent may be after a move from a vertex."""
        places = self._places_known.get((i, here))
        if places is None:
            goal = self.agents[i].goal
            places = [v for v in self._successors[here] if not self.closed[v] or (self.closed[v] == 1 and v == goal)]
            places.append(here)
            self._places_known[i, here] = places
        return places

    def _pass_on(self, N: _Node, OPEN: list[_Node]) -> None:
        """Pass a cheaper way on to all configurations known to follow (Dijkstra's relaxation)."""
        queue = deque([N])
        while queue:
            node = queue.popleft()
            for other in node.neighbours.values():
                g = node.g + self._cost(node.Q, other.Q)
                if g < other.g:
                    other.g, other.parent = g, node
                    queue.append(other)
                    if self.goal is not None and other.g + other.h < self.goal.g:
                        OPEN.append(other)

    def configurations(self) -> list[IntArray]:
        """From the start to the goals, or as near to them as was found."""
        node: _Node | None = self.goal or self._nearest
        found = []
        while node is not None:
            found.append(node.Q)
            node = node.parent
        return found[::-1]


@njit(cache=True)
def _fill_distances(goal: int, closed: NDArray[np.uint8], lanes: Lanes, distance: IntArray) -> None:
    """Moves from every vertex to the goal; closed vertices may be left, not passed."""
    distance[:] = FOREVER
    distance[goal] = 0
    queue = np.empty(len(distance), dtype=np.int32)
    queue[0], first, size = goal, 0, 1
    while first < size:
        v = queue[first]
        first += 1
        if closed[v] and v != goal:
            continue
        for k in range(lanes.first_in[v], lanes.first_in[v + 1]):
            u = lanes.tail[lanes.in_edges[k]]
            if distance[u] == FOREVER:
                distance[u] = distance[v] + 1
                queue[size] = u
                size += 1


@kernel
def _moves_paid(Q_from: IntArray, Q_to: IntArray, distance: IntArray) -> int:
    """A unit for each agent that is not at its goal before and after."""
    paid = 0
    for i in range(len(Q_from)):
        paid += distance[i, Q_from[i]] > 0 or distance[i, Q_to[i]] > 0
    return paid


@kernel
def _settle(
    Q: IntArray, order: IntArray, told: IntArray, moves: Moves, distance: IntArray, closed: NDArray[np.uint8],
    lanes: Lanes, salt: int,
) -> bool:  # fmt: skip
    """Settle every agent's move from ``Q``, first the agents that are told where to go; False if that is impossible."""
    _begin(Q, moves, distance, closed, lanes, salt)
    possible = True
    for k in range(len(told)):
        agent, vertex = told[k]
        if moves.taker[vertex] != NOBODY or closes_ring(agent, vertex, moves):
            possible = False
            break
        moves.next[agent] = vertex
        moves.taker[vertex] = agent
    possible = possible and _complete(order, moves)
    _end(moves)
    return possible


@kernel
def _begin(Q: IntArray, moves: Moves, distance: IntArray, closed: NDArray[np.uint8], lanes: Lanes, salt: int) -> None:
    """No move is settled. Every agent's places are ranked by distance; of equal places, empty ones come first."""
    moves.next[:] = NOBODY
    for i in range(len(Q)):
        moves.now[i] = Q[i]
        moves.occupant[Q[i]] = i
    for i in range(len(Q)):
        v = Q[i]
        row = moves.ranked[i]
        row[:] = NOBODY
        size = 0
        for k in range(lanes.first_out[v], lanes.first_out[v + 1] + 1):
            w = lanes.head[k] if k < lanes.first_out[v + 1] else v
            if w != v and closed[w] and (closed[w] == 2 or w != moves.goals[i]):
                continue
            key = _UNIT * np.int64(distance[i, w]) + (i * 31 + w * 17 + salt) % 7
            if moves.occupant[w] != NOBODY and w != v:
                key += _UNIT // 2
            insert(w, key, size, row, moves.keys)
            size += 1


@kernel
def _complete(order: IntArray, moves: Moves) -> bool:
    """Have PIBT settle the moves that are open; False if two would end at one vertex."""
    one_move(order, moves)
    possible = True
    for i in range(len(order)):
        possible &= moves.taker[moves.next[i]] == i
    return possible


@kernel
def _end(moves: Moves) -> None:
    """Clear the vertices, at a cost proportional to the agents."""
    for i in range(len(moves.now)):
        moves.occupant[moves.now[i]] = NOBODY
        moves.taker[moves.now[i]] = NOBODY
        if moves.next[i] != NOBODY:
            moves.taker[moves.next[i]] = NOBODY
        w = moves.goals[i]
        while moves.outward[w] != NOBODY:  # what was reserved beyond a neck
            moves.taker[w] = NOBODY
            w = moves.outward[w]


def timed_paths(
    problem: PlanningProblem,
    agents: Sequence[PlanAgent],
    configurations: Sequence[IntArray],
    free_at: Mapping[Vertex, int],
) -> dict[AgvNumber, Path]:
    """Earliest times for every agent's way that keep the order of visits at each vertex.

    Args:
        problem: graph and motion.
        agents: whose vertices the configurations hold, in this order.
        configurations: from the agents' present vertices on, one move a row, without rings.
        free_at: step from which on a vertex is free at all, where that is not now.

    Returns:
        A path for each agent, without waits that have no cause.
    """
    graph, motion = problem.graph, problem.motion
    free = dict(free_at)
    clock = [agent.ready_step for agent in agents]
    edges = [agent.in_edge for agent in agents]
    rows: list[tuple[list[Vertex], list[int], list[int]]] = [([agent.vertex], [0], []) for agent in agents]
    for before, after in pairwise(configurations):
        for i in _who_leaves_first(before, after):
            u, w = Vertex(int(before[i])), Vertex(int(after[i]))
            agent, (vertices, arrive, depart) = agents[i], rows[i]
            edge = graph.edge_index[u, w]
            has_turned = len(vertices) == 1 and agent.turned_to == w
            turn = 0 if has_turned else motion.turn(graph, edges[i], edge, agent.loaded)
            drive = int(motion.edge_steps[int(agent.loaded), edge])
            leave = max(clock[i] + turn, free.get(w, 0) - (drive if motion.following else 0))
            clock[i], edges[i] = leave + drive, edge
            free[u] = clock[i]
            vertices.append(w)
            arrive.append(clock[i])
            depart.append(leave)
    return {a.agv: Path(a.agv, tuple(v), tuple(t), tuple(d)) for a, (v, t, d) in zip(agents, rows, strict=True)}


def _who_leaves_first(before: IntArray, after: IntArray) -> list[int]:
    """The agents that move, in an order in which an agent that enters a vertex comes after the agent that leaves it."""
    at = {int(v): i for i, v in enumerate(before)}
    found: dict[int, None] = {}
    for first in np.flatnonzero(before != after).tolist():
        chain = []
        i = first
        while i >= 0 and i not in found and before[i] != after[i]:
            chain.append(i)
            i = at.get(int(after[i]), NOBODY)
        found.update(dict.fromkeys(reversed(chain)))
    return list(found)


def make_lacam(graph: Graph, motion: Motion, options: LacamOptions | None = None) -> Lacam:
    """A LaCAM* planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``LacamOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Lacam(Space(graph, motion), options or LacamOptions())
