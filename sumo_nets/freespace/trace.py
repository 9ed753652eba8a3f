"""Guide paths traced through a floor plan, laid on cells, and written as a layout.

The cells are shifted to where the most slots fit between the pillars. Places beside the same straight aisle form rows;
the ends of rows are joined by guide paths (RRT-GRID of paper 001, or the visibility graph), shortest first, each only
where the lanes so far lead much longer round: a greedy spanner (Althofer and others, 1993). A guide path becomes lanes
along the cells nearest to it. At last AGVs of full size drive every lane and every turn past the walls, and places that
come too close are given up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from sumo_nets.bodies import AGV_WIDTH_M, MIN_GAP_M, closest_moving, driving_bodies, standing_bodies
from sumo_nets.freespace.cells import ROOM_REACH_M, Cell, Cells, neighbours, room_of
from sumo_nets.freespace.draft import Draft, SpurKey
from sumo_nets.freespace.floor import Floor, Point, rectangle
from sumo_nets.freespace.floorplan import FloorPlan, boxes_of
from sumo_nets.freespace.places import Row, best_origin, rows_of
from sumo_nets.freespace.rrt import FreePath, Tuning
from sumo_nets.freespace.rrt_grid import rrt_grid
from sumo_nets.freespace.scenes import WIDTH
from sumo_nets.freespace.visibility import VisibilityGraph
from sumo_nets.graph import FloatArray, Role
from sumo_nets.layout import FIELD_OF_ROLE, Layout, LayoutError
from sumo_nets.plan import GaragePlan, plan_garage, spur_names

#: A guide path keeps this far from walls, pillars and places: half an AGV and the least gap.
LANE_CLEARANCE_M = AGV_WIDTH_M / 2 + MIN_GAP_M
#: Two ends of rows are joined if the lanes so far are this many times as long as the guide path.
STRETCH = 1.7
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
    cells = Cells(walls, floor, origin, plan.pitch_m)
    rows = rows_of(plan, walls, floor, cells, name)
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


def _join(
    rows: Sequence[Row], cells: Cells, trace: Tracer, shortest: VisibilityGraph, source: str
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
        for there in neighbours(here):
            if there not in hops and frozenset((here, there)) in lanes:
                hops[there] = hops[here] + 1
                queue.append(there)
    return np.inf


def _fit(
    plan: FloorPlan,
    walls: Floor,
    cells: Cells,
    rows: Sequence[Row],
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
        draft = Draft(plan, lanes, spurs, street)
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


def _street(plan: FloorPlan, cells: Cells) -> tuple[Cell, Cell]:
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
    garage: GaragePlan, walls: Floor, cells: Cells, draft: Draft, source: str
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
    least = ROOM_REACH_M
    for bodies, before, onto in [
        (standing_bodies(shapes), every, every),
        *driving_bodies(tail, head, shapes),
    ]:
        room = room_of(bodies, walls)
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
