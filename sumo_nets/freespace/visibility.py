"""The shortest path among polygons: a visibility graph and A*, today's measure for every planner.

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
    """The corners of a floor. Which corners see each other is found when a search asks for it, and kept."""

    def __init__(self, floor: Floor) -> None:
        """Find the corners.

        Args:
            floor: the obstacles.
        """
        self.floor = floor
        corners = [p for p in _corners(floor) if floor.holds((float(p[0]), float(p[1])))]
        self._corners = np.array(corners, dtype=np.float64).reshape(-1, 2)
        self._apart: dict[int, FloatArray] = {}

    def shortest(self, start: Point, goal: Point) -> FreePath:
        """The shortest path.

        Args:
            start, goal: free points.

        Returns:
            The path, or none.
        """
        ends, V = np.array([start, goal], dtype=np.float64), self._corners
        g, to_goal = self._seen(ends, V)
        best, last = float(self._seen(ends[:1], ends[1:])[0, 0]), -1
        h = np.hypot(*(V - ends[1]).T)
        parent = np.full(len(V), -1)
        OPEN = [(float(g[v] + h[v]), v) for v in np.flatnonzero(np.isfinite(g)).tolist()]
        heapq.heapify(OPEN)
        while OPEN:
            f, u = heapq.heappop(OPEN)
            if f >= best:
                break
            if f > g[u] + h[u]:
                continue
            if g[u] + to_goal[u] < best:
                best, last = float(g[u] + to_goal[u]), u
            through = g[u] + self._from(u)
            for v in np.flatnonzero(through < g).tolist():
                g[v], parent[v] = through[v], u
                heapq.heappush(OPEN, (float(g[v] + h[v]), v))
        if not np.isfinite(best):
            return free_path(np.empty((0, 2)), 0)
        chain = []
        while last >= 0:
            chain.append(last)
            last = int(parent[last])
        return free_path(np.concatenate([ends[:1], V[chain[::-1]], ends[1:]]), 0)

    def _from(self, u: int) -> FloatArray:
        """Distance of each corner from corner u, infinite if they don't see each other."""
        if u not in self._apart:
            self._apart[u] = self._seen(self._corners[u : u + 1], self._corners)[0]
        return self._apart[u]

    def _seen(self, a: FloatArray, b: FloatArray) -> FloatArray:
        apart: FloatArray = _seen(self.floor.edges, self.floor.clearance, a, b)
        return apart


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
