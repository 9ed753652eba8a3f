"""The garage's books: where every car is, what every customer wants, which slots, bays and places are taken.

It knows vertices but nothing of AGVs' ways. Times are seconds. A request is the customer's wish, and a ``Task`` is
what the ACS makes of it. The time stamps of a task tell its life; ``Garage.audit`` checks that nothing got lost.

A customer who comes with a car is turned away when every slot is taken or promised: by cars in slots, and by cars that
have come and are not in their slots yet. A car on its way out needs no slot as soon as it is lifted. A customer also
turns away when the queue is too long for him. Requests that mean nothing are void: to fetch a car that is not there or
is asked for already, or to park one that is inside; so is a request to fetch a car that was turned away.
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

#: Cars by which the pace of the queue is known: the last ones that had to wait.
_RECENT = 8


@dataclass(frozen=True, slots=True)
class Customers:
    """What customers do.

    Attributes:
        handling_median_s, handling_sigma: lognormal distribution of the time that they need at the bay.
        balk_cars: a customer turns away when this many cars wait in the queue; None: never.
        balk_s: a customer turns away when the wait in the queue is expected to be this long, seconds; None: never.
    """

    handling_median_s: float = 60.0
    handling_sigma: float = 0.5
    balk_cars: int | None = None
    balk_s: float | None = None


@dataclass(slots=True, eq=False)
class Task:
    """One request and what became of it.

    Attributes:
        number: position among all requests of the run.
        request: what was asked.
        handling_s: how long the customer needs at the bay.
        state: waiting until it is served; turned_away (the customer) or void (the request) from the start.
        reason: why it was turned away or is void; what differs from case to case comes after a colon.
        agv: AGV that serves it, -1 before assignment.
        origin, destination: vertices, -1 until known.
        requested_s, at_bay_s, ready_s, assigned_s, lifted_s, delivered_s, done_s: when, NaN until then.
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
        """A car comes in (otherwise it goes out)."""
        return self.request.kind is RequestKind.PARK

    @property
    def car(self) -> str:
        """Name of the car."""
        return self.request.car


@dataclass(slots=True)
class BayPlaces:
    """The two places of a bay on the customers' side: None is free."""

    inbound: Task | None = None
    outbound: Task | None = None


class StreetQueue:
    """Customers that wait for a bay, in their order, and how fast the queue moves.

    The wait that a customer has to expect is the number of cars in the queue times the time a car stands at its head.
    That is the mean of the last cars that had to wait, or the time that the present head has stood there, if longer.
    """

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()
        self._head_since_s = 0.0
        self._stood_s: deque[float] = deque(maxlen=_RECENT)

    def __len__(self) -> int:
        return len(self._tasks)

    def join(self, task: Task, now_s: float) -> None:
        """A customer stands behind the others."""
        if not self._tasks:
            self._head_since_s = now_s
        self._tasks.append(task)

    def call(self, now_s: float) -> Task:
        """The first customer leaves the queue for a bay."""
        stood_s = now_s - self._head_since_s
        if stood_s > 0:
            self._stood_s.append(stood_s)
        self._head_since_s = now_s
        return self._tasks.popleft()

    def expected_s(self, now_s: float) -> float:
        """How long a customer who comes now has to expect to wait, seconds."""
        if not self._tasks:
            return 0.0
        mean_s = sum(self._stood_s) / len(self._stood_s) if self._stood_s else 0.0
        return len(self._tasks) * max(mean_s, now_s - self._head_since_s)


class Garage:
    """Books of one garage.

    Args:
        graph: the garage.
        handover: "bay" (customers come through the street) or "home" (cars stand ready at each AGV's home).
        handling: seeded generator of the customers' handling times at the bay.
        customers: what these times are like, and which queues are too long for customers.
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
        """Park cars before the run starts, in slots drawn at random.

        Raises:
            ValueError: more cars than slots.
        """
        if len(cars) > len(self.graph.slots):
            raise ValueError(f"{len(cars)} cars for {len(self.graph.slots)} slots")
        for car, slot in zip(cars, rng.permutation(self.slots)[: len(cars)], strict=True):
            self._put(car, Vertex(int(slot)))
        self.initial = len(cars)
        self._inside = set(cars)

    def request(self, request: Request, now_s: float) -> Task:
        """Enter a request in the books; its customer may be turned away at once, or it may be void."""
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
        """Why there is no slot for one more car, empty if there is one."""
        parked, queue = len(self.parked), len(self.queue)
        if parked + self.coming < len(self.graph.slots):
            return ""
        return (
            f"every slot is taken or promised: {parked} parked, {queue} in the queue,"
            f" {self.coming - queue} on their way in"
        )

    def _too_long(self, now_s: float) -> str:
        """Why the queue is too long for a customer, empty if it is not."""
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
        # drawn for every request in the order of requests, so that it does not depend on the controller
        z = float(self._handling.standard_normal())
        sigma = self._customers.handling_sigma
        return 0.0 if self._handling_mu is None else float(np.exp(self._handling_mu + sigma * z))

    # --- customers' side of the bays ------------------------------------------------------------------------------

    def call_forward(self, now_s: float, closed: frozenset[Vertex] = frozenset()) -> list[Command]:
        """Send waiting customers, in their order, to bays whose inbound place is free."""
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
        """A customer's car has stopped at the inbound place; the task is open from now on."""
        task = self.tasks[request]
        if self.bays[bay].inbound is not task:
            raise RuntimeError(f"the car of request {request} came to bay {bay}, where nobody called it")
        task.at_bay_s = now_s
        task.ready_s = now_s + task.handling_s
        self.open.append(task)
        return task

    def waiting_at(self, bay: Vertex) -> Task | None:
        """The car that stands at a bay and that no AGV has been sent for."""
        task = self.bays[bay].inbound
        return task if task and task.agv < 0 and task.at_bay_s == task.at_bay_s else None

    def board(self, now_s: float) -> list[Command]:
        """Let those customers drive off who have got into their cars."""
        gone = [j for j in self._boarding if j.delivered_s + j.handling_s <= now_s]
        for task in gone:
            self._boarding.remove(task)
        return [DriveOff(j.number, j.destination) for j in gone]

    def car_left(self, request: RequestNumber, bay: Vertex, now_s: float) -> Task:
        """A retrieved car has driven off: its request is served and the outbound place is free."""
        task = self.tasks[request]
        if self.bays[bay].outbound is not task:
            raise RuntimeError(f"the car of request {request} left bay {bay}, where it did not stand")
        self.bays[bay].outbound = None
        self._leave(task, now_s)
        return task

    # --- AGVs' side -----------------------------------------------------------------------------------------------

    def assign(self, task: Task, agv: AgvNumber, now_s: float, origin: Vertex, slot: Vertex = NO_VERTEX) -> None:
        """An AGV takes an open task; a parking task reserves its slot."""
        self.open.remove(task)
        task.agv, task.assigned_s, task.origin = agv, now_s, origin
        if task.is_park:
            task.destination = slot
            self.reserved[slot] = agv
            self.slot_free[self._slot_number[slot]] = False

    def unassign(self, task: Task) -> None:
        """Give a task back that its AGV has not lifted yet."""
        if task.is_park:
            self.reserved.pop(task.destination)
            self.slot_free[self._slot_number[task.destination]] = True
        task.agv, task.destination, task.assigned_s = NO_AGV, NO_VERTEX, nan
        if task.is_park and self.handover == "home":
            task.origin = NO_VERTEX
        self.open.insert(0, task)

    def move_reservation(self, task: Task, slot: Vertex) -> None:
        """Reserve another slot for a car on its way to one."""
        self.reserved[slot] = self.reserved.pop(task.destination)
        self.slot_free[self._slot_number[task.destination]] = True
        self.slot_free[self._slot_number[slot]] = False
        task.destination = slot

    def close(self, vertices: frozenset[Vertex]) -> None:
        """Let no slot among these be chosen until this is called again."""
        self.slot_open[:] = [slot not in vertices for slot in self.graph.slots]

    def lifted(self, task: Task, now_s: float) -> None:
        """The car is on the AGV. Its slot is for others only when ``vacate`` says so."""
        task.lifted_s = now_s
        if task.is_park:
            if self.handover == "bay":
                self.bays[task.origin].inbound = None
        else:
            slot = self.parked.pop(task.car)
            self.slot_of[slot] = ""
            self.blocked[slot] = 0

    def vacate(self, slot: Vertex) -> None:
        """Whoever lifted the car in a slot has somewhere to bring it: the slot may be chosen for another one."""
        if slot not in self.reserved and not self.slot_of[slot]:
            self.slot_free[self._slot_number[slot]] = True

    def may_lower(self, task: Task) -> bool:
        """The place where the car is to be put down is free."""
        return task.is_park or self.handover == "home" or self.bays[task.destination].outbound is None

    def lower_starts(self, task: Task) -> None:
        """Keep the outbound place for the car that is being lowered."""
        if not task.is_park and self.handover == "bay":
            self.bays[task.destination].outbound = task

    def lowered(self, task: Task, now_s: float) -> list[Command]:
        """The car is down: in its slot, or at the bay where its customer gets in."""
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
        """Cars that are in the garage's care but not parked: in the street, at bays or on AGVs."""
        going = sum(1 for j in self.tasks if not j.is_park and j.state == "waiting" and j.lifted_s == j.lifted_s)
        return self.coming + going

    def audit(self) -> list[str]:
        """What does not add up; empty when every car and request is accounted for."""
        problems = []
        if self.initial + self.arrived != len(self.parked) + self.left + self.in_transit():
            problems.append(
                f"cars: {self.initial} at the start + {self.arrived} arrived != {len(self.parked)} parked"
                f" + {self.left} left + {self.in_transit()} in transit"
            )
        if sorted(self.parked.values()) != sorted(v for v, car in self.slot_of.items() if car):
            problems.append("slots and parked cars disagree")
        if self.coming != sum(1 for j in self.tasks if j.is_park and j.state == "waiting"):
            problems.append("cars: the count of those on their way in is off")
        if len(self.parked) + self.coming > len(self.graph.slots):
            problems.append(f"cars: {len(self.parked)} parked and {self.coming} coming exceed the slots")
        states = [j.state for j in self.tasks]
        if self.unfinished != states.count("waiting"):
            problems.append("requests: the count of unfinished ones is off")
        return problems
