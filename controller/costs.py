"""Driving costs between places, for choosing AGVs, slots and bays. Other AGVs are ignored.

``to`` and ``out_of`` ignore turns and let AGVs pass every slot; their tables are computed once for each place.
``turning_to`` and ``turning_to_any`` count turns, except the first one, and use slots only where no other way exists.
``around`` treats the cars parked at present as walls.
"""

from __future__ import annotations

import heapq
from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.search.space import Space
from controller.types import FOREVER, NEVER, Motion
from sumo_nets.graph import FloatArray, Graph, IntArray
from sumo_nets.numbering import Vertex


class Costs:
    """Steps that an empty AGV drives to a place, or from a place. Tables are computed on demand.

    Args:
        graph, motion: the garage, and the duration of each move.
        blocked: 1 where no AGV may drive at present, shape (n,); ``around`` reads it at each call.
        max_bytes: memory limit for tables. The least recently used table is dropped first. Allow at least one table for
            each AGV.

    Attributes:
        blocked: see above.
        expanded: number of vertices expanded so far.
    """

    def __init__(self, graph: Graph, motion: Motion, blocked: NDArray[np.uint8], max_bytes: int = 1 << 28) -> None:
        self.step_s = motion.step_s
        self._tables: OrderedDict[tuple[Vertex, str], IntArray] = OrderedDict()
        self._keep = max(256, max_bytes // (4 * len(graph.names)))
        into = np.argsort(graph.head, kind="stable").astype(np.int32)
        first = np.searchsorted(graph.head[into], np.arange(len(graph.names) + 1)).astype(np.int32)
        self._into = (first, graph.tail[into], motion.edge_steps[0][into])
        self._out_of = (graph.first_out, graph.head, motion.edge_steps[0])
        self.blocked = blocked
        self._open = np.zeros_like(blocked)
        self._slots = np.zeros_like(blocked)
        self._slots[list(graph.slots)] = 1
        self._lanes = Space(graph, motion).lanes
        self.expanded = 0

    def to(self, goal: Vertex) -> IntArray:
        """Steps from each vertex to the goal, shape (n,); ``FOREVER`` where there is no way."""
        return self._kept(goal, "to", lambda: _dijkstra(goal, self._open, *self._into))

    def out_of(self, start: Vertex) -> IntArray:
        """Steps from a vertex to every vertex, shape (n,). One-way lanes make this differ from ``to``."""
        return self._kept(start, "out_of", lambda: _dijkstra(start, self._open, *self._out_of))

    def turning_to(self, goal: Vertex, loaded: bool = False) -> IntArray:
        """Steps from each vertex to the goal with turns counted, shape (n,); ``FOREVER`` where there is no way."""
        return self._kept(goal, "loaded" if loaded else "empty", lambda: self._to_one(goal, loaded))

    def _to_one(self, goal: Vertex, loaded: bool) -> tuple[IntArray, int]:
        table, expanded = self._turning([goal], [0.0], loaded)
        return table.astype(np.int32), expanded

    def turning_to_any(self, goals: Sequence[Vertex], more: Sequence[float]) -> FloatArray:
        """From each vertex, the least steps to any goal plus the extra cost of that goal in ``more``, shape (n,)."""
        table, expanded = self._turning(goals, more, False)
        self.expanded += expanded
        return table

    def _turning(self, goals: Sequence[Vertex], more: Sequence[float], loaded: bool) -> tuple[FloatArray, int]:
        vertices, extra = np.array(goals, dtype=np.int32), np.array(more)
        table, expanded = _towards(vertices, extra, loaded, self._slots, self._lanes)
        cut_off = table >= FOREVER
        if cut_off.any():
            through_slots, further = _towards(vertices, extra, loaded, self._open, self._lanes)
            table[cut_off] = through_slots[cut_off]
            expanded += further
        return table, expanded

    def _kept(self, vertex: Vertex, kind: str, make: Callable[[], tuple[IntArray, int]]) -> IntArray:
        table = self._tables.get((vertex, kind))
        if table is None:
            table, expanded = make()
            self.expanded += expanded
            self._tables[vertex, kind] = table
            if len(self._tables) > self._keep:
                self._tables.popitem(last=False)
        else:
            self._tables.move_to_end((vertex, kind))
        return table

    def around(self, start: Vertex, blocked: NDArray[np.uint8] | None = None) -> IntArray:
        """Steps from a vertex to every vertex, shape (n,), by ways around parked cars, or around ``blocked`` vertices.

        A way may end at a blocked vertex. ``FOREVER`` where there is no way.
        """
        table: IntArray
        table, expanded = _dijkstra(start, self.blocked if blocked is None else blocked, *self._out_of)
        self.expanded += expanded
        return table

    def way(self, start: Vertex, goal: Vertex, walls: NDArray[np.uint8]) -> list[Vertex]:
        """Vertices of a shortest way around all walls, without the start; empty if there is none. Turns are ignored."""
        way = _descend(start, goal, self.to(goal), walls, *self._out_of)
        if not len(way):
            table, expanded = _dijkstra(goal, walls, *self._into)
            self.expanded += expanded
            way = _descend(start, goal, table, walls, *self._out_of)
        return [Vertex(v) for v in way.tolist()]

    def has_way(self, start: Vertex, goal: Vertex, walls: NDArray[np.uint8]) -> bool:
        """Whether there is a way around all walls; the goal may be one. Turns are ignored."""
        return start == goal or bool(self.way(start, goal, walls))


@njit(cache=True)
def _descend(start, goal, to, walls, first, heads, steps):  # type: ignore[no-untyped-def]
    """Follow the lanes along which the steps to the goal decrease. Empty if walls stand in the way."""
    way = np.empty(len(to), dtype=np.int64)
    size, v = 0, start
    while v != goal and to[v] < FOREVER:
        ahead = -1
        for k in range(first[v], first[v + 1]):
            u = heads[k]
            if (u == goal or not walls[u]) and to[u] + steps[k] == to[v] and (ahead < 0 or u < ahead):
                ahead = u
        if ahead < 0:
            break
        v = ahead
        way[size] = v
        size += 1
    return way[:size] if v == goal else way[:0]


@njit(cache=True)
def _dijkstra(root, blocked, first, ends, steps):  # type: ignore[no-untyped-def]
    """Search outward from the root; ``ends`` holds the far end of each lane. Blocked vertices are not passed."""
    g = np.full(len(first) - 1, FOREVER, dtype=np.int32)
    g[root] = 0
    OPEN = [(np.int32(0), np.int32(root))]
    expanded = 0
    while OPEN:
        cost, v = heapq.heappop(OPEN)
        if cost > g[v]:
            continue
        expanded += 1
        if blocked[v] and v != root:
            continue
        for k in range(first[v], first[v + 1]):
            u = ends[k]
            there = np.int32(cost + steps[k])
            if there < g[u]:
                g[u] = there
                heapq.heappush(OPEN, (there, u))
    return g, expanded


@njit(cache=True)
def _towards(goals, more, loaded, ends, lanes):  # type: ignore[no-untyped-def]
    """Search backwards from several goals over edges, so that turns count. Each goal starts at its extra cost.

    OPEN, the queue of the search, holds edges with the cost from their head onwards. Vertices in ``ends`` are reached
    but never driven through.
    """
    row = int(loaded)
    cost = np.full(len(lanes.first_out) - 1, float(FOREVER))
    g = np.full(len(lanes.tail), float(FOREVER))
    OPEN = [(0.0, np.int32(0)) for _ in range(0)]
    for k in range(len(goals)):
        cost[goals[k]] = min(cost[goals[k]], more[k])
        for i in range(lanes.first_in[goals[k]], lanes.first_in[goals[k] + 1]):
            e = lanes.in_edges[i]
            if more[k] < g[e]:
                g[e] = more[k]
                heapq.heappush(OPEN, (g[e], np.int32(e)))
    expanded = 0
    while OPEN:
        reached, out = heapq.heappop(OPEN)
        if reached > g[out]:
            continue
        expanded += 1
        v = lanes.tail[out]
        there = reached + lanes.edge_steps[row, out]
        cost[v] = min(cost[v], there)
        if ends[v]:
            continue
        for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
            e = lanes.in_edges[i]
            turn = lanes.turn_steps[row, lanes.first_transition[e] + out - lanes.first_out[v]]
            if turn >= NEVER or there + turn >= g[e]:
                continue
            g[e] = there + turn
            if ends[lanes.tail[e]]:
                cost[lanes.tail[e]] = min(cost[lanes.tail[e]], g[e] + lanes.edge_steps[row, e])
            else:
                heapq.heappush(OPEN, (g[e], np.int32(e)))
    return cost, expanded
