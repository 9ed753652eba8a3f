"""Which AGV a bay is promised to, on a floor where every way can be counted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from brute_force import classic

from controller.claims import Claims
from controller.costs import Costs
from controller.executor import Executor
from controller.fleet import Agv
from controller.garage import Customers, Garage
from controller.types import Action, AgvMode, Request, RequestKind
from sumo_nets.graph import Graph, make_graph

#: Two bays at the ends of a row of five, one step from one to the next; a slot and homes beside the row.
NAMES = ("left", "a", "b", "c", "d", "e", "right", "slot", "home", "near")


def row() -> Graph:
    ways = [*pairwise(NAMES[:7]), ("c", "slot"), ("d", "home"), ("a", "near")]
    edges = [(f"{u}>{v}", u, v, 5.0) for pair in ways for u, v in (pair, pair[::-1])]
    vertices = [(name, 5.0 * x, 0.0) for x, name in enumerate(NAMES[:7])]
    vertices += [("slot", 15.0, 5.0), ("home", 20.0, 5.0), ("near", 5.0, 5.0)]
    return make_graph("row", vertices, edges, {"slot": ("slot",), "bay": ("left", "right"), "home": ("home", "near")})


GRAPH = row()
AT = GRAPH.index


class Floor:
    """A garage with AGVs at places, and the claims on its bays."""

    def __init__(self, *places: str, lift_steps: int = 10) -> None:
        motion, starts = classic(GRAPH), [AT[name] for name in places]
        self.garage = Garage(GRAPH, "bay", np.random.default_rng(1), Customers(10.0))
        self.agvs = [Agv(n, start, start) for n, start in enumerate(starts)]
        executor = Executor(GRAPH, motion, starts)
        self.executor = executor
        self.claims = Claims(self.garage, self.agvs, executor, Costs(GRAPH, motion, self.garage.blocked), lift_steps)

    def task(self):
        """A retrieval on its way, lifted at the start."""
        task = self.garage.request(Request(0.0, RequestKind.PARK, f"car{len(self.garage.tasks)}"), 0.0)
        task.lifted_s = 0.0
        return task

    def promised(self, *agvs: int, step: int = 0, behind: bool = True) -> dict[int, str]:
        found = self.claims.promise_bays({n: self.task() for n in agvs}, step, frozenset(), behind)
        return {n: GRAPH.names[bay] for n, bay in found.items()}

    def works(self, agv: int, bay: str, action: Action, steps: int) -> None:
        """An AGV that holds a bay lifts or lowers a car there for so many steps."""
        self.claims.holder[AT[bay]] = agv
        self.agvs[agv].goal, self.agvs[agv].action, self.agvs[agv].mode = AT[bay], action, AgvMode.GOING_TO_COLLECT
        self.executor.act(agv, action, steps, 0)


def test_nearer_is_less_and_not_as_far():
    claims = Floor("a").claims
    assert claims.nearer_to_bays(AT["a"], AT["b"])
    assert not claims.nearer_to_bays(AT["b"], AT["a"])
    assert not claims.nearer_to_bays(AT["a"], AT["e"])  # a step from either bay


@pytest.mark.parametrize(("lift_steps", "bay"), [(10, "right"), (6, "right"), (3, "left"), (0, "left")])
def test_a_bay_whose_outbound_place_is_taken_counts_half_a_lift_more(lift_steps, bay):
    """From b it is 2 steps to the left bay and 4 to the right one: half a lift of 6 is more than what that saves."""
    floor = Floor("b", lift_steps=lift_steps)
    floor.garage.bays[AT["left"]].outbound = floor.task()
    assert floor.promised(0) == {0: bay}
    assert floor.claims.holder == {AT[bay]: 0}


def test_a_free_bay_is_not_made_dearer():
    assert Floor("b", lift_steps=100).promised(0) == {0: "left"}


def test_a_bay_that_another_agv_is_about_to_leave_is_promised_behind_it():
    floor = Floor("left", "right", "b")
    floor.works(0, "left", Action.LOWER, 2)
    floor.works(1, "right", Action.LOWER, 2)
    assert floor.promised(2, behind=False) == {}
    assert floor.promised(2) == {2: "left"}
    assert floor.claims.next == {AT["left"]: 2}
    floor.claims.release(AT["left"], 0)
    floor.claims.move_up()
    assert (floor.claims.holder[AT["left"]], floor.claims.next) == (2, {})


def test_an_agv_that_would_come_before_the_bay_is_left_does_not_get_it():
    floor = Floor("left", "right", "b")
    floor.works(0, "left", Action.LOWER, 3)  # two steps away, left in three
    floor.works(1, "right", Action.LOWER, 3)  # four steps away
    assert floor.promised(2) == {2: "right"}


@pytest.mark.parametrize(("ready_s", "lift_steps", "bay"), [(0.0, 1, "left"), (0.0, 4, "right"), (99.0, 1, "right")])
def test_a_car_that_waits_at_the_bay_is_lifted_first(ready_s, lift_steps, bay):
    """The AGV that lowers a car takes the one that waits there; while that is not ready, the bay is nobody else's."""
    floor = Floor("left", "right", "b", lift_steps=lift_steps)
    floor.works(0, "left", Action.LOWER, 1)
    floor.works(1, "right", Action.LOWER, 1)
    waits = floor.garage.request(Request(0.0, RequestKind.PARK, "waits"), 0.0)
    waits.at_bay_s, waits.ready_s = 0.0, ready_s
    floor.garage.bays[AT["left"]].inbound = waits
    assert floor.promised(2) == {2: bay}


def test_bays_of_agvs_that_are_out_of_order_or_closed_are_not_promised():
    floor = Floor("left", "right", "b")
    floor.works(0, "left", Action.LOWER, 1)
    floor.works(1, "right", Action.LOWER, 1)
    floor.agvs[0].immobile = True
    assert floor.claims.promise_bays({2: floor.task()}, 0, frozenset({AT["right"]}), True) == {}


@pytest.mark.parametrize(("ready_s", "first"), [(0.0, 0), (99.0, 1)])
def test_who_stands_at_a_bay_takes_the_car_there_before_the_next_one_if_it_is_ready(ready_s, first):
    floor = Floor("left", "b")
    floor.claims.next[AT["left"]] = 1
    assert floor.claims.only(5) == {AT["left"]: 1}  # no car waits
    waits = floor.garage.request(Request(0.0, RequestKind.PARK, "waits"), 0.0)
    waits.at_bay_s, waits.ready_s = 0.0, ready_s
    floor.garage.bays[AT["left"]].inbound = waits
    assert floor.claims.only(5) == {AT["left"]: first}
    elsewhere = Floor("a", "b")
    elsewhere.claims.next[AT["left"]] = 1
    elsewhere.garage.bays[AT["left"]].inbound = waits
    assert elsewhere.claims.only(5) == {AT["left"]: 1}  # nobody stands there
    leaves = Floor("left", "b")
    leaves.claims.next[AT["left"]] = 1
    leaves.garage.bays[AT["left"]].inbound = waits
    leaves.executor.agvs[0].standing = False
    assert leaves.claims.only(5) == {AT["left"]: 1}  # who was there drives off


# --- a bay for a nearer AGV, a home for one that waits ----------------------------------------------------------------


def carries(floor: Floor, agv: int, bay: str) -> None:
    """An AGV carries a car to a bay that is promised to it."""
    floor.claims.holder[AT[bay]] = agv
    floor.agvs[agv].goal, floor.agvs[agv].mode = AT[bay], AgvMode.RETURNING_WITH_CAR


@pytest.mark.parametrize(("nearer_s", "traded"), [(3.0, {1: 0}), (4.0, {1: 0}), (5.0, {})])
def test_a_promised_bay_goes_to_an_agv_that_is_so_much_nearer(monkeypatch, nearer_s, traded):
    """From e it is 5 steps of a second to the left bay, from a it is one."""
    monkeypatch.setattr("controller.claims.NEARER_S", nearer_s)
    floor = Floor("e", "a")
    carries(floor, 0, "left")
    assert floor.claims.trade_bays({1: floor.task()}, 0, frozenset()) == traded
    assert floor.claims.holder == {AT["left"]: 1 if traded else 0}
    assert floor.claims.trade_bays({1: floor.task()}, 0, frozenset({AT["left"]})) == {}


def test_the_trade_that_saves_most_comes_first(monkeypatch):
    monkeypatch.setattr("controller.claims.NEARER_S", 1.0)
    floor = Floor("b", "d", "a", "c")
    carries(floor, 0, "right")  # 4 steps away; 3 from c
    carries(floor, 1, "left")  # 4 steps away; 1 from a, 3 from c
    assert floor.claims.trade_bays({2: floor.task(), 3: floor.task()}, 0, frozenset()) == {2: 1, 3: 0}


def test_nobody_gets_a_bay_where_the_other_one_has_arrived_or_before_it_is_left(monkeypatch):
    monkeypatch.setattr("controller.claims.NEARER_S", 1.0)
    floor = Floor("left", "e", "a")
    carries(floor, 0, "left")
    assert floor.claims.trade_bays({2: floor.task()}, 0, frozenset()) == {}
    floor.works(0, "left", Action.LOWER, 3)
    floor.agvs[1].goal, floor.agvs[1].mode = AT["left"], AgvMode.RETURNING_WITH_CAR
    floor.claims.next[AT["left"]] = 1
    assert floor.claims.trade_bays({2: floor.task()}, 0, frozenset()) == {}  # a step away, left in three
    assert floor.claims.trade_bays({2: floor.task()}, 2, frozenset()) == {2: 1}
    assert floor.claims.next == {AT["left"]: 2}


def test_who_waits_takes_the_home_of_one_that_is_away_and_nearer_to_the_bays(monkeypatch):
    """The homes are 2 and 3 steps from their bays."""
    monkeypatch.setattr("controller.claims.NEARER_S", 1.0)
    floor = Floor("home", "near")
    waits, away = floor.agvs

    def absent() -> int:
        return floor.claims.absent_nearer(waits, frozenset())

    assert absent() == -1  # it is at home
    floor = Floor("home", "b")
    waits, away = floor.agvs
    away.home, away.goal = AT["near"], AT["slot"]
    assert absent() == 1
    assert floor.claims.absent_nearer(waits, frozenset({AT["near"]})) == -1
    assert floor.claims.absent_nearer(away, frozenset()) == -1  # the other one's home is farther away
    away.then = AT["near"]
    assert absent() == -1  # its way home is planned
    away.then, away.off_duty = -1, True
    assert absent() == -1
    away.off_duty = False
    floor.executor.agvs[1].pending.append(AT["near"])
    assert absent() == -1
    floor.executor.agvs[1].pending.clear()
    monkeypatch.setattr("controller.claims.NEARER_S", 2.0)
    del floor.claims.__dict__["_nearer"]
    assert absent() == -1
