"""Dispatch rules: who takes which task, against plain counterparts, and what they are worth in a whole run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.costs import Costs
from controller.dispatch import AGE_WEIGHT, DISPATCH, OLDEST, nearest_task
from controller.garage import Task
from controller.types import Request, RequestKind, make_motion
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.movingai import grid_graph

GRAPH = grid_graph("corridor", ["." * 40])
STEP_S = 0.5
MOTION = make_motion(GRAPH, STEP_S, lambda _metres, _loaded: 4, lambda _degrees, _loaded: 0, True)
COSTS = Costs(GRAPH, MOTION, np.zeros(40, dtype=np.uint8))


def task(number, origin, requested_s=0.0):
    return Task(number, Request(0.0, RequestKind.RETRIEVE, f"car{number}"), 0.0, origin=origin, requested_s=requested_s)


def taken_by(offers):
    return {offer.agv: offer.task.number for offer in offers}


def test_who_stands_at_the_bay_takes_the_car_that_waits_there():
    tasks = [task(0, 30), task(1, 9), task(2, 0)]
    assert taken_by(nearest_task(tasks, {4: 9}, {}, COSTS)) == {4: 1}
    assert taken_by(nearest_task(tasks, {4: 9, 5: 29}, {}, COSTS)) == {4: 1, 5: 0}


@pytest.mark.parametrize(("older_s", "first"), [(0.0, 1), (79.0, 1), (81.0, 0)])
def test_an_older_request_may_be_farther_away_by_its_age(older_s, first):
    near, far = 12, 20  # 8 moves of 2 s between them
    assert pytest.approx(8 * 2.0) == AGE_WEIGHT * 80.0
    tasks = [task(0, far, 100.0), task(1, near, 100.0 + older_s)]
    assert taken_by(nearest_task(tasks, {0: 10}, {}, COSTS)) == {0: first}


def test_a_place_that_an_agv_holds_is_for_that_one_alone():
    tasks = [task(0, 5), task(1, 30)]
    assert taken_by(nearest_task(tasks, {0: 5, 1: 31}, {5: 7}, COSTS)) == {1: 1}
    assert taken_by(nearest_task(tasks, {0: 5, 1: 31}, {5: 1, 30: 7}, COSTS)) == {1: 0}


def test_of_very_many_tasks_only_the_oldest_are_looked_at():
    tasks = [task(n, 39, float(n)) for n in range(OLDEST)] + [task(OLDEST, 0, 1e4)]
    assert taken_by(nearest_task(tasks, {0: 0}, {}, COSTS)) == {0: 0}


@given(st.data())
def test_each_agv_task_and_place_is_given_once_and_the_pair_with_the_shortest_way_first(data):
    places = data.draw(st.lists(st.integers(0, 39), min_size=1, max_size=6, unique=True))
    at = {n: data.draw(st.integers(0, 39)) for n in range(data.draw(st.integers(1, 5)))}
    taken = {v: data.draw(st.integers(0, 8)) for v in places if data.draw(st.booleans())}
    tasks = [task(n, v) for n, v in enumerate(places)]
    for rule in (DISPATCH["nearest"], DISPATCH["nearest-task"], DISPATCH["id-order"]):
        offers = rule(tasks, at, taken, COSTS)
        for things in ([o.agv for o in offers], [o.task.number for o in offers]):
            assert len(set(things)) == len(things)
        assert all(taken.get(o.origin, o.agv) == o.agv and o.agv in at and o.origin == o.task.origin for o in offers)
    possible = {(abs(at[a] - j.origin), j.number, a) for j in tasks for a in at if taken.get(j.origin, a) == a}
    ways = [abs(at[o.agv] - o.origin) for o in nearest_task(tasks, at, taken, COSTS)]
    assert ways == sorted(ways)
    assert ways[:1] == [min(possible)[0]] if possible else not ways


def test_where_more_is_asked_than_can_be_done_the_nearest_task_does_more(tmp_path):
    traffic = {"kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5.0, "initial_occupancy": 0.5}
    done = {}
    for rule in ("nearest", "nearest-task"):
        given_keys = {"agvs": 3, "workload": traffic, "duration_s": 1500.0, "dispatch": rule}
        metrics = simulate(load_scenario("map1", given_keys), tmp_path / rule).metrics
        assert metrics["deadlocks_found"] == metrics["footprint_overlaps"] == metrics["sumo_collisions"] == 0
        done[rule] = metrics["tasks_done"]
    assert done["nearest-task"] > done["nearest"]
