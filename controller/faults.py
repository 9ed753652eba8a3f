"""What the controller learns of faults, and how it responds.

A real controller learns that an AGV ignores commands, that a sensor has seen a person in a lane, or that a bay is out
of order. It does not learn that an AGV is late or slow: it only sees the AGV's position. The responses are:

- An AGV that cannot move stays reserved with all vertices granted to it. Other AGVs are planned around it.
- A broken AGV's task returns to the open tasks. If the car is already on the AGV, the AGV keeps the task.
- A closed vertex is granted to no AGV and planned around. A goal there is replaced where possible; otherwise the AGV
  waits for the vertex to open.
- All other AGVs continue: service is degraded, not stopped.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from controller.types import AgvNumber
from sumo_nets.numbering import Vertex

_Number = TypeVar("_Number", AgvNumber, Vertex)

#: What can go wrong, see ``parking_sim.fault_config``. After a breakdown comes a tow or a repair; a command may come
#: late, or be lost and sent again.
FaultKind = Literal[
    "stop", "slow", "stale", "breakdown", "battery", "blocked", "bay", "charger", "zone_stop", "all_stop",
    "tow", "repair", "late", "lost",
]  # fmt: skip

#: Kinds of fault that AGVs report and that stop them.
IMMOBILE: frozenset[FaultKind] = frozenset({"breakdown", "repair", "battery", "zone_stop", "all_stop"})
#: Kinds of fault that exclude an AGV from new tasks until the fault is over.
OFF_DUTY: frozenset[FaultKind] = frozenset({"breakdown", "tow", "repair", "battery"})
#: Kinds that close places for long enough to change goals there. After an emergency stop, AGVs wait instead.
CLOSING: frozenset[FaultKind] = frozenset({"blocked", "bay", "charger"})
#: Kinds reported to the controller.
REPORTED = IMMOBILE | OFF_DUTY | CLOSING


@dataclass(frozen=True, slots=True)
class FaultReport:
    """The start or end of a fault.

    Attributes:
        number: count of faults in the run; start and end have the same.
        kind: what happens.
        started: it begins (otherwise it ends).
        agvs: AGVs concerned.
        vertices: places concerned.
    """

    number: int
    kind: FaultKind
    started: bool
    agvs: tuple[AgvNumber, ...] = ()
    vertices: tuple[Vertex, ...] = ()


@dataclass(slots=True)
class Outages:
    """AGVs and vertices that are out of order, as far as the controller knows. Overlapping faults are counted.

    Attributes:
        immobile: AGVs that cannot move.
        off_duty: AGVs that get no task.
        closed: vertices that no AGV may enter.
        running: faults that have begun and not ended, by number.
    """

    immobile: Counter[AgvNumber] = field(default_factory=Counter)
    off_duty: Counter[AgvNumber] = field(default_factory=Counter)
    closed: frozenset[Vertex] = frozenset()
    running: dict[int, FaultReport] = field(default_factory=dict)
    _closed: Counter[Vertex] = field(default_factory=Counter)

    def take(self, fault: FaultReport) -> None:
        """Record the start or end of a fault."""
        if fault.started:
            self.running[fault.number] = fault
        else:
            self.running.pop(fault.number, None)
        one = 1 if fault.started else -1
        for count, kinds in ((self.immobile, IMMOBILE), (self.off_duty, OFF_DUTY)):
            if fault.kind in kinds:
                _add(count, fault.agvs, one)
        if fault.vertices:
            _add(self._closed, fault.vertices, one)
            self.closed = frozenset(self._closed)

    def holding(self, agv: AgvNumber) -> tuple[int, ...]:
        """Numbers of the faults that stop an AGV."""
        return tuple(n for n, fault in self.running.items() if fault.kind in IMMOBILE and agv in fault.agvs)

    def closing(self, vertex: Vertex) -> tuple[int, ...]:
        """Numbers of the faults that close a vertex."""
        return tuple(n for n, fault in self.running.items() if vertex in fault.vertices)


def _add(count: Counter[_Number], keys: tuple[_Number, ...], one: int) -> None:
    for key in keys:
        count[key] += one
        if not count[key]:
            del count[key]
