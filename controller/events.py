"""Events: what the controller, the plants and the loop tell the record.

``KINDS`` says for each kind of event what has happened, and which keys its detail has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from controller.types import NO_AGV, AgvNumber
from sumo_nets.numbering import NO_VERTEX, Vertex

EventKind = Literal[
    "car_initial",
    "request_made",
    "turned_away",
    "request_void",
    "car_at_bay",
    "car_ready",
    "task_assigned",
    "lift",
    "bay_promised",
    "lower",
    "task_done",
    "car_left",
    "agv_mode",
    "plan_partial",
    "reordered",
    "plan_rejected",
    "deadlock_found",
    "deadlock_resolved",
    "obstruction_found",
    "obstruction_resolved",
    "homes_exchanged",
    "stage_failed",
    "held",
    "held_end",
    "charge_wait",
    "charge_start",
    "charge_end",
    "grant",
    "overlap",
    "turn_under_car",
    "task_returned",
    "fault_start",
    "fault_end",
]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that has happened.

    Attributes:
        kind: what, one of ``KINDS``.
        agv: number of the AGV, -1 for none.
        car: name of the car, empty for none.
        vertex: where, -1 for nowhere in particular.
        detail: the keys that ``KINDS`` names for this kind; finite numbers, texts, lists and dictionaries of these.
    """

    kind: EventKind
    agv: AgvNumber = NO_AGV
    car: str = ""
    vertex: Vertex = NO_VERTEX
    detail: Mapping[str, object] = field(default_factory=dict)


#: Takes the events of a run.
Log = Callable[[Event], None]


class Kind(NamedTuple):
    """What an event of one kind says.

    Attributes:
        meaning: what has happened.
        keys: key of the detail -> its meaning.
        one_of: keys of which a detail has just one; it has all the others.
    """

    meaning: str
    keys: Mapping[str, str] = {}
    one_of: frozenset[str] = frozenset()

    def fits(self, detail: Mapping[str, object]) -> bool:
        """Whether a detail has the keys that it has to have, and no others."""
        named = self.keys.keys() - self.one_of
        return len(detail.keys() & self.one_of) == bool(self.one_of) and detail.keys() - self.one_of == named


_REQUEST = {"request": "number of the request"}
_SOC = {"soc": "state of charge of its battery, 0 to 1"}
_DEADLOCK = {"deadlock": "number of the deadlock"}
_OBSTRUCTION = {"obstruction": "number of the obstruction"}
_WAITING = {"waiting": "number of the AGV that waits with a car"}
_GROUP = {"members": "numbers of the AGVs", "cause": "ring, idle or stuck"}
_FOUND = {
    **_GROUP,
    "waits": "AGV -> AGV it waits for",
    "wants": "AGV -> name of the first vertex on its way that is held",
    "holds": "AGV -> names of its vertices",
    "goals": "AGV -> name of its goal",
    "since_s": "when the wait began, seconds",
}
_RESOLVED = {**_GROUP, "stage": "what resolved it", "cost_s": "seconds since the wait began"}
_FAULT = {"fault": "number of the fault", "cause": "kind of fault, see parking_sim.fault_config"}

#: Kind of event -> what has happened, and the keys of its detail.
KINDS: Mapping[EventKind, Kind] = {
    "car_initial": Kind("a car stands in a slot before the run starts"),
    "request_made": Kind("a customer asks", {**_REQUEST, "what": "park or retrieve"}),
    "turned_away": Kind("a customer who comes with a car is turned away", {**_REQUEST, "reason": "why, in words"}),
    "request_void": Kind("a request means nothing", {**_REQUEST, "reason": "why, in words"}),
    "car_at_bay": Kind("a customer's car stands at a bay", _REQUEST),
    "car_ready": Kind("the customer has left the car, it may be lifted", _REQUEST),
    "task_assigned": Kind(
        "an AGV gets a task",
        {
            **_REQUEST,
            "origin": "name of the vertex where the car is",
            "destination": "name of the vertex where it goes, empty if that is not known yet",
        },
    ),
    "lift": Kind("a car is on the AGV", _REQUEST),
    "bay_promised": Kind(
        "an AGV with a car gets a bay",
        {
            **_REQUEST,
            "behind": "number of the AGV at work there, after which it comes; -1 if it has the bay to itself",
            "instead_of": "number of the AGV that was farther away and loses this bay, -1 if none does",
        },
    ),
    "lower": Kind("a car is lowered", _REQUEST),
    "task_done": Kind("a request is served", _REQUEST),
    "car_left": Kind("a retrieved car has left the garage", _REQUEST),
    "agv_mode": Kind(
        "an AGV changes its state",
        {"from": "the old state, one of controller.types.AgvMode", "to": "the new state"},
    ),
    "plan_partial": Kind("a planning call left agents without a path", {"failed": "numbers of these AGVs"}),
    "reordered": Kind(
        "an AGV goes before one that is late",
        {"before": "number of the late AGV", "gain_moves": "what all AGVs together gain, moves"},
    ),
    "plan_rejected": Kind("a plan was refused by the executor's check", {"reason": "why, in words"}),
    "deadlock_found": Kind("AGVs wait for each other or come no nearer to their goals", {**_DEADLOCK, **_FOUND}),
    "deadlock_resolved": Kind("a deadlock is over", {**_DEADLOCK, **_RESOLVED}),
    "obstruction_found": Kind(
        "an AGV that a fault cuts off from its goal stands in the way of others", {**_OBSTRUCTION, **_FOUND}
    ),
    "obstruction_resolved": Kind("the others have got on", {**_OBSTRUCTION, **_RESOLVED}),
    "homes_exchanged": Kind(
        "AGVs take over each other's homes: to end a deadlock or an obstruction, or because one waits with a car and"
        " the other, which is away, has a home nearer to the bays",
        {**_DEADLOCK, **_OBSTRUCTION, **_WAITING, "homes": "AGV -> name of its new home"},
        frozenset({*_DEADLOCK, *_OBSTRUCTION, *_WAITING}),
    ),
    "stage_failed": Kind(
        "a stage of a deadlock's resolution made no progress",
        {**_DEADLOCK, "stage": "the stage", "reason": "why, in words"},
    ),
    "held": Kind(
        "an AGV has waited for control.stuck_s, or the cause of this wait has changed; its vertex is the place"
        " concerned",
        {
            "cause": "one of controller.holds.Cause",
            "chain": "numbers of AGVs: it waits for the first, that one for the next",
            "faults": "numbers of the faults at the root",
            "request": "number of the request it works on, -1 for none",
            "since_s": "when the wait began, seconds",
        },
    ),
    "held_end": Kind(
        "a wait that was held is over",
        {"cause": "the last one, of controller.holds.Cause", "waited_s": "how long it waited, seconds"},
    ),
    "charge_wait": Kind("an AGV has to charge, and no charger is free", _SOC),
    "charge_start": Kind("an AGV starts to charge", _SOC),
    "charge_end": Kind("an AGV ends charging", _SOC),
    "grant": Kind("an AGV may drive on (recorded on request)", {"vertices": "names of the vertices granted"}),
    "overlap": Kind(
        "the footprints of two bodies overlap",
        {"others": "the other AGV's number, or the car's name, in a list", "clearance_m": "room between them, metres"},
    ),
    "turn_under_car": Kind(
        "an empty AGV turns under a parked car in a slot too short to drive straight out of; its car is that car"
    ),
    "task_returned": Kind("a broken AGV, or one whose goal is closed, gives its task back", _REQUEST),
    "fault_start": Kind(
        "something goes wrong",
        {**_FAULT, "agvs": "numbers of the AGVs concerned", "vertices": "row numbers in vertices of the places"},
    ),
    "fault_end": Kind("a fault is over", _FAULT),
}
