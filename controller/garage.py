"""The garage's books: where each car is, what each customer wants, and which slots and bays are taken.

The books know vertices but no routes. Times are in seconds. A *request* is a customer's wish; a ``Task`` is the work
that the ACS derives from the request. Time stamps in a task record its progress. ``Garage.audit`` checks that no car
and no request is lost.

A customer arriving with a car is *turned away* in two cases: every slot is taken or promised, or the queue is too long
for this customer. A slot is promised to each car that has arrived but is not in its slot. A car on its way out needs
no slot once it is lifted. A request is *void* if it makes no sense: retrieving a car that is absent, turned away or
already requested, or parking a car that is already inside.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from controller.types import (
    NO_AGV,
    AgvNumber,
    CallForward,
    Command,
    DriveOff,
    HandOver,
    Request,
    RequestKind,
    RequestNumber,
)
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, NumberedList, Vertex

TaskState = Literal["waiting", "served", "turned_away", "void"]

#: Number of cars that set the pace of the queue: the last cars that had to wait.
_RECENT = 8


@dataclass(frozen=True, slots=True)
class Customers:
    """How customers behave.

    Attributes:
        handling_median_s, handling_sigma: lognormal distribution of the time a customer needs at the bay.
        balk_cars: customers turn away when this many cars wait in the queue; None: customers never do.
        balk_s: customers turn away when the expected wait in the queue reaches this many seconds; None: they never do.
    """

    handling_median_s: float = 60.0
    handling_sigma: float = 0.5
    balk_cars: int | None = None
    balk_s: float | None = None


@dataclass(slots=True, eq=False)
class Task:
    """One request and its progress.

    Attributes:
        number: position among all requests of the run.
        request: the customer's wish.
        handling_s: seconds the customer needs at the bay.
        state: "waiting" until the request is served; "turned_away" (the customer) or "void" (the request) from the
            start.
        reason: why the request was turned away or is void; details of the case follow a colon.
        agv: number of the AGV that serves the request, -1 before assignment.
        origin, destination: vertices, -1 until known.
        requested_s, at_bay_s, ready_s, assigned_s, lifted_s, delivered_s, done_s: time stamps, NaN until reached.
    """

    number: RequestNumber
    request: Request
    handling_s: float
    state: TaskState = "waiting"
    reason: str = ""
    agv: AgvNumber = NO_AGV
    origin: Vertex = NO_VERTEX
    destination: Vertex = NO_VERTEX
    requested_s: float = nan
    at_bay_s: float = nan
    ready_s: float = nan
    assigned_s: float = nan
    lifted_s: float = nan
    delivered_s: float = nan
    done_s: float = nan

    @property
    def is_park(self) -> bool:
        """The car enters the garage; otherwise it leaves."""
        return self.request.kind is RequestKind.PARK

    @property
    def car(self) -> str:
        """Name of the car."""
        return self.request.car


@dataclass(slots=True)
class BayPlaces:
    """The customers' two places at a bay, one for arriving and one for leaving cars. None means free."""

    inbound: Task | None = None
    outbound: Task | None = None


class StreetQueue:
    """Customers waiting for a bay in order of arrival, and the pace of the queue.

    A customer's expected wait is the number of queued cars times the typical wait at the head of the queue. The typical
    wait is the mean over the last cars that had to wait, or the wait of the present head if that is longer.
    """

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()
        self._head_since_s = 0.0
        self._stood_s: deque[float] = deque(maxlen=_RECENT)

    def __len__(self) -> int:
        return len(self._tasks)

    def join(self, task: Task, now_s: float) -> None:
        """Add a customer to the end of the queue."""
        if not self._tasks:
            self._head_since_s = now_s
        self._tasks.append(task)

    def call(self, now_s: float) -> Task:
        """Remove the first customer, who drives to a bay."""
        stood_s = now_s - self._head_since_s
        if stood_s > 0:
            self._stood_s.append(stood_s)
        self._head_since_s = now_s
        return self._tasks.popleft()

    def expected_s(self, now_s: float) -> float:
        """Seconds that a customer arriving now must expect to wait."""
        if not self._tasks:
            return 0.0
        mean_s = sum(self._stood_s) / len(self._stood_s) if self._stood_s else 0.0
        return len(self._tasks) * max(mean_s, now_s - self._head_since_s)


class Garage:
    """Books of one garage.

    Args:
        graph: the garage.
        handover: "bay" (customers arrive by the street) or "home" (cars stand ready at the home of each AGV).
        handling: seeded generator of the customers' handling times at the bay.
        customers: distribution of the handling times, and the queue lengths that customers accept.
    """

    def __init__(
        self,
        graph: Graph,
        handover: Literal["bay", "home"],
        handling: np.random.Generator,
        customers: Customers = Customers(),
    ) -> None:
        self.graph = graph
        self.handover = handover
        self._handling = handling
        self._customers = customers
        self._handling_mu = float(np.log(customers.handling_median_s)) if customers.handling_median_s > 0 else None
        self.tasks: NumberedList[RequestNumber, Task] = []
        self.open: list[Task] = []
        self.queue = StreetQueue()
        self.bays = {bay: BayPlaces() for bay in graph.bays}
        self.parked: dict[str, Vertex] = {}
        self.slot_of: dict[Vertex, str] = dict.fromkeys(graph.slots, "")
        self.slots = np.array(graph.slots, dtype=np.int32)
        self.slot_free: NDArray[np.bool_] = np.ones(len(graph.slots), dtype=np.bool_)
        self.slot_open: NDArray[np.bool_] = np.ones(len(graph.slots), dtype=np.bool_)
        self._slot_number = {slot: k for k, slot in enumerate(graph.slots)}
        self.reserved: dict[Vertex, AgvNumber] = {}
        self.blocked: NDArray[np.uint8] = np.zeros(len(graph.names), dtype=np.uint8)
        self.arrived = 0
        self.left = 0
        self.initial = 0
        self.unfinished = 0
        self.coming = 0
        self._turned_away: set[str] = set()
        self._inside: set[str] = set()
        self._asked_for: set[str] = set()
        self._early: dict[str, Task] = {}
        self._boarding: list[Task] = []

    # --- requests -------------------------------------------------------------------------------------------------

    def place_initial(self, cars: Sequence[str], rng: np.random.Generator) -> None:
        """Park cars in randomly drawn slots before the run starts.

        Raises:
            ValueError: there are more cars than slots.
        """
        if len(cars) > len(self.graph.slots):
            raise ValueError(f"{len(cars)} cars for {len(self.graph.slots)} slots")
        for car, slot in zip(cars, rng.permutation(self.slots)[: len(cars)], strict=True):
            self._put(car, Vertex(int(slot)))
        self.initial = len(cars)
        self._inside = set(cars)

    def request(self, request: Request, now_s: float) -> Task:
        """Enter a request in the books. The customer may be turned away at once, or the request may be void."""
        task = Task(RequestNumber(len(self.tasks)), request, self._draw_handling(), requested_s=now_s)
        self.tasks.append(task)
        self.unfinished += 1
        if task.is_park:
            self._request_park(task, now_s)
        else:
            self._request_retrieve(task, now_s)
        return task

    def _request_park(self, task: Task, now_s: float) -> None:
        if task.car in self._inside:
            self._dismiss(task, "void", "car is in the garage already")
            return
        reason = self._no_slot() or self._too_long(now_s)
        if reason:
            self._dismiss(task, "turned_away", reason)
            self._turned_away.add(task.car)
            return
        self._turned_away.discard(task.car)
        self._inside.add(task.car)
        self.arrived += 1
        self.coming += 1
        if self.handover == "home":
            task.at_bay_s = task.ready_s = now_s
            self.open.append(task)
        else:
            self.queue.join(task, now_s)

    def _no_slot(self) -> str:
        """Why there is no slot for another car; empty if there is a slot."""
        parked, queue = len(self.parked), len(self.queue)
        if parked + self.coming < len(self.graph.slots):
            return ""
        return (
            f"every slot is taken or promised: {parked} parked, {queue} in the queue,"
            f" {self.coming - queue} on their way in"
        )

    def _too_long(self, now_s: float) -> str:
        """Why the queue is too long for this customer; empty if the queue is acceptable."""
        balk_cars, balk_s, cars = self._customers.balk_cars, self._customers.balk_s, len(self.queue)
        if balk_cars is not None and cars >= balk_cars:
            return f"queue too long: {cars} {'car' if cars == 1 else 'cars'}"
        expected_s = self.queue.expected_s(now_s)
        if balk_s is not None and expected_s >= balk_s:
            return f"queue too long: {expected_s / 60:.1f} min"
        return ""

    def _request_retrieve(self, task: Task, now_s: float) -> None:
        if task.car not in self._inside:
            gone = task.car in self._turned_away
            self._dismiss(task, "void", "car was turned away" if gone else "car is not in the garage")
            return
        if task.car in self._asked_for:
            self._dismiss(task, "void", "car is asked for already")
            return
        self._asked_for.add(task.car)
        if task.car in self.parked:
            self._open_retrieve(task, now_s)
        else:
            self._early[task.car] = task

    def _open_retrieve(self, task: Task, now_s: float) -> None:
        task.ready_s = now_s
        task.origin = self.parked[task.car]
        self.open.append(task)

    def _dismiss(self, task: Task, state: Literal["turned_away", "void"], reason: str) -> None:
        task.state, task.reason = state, reason
        self.unfinished -= 1

    def _draw_handling(self) -> float:
        # draw a time for every request, in order: the sequence must not depend on the controller
        z = float(self._handling.standard_normal())
        sigma = self._customers.handling_sigma
        return 0.0 if self._handling_mu is None else float(np.exp(self._handling_mu + sigma * z))

    # --- customers' side of the bays ------------------------------------------------------------------------------

    def call_forward(self, now_s: float, closed: frozenset[Vertex] = frozenset()) -> list[Command]:
        """Send queued customers, in order, to bays with a free inbound place."""
        commands: list[Command] = []
        for bay, places in self.bays.items():
            if not self.queue:
                break
            if places.inbound is None and bay not in closed:
                task = self.queue.call(now_s)
                task.origin = bay
                places.inbound = task
                commands.append(CallForward(task.number, bay))
        return commands

    def car_at_bay(self, request: RequestNumber, bay: Vertex, now_s: float) -> Task:
        """Record that the customer's car stands at the inbound place. The task is open from now on."""
        task = self.tasks[request]
        if self.bays[bay].inbound is not task:
            raise RuntimeError(f"the car of request {request} came to bay {bay}, where nobody called it")
        task.at_bay_s = now_s
        task.ready_s = now_s + task.handling_s
        self.open.append(task)
        return task

    def waiting_at(self, bay: Vertex) -> Task | None:
        """The car at the bay's inbound place, if no AGV has been sent for it."""
        task = self.bays[bay].inbound
        return task if task and task.agv < 0 and task.at_bay_s == task.at_bay_s else None

    def board(self, now_s: float) -> list[Command]:
        """Let customers leave the bay once they have got into their cars."""
        gone = [j for j in self._boarding if j.delivered_s + j.handling_s <= now_s]
        for task in gone:
            self._boarding.remove(task)
        return [DriveOff(j.number, j.destination) for j in gone]

    def car_left(self, request: RequestNumber, bay: Vertex, now_s: float) -> Task:
        """Record that a retrieved car has left. Its request is served and the outbound place is free."""
        task = self.tasks[request]
        if self.bays[bay].outbound is not task:
            raise RuntimeError(f"the car of request {request} left bay {bay}, where it did not stand")
        self.bays[bay].outbound = None
        self._leave(task, now_s)
        return task

    # --- AGVs' side -----------------------------------------------------------------------------------------------

    def assign(self, task: Task, agv: AgvNumber, now_s: float, origin: Vertex, slot: Vertex = NO_VERTEX) -> None:
        """Assign an open task to an AGV. A parking task reserves its slot."""
        self.open.remove(task)
        task.agv, task.assigned_s, task.origin = agv, now_s, origin
        if task.is_park:
            task.destination = slot
            self.reserved[slot] = agv
            self.slot_free[self._slot_number[slot]] = False

    def unassign(self, task: Task) -> None:
        """Return a task to the open tasks; its AGV has not lifted the car yet."""
        if task.is_park:
            self.reserved.pop(task.destination)
            self.slot_free[self._slot_number[task.destination]] = True
        task.agv, task.destination, task.assigned_s = NO_AGV, NO_VERTEX, nan
        if task.is_park and self.handover == "home":
            task.origin = NO_VERTEX
        self.open.insert(0, task)

    def move_reservation(self, task: Task, slot: Vertex) -> None:
        """Reserve another slot for a car on its way to a slot."""
        self.reserved[slot] = self.reserved.pop(task.destination)
        self.slot_free[self._slot_number[task.destination]] = True
        self.slot_free[self._slot_number[slot]] = False
        task.destination = slot

    def close(self, vertices: frozenset[Vertex]) -> None:
        """Exclude these slots from new choices until the next call."""
        self.slot_open[:] = [slot not in vertices for slot in self.graph.slots]

    def lifted(self, task: Task, now_s: float) -> None:
        """Record that the car is on the AGV. Its slot stays reserved until ``vacate``."""
        task.lifted_s = now_s
        if task.is_park:
            if self.handover == "bay":
                self.bays[task.origin].inbound = None
        else:
            slot = self.parked.pop(task.car)
            self.slot_of[slot] = ""
            self.blocked[slot] = 0

    def vacate(self, slot: Vertex) -> None:
        """Free a slot for other cars, once the AGV that lifted the car has a destination."""
        if slot not in self.reserved and not self.slot_of[slot]:
            self.slot_free[self._slot_number[slot]] = True

    def may_lower(self, task: Task) -> bool:
        """Whether the destination of the car is free."""
        return task.is_park or self.handover == "home" or self.bays[task.destination].outbound is None

    def lower_starts(self, task: Task) -> None:
        """Reserve the outbound place for the car being lowered."""
        if not task.is_park and self.handover == "bay":
            self.bays[task.destination].outbound = task

    def lowered(self, task: Task, now_s: float) -> list[Command]:
        """Record that the car is down: in its slot, or at the bay where its customer gets in."""
        task.delivered_s = now_s
        if task.is_park:
            self.reserved.pop(task.destination)
            self._put(task.car, task.destination)
            self.coming -= 1
            self._serve(task, now_s)
            early = self._early.pop(task.car, None)
            if early:
                self._open_retrieve(early, now_s)
            return []
        if self.handover == "home":
            self._leave(task, now_s)
            return []
        self._boarding.append(task)
        return [HandOver(task.number, task.destination)]

    def _put(self, car: str, slot: Vertex) -> None:
        self.parked[car] = slot
        self.slot_of[slot] = car
        self.slot_free[self._slot_number[slot]] = False
        self.blocked[slot] = 1

    def _leave(self, task: Task, now_s: float) -> None:
        self.left += 1
        self._inside.remove(task.car)
        self._asked_for.remove(task.car)
        self._serve(task, now_s)

    def _serve(self, task: Task, now_s: float) -> None:
        task.state, task.done_s = "served", now_s
        self.unfinished -= 1

    def in_transit(self) -> int:
        """Cars in the garage's care that are not parked: in the street, at bays or on AGVs."""
        going = sum(1 for j in self.tasks if not j.is_park and j.state == "waiting" and j.lifted_s == j.lifted_s)
        return self.coming + going

    def audit(self) -> list[str]:
        """Inconsistencies in the books; empty if every car and every request is accounted for."""
        problems = []
        if self.initial + self.arrived != len(self.parked) + self.left + self.in_transit():
            problems.append(
                f"cars: {self.initial} at the start + {self.arrived} arrived != {len(self.parked)} parked"
                f" + {self.left} left + {self.in_transit()} in transit"
            )
        if sorted(self.parked.values()) != sorted(v for v, car in self.slot_of.items() if car):
            problems.append("slots and parked cars disagree")
        on_agvs = {j.origin for j in self.tasks if j.lifted_s == j.lifted_s and j.delivered_s != j.delivered_s}
        taken = {Vertex(int(v)) for v in self.slots[~self.slot_free]}
        for slot in sorted(taken - set(self.parked.values()) - self.reserved.keys() - on_agvs):
            problems.append(f"{self.graph.names[slot]} is taken, and no car is there, on its way, or just lifted")
        if self.coming != sum(1 for j in self.tasks if j.is_park and j.state == "waiting"):
            problems.append("cars: the count of those on their way in is off")
        if len(self.parked) + self.coming > len(self.graph.slots):
            problems.append(f"cars: {len(self.parked)} parked and {self.coming} coming exceed the slots")
        states = [j.state for j in self.tasks]
        if self.unfinished != states.count("waiting"):
            problems.append("requests: the count of unfinished ones is off")
        return problems
