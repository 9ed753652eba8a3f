"""A layout in metres: vertices, lanes with their exact shapes, bays' places on the street.

Everything that a net needs and SUMO's file formats don't decide is decided here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from sumo_nets.bodies import MIN_GAP_M, closest_standing
from sumo_nets.graph import ROLES, FloatArray, IntArray, Role
from sumo_nets.layout import FIELD_OF_ROLE, STEP, Layout, LayoutError, Side, Spurs, StreetPlan, run_cells

#: Side of the small square that is a vertex; lanes end at its rim, so a lane is this much shorter than its pitch.
NODE_SIZE_M = 0.4
#: Two spurs side by side, as (depth, left or right of the middle) of their corners in metres. They share a straight
#: throat and part behind it, so that a body on its way round the corner keeps 0.5 m from one that stands ahead and
#: from the cars beside it; slanted from the aisle on, they would overlap. In the throat they are a little apart,
#: because netconvert can't connect two lanes that end in one point.
PAIR_SPURS_M = ((0.2, 0.06), (3.0, 0.06), (4.5, 1.75), (10.0, 1.75))
#: Length of a straight spur, aisle vertex to spur vertex. A slot's has room for two bodies: an AGV drives straight out
#: from under the car that it has set down before it turns at the aisle.
SPUR_M = 7.0
SLOT_SPUR_M = 10.0
#: A roadside place in front of a bay, and the gap between the arriving and the leaving customer's place.
AREA_M = 8.0
AREA_GAP_M = 1.0
#: Distance between a bay's vertex and the street's middle line, least (a parked car is between them) and most.
BAY_TO_STREET_M = (5.5, 30.0)

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Lane:
    """One direction of travel between two vertices; ``shape`` runs through both vertices' centres."""

    tail: str
    head: str
    shape: tuple[Point, ...]

    @property
    def name(self) -> str:
        """SUMO edge id."""
        return f"{self.tail}-{self.head}"


@dataclass(frozen=True, slots=True)
class BayPlaces:
    """Roadside places of one bay: (start, end) in metres along the street's front edge."""

    bay: str
    arrive: tuple[float, float]
    leave: tuple[float, float]


@dataclass(frozen=True)
class GaragePlan:
    """A garage in metres, SUMO's axes (y up).

    Attributes:
        name: the layout's name.
        vertices: position by vertex name, in the order of the layout.
        lanes: lanes of AGVs by (tail, head).
        roles: vertex names by role, in the layout's order.
        street: corner points of the street: start, hold lane, bays, exit, end; empty without a street.
        places: the bays' roadside places, in the order of the bays.
    """

    name: str
    vertices: dict[str, Point] = field(default_factory=dict)
    lanes: dict[tuple[str, str], Lane] = field(default_factory=dict)
    roles: dict[Role, list[str]] = field(default_factory=lambda: {role: [] for role in ROLES})
    street: tuple[Point, ...] = ()
    places: tuple[BayPlaces, ...] = ()

    def lane_arrays(self) -> tuple[IntArray, IntArray, list[FloatArray]]:
        """Tail and head of each lane as places in ``vertices``, and its shape as netconvert will cut it."""
        index = {name: i for i, name in enumerate(self.vertices)}
        tail = np.array([index[lane.tail] for lane in self.lanes.values()], dtype=np.int32)
        head = np.array([index[lane.head] for lane in self.lanes.values()], dtype=np.int32)
        return tail, head, [_trimmed(lane) for lane in self.lanes.values()]


def plan_garage(layout: Layout, source: str = "") -> GaragePlan:
    """Lay a garage out in metres and check that its parts fit together.

    Args:
        layout: the layout.
        source: what to call it in an error; its name by default.

    Returns:
        The plan.

    Raises:
        LayoutError: runs that cover each other, a spur without an aisle or on a taken side, bodies that would
            overlap, bays away from the street; one line.
    """
    try:
        return _Planner(layout).plan()
    except _MisfitError as err:
        raise LayoutError(f"{source or layout.name}: {err}") from None


class _MisfitError(Exception):
    """Where and why a layout doesn't fit together."""


class _Planner:
    """One layout on its way to a plan; ``made_by`` remembers which row made a vertex, for errors."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.plan_ = GaragePlan(layout.name)
        self.made_by: dict[str, str] = {}

    def plan(self) -> GaragePlan:
        self._add_floor()
        for i, aisle in enumerate(self.layout.aisles):
            cells = list(run_cells(aisle.start, aisle.to))
            for here, there in pairwise(cells):
                self._join(here, there, aisle.way == "two", f"aisles[{i}]")
        for role in ROLES:
            for i, row in enumerate(self.layout.spurs(role)):
                self._add_spurs(role, row, f"{FIELD_OF_ROLE[role]}[{i}]")
        if self.layout.handover == "home":
            self.plan_.roles["bay"].extend(self.plan_.roles["home"])
        self._check_room()
        if self.layout.street is None:
            return self.plan_
        street, places = self._street(self.layout.street)
        plan = self.plan_
        return GaragePlan(plan.name, plan.vertices, plan.lanes, plan.roles, street, places)

    def _add_floor(self) -> None:
        cells = dict(self.layout.floor())
        for (x, y), is_slot in cells.items():
            name = self._vertex((x, y), "picture")
            if is_slot:
                self.plan_.roles["slot"].append(name)
        for x, y in cells:
            for there in ((x + 1, y), (x, y + 1)):
                if there in cells:
                    self._join((x, y), there, True, "picture")

    def _vertex(self, cell: tuple[int, int], where: str) -> str:
        name = cell_name(cell)
        pitch = self.layout.pitch_m
        self.plan_.vertices.setdefault(name, (cell[0] * pitch, -cell[1] * pitch))
        self.made_by.setdefault(name, where)
        return name

    def _join(self, here: tuple[int, int], there: tuple[int, int], both_ways: bool, where: str) -> None:
        a, b = self._vertex(here, where), self._vertex(there, where)
        if (a, b) in self.plan_.lanes or (b, a) in self.plan_.lanes:
            raise _MisfitError(f"{where}: {list(here)} to {list(there)} has a lane already; runs may only cross")
        self._add_lane(a, b, (), both_ways)

    def _add_lane(self, a: str, b: str, between: tuple[Point, ...], both_ways: bool) -> None:
        shape = (self.plan_.vertices[a], *between, self.plan_.vertices[b])
        self.plan_.lanes[a, b] = Lane(a, b, shape)
        if both_ways:
            self.plan_.lanes[b, a] = Lane(b, a, shape[::-1])

    def _add_spurs(self, role: Role, row: Spurs, where: str) -> None:
        for cell in row.cells():
            if cell_name(cell) not in self.plan_.vertices:
                raise _MisfitError(f"{where}: {list(cell)} is no aisle cell; a spur begins on an aisle")
            for side in row.side:
                if side == "here":
                    self._mark_here(role, cell, where)
                else:
                    self._add_spur(role, cell, side, row.per_cell, where)

    def _mark_here(self, role: Role, cell: tuple[int, int], where: str) -> None:
        name = cell_name(cell)
        taken = [other for other in ROLES if name in self.plan_.roles[other]]
        if taken:
            raise _MisfitError(f"{where}: {list(cell)} is a {taken[0]} already; take a free aisle cell")
        self.plan_.roles[role].append(name)

    def _add_spur(self, role: Role, cell: tuple[int, int], side: Side, per_cell: int, where: str) -> None:
        aisle = cell_name(cell)
        dx, dy = STEP[side]
        if any((aisle, b) in self.plan_.lanes for b in self._side_names(cell, side)) or (
            (cell_name((cell[0] + dx, cell[1] + dy)), aisle) in self.plan_.lanes
        ):
            raise _MisfitError(f"{where}: the {side} side of {list(cell)} is taken; choose a free side")
        for k, name in enumerate(spur_names(role, cell, side, per_cell)):
            shape = spur_shape(role, per_cell)
            between = self._place_spur(name, aisle, (dx, -dy), shape, 1 if k else -1)
            self._add_lane(aisle, name, between, True)
            self.made_by[name] = where
            self.plan_.roles[role].append(name)

    def _side_names(self, cell: tuple[int, int], side: Side) -> Iterator[str]:
        """Every name that a lane on this side of the cell may lead to."""
        dx, dy = STEP[side]
        yield cell_name((cell[0] + dx, cell[1] + dy))
        for role in ROLES:
            for per_cell in (1, 2):
                yield from spur_names(role, cell, side, per_cell)

    def _place_spur(
        self, name: str, aisle: str, out: tuple[int, int], shape: tuple[Point, ...], hand: int
    ) -> tuple[Point, ...]:
        """Set the spur's vertex and return the points between it and the aisle."""
        x, y = self.plan_.vertices[aisle]
        # sideways is the outward direction turned right, so that the first of a pair is on its left
        *between, end = (
            (x + out[0] * depth + out[1] * hand * aside, y + out[1] * depth - out[0] * hand * aside)
            for depth, aside in shape
        )
        self.plan_.vertices[name] = end
        return tuple(between)

    def _check_room(self) -> None:
        closest = closest_standing(*self.plan_.lane_arrays())
        if closest is None or closest.gap_m >= MIN_GAP_M:
            return
        lanes = list(self.plan_.lanes.values())
        a, b = lanes[closest.first], lanes[closest.second]
        raise _MisfitError(
            f"{self.made_by[a.head]}: an AGV at {a.head} would have {closest.gap_m:.2f} m to one at {b.head}"
            f" ({self.made_by[b.head]}); {MIN_GAP_M} m or more is valid: move one of them"
        )

    def _street(self, street: StreetPlan) -> tuple[tuple[Point, ...], tuple[BayPlaces, ...]]:
        pitch = self.layout.pitch_m
        front, end = ((cell[0] * pitch, -cell[1] * pitch) for cell in (street.start, street.to))
        length = float(np.hypot(end[0] - front[0], end[1] - front[1]))
        along = ((end[0] - front[0]) / length, (end[1] - front[1]) / length)

        def at(metres: float) -> Point:
            return (front[0] + along[0] * metres, front[1] + along[1] * metres)

        corners = (at(-street.queue_m - street.entry_m), at(-street.queue_m), front, end, at(length + street.exit_m))
        places = tuple(self._places(bay, front, along, length) for bay in self.plan_.roles["bay"])
        ordered = sorted(places, key=lambda p: p.arrive)
        for a, b in pairwise(ordered):
            if b.arrive[0] < a.leave[1]:
                raise _MisfitError(
                    f"{self.made_by[b.bay]}: its street places overlap those of {a.bay};"
                    f" bays {2 * AREA_M + AREA_GAP_M:g} m or more apart along the street are valid"
                )
        return corners, places

    def _places(self, bay: str, front: Point, along: Point, length: float) -> BayPlaces:
        x, y = self.plan_.vertices[bay]
        ahead = (x - front[0]) * along[0] + (y - front[1]) * along[1]
        right = (x - front[0]) * along[1] - (y - front[1]) * along[0]
        least, most = BAY_TO_STREET_M
        if not least <= right <= most:
            raise _MisfitError(
                f"{self.made_by[bay]}: {bay} is {right:.1f} m to the right of the street;"
                f" {least:g} to {most:g} m is valid"
            )
        room = AREA_M + AREA_GAP_M / 2
        # a car needs some street before its place to slow down in, and some after it to join
        if not room + 2 <= ahead <= length - room - 2:
            raise _MisfitError(
                f"street: {bay} is {ahead:.1f} m after its beginning at {list(self.layout.street.start)};"  # type: ignore[union-attr]
                f" {room + 2:g} to {length - room - 2:g} m is valid: let the street begin earlier or end later"
            )
        return BayPlaces(bay, (ahead - room, ahead - AREA_GAP_M / 2), (ahead + AREA_GAP_M / 2, ahead + room))


def cell_name(cell: tuple[int, int]) -> str:
    """Vertex name of an aisle cell."""
    return f"c{cell[0]}_{cell[1]}"


def spur_names(role: Role, cell: tuple[int, int], side: Side, per_cell: int) -> list[str]:
    """Vertex names of the spurs on one side of an aisle cell."""
    stem = f"{role}{cell[0]}_{cell[1]}{side[0]}"
    return [stem] if per_cell == 1 else [f"{stem}1", f"{stem}2"]


def spur_shape(role: Role, per_cell: int) -> tuple[Point, ...]:
    """The corners of a spur, the last one its vertex: metres from the aisle vertex outwards, and aside."""
    if per_cell == 2:
        return PAIR_SPURS_M
    return ((SLOT_SPUR_M if role == "slot" else SPUR_M, 0.0),)


def _trimmed(lane: Lane) -> FloatArray:
    """The lane's shape between the rims of its vertices, as netconvert will cut it."""
    shape = np.array(lane.shape)
    for end, beside in ((0, 1), (-1, -2)):
        step = shape[beside] - shape[end]
        shape[end] += step * (NODE_SIZE_M / 2 / np.abs(step).max())
    # a shape's point on the rim is its end now
    moves = np.abs(np.diff(shape, axis=0)).max(axis=1) > 1e-9
    distinct: FloatArray = shape[np.append(True, moves)]
    return distinct
