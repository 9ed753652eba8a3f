"""An independent look at all bodies as rectangles: which of them overlap, and how close they come.

SUMO does not see AGVs that cross at a small node, and the controller is what is to be checked. So this knows neither of
them: step by step it is given rectangles, and is told which cars were set down and lifted. Between two steps a body
goes straight from one pose to the next while it turns evenly. What two bodies do in between counts as what they do in a
step; it is looked at until nothing nearer by more than ``FINE_M`` can have happened. A body that goes far in a step, or
round a bend, does not go straight: of such a step its rectangles alone are looked at (``STRAIGHT_M``, ``BEND_M``).

An empty AGV is flat and may be under a parked car while it is aligned with it: it drives in and out lengthwise, the end
that is under the car on the car's axis. Every other contact is an overlap. Only where the lane into a slot is too short
to drive straight out from under a car, as on grids of small cells, an empty AGV that turns under it is counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.types import AgvNumber
from sumo_nets.graph import FloatArray
from sumo_nets.under_cars import ALIGNED_ASIDE_M, ALIGNED_DEG

#: Bodies further apart than this are not measured.
REACH_M = 10.0
#: A body goes straight from one step to the next if it goes no further than this, and if the straight way is not
#: further from an arc than that, metres.
STRAIGHT_M, BEND_M = 2.0, 0.05
#: How exactly the least room between two steps is found, metres.
FINE_M = 0.01
_MAX_PAIRS = 4096
_MOST_SINE = math.sin(math.radians(ALIGNED_DEG))


@dataclass(frozen=True, eq=False)
class Bodies:
    """Rectangles, each given by the middle of its front side; arrays of one length.

    Attributes:
        x, y: middle of the front side in metres.
        angle: direction of driving in radians, counter-clockwise from east.
        length, width: in metres.
        loaded: whether it carries a car.
    """

    x: FloatArray
    y: FloatArray
    angle: FloatArray
    length: FloatArray
    width: FloatArray
    loaded: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Nearness:
    """How close two bodies came, or that they overlapped.

    Attributes:
        time_s: when, in simulated seconds.
        agv: number of the AGV.
        other: the other body: an AGV's number, or the name of a parked car.
        clear_m: room between them in metres, 0 for an overlap.
    """

    time_s: float
    agv: AgvNumber
    other: AgvNumber | str
    clear_m: float


@dataclass(frozen=True, slots=True)
class Clearance:
    """What the check of a whole run found.

    Attributes:
        overlaps: how often two bodies came to overlap.
        overlap_steps: steps in which they did, summed over pairs.
        turns_under_cars: how often an empty AGV turned under a car in a cramped slot.
        agvs: the closest two AGVs ever came, None if they never came within ``REACH_M``.
        parked: the closest an AGV ever came to a parked car, None likewise. An empty AGV that is aligned with the car,
            or turns under it where the slot is too short, does not count.
    """

    overlaps: int
    overlap_steps: int
    turns_under_cars: int
    agvs: Nearness | None
    parked: Nearness | None

    @property
    def least_m(self) -> float:
        """The least room between any two bodies in metres; infinite if no two ever came within reach."""
        return min((n.clear_m for n in (self.agvs, self.parked) if n is not None), default=math.inf)


@dataclass(slots=True)
class _Parked:
    """Parked cars sorted by x: rows of centre x, y, cosine, sine, half length, half width, half diagonal, cramped."""

    names: list[str] = field(default_factory=list)
    rows: FloatArray = field(default_factory=lambda: np.zeros((0, 8)))
    half_diagonal_m: float = 0.0  #: the greatest that any car had so far


class FootprintCheck:
    """Watches the bodies of one run. AGVs that have not moved since the last step are not looked at again."""

    def __init__(self) -> None:
        self.events: list[Nearness] = []  #: every overlap, when it began
        self.turns: list[Nearness] = []  #: every turn of an empty AGV under a car in a cramped slot, when it began
        self._parked = _Parked()
        self._rows = np.zeros((0, 7))
        self._before = np.zeros((0, 7))
        self._pairs = np.zeros((_MAX_PAIRS, 3), dtype=np.int64)
        self._least = np.full(2, np.inf)
        self._closest: list[Nearness | None] = [None, None]
        self._touching: set[tuple[AgvNumber, AgvNumber | str, bool]] = set()  # AGV, other, whether it turns under it
        self._overlap_steps = 0

    def lowered(self, car: str, agv: AgvNumber, cramped: bool = False) -> None:
        """A car stands where this AGV was in the last step; it takes up the AGV's rectangle.

        Args:
            car: its name.
            agv: number of the AGV.
            cramped: the slot's lane is too short for an AGV to drive straight out from under the car.

        Raises:
            KeyError: the car is parked already.
            IndexError: no step was seen yet, or there is no such AGV.
        """
        self._park(car, self._rows[agv], cramped)

    def standing(self, cars: Sequence[str], bodies: Bodies, cramped: Sequence[bool]) -> None:
        """Cars that are parked already when the run starts.

        Args:
            cars: their names.
            bodies: their rectangles, in the same order.
            cramped: likewise, as for :meth:`lowered`.

        Raises:
            KeyError: one of them is parked already.
        """
        rows = np.zeros((len(cars), 7))
        _fill(bodies.x, bodies.y, bodies.angle, bodies.length, bodies.width, rows)
        for car, row, tight in zip(cars, rows, cramped, strict=True):
            self._park(car, row, tight)

    def lifted(self, car: str) -> None:
        """A parked car is gone; unknown cars (from a bay) are none of its business."""
        if car in self._parked.names:
            at = self._parked.names.index(car)
            del self._parked.names[at]
            self._parked.rows = np.delete(self._parked.rows, at, axis=0)

    def step(self, time_s: float, bodies: Bodies) -> None:
        """Look at one step.

        Args:
            time_s: simulated seconds.
            bodies: the AGVs, the same ones in the same order in each step.
        """
        if len(self._rows) != len(bodies.x):
            self._rows = np.full((len(bodies.x), 7), np.inf)
            _fill(bodies.x, bodies.y, bodies.angle, bodies.length, bodies.width, self._rows)
            self._before, looks = self._rows.copy(), True
        else:
            self._before[:], looks = self._rows, bool(self._touching)
        found, agv, other, near, near_car = _look(
            bodies.x, bodies.y, bodies.angle, bodies.length, bodies.width, bodies.loaded, looks, self._before,
            self._rows, self._parked.rows, self._parked.half_diagonal_m, self._least, self._pairs,
        )  # fmt: skip
        if agv >= 0:
            self._closest[0] = Nearness(time_s, AgvNumber(agv), AgvNumber(other), float(self._least[0]))
        if near >= 0:
            self._closest[1] = Nearness(time_s, AgvNumber(near), self._parked.names[near_car], float(self._least[1]))
        if found or self._touching:
            self._note(time_s, self._pairs[:found].tolist())

    def result(self) -> Clearance:
        """What was found so far."""
        return Clearance(len(self.events), self._overlap_steps, len(self.turns), *self._closest)

    def _park(self, car: str, row: FloatArray, cramped: bool) -> None:
        if car in self._parked.names:
            raise KeyError(f"car {car} is parked already")
        at = int(np.searchsorted(self._parked.rows[:, 0], row[0]))
        self._parked.rows = np.insert(self._parked.rows, at, np.append(row, cramped), axis=0)
        self._parked.names.insert(at, car)
        self._parked.half_diagonal_m = max(self._parked.half_diagonal_m, float(row[6]))

    def _note(self, time_s: float, pairs: Sequence[Sequence[int]]) -> None:
        names = self._parked.names
        now: set[tuple[AgvNumber, AgvNumber | str, bool]] = {
            (AgvNumber(i), AgvNumber(j) if j >= 0 else names[-1 - j], bool(turns)) for i, j, turns in pairs
        }
        for agv, other, turns in sorted(now - self._touching, key=lambda pair: (pair[0], str(pair[1]))):
            (self.turns if turns else self.events).append(Nearness(time_s, agv, other, 0.0))
        self._overlap_steps += sum(not turns for _, _, turns in now)
        self._touching = now


def rectangle_distance(a: FloatArray, b: FloatArray) -> float:
    """Room between two rectangles in metres, 0 if they touch or overlap.

    Args:
        a, b: centre x, y, cosine and sine of the direction, half length, half width.
    """
    return float(_distance(a[np.newaxis], 0, b[np.newaxis], 0, np.inf))


@njit(cache=True, error_model="numpy")
def _look(  # type: ignore[no-untyped-def]
    x, y, angle, length, width, loaded, look_at_all, before, rows, parked, half_diagonal_m, least, pairs
):
    """Update the rows; list touching pairs and whether they are turns under cars; lower ``least`` for AGVs and cars.

    A parked car p is listed as -1 - p.
    """
    n = len(x)
    moved = _fill(x, y, angle, length, width, rows)
    way = np.zeros(n)  # how far any point of a body has moved, at most
    for i in range(n):
        if moved[i] and _goes_straight(before, i, rows, i):
            way[i] = _way(before, i, rows, i)
        else:
            before[i] = rows[i]
    found, agv, other, near, near_car = 0, -1, -1, -1, -1
    # plain numbers, not rows, decide who is far away: a view of a row costs more than the comparison
    for i in range(n):
        if not (moved[i] or look_at_all):
            continue
        x0, y0, size = rows[i, 0], rows[i, 1], rows[i, 6] + way[i]
        for j in range(n):
            limit = size + rows[j, 6] + way[j] + min(least[0], REACH_M)
            dx, dy = rows[j, 0] - x0, rows[j, 1] - y0
            if dx * dx + dy * dy > limit * limit or j == i or (j < i and (moved[j] or look_at_all)):
                continue
            d = _least_between(before, rows, i, before, rows, j, way[i] + way[j], least[0], -1)
            if d < least[0]:
                least[0], agv, other = d, i, j
            if d == 0.0 and found < len(pairs):
                pairs[found, 0], pairs[found, 1], pairs[found, 2] = min(i, j), max(i, j), 0
                found += 1
        widest = size + half_diagonal_m + min(least[1], REACH_M)
        for p in range(np.searchsorted(parked[:, 0], x0 - widest), len(parked)):
            limit = size + parked[p, 6] + min(least[1], REACH_M)
            dx, dy = parked[p, 0] - x0, parked[p, 1] - y0
            if dx > widest:
                break
            if dx * dx + dy * dy > limit * limit:
                continue
            d = _least_between(before, rows, i, parked, parked, p, way[i], least[1], int(loaded[i]))
            turns = d == 0.0 and not loaded[i] and parked[p, 7] > 0.0
            if d < least[1] and not turns:
                least[1], near, near_car = d, i, p
            if d == 0.0 and found < len(pairs):
                pairs[found, 0], pairs[found, 1], pairs[found, 2] = i, -1 - p, turns
                found += 1
    return found, agv, other, near, near_car


@njit(cache=True, error_model="numpy")
def _turned(a, i, b, j):  # type: ignore[no-untyped-def]
    """Angle from the axis of a[i] to that of b[j], a right angle at most: an AGV that reverses turns no rectangle."""
    sine, cosine = a[i, 2] * b[j, 3] - a[i, 3] * b[j, 2], a[i, 2] * b[j, 2] + a[i, 3] * b[j, 3]
    return math.atan2(sine, cosine) if cosine >= 0.0 else math.atan2(-sine, -cosine)


@njit(cache=True, error_model="numpy")
def _goes_straight(a, i, b, j):  # type: ignore[no-untyped-def]
    """Whether a body's way from one step to the next is near enough to a straight one."""
    metres = math.hypot(b[j, 0] - a[i, 0], b[j, 1] - a[i, 1])
    return metres <= STRAIGHT_M and metres * abs(_turned(a, i, b, j)) / 8.0 <= BEND_M


@njit(cache=True, error_model="numpy")
def _way(a, i, b, j):  # type: ignore[no-untyped-def]
    """How far any point of a body moves from the pose a[i] to b[j], at most."""
    return math.hypot(b[j, 0] - a[i, 0], b[j, 1] - a[i, 1]) + abs(_turned(a, i, b, j)) * b[j, 6]


@njit(cache=True, error_model="numpy")
def _least_between(a0, a1, i, b0, b1, j, way, enough, load):  # type: ignore[no-untyped-def]
    """The least room between two bodies from one step to the next; not exact where it is more than ``enough``.

    A part of the time in which they move by ``way`` towards each other at most, and at whose ends they are d and e
    apart, can't hold less than (d + e - way) / 2. It is halved as long as that is less than what was found.

    Args:
        a0, a1, i: the AGV before and now.
        b0, b1, j: the other body before and now.
        way: how far their points can have moved towards each other.
        enough: what is to be undercut.
        load: 1 or 0 for a loaded or empty AGV beside a parked car, under which it may be; -1 beside an AGV.
    """
    last, under_last = _distance(a1, i, b1, j, enough), _is_under(a1, i, b1, j, load)
    best = np.inf if under_last else last
    if way <= FINE_M or last - way >= enough or best == 0.0:
        return best
    first, under_first = _distance(a0, i, b0, j, np.inf), _is_under(a0, i, b0, j, load)
    if under_first and under_last:
        return best
    last = _distance(a1, i, b1, j, np.inf)
    best = min(np.inf if under_first else first, best)
    one, two = np.empty((1, 7)), np.empty((1, 7))
    parts = np.empty((64, 4))  # beginning, length, room at the beginning and at the end
    parts[0, 0], parts[0, 1], parts[0, 2], parts[0, 3] = 0.0, 1.0, first, last
    count = 1
    while count and best > 0.0:
        count -= 1
        start, length, d, e = parts[count, 0], parts[count, 1], parts[count, 2], parts[count, 3]
        if length * way <= FINE_M or (d + e - length * way) / 2.0 >= min(best, enough):
            continue
        half = length / 2.0
        _between(a0, a1, i, start + half, one)
        _between(b0, b1, j, start + half, two)
        m = _distance(one, 0, two, 0, np.inf)
        if not _is_under(one, 0, two, 0, load):
            best = min(best, m)
        parts[count, 0], parts[count, 1], parts[count, 2], parts[count, 3] = start, half, d, m
        parts[count + 1, 0], parts[count + 1, 1], parts[count + 1, 2], parts[count + 1, 3] = start + half, half, m, e
        count += 2
    return best


@njit(cache=True, error_model="numpy")
def _between(a, b, i, t, row):  # type: ignore[no-untyped-def]
    """The pose at a part t of the time from a[i] to b[i]: straight on, turning evenly."""
    turned = t * _turned(a, i, b, i)
    c, s = math.cos(turned), math.sin(turned)
    row[0, 0], row[0, 1] = a[i, 0] + t * (b[i, 0] - a[i, 0]), a[i, 1] + t * (b[i, 1] - a[i, 1])
    row[0, 2], row[0, 3] = a[i, 2] * c - a[i, 3] * s, a[i, 3] * c + a[i, 2] * s
    row[0, 4], row[0, 5], row[0, 6] = b[i, 4], b[i, 5], b[i, 6]


@njit(cache=True, error_model="numpy")
def _is_under(a, i, b, j, load):  # type: ignore[no-untyped-def]
    """Whether an AGV is where it may be under a parked car. ``load`` as in ``_least_between``."""
    return load >= 0 and _may_be_under(a, i, b, j, load)


@njit(cache=True, error_model="numpy")
def _fill(x, y, angle, length, width, rows):  # type: ignore[no-untyped-def]
    """Bodies as rows of centre, direction, half sizes and half diagonal; returns which ones have changed."""
    moved = np.zeros(len(x), dtype=np.bool_)
    for i in range(len(x)):
        c, s = math.cos(angle[i]), math.sin(angle[i])
        cx, cy = x[i] - c * length[i] / 2, y[i] - s * length[i] / 2
        moved[i] = rows[i, 0] != cx or rows[i, 1] != cy or rows[i, 2] != c or rows[i, 3] != s
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = cx, cy, c, s
        rows[i, 4], rows[i, 5], rows[i, 6] = length[i] / 2, width[i] / 2, math.hypot(length[i], width[i]) / 2
    return moved


@njit(cache=True, error_model="numpy")
def _may_be_under(a, i, b, j, loaded):  # type: ignore[no-untyped-def]
    """Whether the AGV a[i] is aligned with the parked car b[j]; if loaded, also that it is in its place."""
    dx, dy = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1]
    if loaded and dx * dx + dy * dy > ALIGNED_ASIDE_M * ALIGNED_ASIDE_M:
        return False  # otherwise it has just lifted this very car
    sine = a[i, 3] * b[j, 2] - a[i, 2] * b[j, 3]
    cosine = a[i, 2] * b[j, 2] + a[i, 3] * b[j, 3]
    along, aside = dx * b[j, 2] + dy * b[j, 3], dy * b[j, 2] - dx * b[j, 3]
    inwards = -a[i, 4] if along * cosine > 0.0 else a[i, 4]  # the end that is nearer to the middle of the car
    return abs(sine) <= _MOST_SINE and abs(aside + inwards * sine) <= ALIGNED_ASIDE_M


@njit(cache=True, error_model="numpy")
def _distance(a, i, b, j, enough):  # type: ignore[no-untyped-def]
    """Room between the rectangles a[i] and b[j], 0 if they overlap; not exact where it is more than ``enough``.

    They are apart if an axis of one of them separates them; the gap along it is a lower bound of the distance, and the
    least distance is one from a corner.
    """
    gap = max(_gap(a, i, b, j), _gap(b, j, a, i))
    if gap <= 0.0:
        return 0.0
    if gap > enough:
        return gap
    return math.sqrt(min(_corners(a, i, b, j), _corners(b, j, a, i)))


@njit(cache=True, error_model="numpy")
def _gap(a, i, b, j):  # type: ignore[no-untyped-def]
    """The wider gap along the two axes of a[i]; negative where both overlap."""
    dx, dy = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1]
    c, s = abs(a[i, 2] * b[j, 2] + a[i, 3] * b[j, 3]), abs(a[i, 2] * b[j, 3] - a[i, 3] * b[j, 2])
    along = abs(dx * a[i, 2] + dy * a[i, 3]) - (a[i, 4] + b[j, 4] * c + b[j, 5] * s)
    return max(along, abs(dy * a[i, 2] - dx * a[i, 3]) - (a[i, 5] + b[j, 4] * s + b[j, 5] * c))


@njit(cache=True, error_model="numpy")
def _corners(a, i, b, j):  # type: ignore[no-untyped-def]
    """Least squared distance from a corner of a[i] to b[j]."""
    best = np.inf
    for end in (a[i, 4], -a[i, 4]):
        for side in (a[i, 5], -a[i, 5]):
            dx = a[i, 0] + end * a[i, 2] - side * a[i, 3] - b[j, 0]
            dy = a[i, 1] + end * a[i, 3] + side * a[i, 2] - b[j, 1]
            along = max(abs(dx * b[j, 2] + dy * b[j, 3]) - b[j, 4], 0.0)
            aside = max(abs(dy * b[j, 2] - dx * b[j, 3]) - b[j, 5], 0.0)
            best = min(best, along * along + aside * aside)
    return best
