"""When what goes wrong: the faults of one run as a stream in order of time, drawn or scripted.

Each kind, and for faults of AGVs each AGV, has its own seeded generator, so that two controllers meet the same faults
at the same times whatever they do. Between two faults of one kind an exponentially distributed time passes.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from controller.faults import FaultKind
from controller.types import NO_AGV, AgvNumber
from demand.types import stream
from parking_sim.fault_config import AGV_FAULTS, DRAWN_FAULTS, AnyFault, Drawn, FaultConfig
from sumo_nets.errors import InputError
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Vertex
from sumo_nets.wording import one_of


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        start_s: when it begins, seconds.
        kind: what happens: one of ``fault_config.DRAWN_FAULTS``, or what follows from one (tow, repair, late, lost).
        for_s: how long it lasts, seconds.
        agv: the AGV that has it, -1 for none.
        vertex: where it is, -1 for nowhere in particular.
    """

    start_s: float
    kind: FaultKind
    for_s: float
    agv: AgvNumber = NO_AGV
    vertex: Vertex = NO_VERTEX


def fault_stream(config: FaultConfig, graph: Graph, agvs: int, seed: int) -> Iterator[Fault]:
    """All faults of a run in order of time; endless if any are drawn.

    Args:
        config: what can go wrong.
        graph: the garage.
        agvs: number of AGVs.
        seed: seed of the run.

    Raises:
        InputError: a scripted fault names an AGV or a place that isn't there.
    """
    streams = [iter(scripted_faults(config, graph, agvs))]
    for kind in DRAWN_FAULTS:
        drawn: Drawn | None = getattr(config, kind)
        if drawn is None or drawn.per_h == 0:
            continue
        if kind in AGV_FAULTS:
            streams += [_drawn(kind, drawn, seed, AgvNumber(agv), ()) for agv in range(agvs)]
        elif kind == "all_stop" or _places(kind, graph):
            streams.append(_drawn(kind, drawn, seed, NO_AGV, _places(kind, graph)))
    return heapq.merge(*streams, key=lambda fault: fault.start_s)


def scripted_faults(config: FaultConfig, graph: Graph, agvs: int) -> list[Fault]:
    """The scripted faults in order of time; arguments and exceptions as for ``fault_stream``."""
    faults = []
    for number, row in enumerate(config.script):
        if row.agv >= agvs:
            raise InputError(f"faults.script[{number}].agv: {row.agv}: AGVs have the numbers 0 to {agvs - 1}")
        kinds = {"bay": graph.bays, "charger": graph.chargers}
        what = row.kind if row.kind in kinds else "vertex"
        valid = [graph.names[v] for v in kinds.get(row.kind, graph.vertices)]
        if row.place and row.place not in valid:
            wrong = f"{row.place!r}: {graph.name} has no such {what}; {one_of(valid, row.place)}"
            raise InputError(f"faults.script[{number}].place: {wrong}")
        vertex = graph.index[row.place] if row.place else NO_VERTEX
        faults.append(Fault(row.at_s, row.kind, row.for_s, AgvNumber(row.agv), vertex))
    return sorted(faults, key=lambda fault: fault.start_s)


def _places(kind: AnyFault, graph: Graph) -> tuple[Vertex, ...]:
    """Where a fault of this kind may be: lanes and slots, since a blocked home or bay has its own kind or none."""
    if kind == "bay":
        return tuple(graph.bays)
    if kind == "charger":
        return tuple(graph.chargers)
    if kind == "zone_stop":
        return tuple(graph.vertices)
    if kind == "blocked":
        kept = {*graph.bays, *graph.chargers, *graph.homes}
        return tuple(v for v in graph.vertices if v not in kept)
    return ()


def _drawn(kind: AnyFault, drawn: Drawn, seed: int, agv: AgvNumber, places: Sequence[Vertex]) -> Iterator[Fault]:
    rng = stream(seed, f"fault {kind} {agv}")
    time_s = 0.0
    while True:
        time_s += float(rng.exponential(3600.0 / drawn.per_h))
        for_s = float(rng.uniform(drawn.least_s, drawn.most_s))
        vertex = places[int(rng.integers(len(places)))] if places else NO_VERTEX
        yield Fault(time_s, kind, for_s, agv, vertex)
        time_s += for_s
