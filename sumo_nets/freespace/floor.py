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
    _solid: FloatArray = field(init=False)
    _rim: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_solid", _sides(self.obstacles))
        object.__setattr__(self, "_rim", _sides(() if self.outline is None else (self.outline,)))
        object.__setattr__(self, "edges", np.concatenate([self._solid, self._rim]))

    def holds(self, point: Point) -> bool:
        """Whether a path may pass through the point."""
        x, y = point
        if not (0 <= x <= self.width and 0 <= y <= self.height):
            return False
        if winding(self._solid, x, y) != 0 or (len(self._rim) and winding(self._rim, x, y) == 0):
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


def _sides(polygons: Sequence[FloatArray]) -> FloatArray:
    """Sides of polygons, all turning the same way, as (x0, y0, x1, y1), shape (m, 4)."""
    sides = [np.empty((0, 4))]
    for polygon in polygons:
        x, y = polygon.T
        turned = polygon if x @ np.roll(y, -1) >= y @ np.roll(x, -1) else polygon[::-1]
        sides.append(np.hstack([turned, np.roll(turned, -1, axis=0)]))
    return np.ascontiguousarray(np.concatenate(sides), dtype=np.float64)


@njit(cache=True)
def winding(sides: FloatArray, x: float, y: float) -> int:
    """How many of the polygons with these sides hold the point; on a rim either answer."""
    turns = 0
    for i in range(len(sides)):
        ax, ay, bx, by = sides[i, 0] - x, sides[i, 1] - y, sides[i, 2] - x, sides[i, 3] - y
        if ay <= 0 < by and ax * by > bx * ay:
            turns += 1
        elif by <= 0 < ay and ax * by < bx * ay:
            turns -= 1
    return turns


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
def room_around(bodies: FloatArray, length: float, width: float, edges: FloatArray, reach: float) -> FloatArray:
    """Room between bodies and edges.

    Args:
        bodies: centre x, y and heading unit vector x, y of each body, shape (n, 4).
        length, width: size of a body.
        edges: shape (m, 4).
        reach: room is not measured beyond this.

    Returns:
        Least distance of each body's rectangle to an edge, shape (n,): 0 if they touch or overlap, ``reach`` at most.
    """
    room = np.full(len(bodies), reach * reach)
    far = reach + np.hypot(length, width) / 2
    half_l, half_w = length / 2, width / 2
    for i in range(len(bodies)):
        x, y, hx, hy = bodies[i, 0], bodies[i, 1], bodies[i, 2], bodies[i, 3]
        for j in range(len(edges)):
            ax, ay, bx, by = edges[j, 0] - x, edges[j, 1] - y, edges[j, 2] - x, edges[j, 3] - y
            if min(ax, bx) > far or max(ax, bx) < -far or min(ay, by) > far or max(ay, by) < -far:
                continue
            # in the body's frame: u forwards, v to the left
            au, av, bu, bv = ax * hx + ay * hy, ay * hx - ax * hy, bx * hx + by * hy, by * hx - bx * hy
            if abs(au) <= half_l and abs(av) <= half_w:
                room[i] = 0.0
                break
            d = min(
                _segments_apart2(au, av, bu, bv, -half_l, -half_w, half_l, -half_w),
                _segments_apart2(au, av, bu, bv, -half_l, half_w, half_l, half_w),
                _segments_apart2(au, av, bu, bv, -half_l, -half_w, -half_l, half_w),
                _segments_apart2(au, av, bu, bv, half_l, -half_w, half_l, half_w),
            )
            room[i] = min(room[i], d)
    distances: FloatArray = np.sqrt(room)
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
