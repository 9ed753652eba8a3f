"""Driving costs between places, for choosing AGVs, slots and bays. Other AGVs and turns are left out of the account."""

from __future__ import annotations

import heapq
from collections import OrderedDict

import numpy as np

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
        self._n = len(graph.names)
        self._into: list[list[tuple[int, int]]] = [[] for _ in range(self._n)]
        for e, (u, v) in enumerate(zip(graph.tail, graph.head, strict=True)):
            self._into[int(v)].append((int(u), int(motion.edge_steps[0, e])))
        self.expanded = 0

    def to(self, goal: int) -> IntArray:
        """Steps from each vertex to the goal, shape (n,); ``FOREVER`` where it cannot be reached."""
        table = self._tables.get(goal)
        if table is None:
            table = self._search(goal)
            self._tables[goal] = table
            if len(self._tables) > self._keep:
                self._tables.popitem(last=False)
        else:
            self._tables.move_to_end(goal)
        return table

    def _search(self, goal: int) -> IntArray:
        """Dijkstra backwards from the goal."""
        g = [FOREVER] * self._n
        g[goal] = 0
        OPEN = [(0, goal)]
        while OPEN:
            cost, v = heapq.heappop(OPEN)
            if cost > g[v]:
                continue
            self.expanded += 1
            for u, steps in self._into[v]:
                if cost + steps < g[u]:
                    g[u] = cost + steps
                    heapq.heappush(OPEN, (cost + steps, u))
        return np.array(g, dtype=np.int32)
