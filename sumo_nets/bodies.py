"""Where an AGV's body is, and how far apart two AGVs are at their closest.

An AGV at a vertex stands with its front at the end of the lane it came by, wholly on that lane. SUMO points a body
from where its rear is on its lanes to its front and draws its full length behind the front, so that it swings out a
little behind while it turns. This module does the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sumo_nets.graph import FloatArray, IntArray
from sumo_nets.numbering import EdgeIndex, Numbered, numbers

#: Body of an AGV, loaded or not. On the 6.5 m cells of the thesis 5 m would touch an AGV ahead in a 90-degree turn.
AGV_LENGTH_M = 4.7
AGV_WIDTH_M = 2.0
AGV_SIZE_M = (AGV_LENGTH_M, AGV_WIDTH_M)
#: Room between a body on its lane and the side of one that crosses behind it.
REAR_MARGIN_M = 0.05
#: AGVs closer than this count as a mistake of the layout.
MIN_GAP_M = 0.2
#: A moving body is looked at each time its front has come this much further.
_SAMPLE_M = 0.4
#: The same where a rear has to be clear of others, and the room left then.
_CLEAR_STEP_M = 0.15
CLEAR_M = 0.05
_FOLD_COSINE = -0.9
#: Moving bodies looked at in one go; bounds the memory.
_BATCH = 20_000


@dataclass(frozen=True)
class ClosestBodies:
    """The two AGVs with the least room between them.

    Attributes:
        gap_m: room in metres; negative if they overlap.
        first, second: lane indices. An AGV stands at the end of ``second``; the other one stands at the end of
            ``first`` or is driving onto it.
    """

    gap_m: float
    first: EdgeIndex
    second: EdgeIndex


def least_way_m(size_m: tuple[float, float]) -> float:
    """Least way from a vertex's centre to the end of a lane: a body stands there, another one crosses behind it.

    Args:
        size_m: length and width of the bodies.
    """
    return size_m[0] + size_m[1] / 2 + REAR_MARGIN_M


def chord_m(shape: FloatArray, length_m: float) -> float:
    """Straight distance in metres from the front to the rear of a body that stands at the end of a lane."""
    return float(np.hypot(*_rear_from_origin(seen_from(shape[-1], shape), length_m)))


def standing_bodies(shapes: Collection[FloatArray], length_m: float = AGV_LENGTH_M) -> FloatArray:
    """Bodies of AGVs standing at the ends of lanes.

    Args:
        shapes: each lane's centre line in metres, shape (k, 2), in driving direction.
        length_m: of the bodies.

    Returns:
        Centre x, y and heading unit vector x, y of each body, shape (m, 4).
    """
    fronts = np.array([shape[-1] for shape in shapes])
    rears = [_rear_from_origin(seen_from(front, shape), length_m) for front, shape in zip(fronts, shapes, strict=True)]
    return _bodies(fronts + np.array(rears), fronts, length_m)


def bodies_along(way: FloatArray, fronts_m: FloatArray, length_m: float) -> FloatArray:
    """Bodies of an AGV that drives along a line.

    Args:
        way: the line in metres, shape (k, 2), in driving direction.
        fronts_m: where the front is, in metres from the line's beginning, shape (n,).
        length_m: of the body.

    Returns:
        Bodies as in :func:`standing_bodies`, shape (n, 4).
    """
    return _bodies(_interpolate(way, fronts_m - length_m), _interpolate(way, fronts_m), length_m)


def closest_standing(
    tail: IntArray, head: IntArray, shapes: Numbered[EdgeIndex, FloatArray], size_m: tuple[float, float] = AGV_SIZE_M
) -> ClosestBodies | None:
    """The least room between two AGVs standing at different vertices, by whatever lanes they came.

    An AGV owns its vertex and both directions of the lane it stands on, so two lanes into one vertex and the two
    directions of one lane are never occupied together.

    Args:
        tail, head: vertex indices of each lane's ends, shape (m,).
        shapes: each lane's centre line in metres.
        size_m: length and width of the bodies.

    Returns:
        The closest pair, or None if no two AGVs can be within a body's length of each other.
    """
    bodies = standing_bodies(shapes, size_m[0])
    a, b = _close_pairs(bodies, bodies, size_m)
    possible = (a < b) & (head[a] != head[b]) & ~_twins(tail, head, a, b)
    lanes = np.arange(len(bodies), dtype=np.int32)
    return _least((bodies[a[possible]], bodies[b[possible]]), (lanes[a[possible]], lanes[b[possible]]), size_m)


def closest_moving(
    tail: IntArray, head: IntArray, shapes: Numbered[EdgeIndex, FloatArray], size_m: tuple[float, float] = AGV_SIZE_M
) -> ClosestBodies | None:
    """The least room between an AGV driving from one lane onto the next and one standing elsewhere.

    Every way through every vertex is driven in small steps, but for those that fold back into a spur beside the one
    left, where SUMO turns the body about at once, as in a reversal. The moving AGV owns both directions of both
    lanes, the vertex between them and the one ahead; everywhere else an AGV may stand, the vertex behind included.

    Args:
        tail, head: vertex indices of each lane's ends, shape (m,).
        shapes: each lane's centre line in metres.
        size_m: length and width of the bodies.

    Returns:
        The closest pair, or None if no two AGVs can be within a body's length of each other.
    """
    standing = standing_bodies(shapes, size_m[0])
    least: ClosestBodies | None = None
    for moving, before, onto in driving_bodies(tail, head, shapes, size_m[0]):
        a, b = _close_pairs(moving, standing, size_m)
        free = (head[b] != head[before[a]]) & (head[b] != head[onto[a]])
        free &= ~_twins(tail, head, before[a], b) & ~_twins(tail, head, onto[a], b)
        found = _least((moving[a[free]], standing[b[free]]), (onto[a[free]], b[free]), size_m)
        if found is not None and (least is None or found.gap_m < least.gap_m):
            least = found
    return least


def clear_of_ways(
    ways: Sequence[FloatArray], leaving: FloatArray, least_m: float, size_m: tuple[float, float] = AGV_SIZE_M
) -> float:
    """How far an AGV's rear must be along the lane it leaves by before no AGV on the lanes behind can touch it.

    On a slanted lane a body's corner comes across the lanes beside it before it is where it stops, and in a turn its
    rear swings out.

    Args:
        ways: lines that others may drive along, from the beginning of the lane by which they come.
        leaving: centre line from the vertex's centre on, of the lane that is driven off by.
        least_m: at least so far from the centre.
        size_m: length and width of the bodies.

    Returns:
        Metres from the vertex's centre; at most where the body ends with the lane.
    """
    length_m = size_m[0]
    most_m = line_m(leaving) - length_m
    if most_m <= least_m or not ways:
        return least_m
    rears = np.append(np.arange(least_m, most_m, _CLEAR_STEP_M), most_m)
    off = bodies_along(leaving, rears + length_m, length_m)
    driven = []
    for way in ways:
        fronts = np.append(np.arange(length_m, line_m(way), _CLEAR_STEP_M), line_m(way))
        driven.append(bodies_along(way, fronts, length_m))
    others = np.concatenate(driven)
    gaps = gaps_m(np.repeat(off, len(others), axis=0), np.tile(others, (len(off), 1)), size_m).reshape(len(off), -1)
    touching = np.flatnonzero(gaps.min(axis=1) < CLEAR_M)
    return float(rears[min(touching[-1] + 1, len(rears) - 1)]) if len(touching) else least_m


def ways_past(into: Sequence[FloatArray], out_of: Sequence[FloatArray]) -> list[FloatArray]:
    """Lines along which a vertex can be driven to and through.

    Args:
        into, out_of: centre lines of lanes into a vertex and out of it, in driving direction.

    Returns:
        Each lane in alone, and each with each lane out but for those that fold back.
    """
    through = [np.concatenate([a, b]) for a in into for b in out_of if not _folds_back(a, b)]
    return [*into, *through]


def driving_bodies(
    tail: IntArray, head: IntArray, shapes: Numbered[EdgeIndex, FloatArray], length_m: float = AGV_LENGTH_M
) -> Iterator[tuple[FloatArray, IntArray, IntArray]]:
    """Bodies of AGVs on their way from every lane to every next one, but for ways that fold back.

    Args:
        tail, head: vertex indices of each lane's ends, shape (m,).
        shapes: each lane's centre line in metres.
        length_m: of the bodies.

    Yields:
        In batches: bodies as in :func:`standing_bodies`, the lane each comes from and the lane it drives onto.
    """
    leaving: dict[int, list[EdgeIndex]] = {}
    for lane in numbers(shapes):
        leaving.setdefault(int(tail[lane]), []).append(lane)
    bodies: list[FloatArray] = []
    lanes: list[tuple[int, int]] = []
    for before in numbers(shapes):
        for onto in leaving.get(int(head[before]), ()):
            if head[onto] != tail[before]:
                driven = _drive(shapes[before], shapes[onto], length_m)
                bodies.append(driven)
                lanes.extend([(before, onto)] * len(driven))
        if len(lanes) > _BATCH or (lanes and before == len(tail) - 1):
            pairs = np.array(lanes, dtype=np.int32)
            yield np.concatenate(bodies), pairs[:, 0], pairs[:, 1]
            bodies, lanes = [], []


def _folds_back(before: FloatArray, onto: FloatArray) -> bool:
    """Whether the way on leads back beside the way in, within some 25 degrees."""
    way_in, way_on = before[-1] - before[-2], onto[1] - onto[0]
    return float(way_in @ way_on) < _FOLD_COSINE * float(np.hypot(*way_in) * np.hypot(*way_on))


def _drive(before: FloatArray, onto: FloatArray, length_m: float) -> FloatArray:
    """Bodies between standing at the end of one lane and at the end of the next; none where the way folds back."""
    here = before[-1]
    bodies = _drive_from_origin(seen_from(here, before), seen_from(here, onto), length_m)
    driven: FloatArray = bodies + np.array([*here, 0.0, 0.0])
    return driven


def seen_from(here: FloatArray, line: FloatArray) -> bytes:
    """A cache key for a line, relative to the body's position. Garages repeat a few shapes, so the cache hits often."""
    return np.round(line - here, 6).tobytes()


@lru_cache(maxsize=1 << 10)
def _rear_from_origin(line: bytes, length_m: float) -> FloatArray:
    shape = np.frombuffer(line).reshape(-1, 2)
    rear: FloatArray = _interpolate(shape, np.array([line_m(shape) - length_m]))[0]
    return rear


@lru_cache(maxsize=1 << 10)
def _drive_from_origin(before: bytes, onto: bytes, length_m: float) -> FloatArray:
    line_in, line_on = (np.frombuffer(line).reshape(-1, 2) for line in (before, onto))
    if _folds_back(line_in, line_on):
        return np.empty((0, 4))
    way = np.concatenate([line_in, line_on])
    return bodies_along(way, np.arange(line_m(line_in), line_m(way), _SAMPLE_M), length_m)


def line_m(shape: FloatArray) -> float:
    """Length of a line in metres."""
    return float(np.hypot(*np.diff(shape, axis=0).T).sum())


def _interpolate(shape: FloatArray, at_m: FloatArray) -> FloatArray:
    """Points on a line at the given distances from its start, shape (n, 2)."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(shape, axis=0).T))))
    return np.stack([np.interp(at_m, along, shape[:, 0]), np.interp(at_m, along, shape[:, 1])], axis=1)


def _bodies(rears: FloatArray, fronts: FloatArray, length_m: float) -> FloatArray:
    axes = fronts - rears
    axes = axes / np.hypot(axes[:, 0], axes[:, 1])[:, None]
    return np.concatenate([fronts - axes * (length_m / 2), axes], axis=1)


def _twins(tail: IntArray, head: IntArray, a: IntArray, b: IntArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether lanes ``a`` and ``b`` are the two directions of one lane."""
    twins: np.ndarray[tuple[int], np.dtype[np.bool_]] = (head[a] == tail[b]) & (tail[a] == head[b])
    return twins


def _close_pairs(a: FloatArray, b: FloatArray, size_m: tuple[float, float]) -> tuple[IntArray, IntArray]:
    """Index pairs of bodies that may be within reach of each other, found on a grid of squares."""
    reach = float(np.hypot(*size_m)) + MIN_GAP_M
    origin = np.minimum(a[:, :2].min(axis=0), b[:, :2].min(axis=0)) - reach
    square_a, square_b = (((x[:, :2] - origin) // reach).astype(np.int64) for x in (a, b))
    rows = int(max(square_a[:, 1].max(), square_b[:, 1].max())) + 2
    key_a, key_b = (s[:, 0] * rows + s[:, 1] for s in (square_a, square_b))
    order = np.argsort(key_b, kind="stable")
    first, second = [], []
    for column in (-rows, 0, rows):
        # the three squares of one column have neighbouring keys
        low = np.searchsorted(key_b[order], key_a + column - 1, side="left")
        high = np.searchsorted(key_b[order], key_a + column + 1, side="right")
        count = high - low
        first.append(np.repeat(np.arange(len(a)), count))
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        second.append(order[np.repeat(low, count) + within])
    i, j = np.concatenate(first), np.concatenate(second)
    between = a[i, :2] - b[j, :2]
    near = (between * between).sum(axis=1) < reach * reach
    return i[near].astype(np.int32), j[near].astype(np.int32)


def _least(
    bodies: tuple[FloatArray, FloatArray], lanes: tuple[IntArray, IntArray], size_m: tuple[float, float]
) -> ClosestBodies | None:
    """The closest of pairs of bodies, whose lanes are given."""
    if not len(lanes[0]):
        return None
    gaps = gaps_m(*bodies, size_m)
    least = int(np.argmin(gaps))
    return ClosestBodies(float(gaps[least]), EdgeIndex(int(lanes[0][least])), EdgeIndex(int(lanes[1][least])))


def gaps_m(a: FloatArray, b: FloatArray, size_m: tuple[float, float]) -> FloatArray:
    """Room between pairs of bodies in metres, shape (n,): the widest gap along any of their four axes.

    Args:
        a, b: bodies as in :func:`standing_bodies`, shape (n, 4).
        size_m: length and width of the bodies.
    """
    between = b[:, :2] - a[:, :2]
    room = np.full(len(a), -np.inf)
    for axes in (a[:, 2:], b[:, 2:]):
        for axis in (axes, np.stack([-axes[:, 1], axes[:, 0]], axis=1)):
            apart = np.abs(between[:, 0] * axis[:, 0] + between[:, 1] * axis[:, 1])
            room = np.maximum(room, apart - _half_extent(a, axis, size_m) - _half_extent(b, axis, size_m))
    return room


def _half_extent(body: FloatArray, axis: FloatArray, size_m: tuple[float, float]) -> FloatArray:
    along = np.abs(body[:, 2] * axis[:, 0] + body[:, 3] * axis[:, 1])
    across = np.abs(body[:, 2] * axis[:, 1] - body[:, 3] * axis[:, 0])
    extent: FloatArray = along * (size_m[0] / 2) + across * (size_m[1] / 2)
    return extent
