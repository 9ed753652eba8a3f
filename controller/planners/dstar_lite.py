"""D* Lite: one move at a time, by a search that is kept and repaired (Koenig and Likhachev 2002, 2005).

Each AGV has a search of its own, from its goal back to where it stands, begun anew with each goal. Before a move the
obstacles are announced and the search is repaired; after it the announcement is taken back (thesis 2025, III-3.2). The
algorithm is the optimized version of the 2005 paper, Figure 4, in its symbols; cars that were parked or fetched since
the last move are changes of the same kind as announced obstacles. Turns are left out of the costs, as in the thesis.

Departure from the paper: what changes is the cost of all edges into a vertex at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.planners.one_step import OneStep, best_edge, estimate, ranked_edges
from controller.search.heap import Counts, Heap, clear, make_heap, put, take
from controller.search.space import EXPANDED, VALID, Lanes, Space
from controller.types import FOREVER, AgvNumber, Motion, PlanAgent
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import EdgeIndex, Vertex

#: Places of ``Memory.meta``.
GOAL, LOADED, LAST, KM = 0, 1, 2, 3


class Memory(NamedTuple):
    """One AGV's search.

    Attributes:
        g, rhs: steps to the goal as found, and one step ahead, shape (n,); ``FOREVER`` is infinity.
        closed: shape (n,), 1 where an edge into the vertex costs infinity.
        U: the queue of inconsistent vertices.
        meta: the goal (-1 before the first), 1 if loaded, ``s_last`` and ``k_m``.
    """

    g: IntArray
    rhs: IntArray
    closed: NDArray[np.uint8]
    U: Heap
    meta: NDArray[np.int64]


class DStarLite:
    """One search for each AGV, kept between moves.

    Attributes:
        counters: search work so far, see ``controller.types.Counters``; an expansion is valid unless the vertex's key
            was out of date or its g had to be raised.
    """

    def __init__(self, space: Space) -> None:
        self.counters: Counts = np.zeros(4, dtype=np.int64)
        self._space = space
        self._ranked = ranked_edges(space)
        self._memory: dict[AgvNumber, Memory] = {}

    def next_edge(self, agent: PlanAgent, blocked: NDArray[np.uint8], obstacles: Iterable[Vertex]) -> EdgeIndex:
        """See ``MoveSearch.next_edge``."""
        announced = np.array(list(obstacles), dtype=np.int32)
        return self.announced_edge(agent, blocked, announced)[0]

    def announced_edge(
        self, agent: PlanAgent, blocked: NDArray[np.uint8], announced: IntArray
    ) -> tuple[EdgeIndex, int]:
        """Announce, repair, step, take back.

        Args:
            agent, blocked: see ``MoveSearch.next_edge``.
            announced: vertices that may not be entered for the moment.

        Returns:
            The first edge of a shortest path (``STAY`` if there is none) and the path's steps (``FOREVER``).
        """
        base = blocked.copy()
        base[agent.goal] = 0
        wanted = base.copy()
        wanted[announced] = 1
        memory = self.repair(agent, wanted)
        lanes, steps, rate = self._edges(agent)
        cost = int(memory.rhs[agent.vertex])
        edge = best_edge(agent.vertex, agent.in_edge, agent.goal, memory.g, memory.closed, steps, self._ranked, lanes)
        _change(agent.vertex, base, steps, rate, lanes, memory, self.counters)
        return EdgeIndex(int(edge)), cost

    def repair(self, agent: PlanAgent, closed: NDArray[np.uint8]) -> Memory:
        """Bring an AGV's search up to date, or begin it anew for a new goal.

        Args:
            agent: the agent, not at its goal.
            closed: shape (n,), 1 where no AGV may drive.

        Returns:
            The search; g is exact along the shortest paths from where the agent stands.
        """
        lanes, steps, rate = self._edges(agent)
        loaded = int(agent.loaded)
        memory = self._memory.setdefault(agent.agv, _new_memory(len(closed)))
        if (memory.meta[GOAL], memory.meta[LOADED]) != (agent.goal, loaded):
            _initialize(agent.vertex, agent.goal, loaded, closed, rate, lanes, memory, self.counters)
        _change(agent.vertex, closed, steps, rate, lanes, memory, self.counters)
        _compute_shortest_path(agent.vertex, steps, rate, lanes, memory, self.counters)
        return memory

    def _edges(self, agent: PlanAgent) -> tuple[Lanes, IntArray, float]:
        """The lanes, the steps over each edge, and least steps per metre."""
        loaded = int(agent.loaded)
        return self._space.lanes, self._space.lanes.edge_steps[loaded], float(self._space.rates[loaded, 0])


def _new_memory(n: int) -> Memory:
    g, rhs = (np.full(n, FOREVER, dtype=np.int32) for _ in range(2))
    return Memory(g, rhs, np.zeros(n, dtype=np.uint8), make_heap(n), np.array([-1, 0, -1, 0], dtype=np.int64))


@kernel
def _initialize(
    s_start: int,
    goal: int,
    loaded: int,
    blocked: NDArray[np.uint8],
    rate: float,
    lanes: Lanes,
    memory: Memory,
    counters: Counts,
) -> None:
    g, rhs, closed, U, meta = memory
    g[:] = FOREVER
    rhs[:] = FOREVER
    for v in range(len(blocked)):
        closed[v] = blocked[v]
    closed[goal] = 0
    clear(U)
    meta[GOAL], meta[LOADED], meta[LAST], meta[KM] = goal, loaded, s_start, 0
    rhs[goal] = 0
    put(goal, _calculate_key(goal, s_start, rate, lanes, memory), U, counters)


@kernel
def _calculate_key(s: int, s_start: int, rate: float, lanes: Lanes, memory: Memory) -> int:
    """``[min(g, rhs) + h + k_m; min(g, rhs)]`` in one integer."""
    least = np.int64(min(memory.g[s], memory.rhs[s]))
    return int(((least + estimate(s_start, s, lanes.xy, rate) + memory.meta[KM]) << 32) | least)


@kernel
def _update_vertex(u: int, s_start: int, rate: float, lanes: Lanes, memory: Memory, counters: Counts) -> None:
    if memory.g[u] != memory.rhs[u]:
        put(u, _calculate_key(u, s_start, rate, lanes, memory), memory.U, counters)
    elif memory.U.place[u] >= 0:
        take(u, memory.U, counters)


@kernel
def _through(e: int, g: int, steps: IntArray, closed: int) -> int:
    """``c + g`` over an edge whose head has that g and is closed or not."""
    return FOREVER if closed or g >= FOREVER else int(steps[e] + g)


@kernel
def _one_step_ahead(s: int, steps: IntArray, lanes: Lanes, memory: Memory) -> int:
    """The least ``c(s, s') + g(s')`` over all successors."""
    least = FOREVER
    for e in range(lanes.first_out[s], lanes.first_out[s + 1]):
        least = min(least, _through(e, memory.g[lanes.head[e]], steps, memory.closed[lanes.head[e]]))
    return least


@kernel
def _compute_shortest_path(
    s_start: int, steps: IntArray, rate: float, lanes: Lanes, memory: Memory, counters: Counts
) -> None:
    g, rhs, closed, U, meta = memory
    while U.size[0] and (
        U.key[U.items[0]] < _calculate_key(s_start, s_start, rate, lanes, memory) or rhs[s_start] > g[s_start]
    ):
        u = U.items[0]
        counters[EXPANDED] += 1
        k_new = _calculate_key(u, s_start, rate, lanes, memory)
        if U.key[u] < k_new:
            put(u, k_new, U, counters)
            continue
        g_old = g[u]
        if g_old > rhs[u]:
            counters[VALID] += 1
            g[u] = rhs[u]
            take(u, U, counters)
        else:
            g[u] = FOREVER
            _update_vertex(u, s_start, rate, lanes, memory, counters)
        for i in range(lanes.first_in[u], lanes.first_in[u + 1]):
            e = lanes.in_edges[i]
            s = lanes.tail[e]
            if s == meta[GOAL]:
                continue
            if g[u] < FOREVER:
                rhs[s] = min(rhs[s], _through(e, g[u], steps, closed[u]))
            elif rhs[s] == _through(e, g_old, steps, closed[u]):
                rhs[s] = _one_step_ahead(s, steps, lanes, memory)
            _update_vertex(s, s_start, rate, lanes, memory, counters)


@kernel
def _change(
    s_start: int,
    wanted: NDArray[np.uint8],
    steps: IntArray,
    rate: float,
    lanes: Lanes,
    memory: Memory,
    counters: Counts,
) -> None:
    """Close and open vertices until ``closed`` is as wanted, and make rhs and the queue right again."""
    g, rhs, closed, _, meta = memory
    for v in range(len(wanted)):
        if closed[v] == wanted[v]:
            continue
        if meta[LAST] != s_start:
            meta[KM] += estimate(meta[LAST], s_start, lanes.xy, rate)
            meta[LAST] = s_start
        before = closed[v]
        closed[v] = wanted[v]
        for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
            e = lanes.in_edges[i]
            u = lanes.tail[e]
            if u == meta[GOAL]:
                continue
            if before:
                rhs[u] = min(rhs[u], _through(e, g[v], steps, 0))
            elif rhs[u] == _through(e, g[v], steps, 0):
                rhs[u] = _one_step_ahead(u, steps, lanes, memory)
            _update_vertex(u, s_start, rate, lanes, memory, counters)


def make_dstar_lite(graph: Graph, motion: Motion, options: None = None) -> OneStep:
    """The thesis's D* Lite for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: none.

    Returns:
        The planner; call it with a problem.
    """
    return OneStep(DStarLite(Space(graph, motion)))
