"""What the controller is told of faults, and how it answers.

A real controller learns that an AGV does not answer to commands, that a sensor has seen a person in a lane, that a bay
is out of order. It does not learn that an AGV is late or slow: it only sees where the AGV is. The answers:

- an AGV that can't move stands reserved like all others, with all that was granted to it, and is planned round;
- a broken AGV's task is given back to the open ones, unless the car is on it: then it keeps the task;
- what is closed is granted to nobody and planned round; goals there are changed where another will do, and are waited
  for where not;
- all other AGVs go on: service is degraded, not stopped.
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

#: Kinds of fault that AGVs report: they cannot move.
IMMOBILE: frozenset[FaultKind] = frozenset({"breakdown", "repair", "battery", "zone_stop", "all_stop"})
#: Kinds after whose start an AGV gets no new task until they are over.
OFF_DUTY: frozenset[FaultKind] = frozenset({"breakdown", "tow", "repair", "battery"})
#: Kinds that close places for so long that goals there are changed; for the end of an emergency stop one waits.
CLOSING: frozenset[FaultKind] = frozenset({"blocked", "bay", "charger"})
#: Kinds the controller is told of.
REPORTED = IMMOBILE | OFF_DUTY | CLOSING


@dataclass(frozen=True, slots=True)
class FaultReport:
    """A fault begins or ends.

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
    """What is out of order, as far as the controller was told. Faults overlap, so they are counted.

    Attributes:
        immobile: AGVs that cannot move.
        off_duty: AGVs that get no task.
        closed: vertices that nobody may enter.
        running: the faults that have begun and not ended, by number.
    """

    immobile: Counter[AgvNumber] = field(default_factory=Counter)
    off_duty: Counter[AgvNumber] = field(default_factory=Counter)
    closed: frozenset[Vertex] = frozenset()
    running: dict[int, FaultReport] = field(default_factory=dict)
    _closed: Counter[Vertex] = field(default_factory=Counter)

    def take(self, fault: FaultReport) -> None:
        """Take note of a fault that begins or ends."""
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
        """Numbers of the faults because of which an AGV cannot move."""
        return tuple(n for n, fault in self.running.items() if fault.kind in IMMOBILE and agv in fault.agvs)

    def closing(self, vertex: Vertex) -> tuple[int, ...]:
        """Numbers of the faults that close a vertex."""
        return tuple(n for n, fault in self.running.items() if vertex in fault.vertices)


def _add(count: Counter[_Number], keys: tuple[_Number, ...], one: int) -> None:
    for key in keys:
        count[key] += one
        if not count[key]:
            del count[key]
