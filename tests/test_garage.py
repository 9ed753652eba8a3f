"""The garage's books, against a count of cars kept apart."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from controller.garage import Customers, Garage, Task
from controller.types import CallForward, DriveOff, HandOver, Request, RequestKind
from sumo_nets.graph import Graph, make_graph

SLOTS = ("s1", "s2", "s3", "s4")
BAYS = ("b1", "b2")


def star(slots) -> Graph:
    """A home in the middle, bays and slots around it."""
    edges = [
        (f"home{way}{name}", *ends, 5.0)
        for name in (*BAYS, *slots)
        for way, ends in ((">", ("home", name)), ("<", (name, "home")))
    ]
    vertices = [(name, float(x), 0.0) for x, name in enumerate(("home", *BAYS, *slots))]
    return make_graph("books", vertices, edges, {"slot": slots, "bay": BAYS, "home": ("home",)})


GRAPH = star(SLOTS)
BIG = star(tuple(f"s{k}" for k in range(20)))


def empty(handover="bay", **customers) -> Garage:
    return Garage(GRAPH, handover, np.random.default_rng(1), Customers(10.0, **customers))


def park(garage: Garage, car: str, now_s: float = 0.0) -> Task:
    return garage.request(Request(now_s, RequestKind.PARK, car), now_s)


def retrieve(garage: Garage, car: str) -> Task:
    return garage.request(Request(0.0, RequestKind.RETRIEVE, car), 0.0)


def with_cars(*cars: str, handover="home") -> Garage:
    garage = empty(handover)
    garage.place_initial(cars, np.random.default_rng(1))
    return garage


def brought_in(garage: Garage, task: Task, slot: int) -> None:
    """What an AGV does with a car that stands at home."""
    garage.assign(task, 0, 1.0, GRAPH.homes[0], slot)
    garage.lifted(task, 2.0)
    garage.lowered(task, 3.0)


class Books(RuleBasedStateMachine):
    """Customers and AGVs do what they can in any order; the model only knows which car is where."""

    @initialize(handover=st.sampled_from(["bay", "home"]), cars=st.integers(0, 4))
    def open_garage(self, handover, cars):
        self.garage = empty(handover)
        self.garage.place_initial([f"early{k}" for k in range(cars)], np.random.default_rng(cars))
        #: car -> "coming", "parked", "leaving"; a car that was turned away or has left is not here
        self.cars = {f"early{k}": "parked" for k in range(cars)}
        self.asked: set[str] = set()
        self.called: list[Task] = []
        self.assigned: list[Task] = []
        self.carried: list[Task] = []
        self.boarding: list[Task] = []
        self.now_s = 0.0
        self.away: set[str] = set()
        self.made = self.served = self.turned_away = self.void = 0

    @rule(car=st.sampled_from("abcdef"))
    def customer_comes(self, car):
        task = park(self.garage, car)
        self.made += 1
        places = list(self.cars.values())
        if car in self.cars:
            assert (task.state, task.reason) == ("void", "car is in the garage already")
            self.void += 1
        elif len(places) - places.count("leaving") == len(SLOTS):
            assert task.state == "turned_away"
            parked, queue, coming = (int(n) for n in re.findall(r"\d+", task.reason))
            assert parked == places.count("parked")
            assert queue + coming == places.count("coming")
            assert queue == len(self.garage.queue)
            self.turned_away += 1
            self.away.add(car)
        else:
            assert task.state == "waiting"
            self.cars[car] = "coming"
            self.away.discard(car)

    @rule(car=st.sampled_from(["a", "b", "c", "d", "e", "f", "early0", "early1", "unknown"]))
    def customer_wants_the_car_back(self, car):
        task = retrieve(self.garage, car)
        self.made += 1
        if car not in self.cars or car in self.asked:
            gone = "car was turned away" if car in self.away else "car is not in the garage"
            assert (task.state, task.reason) == ("void", "car is asked for already" if car in self.cars else gone)
            self.void += 1
        else:
            assert task.state == "waiting"
            self.asked.add(car)

    @rule(closed=st.sets(st.sampled_from(GRAPH.bays), max_size=2))
    def cars_are_called_forward(self, closed):
        for command in self.garage.call_forward(self.now_s, frozenset(closed)):
            assert isinstance(command, CallForward)
            assert command.bay not in closed
            self.called.append(self.garage.bays[command.bay].inbound)
            assert self.called[-1].number == command.request
        before_lifting = (*self.called, *self.garage.open, *self.assigned)
        taken = {task.origin for task in before_lifting if task.is_park}
        assert not self.garage.queue or set(GRAPH.bays) <= taken | closed, "a customer waits while a bay is free"

    @precondition(lambda self: self.called)
    @rule(data=st.data())
    def car_reaches_its_bay(self, data):
        task = data.draw(st.sampled_from(self.called))
        self.called.remove(task)
        assert self.garage.car_at_bay(task.number, task.origin, self.now_s) is task
        assert task.ready_s >= task.at_bay_s == self.now_s

    @precondition(lambda self: self.garage.open)
    @rule(data=st.data())
    def an_agv_takes_a_task(self, data):
        task = data.draw(st.sampled_from(self.garage.open))
        free = [int(v) for v in self.garage.slots[self.garage.slot_free]]
        if task.is_park and not free:
            leaving = [task for task in self.carried if not task.is_park and task.destination < 0]
            assert leaving, "a car was let in without a slot for it"
            return
        slot = data.draw(st.sampled_from(free)) if task.is_park else -1
        self.garage.assign(task, 0, self.now_s, task.origin if task.origin >= 0 else GRAPH.homes[0], slot)
        self.assigned.append(task)

    @precondition(lambda self: self.assigned)
    @rule(data=st.data())
    def an_agv_gives_a_task_back(self, data):
        task = data.draw(st.sampled_from(self.assigned))
        self.assigned.remove(task)
        self.garage.unassign(task)

    @precondition(lambda self: self.assigned)
    @rule(data=st.data())
    def an_agv_lifts(self, data):
        task = data.draw(st.sampled_from(self.assigned))
        self.assigned.remove(task)
        self.garage.lifted(task, self.now_s)
        self.carried.append(task)
        if not task.is_park:
            assert self.cars[task.car] == "parked"
            self.cars[task.car] = "leaving"

    @precondition(lambda self: any(task.destination < 0 for task in self.carried))
    @rule(data=st.data())
    def an_agv_learns_where_to_bring_its_car(self, data):
        task = data.draw(st.sampled_from([task for task in self.carried if task.destination < 0]))
        task.destination = data.draw(st.sampled_from(GRAPH.bays)) if self.garage.handover == "bay" else GRAPH.homes[0]
        for _ in range(data.draw(st.integers(1, 2))):  # once more does no harm
            self.garage.vacate(task.origin)

    @precondition(lambda self: self._may_lower())
    @rule(data=st.data())
    def an_agv_lowers(self, data):
        task = data.draw(st.sampled_from(self._may_lower()))
        self.carried.remove(task)
        self.garage.lower_starts(task)
        commands = self.garage.lowered(task, self.now_s)
        if task.is_park:
            self.cars[task.car] = "parked"
            self.served += 1
        elif self.garage.handover == "bay":
            assert commands == [HandOver(task.number, task.destination)]
        else:
            self._has_left(task)

    @rule(seconds=st.floats(0.0, 60.0))
    def time_passes(self, seconds):
        self.now_s += seconds
        for command in self.garage.board(self.now_s):
            assert isinstance(command, DriveOff)
            task = self.garage.bays[command.bay].outbound
            assert task.number == command.request
            assert task.delivered_s + task.handling_s <= self.now_s
            self.boarding.append(task)

    @precondition(lambda self: self.boarding)
    @rule(data=st.data())
    def car_drives_off(self, data):
        task = data.draw(st.sampled_from(self.boarding))
        self.boarding.remove(task)
        assert self.garage.car_left(task.number, task.destination, self.now_s) is task
        self._has_left(task)

    def _may_lower(self):
        return [task for task in self.carried if task.destination >= 0 and self.garage.may_lower(task)]

    def _has_left(self, task):
        del self.cars[task.car]
        self.asked.discard(task.car)
        self.served += 1

    @invariant()
    def a_slot_is_reserved_for_each_car_on_its_way_to_one_and_for_no_other(self):
        parking = {task.destination for task in (*self.assigned, *self.carried) if task.is_park}
        assert set(self.garage.reserved) == parking

    @invariant()
    def everything_adds_up(self):
        if not hasattr(self, "garage"):
            return
        assert self.garage.audit() == []
        where = sorted(self.cars.values())
        assert set(self.garage.parked) == {car for car, place in self.cars.items() if place == "parked"}
        assert self.garage.in_transit() == where.count("coming") + where.count("leaving")
        states = [task.state for task in self.garage.tasks]
        assert len(states) == self.made
        counts = [states.count(state) for state in ("served", "turned_away", "void")]
        assert counts == [self.served, self.turned_away, self.void]
        assert self.garage.unfinished == self.made - sum(counts)

    @invariant()
    def no_slot_is_given_twice(self):
        if not hasattr(self, "garage"):
            return
        parked = list(self.garage.parked.values())
        promised = [task.destination for task in (*self.assigned, *self.carried) if task.is_park]
        left_soon = [task.origin for task in self.carried if not task.is_park and task.destination < 0]
        taken = parked + promised + left_soon
        assert len(set(taken)) == len(taken)
        free = set(self.garage.slots[self.garage.slot_free].tolist())
        assert free == set(GRAPH.slots) - set(taken)
        assert set(np.flatnonzero(self.garage.blocked).tolist()) == set(parked)


TestBooks = Books.TestCase
TestBooks.settings = settings(max_examples=80, stateful_step_count=40, deadline=None)


def test_a_full_garage_turns_customers_away_until_a_car_is_lifted_to_go_out():
    garage = with_cars("a", "b", "c")
    assert park(garage, "d").state == "waiting"
    late = park(garage, "e")
    assert late.state == "turned_away"
    assert late.reason == "every slot is taken or promised: 3 parked, 0 in the queue, 1 on their way in"
    out = retrieve(garage, "a")
    garage.assign(out, 0, 1.0, out.origin)
    assert park(garage, "f").state == "turned_away", "the car still stands in its slot"
    garage.lifted(out, 2.0)
    assert park(garage, "g").state == "waiting", "a car on its way out needs no slot"
    assert park(garage, "h").state == "turned_away"
    assert garage.audit() == []
    assert all(math.isnan(task.done_s) for task in garage.tasks), "who is turned away is not done"


def test_cars_in_the_queue_have_slots_promised_to_them():
    garage = empty()
    for car in "abcd":
        park(garage, car)
    garage.call_forward(0.0)
    assert park(garage, "e").reason == "every slot is taken or promised: 0 parked, 2 in the queue, 2 on their way in"


def test_a_car_that_was_turned_away_cannot_be_asked_for_and_may_come_again():
    garage = with_cars("a", "b", "c", "d")
    park(garage, "e")
    task = retrieve(garage, "e")
    assert (task.state, task.reason) == ("void", "car was turned away")
    out = retrieve(garage, "a")
    garage.assign(out, 0, 1.0, out.origin)
    garage.lifted(out, 2.0)
    assert park(garage, "e").state == "waiting"
    assert retrieve(garage, "e").state == "waiting"
    again = empty(balk_cars=0)
    assert park(again, "f").state == "turned_away"
    again._customers = Customers(10.0)
    assert park(again, "f").state == "waiting"
    assert again._turned_away == set()


def test_customers_turn_away_at_a_queue_of_so_many_cars():
    garage = empty(balk_cars=1)
    assert [park(garage, car).state for car in "a"] == ["waiting"]
    garage.call_forward(0.0)
    assert park(garage, "b", 1.0).state == "waiting", "the first car is at its bay, nobody waits"
    away = park(garage, "c", 2.0)
    assert (away.state, away.reason) == ("turned_away", "queue too long: 1 car")
    garage.call_forward(3.0)
    assert park(garage, "c", 4.0).state == "waiting"


def test_customers_turn_away_at_a_queue_that_they_expect_to_last_so_long():
    """Both bays are taken at once, then the head of the queue leaves it every 40 s; a customer bears two minutes."""
    garage = Garage(BIG, "bay", np.random.default_rng(1), Customers(balk_s=120.0))
    tasks = [park(garage, f"car{k}") for k in range(6)]
    garage.call_forward(0.0)
    for time_s, task in ((40.0, tasks[0]), (80.0, tasks[1])):
        garage.car_at_bay(task.number, task.origin, time_s - 10.0)
        garage.assign(task, 0, time_s, task.origin, int(garage.slots[garage.slot_free][0]))
        garage.lifted(task, time_s)
        garage.call_forward(time_s)
    assert len(garage.queue) == 2
    assert garage.queue.expected_s(80.0) == 80.0
    assert park(garage, "joins", 80.0).state == "waiting"
    assert garage.queue.expected_s(80.0) == 120.0
    assert park(garage, "not", 80.0).reason == "queue too long: 2.0 min"
    assert garage.queue.expected_s(180.0) == 300.0, "its head has stood there for 100 s: the queue has become slower"


def test_a_car_asked_for_before_it_is_parked_is_brought_as_soon_as_it_is():
    garage = empty("home")
    coming = park(garage, "a")
    early = retrieve(garage, "a")
    assert early.state == "waiting"
    assert early not in garage.open
    brought_in(garage, coming, GRAPH.slots[2])
    assert garage.open == [early]
    assert (early.origin, early.ready_s) == (GRAPH.slots[2], 3.0)


@pytest.mark.parametrize("car", ["never seen", "gone"])
def test_a_car_that_is_not_there_cannot_be_had(car):
    garage = with_cars("gone")
    out = retrieve(garage, "gone")
    garage.assign(out, 0, 1.0, out.origin)
    garage.lifted(out, 2.0)
    garage.lowered(out, 3.0)
    task = retrieve(garage, car)
    assert (task.state, task.reason) == ("void", "car is not in the garage")
    assert math.isnan(task.done_s)
    assert garage.open == []


@pytest.mark.parametrize("parked", [True, False])
def test_a_car_is_fetched_once_however_often_it_is_asked_for(parked):
    garage = with_cars("a") if parked else empty("home")
    if not parked:
        park(garage, "a")
    assert retrieve(garage, "a").state == "waiting"
    again = retrieve(garage, "a")
    assert (again.state, again.reason) == ("void", "car is asked for already")


def test_a_bay_takes_the_next_customer_as_soon_as_its_car_is_lifted():
    garage = empty()
    tasks = [park(garage, car) for car in "abc"]
    assert [command.request for command in garage.call_forward(2.0)] == [0, 1]
    garage.car_at_bay(0, tasks[0].origin, 1.0)
    garage.assign(tasks[0], 0, 1.0, tasks[0].origin, GRAPH.slots[0])
    assert garage.call_forward(2.0) == []
    garage.lifted(tasks[0], 2.0)
    assert garage.call_forward(2.0) == [CallForward(2, tasks[0].origin)]


def test_a_bay_is_kept_until_its_customer_has_driven_off():
    garage = with_cars("a", "b", handover="bay")
    outs = [retrieve(garage, car) for car in "ab"]
    for task in outs:
        garage.assign(task, task.number, 1.0, task.origin)
        garage.lifted(task, 2.0)
        task.destination = GRAPH.bays[0]
    garage.lower_starts(outs[0])
    assert not garage.may_lower(outs[1])
    assert garage.lowered(outs[0], 3.0) == [HandOver(outs[0].number, GRAPH.bays[0])]
    assert garage.board(3.0) == []
    assert garage.board(3.0 + outs[0].handling_s) == [DriveOff(outs[0].number, GRAPH.bays[0])]
    assert not garage.may_lower(outs[1])
    assert garage.car_left(outs[0].number, GRAPH.bays[0], 99.0).state == "served"
    assert garage.may_lower(outs[1])


def test_handling_times_depend_on_the_order_of_requests_alone():
    plain, busy = with_cars("a"), with_cars("a")
    park(busy, "x")
    brought_in(busy, busy.open[0], int(busy.slots[busy.slot_free][0]))
    park(plain, "x")
    assert park(plain, "y").handling_s == park(busy, "y").handling_s


def test_more_cars_than_slots_cannot_stand_there_at_the_start():
    with pytest.raises(ValueError, match="5 cars for 4 slots"):
        with_cars("a", "b", "c", "d", "e")


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda g: setattr(g, "unfinished", g.unfinished + 1), "requests: the count of unfinished ones is off"),
        (lambda g: setattr(g, "coming", g.coming + 1), "cars: the count of those on their way in is off"),
        (lambda g: setattr(g, "left", g.left - 1), "cars: 2 at the start + 1 arrived != 2 parked + -1 left"),
        (lambda g: g.slot_of.update({g.parked["a"]: ""}), "slots and parked cars disagree"),
        (lambda g: g.slot_free.__setitem__(int(np.argmax(g.slot_free)), False), "is taken, and no car is there"),
    ],
)
def test_books_that_are_off_are_told(spoil, says):
    garage = with_cars("a", "b", handover="bay")
    park(garage, "c")
    assert garage.audit() == []
    spoil(garage)
    assert any(says in problem for problem in garage.audit()), garage.audit()


def test_a_slot_from_which_a_car_was_lifted_is_free_unless_it_is_promised_or_taken():
    garage = with_cars("a", "b")
    slot = garage.parked["a"]
    number = garage._slot_number[slot]
    garage.vacate(slot)
    assert not garage.slot_free[number], "a car is there"
    garage.slot_of[slot], garage.reserved[slot] = "", 3
    garage.vacate(slot)
    assert not garage.slot_free[number], "it is promised"
    del garage.reserved[slot]
    garage.vacate(slot)
    assert garage.slot_free[number]


def test_books_into_which_no_car_was_ever_put_are_in_order():
    assert empty().audit() == []
