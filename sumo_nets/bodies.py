"""Where an AGV's body is when it stands, and how far apart two standing AGVs are.

An AGV at a vertex stands with its front at the end of the lane it came by, wholly on that lane. SUMO points a body
from its rear on the lane to its front, and so does this module.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sumo_nets.graph import FloatArray, IntArray

#: Body of an AGV, loaded or not.
AGV_LENGTH_M = 5.0
AGV_WIDTH_M = 2.0
#: Least lane length on which an AGV may stand: its body and a margin for where SUMO stops it.
MIN_LANE_M = AGV_LENGTH_M + 0.3
#: Two standing AGVs closer than this count as a mistake of the layout.
MIN_GAP_M = 0.25


@dataclass(frozen=True)
class ClosestBodies:
    """The two standing AGVs with the least room between them.

    Attributes:
        gap_m: room in metres; negative if they overlap.
        first, second: lane indices; an AGV stands at the end of each.
    """

    gap_m: float
    first: int
    second: int


def standing_bodies(shapes: Sequence[FloatArray]) -> FloatArray:
    """Bodies of AGVs standing at the ends of lanes.

    Args:
        shapes: each lane's centre line in metres, shape (k, 2), in driving direction.

    Returns:
        Centre x, y and heading unit vector x, y of each body, shape (m, 4).
    """
    bodies = np.empty((len(shapes), 4))
    for row, shape in zip(bodies, shapes, strict=True):
        front = shape[-1]
        axis = front - _point_back(shape, AGV_LENGTH_M)
        axis = axis / np.hypot(*axis)
        row[:2] = front - axis * AGV_LENGTH_M / 2
        row[2:] = axis
    return bodies


def closest_standing(tail: IntArray, head: IntArray, shapes: Sequence[FloatArray]) -> ClosestBodies | None:
    """The least room between two AGVs standing at different vertices, by whatever lanes they came.

    An AGV owns its vertex and both directions of the lane it stands on, so two lanes into one vertex and the two
    directions of one lane are never occupied together.

    Args:
        tail, head: vertex indices of each lane's ends, shape (m,).
        shapes: each lane's centre line in metres.

    Returns:
        The closest pair, or None if no two AGVs can be within a body's length of each other.
    """
    bodies = standing_bodies(shapes)
    a, b = _neighbours(bodies[:, :2])
    possible = (head[a] != head[b]) & ~((head[a] == tail[b]) & (tail[a] == head[b]))
    a, b = a[possible], b[possible]
    if not len(a):
        return None
    gaps = _gaps(bodies[a], bodies[b])
    least = int(np.argmin(gaps))
    return ClosestBodies(float(gaps[least]), int(a[least]), int(b[least]))


def _point_back(shape: FloatArray, distance_m: float) -> FloatArray:
    """The point that far behind the end of a line, on the line or its straight extension."""
    left = distance_m
    for k in range(len(shape) - 1, 0, -1):
        step = float(np.hypot(*(shape[k - 1] - shape[k])))
        if step >= left or k == 1:
            break
        left -= step
    point: FloatArray = shape[k] + (shape[k - 1] - shape[k]) * (left / step)
    return point


def _neighbours(centres: FloatArray) -> tuple[IntArray, IntArray]:
    """Index pairs of points that may be within a body's reach of each other, each pair once."""
    size = float(np.hypot(AGV_LENGTH_M, AGV_WIDTH_M)) + MIN_GAP_M
    buckets: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    for i, (x, y) in enumerate(np.floor(centres / size).astype(int).tolist()):
        buckets[x, y].append(i)
    first: list[int] = []
    second: list[int] = []
    for (x, y), here in buckets.items():
        # half of the eight neighbours: the other half meets this bucket from the other side
        for beside in ((x + 1, y), (x - 1, y + 1), (x, y + 1), (x + 1, y + 1)):
            for j in buckets.get(beside, ()):
                first.extend(here)
                second.extend([j] * len(here))
        for k, i in enumerate(here):
            first.extend([i] * (len(here) - k - 1))
            second.extend(here[k + 1 :])
    return np.array(first, dtype=np.int32), np.array(second, dtype=np.int32)


def _gaps(a: FloatArray, b: FloatArray) -> FloatArray:
    """Room between pairs of bodies, shape (n,): the widest gap along any of their four axes."""
    half = np.array([AGV_LENGTH_M / 2, AGV_WIDTH_M / 2])
    between = b[:, :2] - a[:, :2]
    room = np.full(len(a), -np.inf)
    for axes in (a[:, 2:], b[:, 2:]):
        for axis in (axes, np.stack([-axes[:, 1], axes[:, 0]], axis=1)):
            reach = _half_extent(a, axis, half) + _half_extent(b, axis, half)
            room = np.maximum(room, np.abs(np.einsum("ij,ij->i", between, axis)) - reach)
    return room


def _half_extent(body: FloatArray, axis: FloatArray, half: FloatArray) -> FloatArray:
    along = np.abs(np.einsum("ij,ij->i", body[:, 2:], axis))
    across = np.abs(body[:, 2] * axis[:, 1] - body[:, 3] * axis[:, 0])
    extent: FloatArray = along * half[0] + across * half[1]
    return extent
