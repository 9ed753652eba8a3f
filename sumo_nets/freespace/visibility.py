"""The shortest path among polygons: a visibility graph and Dijkstra's algorithm, today's measure for every planner.

Without a clearance it is exact up to :data:`_OFF` per corner. With one, the corners' arcs are replaced by tangents
outside of them, which makes a quarter turn longer by less than one percent of the clearance.

Source: Lozano-Perez and Wesley (1979).
"""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit

from sumo_nets.freespace.floor import Floor, Point, is_clear
from sumo_nets.freespace.rrt import FreePath, free_path
from sumo_nets.graph import FloatArray

#: Paths keep this far from corners when there is no clearance to keep, in the floor's unit.
_OFF = 1e-6
#: Tangents that replace the arc round a corner, where a clearance is kept.
_TANGENTS = 4


class VisibilityGraph:
    """The corners of a floor that see each other; built once, asked often."""

    def __init__(self, floor: Floor) -> None:
        """Find the corners and who sees whom.

        Args:
            floor: the obstacles.
        """
        self.floor = floor
        corners = [p for p in _corners(floor) if floor.holds((float(p[0]), float(p[1])))]
        self._corners = np.array(corners, dtype=np.float64).reshape(-1, 2)
        self._apart = _seen(floor.edges, floor.clearance, self._corners, self._corners)

    def shortest(self, start: Point, goal: Point) -> FreePath:
        """The shortest path.

        Args:
            start, goal: free points.

        Returns:
            The path, or none.
        """
        floor, ends = self.floor, np.array([start, goal], dtype=np.float64)
        V = np.concatenate([ends, self._corners])
        n = len(V)
        apart = np.full((n, n), np.inf)
        apart[2:, 2:] = self._apart
        apart[:2] = _seen(floor.edges, floor.clearance, ends, V)
        apart[:, :2] = apart[:2].T
        return free_path(_dijkstra(V, apart), 0)


def _corners(floor: Floor) -> list[FloatArray]:
    """Points that a tight path bends at, beside every corner that sticks out into the floor."""
    corners: list[FloatArray] = []
    for polygon in floor.obstacles:
        corners += _bends(polygon, floor.clearance, 1.0)
    if floor.outline is not None:
        corners += _bends(floor.outline, floor.clearance, -1.0)
    return corners


def _bends(polygon: FloatArray, clearance: float, outwards: float) -> list[FloatArray]:
    x, y = polygon.T
    area2 = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    sense = np.sign(area2) * outwards
    bends: list[FloatArray] = []
    for before, corner, after in zip(np.roll(polygon, 1, axis=0), polygon, np.roll(polygon, -1, axis=0), strict=True):
        way_in, way_out = corner - before, after - corner
        cross, dot = way_in[0] * way_out[1] - way_in[1] * way_out[0], float(way_in @ way_out)
        turn = float(np.arctan2(cross, dot)) * sense
        if turn <= 0:
            continue
        first = np.arctan2(-way_in[0] * sense, way_in[1] * sense)
        pieces = _TANGENTS if clearance > 0 else 1
        radius = (clearance * (1 + 1e-6) + _OFF) / np.cos(turn / (2 * pieces))
        for k in range(pieces):
            angle = first + sense * turn * (k + 0.5) / pieces
            bends.append(corner + radius * np.array([np.cos(angle), np.sin(angle)]))
    return bends


@njit(cache=True)
def _seen(edges: FloatArray, clearance: float, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance between points that see each other, infinite between others, shape (len(a), len(b))."""
    apart = np.full((len(a), len(b)), np.inf)
    for i in range(len(a)):
        for j in range(len(b)):
            if is_clear(edges, clearance, a[i, 0], a[i, 1], b[j, 0], b[j, 1]):
                apart[i, j] = np.sqrt((a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2)
    return apart


def _dijkstra(V: FloatArray, apart: FloatArray) -> FloatArray:
    """Points of the shortest path from the first vertex to the second; none if there is none."""
    OPEN = [(0.0, 0)]
    g = np.full(len(V), np.inf)
    g[0] = 0.0
    parent = np.full(len(V), -1)
    while OPEN:
        g_u, u = heapq.heappop(OPEN)
        if u == 1:
            chain = [1]
            while parent[chain[-1]] >= 0:
                chain.append(int(parent[chain[-1]]))
            return V[chain[::-1]]
        if g_u > g[u]:
            continue
        through = g_u + apart[u]
        for v in np.flatnonzero(through < g).tolist():
            g[v], parent[v] = through[v], u
            heapq.heappush(OPEN, (float(g[v]), v))
    return np.empty((0, 2))
