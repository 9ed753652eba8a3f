"""One move at a time, around temporary obstacles: the planning procedure of the thesis's A* and D* Lite (2025, III-3).

Agents are planned in order of priority. For each of them the next places of those planned before it and the present
places of those planned after it are obstacles for the moment; a search of single-agent paths around them yields the
next move. Agents that turn or act are left alone and stay an obstacle where they are.

Guarantee: the moves of one call are free of conflicts, so the thesis's final conflict resolution is not needed.
Limits: the planner does not look beyond the next move. Agents may block each other for ever; deadlock handling detects
and resolves such blocks.

Departures from the thesis: everything that a fixed path passes is an obstacle too, and where bodies need both places
while they drive (``Motion.following`` False) the places that are being left are obstacles as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.heap import Counts
from controller.search.space import Lanes, Space
from controller.types import FOREVER, NEVER, AgvNumber, Counters, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import FloatArray, IntArray
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Vertex

#: Instead of an edge: no move.
STAY = NO_EDGE


class MoveSearch(Protocol):
    """Finds one agent's next move.

    Attributes:
        counters: search work so far, int64: expanded, heap moves, generated, valid.
    """

    counters: Counts

    def next_edge(self, agent: PlanAgent, blocked: NDArray[np.uint8], obstacles: Iterable[Vertex]) -> EdgeIndex:
        """First edge of a shortest path to the agent's goal, or ``STAY`` when there is none.

        Args:
            agent: the agent, not at its goal.
            blocked: shape (n,), where no AGV may drive; the goal is exempt.
            obstacles: further vertices that may not be entered for the moment, the goal included.
        """


class OneStep:
    """The planner.

    Attributes:
        one_move: its paths end with the move, before the window does.
        search: what finds the moves.
    """

    one_move = True

    def __init__(self, search: MoveSearch) -> None:
        self.search = search

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan one move for all agents of a problem.

        Returns:
            SOLVED with paths of at most one move; agents without a way at present have a path that stays.
        """
        self.search.counters[:] = 0
        passed = {v for path in problem.fixed for v in path.vertices}
        current = {agent.agv: agent.vertex for agent in problem.agents}
        next_ = dict(current)
        following = problem.motion.following
        paths: dict[AgvNumber, Path] = {}
        for agent in sorted(problem.agents, key=lambda a: (-a.priority, a.agv)):
            taken = [v for agv, v in next_.items() if agv != agent.agv]
            if not following:
                taken += [v for agv, v in current.items() if agv != agent.agv]
            edge = STAY
            if agent.vertex != agent.goal and not (following and agent.ready_step > 0):
                blocked = blocked_for(problem, agent)
                edge = self.search.next_edge(agent, blocked, {*taken, *passed})
            path = one_move_path(problem, agent, edge)
            paths[agent.agv] = path
            if not following or path.arrive[-1] == 1:  # an agent that turns first is an obstacle where it stands
                next_[agent.agv] = path.vertices[-1]
        return PlanResult(Status.SOLVED, paths, counters=Counters(*self.search.counters.tolist()))


def blocked_for(problem: PlanningProblem, agent: PlanAgent) -> NDArray[np.uint8]:
    """Where an agent may not drive, shape (n,): slots, too, for those that avoid them."""
    if not agent.avoids_slots:
        return problem.blocked
    blocked = problem.blocked.copy()
    blocked[list(problem.graph.slots)] = 1
    return blocked


def one_move_path(problem: PlanningProblem, agent: PlanAgent, edge: EdgeIndex) -> Path:
    """One move, or none, and no claim to its end: others may plan to go there later."""
    graph, motion = problem.graph, problem.motion
    vertices: tuple[Vertex, ...] = (agent.vertex,)
    arrive: tuple[int, ...] = (0,)
    depart: tuple[int, ...] = ()
    if edge != STAY:
        head = graph.ends[edge][1]
        turn = 0 if agent.turned_to == head else motion.turn(graph, agent.in_edge, edge, agent.loaded)
        leave = agent.ready_step + turn
        vertices, depart = (agent.vertex, head), (leave,)
        arrive = (0, leave + int(motion.edge_steps[int(agent.loaded), edge]))
    return Path(agent.agv, vertices, arrive, depart, arrive[-1])


#: The thesis's order of neighbours, by heading in degrees.
DOWN_UP_RIGHT_LEFT = (270, 90, 0, 180)


def ranked_edges(space: Space, headings: Sequence[int] = DOWN_UP_RIGHT_LEFT) -> IntArray:
    """The edges that leave each vertex in an order of headings, those of no such heading last; shape (m,).

    Those of vertex ``v`` stand at ``first_out[v]`` to ``first_out[v + 1]``, as in ``Lanes``.
    """
    rank = {heading: k for k, heading in enumerate(headings)}
    heading = np.rint(space.graph.heading_deg).astype(int) % 360
    order = sorted(range(len(heading)), key=lambda e: (space.lanes.tail[e], rank.get(int(heading[e]), 4), e))
    return np.array(order, dtype=np.int32)


@kernel
def estimate(u: int, v: int, xy: FloatArray, rate: float) -> int:
    """Least steps between two vertices by Manhattan distance, at so many steps per metre (consistent)."""
    return int(np.ceil(rate * (abs(xy[u, 0] - xy[v, 0]) + abs(xy[u, 1] - xy[v, 1])) - 1e-6))


@kernel
def best_edge(
    start: int, in_edge: int, goal: int, g: IntArray, closed: NDArray[np.uint8], steps: IntArray, ranked: IntArray,
    lanes: Lanes,
) -> int:  # fmt: skip
    """The edge to the neighbour of least cost + g, then least Manhattan distance to the goal, then first in order.

    Turns cost nothing here, but edges that no AGV can turn to from ``in_edge`` (-1: none) are left out.
    """
    best, best_cost, best_far = STAY, FOREVER, 0.0
    for i in range(lanes.first_out[start], lanes.first_out[start + 1]):
        e = ranked[i]
        v = lanes.head[e]
        if closed[v] or g[v] >= FOREVER:
            continue
        if in_edge >= 0 and lanes.turn_steps[0, lanes.first_transition[in_edge] + e - lanes.first_out[start]] >= NEVER:
            continue
        cost = steps[e] + g[v]
        far = abs(lanes.xy[v, 0] - lanes.xy[goal, 0]) + abs(lanes.xy[v, 1] - lanes.xy[goal, 1])
        if cost < best_cost or (cost == best_cost and far < best_far - 1e-6):
            best, best_cost, best_far = e, cost, far
    return best
