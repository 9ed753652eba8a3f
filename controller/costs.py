"""Driving costs between places, for choosing AGVs, slots and bays. Other AGVs and turns are left out of the account."""

from __future__ import annotations

import heapq
from collections import OrderedDict

import numpy as np
from numba import njit

from controller.types import FOREVER, Motion
from sumo_nets.graph import Graph, IntArray


class Costs:
    """Steps an empty AGV drives from every vertex to a goal, one table per goal, made when first asked for.

    Args:
        graph, motion: the garage and how long moves take.
        keep: tables kept; the one not used for longest goes first.

    Attributes:
        expanded: vertices expanded so far (the search work of slot choice).
    """

    def __init__(self, graph: Graph, motion: Motion, keep: int = 256) -> None:
        self._tables: OrderedDict[int, IntArray] = OrderedDict()
        self._keep = keep
        into = np.argsort(graph.head, kind="stable").astype(np.int32)
        first = np.searchsorted(graph.head[into], np.arange(len(graph.names) + 1)).astype(np.int32)
        self._lanes = (first, graph.tail[into], motion.edge_steps[0][into])
        self.expanded = 0

    def to(self, goal: int) -> IntArray:
        """Steps from each vertex to the goal, shape (n,); ``FOREVER`` where it cannot be reached."""
        table = self._tables.get(goal)
        if table is None:
            table, expanded = _dijkstra(goal, *self._lanes)
            self.expanded += expanded
            self._tables[goal] = table
            if len(self._tables) > self._keep:
                self._tables.popitem(last=False)
        else:
            self._tables.move_to_end(goal)
        return table


@njit(cache=True)
def _dijkstra(goal, first, tails, steps):  # type: ignore[no-untyped-def]
    """Backwards from the goal over lanes sorted by head."""
    g = np.full(len(first) - 1, FOREVER, dtype=np.int32)
    g[goal] = 0
    OPEN = [(np.int32(0), np.int32(goal))]
    expanded = 0
    while OPEN:
        cost, v = heapq.heappop(OPEN)
        if cost > g[v]:
            continue
        expanded += 1
        for k in range(first[v], first[v + 1]):
            u = tails[k]
            there = np.int32(cost + steps[k])
            if there < g[u]:
                g[u] = there
                heapq.heappush(OPEN, (there, u))
    return g, expanded
