"""A floor with obstacles: polygons, and the questions that path planners ask about them.

Lengths are in whatever unit the floor is given in: pixels in the experiments of paper 001, metres in floor plans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from sumo_nets.graph import FloatArray

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Floor:
    """A rectangle ``[0, width] x [0, height]`` with obstacles in it.

    Attributes:
        width, height: size of the rectangle.
        obstacles: simple polygons, each an array of corners, shape (k, 2); they may touch and overlap.
        clearance: paths stay farther than this from every obstacle; 0 forbids touching.
        outline: a simple polygon the paths stay inside of, with the clearance; without one, the rectangle's rim is
            no obstacle.
        edges: the sides of all polygons as (x0, y0, x1, y1), shape (m, 4).
    """

    width: float
    height: float
    obstacles: tuple[FloatArray, ...] = ()
    clearance: float = 0.0
    outline: FloatArray | None = None
    edges: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        polygons = [*self.obstacles, *([] if self.outline is None else [self.outline])]
        sides = [np.hstack([p, np.roll(p, -1, axis=0)]) for p in polygons]
        edges = np.concatenate(sides) if sides else np.empty((0, 4))
        object.__setattr__(self, "edges", np.ascontiguousarray(edges, dtype=np.float64))

    def holds(self, point: Point) -> bool:
        """Whether a path may pass through the point."""
        x, y = point
        if not (0 <= x <= self.width and 0 <= y <= self.height):
            return False
        if self.outline is not None and not is_inside(self.outline, x, y):
            return False
        if any(is_inside(polygon, x, y) for polygon in self.obstacles):
            return False
        return bool(is_clear(self.edges, self.clearance, x, y, x, y))

    def sees(self, a: Point, b: Point) -> bool:
        """Whether a straight path may lead from one free point to another."""
        return bool(is_clear(self.edges, self.clearance, *a, *b))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Corners of an upright rectangle, shape (4, 2)."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64)


def path_length(path: FloatArray | Sequence[Point]) -> float:
    """Length of a path given by its points, shape (k, 2)."""
    return float(np.hypot(*np.diff(np.asarray(path, dtype=np.float64), axis=0).T).sum())


@njit(cache=True)
def is_inside(polygon: FloatArray, x: float, y: float) -> bool:
    """Whether a point lies inside a polygon, by the parity of crossings; on the rim either answer."""
    inside = False
    j = len(polygon) - 1
    for i in range(len(polygon)):
        xi, yi, xj, yj = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
        if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
            inside = not inside
        j = i
    return inside


@njit(cache=True)
def is_clear(edges: FloatArray, clearance: float, ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether a segment is farther than the clearance from every edge, shape (m, 4)."""
    low_x, high_x = min(ax, bx) - clearance, max(ax, bx) + clearance
    low_y, high_y = min(ay, by) - clearance, max(ay, by) + clearance
    for i in range(len(edges)):
        cx, cy, dx, dy = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        if max(cx, dx) < low_x or min(cx, dx) > high_x or max(cy, dy) < low_y or min(cy, dy) > high_y:
            continue
        if _segments_apart2(ax, ay, bx, by, cx, cy, dx, dy) <= clearance * clearance:
            return False
    return True


@njit(cache=True)
def segments_apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Least distance of each segment of ``a``, shape (n, 4), to the segments of ``b``, shape (m, 4)."""
    apart = np.full(len(a), np.inf)
    for i in range(len(a)):
        for j in range(len(b)):
            d = _segments_apart2(a[i, 0], a[i, 1], a[i, 2], a[i, 3], b[j, 0], b[j, 1], b[j, 2], b[j, 3])
            apart[i] = min(apart[i], d)
    distances: FloatArray = np.sqrt(apart)
    return distances


@njit(cache=True)
def _segments_apart2(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> float:
    """Squared distance between segments ab and cd; 0 where they cross or touch."""
    ux, uy, vx, vy = bx - ax, by - ay, dx - cx, dy - cy
    c_side = ux * (cy - ay) - uy * (cx - ax)
    d_side = ux * (dy - ay) - uy * (dx - ax)
    a_side = vx * (ay - cy) - vy * (ax - cx)
    b_side = vx * (by - cy) - vy * (bx - cx)
    if c_side * d_side < 0 and a_side * b_side < 0:
        return 0.0
    return min(
        _point_apart2(cx, cy, ax, ay, ux, uy),
        _point_apart2(dx, dy, ax, ay, ux, uy),
        _point_apart2(ax, ay, cx, cy, vx, vy),
        _point_apart2(bx, by, cx, cy, vx, vy),
    )


@njit(cache=True)
def _point_apart2(px: float, py: float, ax: float, ay: float, ux: float, uy: float) -> float:
    """Squared distance of a point from the segment that begins at a and runs along u."""
    length2 = ux * ux + uy * uy
    t = 0.0 if length2 == 0 else min(1.0, max(0.0, ((px - ax) * ux + (py - ay) * uy) / length2))
    x, y = px - ax - t * ux, py - ay - t * uy
    return x * x + y * y
