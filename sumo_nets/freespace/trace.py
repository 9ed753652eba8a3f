"""Guide paths traced through a floor plan, laid on cells, and written as a layout.

The cells are shifted to where the most slots fit between the pillars. Places beside the same straight aisle form rows;
the ends of rows are joined by guide paths (RRT-GRID of paper 001, or the visibility graph), shortest first, each only
where the lanes so far lead much longer round: a greedy spanner (Althofer and others, 1993). A guide path becomes lanes
along the cells nearest to it. At last AGVs of full size drive every lane and every turn past the walls, and places that
come too close are given up.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, groupby, pairwise
from typing import Any

import numpy as np

from sumo_nets.bodies import AGV_LENGTH_M, AGV_WIDTH_M, MIN_GAP_M, closest_moving, driving_bodies, standing_bodies
from sumo_nets.freespace.floor import Floor, Point, rectangle, room_around
from sumo_nets.freespace.floorplan import Box, FloorPlan, boxes_of
from sumo_nets.freespace.rrt import FreePath, Tuning
from sumo_nets.freespace.rrt_grid import rrt_grid
from sumo_nets.freespace.scenes import WIDTH
from sumo_nets.freespace.visibility import VisibilityGraph
from sumo_nets.graph import FloatArray, Role
from sumo_nets.layout import FIELD_OF_ROLE, STEP, Layout, LayoutError, Side
from sumo_nets.plan import PAIR_SPURS_M, SPUR_M, GaragePlan, plan_garage, spur_names

#: A guide path keeps this far from walls, pillars and places: half an AGV and the least gap.
LANE_CLEARANCE_M = AGV_WIDTH_M / 2 + MIN_GAP_M
#: Two ends of rows are joined if the lanes so far are this many times as long as the guide path.
STRETCH = 1.7
#: The cells are shifted by this part of the pitch when the best origin is looked for.
_SHIFTS = 16
#: Laying a guide path on cells, a lane that is there already costs this share of a new one.
_REUSE = 0.5
_ROOM_REACH_M = 3.0
#: Nothing farther from a box than this is near its places or the aisle beside them.
_MATTERS_M = 16.0
_OPPOSITE: Mapping[Side, Side] = {"north": "south", "south": "north", "east": "west", "west": "east"}

Cell = tuple[int, int]
#: A spur: the aisle's cell and the side of it.
SpurKey = tuple[Cell, Side]
Tracer = Callable[[Point, Point], FreePath]


@dataclass(frozen=True, eq=False)
class GuidePath:
    """One traced path that became lanes.

    Attributes:
        start, to: the boxes whose rows it joins.
        points: the path in the plan's metres, shape (k, 2).
        length_m: its length.
        shortest_m: length of the shortest path there is, by the visibility graph.
        lanes_m: length of the way along the lanes.
    """

    start: str
    to: str
    points: FloatArray
    length_m: float
    shortest_m: float
    lanes_m: float


@dataclass(frozen=True, eq=False)
class Tracing:
    """A layout proposed for a floor plan.

    Attributes:
        layout: builds and runs.
        origin: where the layout's cell [0, 0] lies in the plan, metres.
        guide_paths: the traced paths, in the order of tracing.
        places: number of places by role.
        dropped: places given up for want of room, by the box they lie in.
        least_room_m: least room between an AGV and a wall or pillar, anywhere.
    """

    layout: Layout
    origin: Point
    guide_paths: tuple[GuidePath, ...]
    places: Mapping[Role, int]
    dropped: Mapping[str, int]
    least_room_m: float


def trace_lanes(plan: FloorPlan, walls: Floor, method: str = "rrt-grid", seed: int = 1, source: str = "") -> Tracing:
    """Propose a layout for a floor plan.

    Args:
        plan, walls: the plan as read.
        method: what traces the guide paths, ``rrt-grid`` or ``visibility``.
        seed: seed of RRT-GRID.
        source: what to call the plan in an error; its name by default.

    Returns:
        The layout, all its lanes two-way, with what it was made from.

    Raises:
        LayoutError: a box in which nothing fits, rows that no path joins, a street the bays don't suit; one line.
    """
    name = source or plan.name
    floor = _floor(plan, walls)
    origin = plan.origin or best_origin(plan, walls, floor)
    cells = _Cells(walls, floor, origin, plan.pitch_m)
    rows = _rows(plan, walls, cells, name)
    lanes, guide_paths = _join(rows, cells, _tracer(floor, method, seed), VisibilityGraph(floor), name)
    return _fit(plan, walls, cells, rows, lanes, guide_paths, name)


def _floor(plan: FloorPlan, walls: Floor) -> Floor:
    """Where lanes may lead: clear of walls, pillars and places."""
    boxes = [rectangle(*box.box) for _, _, box in boxes_of(plan)]
    return Floor(walls.width, walls.height, (*walls.obstacles, *boxes), LANE_CLEARANCE_M, walls.outline)


def _tracer(floor: Floor, method: str, seed: int) -> Tracer:
    if method == "visibility":
        return VisibilityGraph(floor).shortest
    rng = np.random.default_rng(seed)
    tuning = Tuning().scaled(max(floor.width, floor.height) / WIDTH)
    return lambda start, goal: rrt_grid(floor, start, goal, rng, tuning)


# --- cells -----------------------------------------------------------------------------------------------------------


class _Cells:
    """The cells an AGV may drive on and turn in every way, and which of them are joined."""

    def __init__(self, walls: Floor, floor: Floor, origin: Point, pitch: float) -> None:
        self.origin, self.pitch, self.walls = origin, pitch, walls
        columns, rows = (
            range(-int(o // pitch), int((size - o) // pitch) + 1)
            for size, o in zip((walls.width, walls.height), origin, strict=True)
        )
        free = {(x, y) for x in columns for y in rows if floor.holds(self.centre((x, y)))}
        self.beside = {
            cell: [there for there in _neighbours(cell) if there in free and self._sees(floor, cell, there)]
            for cell in sorted(free)
        }
        for cell in self._tight():
            for there in self.beside.pop(cell):
                if there in self.beside:
                    self.beside[there].remove(cell)

    def centre(self, cell: Cell) -> Point:
        """Middle of a cell in the plan's metres."""
        return self.origin[0] + cell[0] * self.pitch, self.origin[1] + cell[1] * self.pitch

    def _sees(self, floor: Floor, here: Cell, there: Cell) -> bool:
        return floor.sees(self.centre(here), self.centre(there))

    def _tight(self) -> set[Cell]:
        """Cells in which some turn between joined cells comes too close to a wall."""
        index = {cell: i for i, cell in enumerate(self.beside)}
        lanes = [(here, there) for here, others in self.beside.items() for there in others]
        if not lanes:
            return set()
        tail, head = (np.array([index[lane[k]] for lane in lanes], dtype=np.int32) for k in (0, 1))
        shapes = [np.array([self.centre(here), self.centre(there)]) for here, there in lanes]
        tight: set[Cell] = set()
        for bodies, before, _ in driving_bodies(tail, head, shapes):
            room = _room(bodies, self.walls)
            tight |= {lanes[e][1] for e in before[room < MIN_GAP_M].tolist()}
        return tight

    def lay(self, path: FloatArray, start: Cell, goal: Cell, lanes: set[frozenset[Cell]]) -> list[Cell]:
        """The cells along a path: the shortest way where leaving the path costs extra; none if there is no way."""
        OPEN: list[tuple[float, Cell]] = [(0.0, start)]
        g = {start: 0.0}
        parent: dict[Cell, Cell] = {}
        while OPEN:
            g_here, here = heapq.heappop(OPEN)
            if here == goal:
                way = [goal]
                while way[-1] in parent:
                    way.append(parent[way[-1]])
                return way[::-1]
            if g_here > g[here]:
                continue
            for there in self.beside[here]:
                a, b = self.centre(here), self.centre(there)
                aside = _distance(((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), path)
                share = _REUSE if frozenset((here, there)) in lanes else 1.0
                g_there = g_here + (self.pitch + aside) * share
                if g_there < g.get(there, np.inf):
                    g[there], parent[there] = g_there, here
                    heapq.heappush(OPEN, (g_there, there))
        return []


def _neighbours(cell: Cell) -> Iterator[Cell]:
    for side in _OPPOSITE:
        yield _step(cell, side)


def _step(cell: Cell, side: Side) -> Cell:
    return cell[0] + STEP[side][0], cell[1] + STEP[side][1]


def _distance(point: Point, path: FloatArray) -> float:
    """Distance of a point from a path."""
    a, u = path[:-1], np.diff(path, axis=0)
    t = ((np.array(point) - a) * u).sum(axis=1) / np.maximum((u * u).sum(axis=1), 1e-12)
    near = a + np.clip(t, 0, 1)[:, None] * u
    return float(np.hypot(*(near - point).T).min())


def _room(bodies: FloatArray, walls: Floor) -> FloatArray:
    room: FloatArray = room_around(bodies, AGV_LENGTH_M, AGV_WIDTH_M, walls.edges, _ROOM_REACH_M)
    return room


# --- places ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Row:
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
        used, slots, least = 0, 0, _ROOM_REACH_M
        for role, box, walls_near, floor_near in boxes:
            line, room = _best_line(box, walls_near, floor_near, origin, plan.pitch_m)
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


def _best_line(box: Box, walls: Floor, floor: Floor, origin: Point, pitch: float) -> tuple[list[Cell], float]:
    """The line of aisle cells from which the most places of the box are reached, and the places' least room."""
    side = _OPPOSITE[box.opens]
    along = 0 if side in ("north", "south") else 1
    depth, aside = _place(box.per_cell)
    shift = [STEP[side][0] * depth, STEP[side][1] * depth]
    left, top, right, bottom = box.box
    spans = [[left - shift[0], right - shift[0]], [top - shift[1], bottom - shift[1]]]
    spans[along] = [spans[along][0] + aside, spans[along][1] - aside]
    across, lengthwise = (
        range(int(np.ceil((low - o) / pitch - 1e-9)), int(np.floor((high - o) / pitch + 1e-9)) + 1)
        for (low, high), o in zip((spans[1 - along], spans[along]), (origin[1 - along], origin[along]), strict=True)
    )
    best: tuple[list[Cell], float] = ([], _ROOM_REACH_M)
    for line in across:
        cells: list[Cell] = [(k, line) if along == 0 else (line, k) for k in lengthwise]
        rooms = {cell: _standing_room(cell, box, walls, floor, origin, pitch) for cell in cells}
        fitting = [cell for cell in cells if rooms[cell] >= MIN_GAP_M]
        if len(fitting) > len(best[0]):
            best = fitting, min(rooms[cell] for cell in fitting)
    return best


def _place(per_cell: int) -> Point:
    """How deep and how far aside of the aisle cell the middle of a place lies."""
    if per_cell == 1:
        return SPUR_M - AGV_LENGTH_M / 2, 0.0
    depth, aside = PAIR_SPURS_M[-1]
    return depth - AGV_LENGTH_M / 2, aside


def _standing_room(cell: Cell, box: Box, walls: Floor, floor: Floor, origin: Point, pitch: float) -> float:
    """Least room around AGVs standing in a cell's places; negative if the aisle cell or a place is no floor."""
    x, y = origin[0] + cell[0] * pitch, origin[1] + cell[1] * pitch
    dx, dy = STEP[_OPPOSITE[box.opens]]
    depth, aside = _place(box.per_cell)
    hands = (-1, 1) if box.per_cell == 2 else (0,)
    bodies = np.array([(x + dx * depth + dy * h * aside, y + dy * depth + dx * h * aside, dx, dy) for h in hands])
    if not floor.holds((x, y)) or not all(walls.holds((bx, by)) for bx, by, _, _ in bodies.tolist()):
        return -1.0
    return float(_room(bodies, walls).min())


def _rows(plan: FloorPlan, walls: Floor, cells: _Cells, source: str) -> list[_Row]:
    floor = _floor(plan, walls)
    rows: list[_Row] = []
    for role, label, box in boxes_of(plan):
        line = [c for c in _best_line(box, walls, floor, cells.origin, plan.pitch_m)[0] if c in cells.beside]
        if not line:
            raise LayoutError(
                f"{source}: {label}: no place fits between walls and pillars with an aisle to the {box.opens};"
                f" an AGV is {AGV_LENGTH_M:g} x {AGV_WIDTH_M:g} m, a place begins"
                f" {_place(box.per_cell)[0] - AGV_LENGTH_M / 2:.1f} m beside the middle of the aisle"
            )
        side = _OPPOSITE[box.opens]
        rows += [_Row(role, label, side, box.per_cell, run) for run in _unbroken(line, cells)]
    return rows


def _unbroken(line: Sequence[Cell], cells: _Cells) -> Iterator[tuple[Cell, ...]]:
    run = [line[0]]
    for cell in line[1:]:
        if cell not in cells.beside[run[-1]]:
            yield tuple(run)
            run = []
        run.append(cell)
    yield tuple(run)


# --- lanes -----------------------------------------------------------------------------------------------------------


def _join(
    rows: Sequence[_Row], cells: _Cells, trace: Tracer, shortest: VisibilityGraph, source: str
) -> tuple[set[frozenset[Cell]], tuple[GuidePath, ...]]:
    """Lanes along the rows and along guide paths between their ends."""
    lanes = {frozenset(pair) for row in rows for pair in pairwise(row.cells)}
    ends = {cell: row.label for row in reversed(rows) for cell in (row.cells[-1], row.cells[0])}
    guide_paths: list[GuidePath] = []

    def apart(pair: tuple[Cell, Cell]) -> float:
        return float(np.hypot(pair[0][0] - pair[1][0], pair[0][1] - pair[1][1]))

    for a, b in sorted(combinations(sorted(ends), 2), key=apart):
        if cells.pitch * _hops(lanes, a, b) <= STRETCH * cells.pitch * apart((a, b)):
            continue
        path = trace(cells.centre(a), cells.centre(b))
        if not path.found or cells.pitch * _hops(lanes, a, b) <= STRETCH * path.length:
            continue
        way = cells.lay(path.points, a, b, lanes)
        lanes |= {frozenset(pair) for pair in pairwise(way)}
        if way:
            best = shortest.shortest(cells.centre(a), cells.centre(b))
            guide_paths.append(
                GuidePath(ends[a], ends[b], path.points, path.length, best.length, cells.pitch * (len(way) - 1))
            )
    first = next(iter(ends))
    for cell, label in ends.items():
        if not np.isfinite(_hops(lanes, first, cell)):
            raise LayoutError(
                f"{source}: no way from {ends[first]} to {label} that is {2 * LANE_CLEARANCE_M:g} m wide and lets an"
                f" AGV turn on cells of {cells.pitch:g} m; move walls or boxes, or give another pitch_m or origin"
            )
    return lanes, tuple(guide_paths)


def _hops(lanes: set[frozenset[Cell]], start: Cell, goal: Cell) -> float:
    """Lanes on the shortest way, infinite without one."""
    hops = {start: 0}
    queue = deque([start])
    while queue:
        here = queue.popleft()
        if here == goal:
            return hops[here]
        for there in _neighbours(here):
            if there not in hops and frozenset((here, there)) in lanes:
                hops[there] = hops[here] + 1
                queue.append(there)
    return np.inf


# --- layout ----------------------------------------------------------------------------------------------------------


@dataclass
class _Draft:
    """A layout in the making, on the tracer's own cells."""

    plan: FloorPlan
    lanes: set[frozenset[Cell]]
    spurs: dict[SpurKey, tuple[Role, int, str]]
    street: tuple[Cell, Cell]
    low: Cell = field(init=False)

    def __post_init__(self) -> None:
        used = [cell for lane in self.lanes for cell in lane] + [cell for cell, _ in self.spurs] + [*self.street]
        self.low = min(x for x, _ in used), min(y for _, y in used)

    def at(self, cell: Cell) -> list[int]:
        """A cell as the layout counts it."""
        return [cell[0] - self.low[0], cell[1] - self.low[1]]

    def layout(self) -> Layout:
        data: dict[str, Any] = {"name": self.plan.name, "pitch_m": self.plan.pitch_m, "handover": "bay"}
        data["aisles"] = [
            {"from": self.at(run[0]), "to": self.at(run[-1]), "way": "two"} for run in _straight_runs(self.lanes)
        ]
        for role, key in FIELD_OF_ROLE.items():
            data[key] = list(self._spur_rows(role))
        data["street"] = {"from": self.at(self.street[0]), "to": self.at(self.street[1])}
        return Layout.model_validate(data)

    def _spur_rows(self, role: Role) -> Iterator[dict[str, Any]]:
        chosen = [(side, per_cell, cell) for (cell, side), (r, per_cell, _) in self.spurs.items() if r == role]
        for (side, per_cell), group in groupby(sorted(chosen), key=lambda spur: spur[:2]):
            along = 0 if side in ("north", "south") else 1
            for run in _runs([cell for _, _, cell in group], along):
                where = {"from": self.at(run[0]), "to": self.at(run[-1])} if len(run) > 1 else {"at": self.at(run[0])}
                yield {**where, "side": side, "per_cell": per_cell}


def _runs(cells: Sequence[Cell], along: int) -> Iterator[list[Cell]]:
    """Unbroken runs of cells along an axis (0: in a row, 1: in a column)."""
    run: list[Cell] = []
    for cell in sorted(cells, key=lambda c: (c[1 - along], c[along])):
        if run and (cell[1 - along], cell[along]) != (run[-1][1 - along], run[-1][along] + 1):
            yield run
            run = []
        run.append(cell)
    if run:
        yield run


def _straight_runs(lanes: set[frozenset[Cell]]) -> Iterator[list[Cell]]:
    """Lanes as straight runs of cells, as long as they go."""
    for along in (0, 1):
        firsts = [min(lane) for lane in lanes if len({cell[1 - along] for cell in lane}) == 1]
        for run in _runs(firsts, along):
            last = run[-1]
            yield [*run, (last[0] + 1 - along, last[1] + along)]


def _fit(
    plan: FloorPlan,
    walls: Floor,
    cells: _Cells,
    rows: Sequence[_Row],
    lanes: set[frozenset[Cell]],
    guide_paths: tuple[GuidePath, ...],
    source: str,
) -> Tracing:
    """Make the layout; places that AGVs of full size can't reach are left out."""
    spurs = {(cell, row.side): (row.role, row.per_cell, row.label) for row in rows for cell in row.cells}
    dropped: dict[str, int] = {}
    street = _street(plan, cells)
    while True:
        _check_roles(spurs, source)
        draft = _Draft(plan, lanes, spurs, street)
        garage = plan_garage(draft.layout(), source)
        tight, least = _tight_spurs(garage, walls, cells, draft, source)
        if not tight:
            break
        for key in tight:
            _, per_cell, label = spurs.pop(key)
            dropped[label] = dropped.get(label, 0) + per_cell
    closest = closest_moving(*garage.lane_arrays())
    if closest is not None and closest.gap_m < MIN_GAP_M:
        raise LayoutError(f"{source}: AGVs would pass each other with {closest.gap_m:.2f} m; give another pitch_m")
    places = {role: len(garage.roles[role]) for role in FIELD_OF_ROLE if garage.roles[role]}
    return Tracing(draft.layout(), cells.centre(draft.low), guide_paths, places, dropped, least)


def _street(plan: FloorPlan, cells: _Cells) -> tuple[Cell, Cell]:
    """The cells nearest to the street's ends, in one row or one column."""
    (x0, y0), (x1, y1) = (
        tuple(round((p - o) / cells.pitch) for p, o in zip(end, cells.origin, strict=True))
        for end in (plan.street.start, plan.street.to)
    )
    if abs(x1 - x0) < abs(y1 - y0):
        return (x0, y0), (x0, y1)
    return (x0, y0), (x1, y0)


def _check_roles(spurs: Mapping[SpurKey, tuple[Role, int, str]], source: str) -> None:
    roles = {role for role, _, _ in spurs.values()}
    for role in ("slot", "bay", "home"):
        if role not in roles:
            raise LayoutError(f"{source}: {FIELD_OF_ROLE[role]}: no AGV gets into any place past walls and pillars")


def _tight_spurs(
    garage: GaragePlan, walls: Floor, cells: _Cells, draft: _Draft, source: str
) -> tuple[set[SpurKey], float]:
    """Spurs on which an AGV, standing or on its way, comes too close to a wall; and the least room of all."""
    owner = {
        name: (cell, side)
        for (cell, side), (role, per_cell, _) in draft.spurs.items()
        for name in spur_names(role, (draft.at(cell)[0], draft.at(cell)[1]), side, per_cell)
    }
    lanes = list(garage.lanes.values())
    tail, head, shapes = garage.lane_arrays()
    corner = np.array(cells.centre(draft.low))
    # the net's y points up
    shapes = [corner + shape * (1, -1) for shape in shapes]
    every = np.arange(len(lanes), dtype=np.int32)
    tight: set[SpurKey] = set()
    least = _ROOM_REACH_M
    for bodies, before, onto in [
        (standing_bodies(shapes), every, every),
        *driving_bodies(tail, head, shapes),
    ]:
        room = _room(bodies, walls)
        least = min(least, float(room.min()))
        for e in np.flatnonzero(room < MIN_GAP_M).tolist():
            ends = (lanes[before[e]].tail, lanes[before[e]].head, lanes[onto[e]].head)
            guilty = {owner[name] for name in ends if name in owner}
            if not guilty:
                raise LayoutError(
                    f"{source}: an AGV from {ends[0]} over {ends[1]} to {ends[2]} has {room[e]:.2f} m to a wall or"
                    f" pillar; {MIN_GAP_M} m is needed: give another pitch_m or origin"
                )
            tight |= guilty
    return tight, least
