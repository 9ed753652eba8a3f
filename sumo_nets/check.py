"""Check that a net is a garage that works: whole two-way lanes, a way everywhere, room for every body, no warning."""

from __future__ import annotations

import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence

from sumo_nets.bodies import MIN_GAP_M, MIN_LANE_M, ClosestBodies, closest_moving, closest_standing
from sumo_nets.graph import Graph
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered
from sumo_nets.read import GarageNet
from sumo_nets.well_formed import describe

#: Longest that SUMO may take to load a net.
_LOAD_TIMEOUT_S = 300
_LOAD = """
import sys, libsumo
libsumo.start(["sumo", "-n", sys.argv[1], "-a", sys.argv[2], "--no-step-log", "--step-length", "0.5"])
libsumo.simulationStep()
libsumo.close()
"""


def check_net(garage: GarageNet) -> list[str]:
    """Look for everything that would stop AGVs later.

    Args:
        garage: the net as read.

    Returns:
        One line for each complaint; empty if the net is fine.
    """
    return [
        *_check_counts(garage.graph),
        *_check_lanes(garage),
        *_check_ways(garage.graph),
        *_check_chargers(garage),
        *_check_room(garage),
        *_check_loads(garage),
    ]


def describe_net(garage: GarageNet) -> str:
    """One line with what a net holds: counts by role, vertices, lanes, one-way lanes, whether end points block ways."""
    graph = garage.graph
    counts = ", ".join(
        f"{len(graph.roles[role])} {role}s"
        for role in ("slot", "bay", "home", "charger", "refuge")
        if graph.roles[role]
    )
    one_way = int((graph.reverse < 0).sum())
    return (
        f"{garage.name}: {counts}; {len(graph.names)} vertices,"
        f" {(len(graph.tail) - one_way) // 2} two-way and {one_way} one-way lanes; hand-over at the {garage.handover};"
        f" {describe(graph)}"
    )


def _check_counts(graph: Graph) -> Iterator[str]:
    for role in ("slot", "bay", "home"):
        if not graph.roles[role]:
            yield f"no {role}s"


def _check_lanes(garage: GarageNet) -> Iterator[str]:
    graph = garage.graph
    for e, name in numbered(graph.edge_names):
        twin = EdgeIndex(int(graph.reverse[e]))
        if twin >= 0 and not garage.bidi[e]:
            yield f"{name}: not marked bidi with {graph.edge_names[twin]}, so no AGV can reverse there"
        elif twin > e and abs(graph.length_m[e] - graph.length_m[twin]) > 0.005:
            yield f"{name}: {graph.length_m[e]:.2f} m, but {graph.length_m[twin]:.2f} m in the other direction"
        if graph.length_m[e] < MIN_LANE_M:
            yield f"{name}: {graph.length_m[e]:.2f} m long; an AGV needs {MIN_LANE_M:.2f} m to stand on"


def _check_ways(graph: Graph) -> Iterator[str]:
    """Ways between every bay and every slot, home and charger, both ways, through no other place where AGVs stay."""
    places = {v for role in ("slot", "bay", "home", "charger") for v in graph.roles[role]}
    forward = graph.successors
    backward: Numbered[Vertex, list[Vertex]] = [[] for _ in forward]
    for u, v in graph.ends:
        backward[v].append(u)
    # on an open floor slots and homes lie in the way by design, and are passed while nobody stands there
    open_floor = any(len({*forward[v], *backward[v]}) > 1 for v in graph.slots)
    closed = set() if open_floor else places
    for bay in graph.bays:
        for neighbours, way in (
            (forward, f"from bay {graph.names[bay]} to"),
            (backward, f"to bay {graph.names[bay]} from"),
        ):
            missing = sorted(places - _reached(bay, neighbours, closed))
            if missing:
                more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
                yield f"no way {way} {graph.names[missing[0]]}{more}"


def _reached(start: Vertex, neighbours: Numbered[Vertex, Sequence[Vertex]], closed: set[Vertex]) -> set[Vertex]:
    """Vertices reached without leaving any closed vertex but the start."""
    seen = {start}
    queue = deque(seen)
    while queue:
        here = queue.popleft()
        if here in closed and here != start:
            continue
        for there in neighbours[here]:
            if there not in seen:
                seen.add(there)
                queue.append(there)
    return seen


def _check_chargers(garage: GarageNet) -> Iterator[str]:
    leading = sorted(e for charger in garage.graph.chargers for e in garage.graph.in_edges(charger))
    for e in leading:
        if e not in garage.charging_station_of_edge:
            yield f"{garage.graph.edge_names[e]}: leads to a charger, but has no chargingStation"


def _check_room(garage: GarageNet) -> Iterator[str]:
    graph = garage.graph
    for closest, doing in (
        (closest_standing(graph.tail, graph.head, garage.shapes), "standing at the end of"),
        (closest_moving(graph.tail, graph.head, garage.shapes), "driving onto"),
    ):
        if closest is not None and closest.gap_m < MIN_GAP_M:
            yield _room(graph, closest, doing)


def _room(graph: Graph, closest: ClosestBodies, doing: str) -> str:
    first, second = (graph.edge_names[e] for e in (closest.first, closest.second))
    return f"an AGV {doing} {first} has {closest.gap_m:.2f} m to one at the end of {second}; {MIN_GAP_M} m is needed"


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
