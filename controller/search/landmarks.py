"""Landmarks: places where AGVs often start (homes, bays, chargers), with exact steps from there to each edge.

A landmark's table, made once by Dijkstra's algorithm, says how many steps it takes at least until each edge has been
driven. A search that sets out from a landmark goes straight by it. To all other searches the triangle inequality gives
a bound (ALT, Goldberg and Harrelson 2005): from edge e to a goal it takes at least what it takes from a landmark to
the goal less what it takes from the landmark to e, turns included. More blocked vertices only make ways longer.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.space import EXPANDED, GENERATED, HEAP_MOVES, VALID, Lanes, Space
from controller.types import FOREVER, NEVER
from sumo_nets.graph import IntArray
from sumo_nets.numbering import Vertex

#: Greatest number of landmarks; more landmarks hardly improve the bounds.
MOST_IN_BOUNDS = 16


class Bounds(NamedTuple):
    """Data of the landmarks about one goal.

    Attributes:
        tables: steps from each of k landmarks until each edge has been driven, shape (k, m).
        to_goal: steps from each of them to the goal, shape (k,).
    """

    tables: IntArray
    to_goal: IntArray


class Landmarks:
    """The tables of a garage, made when an AGV first starts from a landmark.

    Args:
        space: the garage.
        ends: shape (n,), 1 at vertices that are never driven through.

    Attributes:
        vertices: where landmarks are.
    """

    def __init__(self, space: Space, ends: NDArray[np.uint8]) -> None:
        roles = space.graph.roles
        self.vertices = frozenset((*roles["home"], *roles["bay"], *roles["charger"]))
        self._lanes = space.lanes
        self._ends = ends
        self._tables: dict[tuple[Vertex, bool], IntArray] = {}
        none = np.zeros((0, len(space.lanes.tail)), dtype=np.int32)
        self._stacked: dict[bool, IntArray] = {False: none, True: none}
        self._bounds: dict[tuple[Vertex, bool], Bounds] = {}

    def steps_from(self, vertex: Vertex, loaded: bool, counters: NDArray[np.int64]) -> IntArray:
        """Steps from a landmark until each edge has been driven, shape (m,); ``FOREVER`` where there is no way."""
        table = self._tables.get((vertex, loaded))
        if table is None:
            table = _dijkstra(vertex, loaded, self._lanes, self._ends, counters)
            self._tables[vertex, loaded] = table
            if len(self._stacked[loaded]) < MOST_IN_BOUNDS:
                self._stacked[loaded] = np.vstack((self._stacked[loaded], table[None]))
                self._bounds.clear()
        return table

    def bounds(self, goal: Vertex, loaded: bool) -> Bounds:
        """What the tables made so far say about a goal."""
        bounds = self._bounds.get((goal, loaded))
        if bounds is None:
            tables, lanes = self._stacked[loaded], self._lanes
            into = lanes.in_edges[lanes.first_in[goal] : lanes.first_in[goal + 1]]
            bounds = Bounds(tables, tables[:, into].min(axis=1, initial=FOREVER))
            self._bounds[goal, loaded] = bounds
        return bounds


@kernel
def at_least(edge: int, bounds: Bounds) -> int:
    """A bound below the steps from the head of an edge to the goal; 0 at least."""
    most = 0
    for k in range(len(bounds.to_goal)):
        most = max(most, bounds.to_goal[k] - bounds.tables[k, edge])
    return most


@njit(cache=True)
def _dijkstra(start: int, loaded: bool, lanes: Lanes, ends: NDArray[np.uint8], counters: NDArray[np.int64]) -> IntArray:
    """Least steps from a vertex until each edge has been driven, the first one without a turn."""
    row = int(loaded)
    g = np.full(len(lanes.tail), FOREVER, dtype=np.int32)
    OPEN = [(np.int32(0), np.int32(0))]
    OPEN.pop()
    for e in range(lanes.first_out[start], lanes.first_out[start + 1]):
        g[e] = lanes.edge_steps[row, e]
        heapq.heappush(OPEN, (g[e], np.int32(e)))
    while OPEN:
        cost, last = heapq.heappop(OPEN)
        if cost > g[last]:
            continue
        counters[EXPANDED] += 1
        counters[VALID] += 1
        v = lanes.head[last]
        if ends[v]:
            continue
        for out in range(lanes.first_out[v], lanes.first_out[v + 1]):
            turn = lanes.turn_steps[row, lanes.first_transition[last] + out - lanes.first_out[v]]
            there = np.int32(cost + turn + lanes.edge_steps[row, out])
            if turn < NEVER and there < g[out]:
                g[out] = there
                counters[GENERATED] += 1
                counters[HEAP_MOVES] += 1
                heapq.heappush(OPEN, (there, np.int32(out)))
    return g
