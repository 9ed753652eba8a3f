"""Places for AGVs in the boxes of a floor plan, and the straight aisles that they open onto."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sumo_nets.bodies import AGV_LENGTH_M, AGV_WIDTH_M, MIN_GAP_M
from sumo_nets.freespace.cells import OPPOSITE, ROOM_REACH_M, Cell, Cells, room_of
from sumo_nets.freespace.floor import Floor, Point
from sumo_nets.freespace.floorplan import Box, FloorPlan, boxes_of
from sumo_nets.graph import Role
from sumo_nets.layout import STEP, LayoutError, Side
from sumo_nets.plan import spur_shape

#: The cells are shifted by this part of the pitch when the best origin is looked for.
_SHIFTS = 16
#: Nothing farther from a box than this is near its places or the aisle beside them.
_MATTERS_M = 16.0


@dataclass(frozen=True)
class Row:
    """Neighbouring aisle cells with places of one box on one side."""

    role: Role
    label: str
    side: Side
    per_cell: int
    cells: tuple[Cell, ...]


def best_origin(plan: FloorPlan, walls: Floor, floor: Floor) -> Point:
    """Where the middle of a cell should lie: the most boxes in use, then the most slots, then the most room.

    Args:
        plan, walls: the plan as read.
        floor: where lanes may lead.

    Returns:
        A point in the plan's metres, within one pitch of its corner.
    """
    step = plan.pitch_m / _SHIFTS
    boxes = [(role, box, _around(box, walls), _around(box, floor)) for role, _, box in boxes_of(plan)]

    def worth(origin: Point) -> tuple[int, int, float]:
        used, slots, least = 0, 0, ROOM_REACH_M
        for role, box, walls_near, floor_near in boxes:
            line, room = _best_line(box, _place(role, box), walls_near, floor_near, origin, plan.pitch_m)
            used += bool(line)
            slots += len(line) * box.per_cell if role == "slot" else 0
            least = min(least, room)
        return used, slots, round(least, 2)

    origins = [(i * step, j * step) for i in range(_SHIFTS) for j in range(_SHIFTS)]
    return max(origins, key=worth)


def _around(box: Box, floor: Floor) -> Floor:
    """The floor with only those obstacles that matter to places in the box."""
    low, high = np.array(box.box[:2]) - _MATTERS_M, np.array(box.box[2:]) + _MATTERS_M
    near = [o for o in floor.obstacles if (o.max(axis=0) >= low).all() and (o.min(axis=0) <= high).all()]
    return Floor(floor.width, floor.height, tuple(near), floor.clearance, floor.outline)


def _best_line(
    box: Box, place: Point, walls: Floor, floor: Floor, origin: Point, pitch: float
) -> tuple[list[Cell], float]:
    """The line of aisle cells from which the most places of the box are reached, and the places' least room."""
    side = OPPOSITE[box.opens]
    along = 0 if side in ("north", "south") else 1
    depth, aside = place
    shift = [STEP[side][0] * depth, STEP[side][1] * depth]
    left, top, right, bottom = box.box
    spans = [[left - shift[0], right - shift[0]], [top - shift[1], bottom - shift[1]]]
    spans[along] = [spans[along][0] + aside, spans[along][1] - aside]
    across, lengthwise = (
        range(int(np.ceil((low - o) / pitch - 1e-9)), int(np.floor((high - o) / pitch + 1e-9)) + 1)
        for (low, high), o in zip((spans[1 - along], spans[along]), (origin[1 - along], origin[along]), strict=True)
    )
    best: tuple[list[Cell], float] = ([], ROOM_REACH_M)
    for line in across:
        cells: list[Cell] = [(k, line) if along == 0 else (line, k) for k in lengthwise]
        rooms = {cell: _standing_room(cell, box, place, walls, floor, origin, pitch) for cell in cells}
        fitting = [cell for cell in cells if rooms[cell] >= MIN_GAP_M]
        if len(fitting) > len(best[0]):
            best = fitting, min(rooms[cell] for cell in fitting)
    return best


def _place(role: Role, box: Box) -> Point:
    """How deep and how far aside of the aisle cell the middle of a place lies."""
    depth, aside = spur_shape(role, box.per_cell)[-1]
    return depth - AGV_LENGTH_M / 2, aside


def _standing_room(
    cell: Cell, box: Box, place: Point, walls: Floor, floor: Floor, origin: Point, pitch: float
) -> float:
    """Least room around AGVs standing in a cell's places; negative if the aisle cell or a place is no floor."""
    x, y = origin[0] + cell[0] * pitch, origin[1] + cell[1] * pitch
    dx, dy = STEP[OPPOSITE[box.opens]]
    depth, aside = place
    hands = (-1, 1) if box.per_cell == 2 else (0,)
    bodies = np.array([(x + dx * depth + dy * h * aside, y + dy * depth + dx * h * aside, dx, dy) for h in hands])
    if not floor.holds((x, y)) or not all(walls.holds((bx, by)) for bx, by, _, _ in bodies.tolist()):
        return -1.0
    return float(room_of(bodies, walls).min())


def rows_of(plan: FloorPlan, walls: Floor, floor: Floor, cells: Cells, source: str) -> list[Row]:
    """The rows of every box.

    Args:
        plan, walls: the plan as read.
        floor: where lanes may lead.
        cells: the cells on it.
        source: what to call the plan in an error.

    Raises:
        LayoutError: a box in which no place fits.
    """
    rows: list[Row] = []
    for role, label, box in boxes_of(plan):
        place = _place(role, box)
        line = [c for c in _best_line(box, place, walls, floor, cells.origin, plan.pitch_m)[0] if c in cells.beside]
        if not line:
            raise LayoutError(
                f"{source}: {label}: no place fits between walls and pillars with an aisle to the {box.opens};"
                f" an AGV is {AGV_LENGTH_M:g} x {AGV_WIDTH_M:g} m, a place begins"
                f" {place[0] - AGV_LENGTH_M / 2:.1f} m beside the middle of the aisle"
            )
        side = OPPOSITE[box.opens]
        rows += [Row(role, label, side, box.per_cell, run) for run in _unbroken(line, cells)]
    return rows


def _unbroken(line: Sequence[Cell], cells: Cells) -> Iterator[tuple[Cell, ...]]:
    run = [line[0]]
    for cell in line[1:]:
        if cell not in cells.beside[run[-1]]:
            yield tuple(run)
            run = []
        run.append(cell)
    yield tuple(run)
