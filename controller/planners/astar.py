"""A*: one move at a time, each by a fresh search (thesis 2025, III-3.1; Hart, Nilsson and Raphael 1968).

The search runs backwards from the goal to the agent, like D* Lite. Both searches therefore know g, the steps to the
goal, at the agent's neighbours, and break ties alike. OPEN, the queue of the search, is ordered by f = g + h, then by
smaller g; h is a lower bound on the steps left. The costs ignore turns, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.planners.one_step import OneStep, best_edge, estimate, ranked_edges
from controller.search.heap import Counts, Heap, clear, make_heap, put, take
from controller.search.space import EXPANDED, VALID, Lanes, Space
from controller.types import FOREVER, Motion, PlanAgent
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import EdgeIndex, Vertex


class AStar:
    """A fresh search for each move.

    Attributes:
        counters: search work so far, see ``controller.types.Counters``.
    """

    def __init__(self, space: Space) -> None:
        self.counters: Counts = np.zeros(4, dtype=np.int64)
        self._space = space
        self._ranked = ranked_edges(space)
        n = len(space.graph.names)
        self._g: IntArray = np.full(n, FOREVER, dtype=np.int32)
        self._heap = make_heap(n)

    def next_edge(self, agent: PlanAgent, blocked: NDArray[np.uint8], obstacles: Iterable[Vertex]) -> EdgeIndex:
        """See ``MoveSearch.next_edge``."""
        closed = blocked.copy()
        closed[agent.goal] = 0
        closed[list(obstacles)] = 1
        lanes, loaded = self._space.lanes, int(agent.loaded)
        steps, rate = lanes.edge_steps[loaded], float(self._space.rates[loaded, 0])
        _search(agent.vertex, agent.goal, closed, steps, rate, lanes, self._g, self._heap, self.counters)
        edge = best_edge(agent.vertex, agent.in_edge, agent.goal, self._g, closed, steps, self._ranked, lanes)
        return EdgeIndex(int(edge))


@kernel
def _search(
    start: int,
    goal: int,
    closed: NDArray[np.uint8],
    steps: IntArray,
    rate: float,
    lanes: Lanes,
    g: IntArray,
    OPEN: Heap,
    counters: Counts,
) -> None:
    """Fill ``g`` with steps to the goal as far as the start needs it; closed vertices can't be entered."""
    g[:] = FOREVER
    clear(OPEN)
    if closed[goal]:
        return
    g[goal] = 0
    put(goal, _key(estimate(start, goal, lanes.xy, rate), 0), OPEN, counters)
    while OPEN.size[0]:
        v = OPEN.items[0]
        if v == start:
            return
        take(v, OPEN, counters)
        counters[EXPANDED] += 1
        counters[VALID] += 1
        for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
            e = lanes.in_edges[i]
            u = lanes.tail[e]
            cost = g[v] + steps[e]
            if cost < g[u] and (not closed[u] or u == start):
                g[u] = cost
                put(u, _key(cost + estimate(start, u, lanes.xy, rate), cost), OPEN, counters)


@kernel
def _key(f: int, g: int) -> int:
    return (f << 32) | g


def make_astar(graph: Graph, motion: Motion, options: None = None) -> OneStep:
    """The thesis's A* for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: none.

    Returns:
        The planner; call it with a problem.
    """
    return OneStep(AStar(Space(graph, motion)))
