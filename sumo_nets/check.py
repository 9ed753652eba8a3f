"""Check that a net is a garage that works: whole two-way lanes, a way everywhere, room for every body, no warning."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from sumo_nets.bodies import (
    AGV_SIZE_M,
    CLEAR_M,
    MIN_GAP_M,
    ClosestBodies,
    chord_m,
    closest_moving,
    closest_standing,
    least_way_m,
)
from sumo_nets.doors import one_door_each
from sumo_nets.errors import NetError
from sumo_nets.graph import FloatArray, Graph
from sumo_nets.numbering import EdgeIndex, Vertex, numbered
from sumo_nets.passing import crowded
from sumo_nets.read import GarageNet, is_shipped
from sumo_nets.under_cars import longest_with_room_m, tightest_turn
from sumo_nets.ways import cut_off, shut_in, unconnected_turns
from sumo_nets.well_formed import describe

#: A vertex may lie so far outside the box around its lanes' ends.
OFF_VERTEX_M = 1.0
#: Differences in length that come of rounding: between the directions of a lane, and between a lane and its drawing.
SAME_LENGTH_M, DRAWN_LENGTH_M = 0.005, 0.1
ROUNDING_M = 1e-6
#: SUMO takes vehicles that are slower for standing.
LEAST_SPEED_MPS = 0.1
#: A body lies across a bend; its rear is at least this share of its length away from its front.
STRAIGHT_SHARE = 0.8
#: Longest that SUMO may take to load a net.
_LOAD_TIMEOUT_S = 300
_LOAD = """
import sys, libsumo
libsumo.start(["sumo", "-n", sys.argv[1], "-a", sys.argv[2], "--no-step-log", "--step-length", "0.5"])
libsumo.simulationStep()
libsumo.close()
"""


@lru_cache(maxsize=32)
def check_net(garage: GarageNet, size_m: tuple[float, float] = AGV_SIZE_M, loads: bool = True) -> tuple[str, ...]:
    """Look for everything that would stop AGVs later; once for all runs of a process.

    Args:
        garage: the net as read.
        size_m: length and width of the AGVs.
        loads: also let SUMO load it, in a process of its own.

    Returns:
        One line for each complaint; empty if the net is fine.
    """
    driven = one_door_each(garage)
    shut = list(shut_in(garage.graph))
    lanes = list(_check_lanes(driven, size_m))
    return (
        *_check_counts(garage.graph),
        *shut,
        *(() if shut else cut_off(driven.graph)),
        *_check_vertices(driven),
        *lanes,
        *_check_chargers(driven),
        *((*_check_under_cars(driven, size_m), *_check_room(driven, size_m)) if driven.shapes and not lanes else ()),
        *(_check_loads(garage) if loads else ()),
    )


def require_fit(garage: GarageNet, size_m: tuple[float, float]) -> None:
    """Refuse a garage if :func:`check_net` complains of it. SUMO is not asked about shipped nets.

    Args:
        garage: the net as read.
        size_m: length and width of the AGVs.

    Raises:
        NetError: there are complaints; it has the first one, and how many more.
    """
    complaints = check_net(garage, size_m, loads=False) or check_net(garage, size_m, loads=not is_shipped(garage))
    if complaints:
        more = f"; and {len(complaints) - 1} more: parking-sim check-net names them" if len(complaints) > 1 else ""
        raise NetError(f"{garage.net_file}: {complaints[0]}{more}")


def describe_net(garage: GarageNet) -> str:
    """One line with what a net holds: counts by role, vertices, lanes, one-way lanes, whether end points block ways."""
    graph = garage.graph
    counts = ", ".join(
        f"{len(graph.roles[role])} {role}s"
        for role in ("slot", "bay", "home", "charger", "refuge")
        if graph.roles[role]
    )
    one_way = int((graph.reverse < 0).sum())
    passed = len(graph.tail) - len(one_door_each(garage).graph.tail)
    notes = [describe(graph)]
    if crowd := crowded(one_door_each(garage).graph, len(graph.homes)):
        notes.append(f"not all AGVs can work at once: {crowd}")
    if passed:
        notes.append(f"slots are not driven through in SUMO, which leaves {passed} lanes unused")
    if graph.unconnected:
        notes.append(f"AGVs don't turn {unconnected_turns(graph)}, which the net does not connect")
    return (
        f"{garage.name}: {counts}; {len(graph.names)} vertices,"
        f" {(len(graph.tail) - one_way) // 2} two-way and {one_way} one-way lanes; hand-over at the {garage.handover};"
        f" {'; '.join(notes)}"
    )


def _check_counts(graph: Graph) -> Iterator[str]:
    for role in ("slot", "bay", "home"):
        if not graph.roles[role]:
            yield f"no {role}s"


def _check_vertices(garage: GarageNet) -> Iterator[str]:
    """A vertex lies where its lanes meet: what is planned and freed is counted from there."""
    graph = garage.graph
    meeting: dict[Vertex, list[FloatArray]] = {}
    for e, (tail, head) in numbered(graph.ends):
        meeting.setdefault(tail, []).append(garage.shapes[e][0])
        meeting.setdefault(head, []).append(garage.shapes[e][-1])
    for v, points in meeting.items():
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        off_m = float(np.max(np.maximum(low - graph.xy[v], graph.xy[v] - high)))
        if off_m > OFF_VERTEX_M:
            yield f"{graph.names[v]}: its lanes end {off_m:.2f} m beside it"


def _check_lanes(garage: GarageNet, size_m: tuple[float, float]) -> Iterator[str]:
    graph = garage.graph
    least_m = least_way_m(size_m)
    for e, name in numbered(graph.edge_names):
        twin, lane_m, shape = EdgeIndex(int(graph.reverse[e])), float(graph.length_m[e]), garage.shapes[e]
        drawn_m = float(np.hypot(*np.diff(shape, axis=0).T).sum())
        way_m = lane_m + float(np.hypot(*(shape[0] - graph.xy[graph.tail[e]])))
        if twin >= 0 and not garage.bidi[e]:
            yield f"{name}: not marked bidi with {graph.edge_names[twin]}, so no AGV can reverse there"
        elif twin > e and abs(lane_m - graph.length_m[twin]) > SAME_LENGTH_M:
            yield f"{name}: {lane_m:.2f} m, but {graph.length_m[twin]:.2f} m in the other direction"
        if abs(drawn_m - lane_m) > DRAWN_LENGTH_M:
            yield f"{name}: {lane_m:.2f} m long, but drawn with {drawn_m:.2f} m"
        if way_m < least_m - ROUNDING_M:
            yield f"{name}: {way_m:.2f} m from its vertex to its end; an AGV needs {least_m:.2f} m to stand on"
        elif len(shape) > 2 and chord_m(shape, size_m[0]) < STRAIGHT_SHARE * size_m[0]:
            yield f"{name}: too bent at its end for an AGV of {size_m[0]:g} m to stand there"
        if graph.limit_mps[e] < LEAST_SPEED_MPS:
            yield f"{name}: {graph.limit_mps[e]:g} m/s; {LEAST_SPEED_MPS} m/s or more is valid"


def _check_chargers(garage: GarageNet) -> Iterator[str]:
    for e in sorted(e for charger in garage.graph.chargers for e in garage.graph.in_edges(charger)):
        if e not in garage.charging_station_of_edge:
            yield (
                f"{garage.graph.edge_names[e]}: leads to a charger, but no chargingStation covers its lane's end, where"
                " AGVs stop"
            )


def _check_room(garage: GarageNet, size_m: tuple[float, float]) -> Iterator[str]:
    graph = garage.graph
    for closest, doing in (
        (closest_standing(graph.tail, graph.head, garage.shapes, size_m), "standing at the end of"),
        (closest_moving(graph.tail, graph.head, garage.shapes, size_m), "driving onto"),
    ):
        # a gap that is no number is a complaint, too
        if closest is not None and not closest.gap_m >= MIN_GAP_M:
            yield _room(graph, closest, doing)


def _check_under_cars(garage: GarageNet, size_m: tuple[float, float]) -> Iterator[str]:
    """Check the ways of empty AGVs under cars: out from under a car just set down, and in under a car to be fetched."""
    graph, tightest = garage.graph, tightest_turn(garage, size_m)
    if tightest is None or tightest.room_m >= CLEAR_M:
        return
    fitting_m = longest_with_room_m(garage, size_m, CLEAR_M)
    yield (
        f"{graph.names[tightest.slot]}: an empty AGV of {size_m[0]:g} x {size_m[1]:g} m that turns between the slot and"
        f" {graph.edge_names[tightest.beyond]} has {tightest.room_m:z.2f} m to the car parked there;"
        f" {CLEAR_M} m is needed{f', which AGVs of up to {fitting_m:g} m have' if fitting_m else ''}"
    )


def _room(graph: Graph, closest: ClosestBodies, doing: str) -> str:
    first, second = (graph.edge_names[e] for e in (closest.first, closest.second))
    return f"an AGV {doing} {first} has {closest.gap_m:z.2f} m to one at the end of {second}; {MIN_GAP_M} m is needed"


def _check_loads(garage: GarageNet) -> Iterator[str]:
    # in a process of its own: SUMO allows one simulation in a process, and the caller may be running one
    command = [sys.executable, "-c", _LOAD, str(garage.net_file), str(garage.additional_file)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LOAD_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        yield f"SUMO did not load it within {_LOAD_TIMEOUT_S} s"
        return
    said = [line for line in done.stderr.splitlines() if line.startswith(("Warning", "Error"))]
    yield from (f"SUMO: {line}" for line in said)
    if done.returncode and not said:
        yield f"SUMO: did not load it (exit code {done.returncode})"
