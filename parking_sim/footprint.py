"""An independent look at all bodies as rectangles: who overlaps, and how close they come.

SUMO does not see AGVs that cross at a small node, and the controller is what is to be checked. So this knows neither of
them: step by step it is given rectangles, and is told which cars were set down and lifted.

An empty AGV is flat and may drive in under a parked car, along its axis, with the front or rear in the middle, and out
again as it likes; a loaded one may not. Straight across an aisle it may be under two cars at once.
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

#: An empty AGV gets under a parked car when the middle of its front or rear is within this many metres of the car's
#: axis, and as far along it as an end of the car, give or take so many metres inwards and outwards. It counts as under
#: the car until it is this many metres (the latter) away from it.
UNDER_ASIDE_M = 0.5
UNDER_INSIDE_M = 1.0
UNDER_AHEAD_M = 1.5
#: Bodies further apart than this are not measured.
REACH_M = 10.0
#: No parked car is larger than this.
MAX_HALF_DIAGONAL_M = 5.0
_MAX_PAIRS = 4096


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
        agvs: the closest two AGVs ever came, None if they never came within ``REACH_M``.
        parked: the closest an AGV ever came to a parked car, None likewise.
    """

    overlaps: int
    overlap_steps: int
    agvs: Nearness | None
    parked: Nearness | None

    @property
    def least_m(self) -> float:
        """The least room between any two bodies in metres; infinite if no two ever came within reach."""
        return min((n.clear_m for n in (self.agvs, self.parked) if n is not None), default=math.inf)


@dataclass(slots=True)
class _Parked:
    """Parked cars sorted by x: rows of centre x, y, cosine, sine, half length, half width, half diagonal, number."""

    names: list[str] = field(default_factory=list)
    rows: FloatArray = field(default_factory=lambda: np.zeros((0, 8)))
    count: int = 0


class FootprintCheck:
    """Watches the bodies of one run. AGVs that have not moved since the last step are not looked at again."""

    def __init__(self) -> None:
        self.events: list[Nearness] = []  #: every overlap, when it began
        self._parked = _Parked()
        self._rows = np.zeros((0, 7))
        self._under = np.zeros((0, 2), dtype=np.int64)  # numbers of the parked cars each AGV is under, -1 for none
        self._pairs = np.zeros((_MAX_PAIRS, 2), dtype=np.int64)
        self._least = np.full(2, np.inf)
        self._closest: list[Nearness | None] = [None, None]
        self._overlapping: set[tuple[AgvNumber, AgvNumber | str]] = set()
        self._overlap_steps = 0

    def lowered(self, car: str, agv: AgvNumber) -> None:
        """A car stands where this AGV was in the last step; it takes up the AGV's rectangle.

        Raises:
            KeyError: the car is parked already.
            IndexError: no step was seen yet, or there is no such AGV.
        """
        self._under[agv] = (self._park(car, self._rows[agv]), -1)

    def standing(self, cars: Sequence[str], bodies: Bodies) -> None:
        """Cars that are parked already when the run starts.

        Args:
            cars: their names.
            bodies: their rectangles, in the same order.

        Raises:
            KeyError: one of them is parked already.
        """
        rows = np.zeros((len(cars), 7))
        _fill(bodies.x, bodies.y, bodies.angle, bodies.length, bodies.width, rows)
        for car, row in zip(cars, rows, strict=True):
            self._park(car, row)

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
            self._under = np.full((len(bodies.x), 2), -1)
            self._rows = np.full((len(bodies.x), 7), np.inf)
        found, agv, other, near, near_car = _look(
            bodies.x, bodies.y, bodies.angle, bodies.length, bodies.width, bodies.loaded, bool(self._overlapping),
            self._rows, self._parked.rows, self._under, self._least, self._pairs,
        )  # fmt: skip
        if agv >= 0:
            self._closest[0] = Nearness(time_s, AgvNumber(agv), AgvNumber(other), float(self._least[0]))
        if near >= 0:
            self._closest[1] = Nearness(time_s, AgvNumber(near), self._parked.names[near_car], float(self._least[1]))
        if found or self._overlapping:
            self._note(time_s, self._pairs[:found].tolist())

    def result(self) -> Clearance:
        """What was found so far."""
        return Clearance(len(self.events), self._overlap_steps, self._closest[0], self._closest[1])

    def _park(self, car: str, row: FloatArray) -> int:
        if car in self._parked.names:
            raise KeyError(f"car {car} is parked already")
        number = self._parked.count
        self._parked.count += 1
        at = int(np.searchsorted(self._parked.rows[:, 0], row[0]))
        self._parked.rows = np.insert(self._parked.rows, at, np.append(row, number), axis=0)
        self._parked.names.insert(at, car)
        return number

    def _note(self, time_s: float, pairs: Sequence[Sequence[int]]) -> None:
        names = self._parked.names
        now: set[tuple[AgvNumber, AgvNumber | str]] = {
            (AgvNumber(i), AgvNumber(j) if j >= 0 else names[-1 - j]) for i, j in pairs
        }
        fresh = sorted(now - self._overlapping, key=lambda pair: (pair[0], str(pair[1])))
        self.events += [Nearness(time_s, agv, other, 0.0) for agv, other in fresh]
        self._overlap_steps += len(now)
        self._overlapping = now


def rectangle_distance(a: FloatArray, b: FloatArray) -> float:
    """Room between two rectangles in metres, 0 if they touch or overlap.

    Args:
        a, b: centre x, y, cosine and sine of the direction, half length, half width.
    """
    return float(_distance(a[np.newaxis], 0, b[np.newaxis], 0, np.inf))


@njit(cache=True, error_model="numpy")
def _look(x, y, angle, length, width, loaded, look_at_all, rows, parked, under, least, pairs):  # type: ignore[no-untyped-def]
    """Update the rows; list overlapping pairs (a parked car p as -1 - p); lower ``least`` for AGVs and parked cars."""
    n = len(x)
    moved = _fill(x, y, angle, length, width, rows)
    found, agv, other, near, near_car = 0, -1, -1, -1, -1
    # plain numbers, not rows, decide who is far away: a view of a row costs more than the comparison
    for i in range(n):
        if not (moved[i] or look_at_all):
            continue
        x0, y0, size = rows[i, 0], rows[i, 1], rows[i, 6]
        for j in range(n):
            limit = size + rows[j, 6] + min(least[0], REACH_M)
            dx, dy = rows[j, 0] - x0, rows[j, 1] - y0
            if dx * dx + dy * dy > limit * limit or j == i or (j < i and (moved[j] or look_at_all)):
                continue
            d = _distance(rows, i, rows, j, least[0])
            if d < least[0]:
                least[0], agv, other = d, i, j
            if d == 0.0 and found < len(pairs):
                pairs[found, 0], pairs[found, 1] = min(i, j), max(i, j)
                found += 1
        widest = size + MAX_HALF_DIAGONAL_M + min(least[1], REACH_M)
        for p in range(np.searchsorted(parked[:, 0], x0 - widest), len(parked)):
            limit = size + parked[p, 6] + min(least[1], REACH_M)
            dx, dy = parked[p, 0] - x0, parked[p, 1] - y0
            if dx > widest:
                break
            if dx * dx + dy * dy > limit * limit:
                continue
            car = parked[p, 7]
            if not loaded[i] and _gets_under(rows, i, parked, p):
                if car not in (under[i, 0], under[i, 1]):
                    under[i, 0], under[i, 1] = car, under[i, 0]
                continue
            d = _distance(rows, i, parked, p, max(least[1], UNDER_AHEAD_M))
            if car in (under[i, 0], under[i, 1]):
                if not loaded[i] and d < UNDER_AHEAD_M:
                    continue
                under[i, 0 if under[i, 0] == car else 1] = -1
            if d < least[1]:
                least[1], near, near_car = d, i, p
            if d == 0.0 and found < len(pairs):
                pairs[found, 0], pairs[found, 1] = i, -1 - p
                found += 1
    return found, agv, other, near, near_car


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
def _gets_under(a, i, b, j):  # type: ignore[no-untyped-def]
    """Whether the middle of the front or rear of a[i] is on the axis of b[j], near its front or rear."""
    for end in (a[i, 4], -a[i, 4]):
        dx, dy = a[i, 0] + end * a[i, 2] - b[j, 0], a[i, 1] + end * a[i, 3] - b[j, 1]
        along, aside = dx * b[j, 2] + dy * b[j, 3], dy * b[j, 2] - dx * b[j, 3]
        if abs(aside) <= UNDER_ASIDE_M and -UNDER_INSIDE_M <= abs(along) - b[j, 4] <= UNDER_AHEAD_M:
            return True
    return False


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
