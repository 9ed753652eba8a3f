"""Which slot and which bay: against shortest paths of networkx in a garage with one-way lanes, and in whole runs."""

import json

import networkx as nx
import numpy as np
import pytest
from brute_force import bodies, garages
from hypothesis import given, settings
from hypothesis import strategies as st
from whole_runs import coming_next

from analysis.tables import load_run
from controller.costs import Costs
from controller.dispatch import AGE_WEIGHT
from controller.garage import Garage
from controller.places import ONWARD_WEIGHT, WAIT_WEIGHT, choose_bays, choose_slot
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import FOREVER, Request, RequestKind, make_motion
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.movingai import grid_graph
from sumo_nets.read import read_net

GRAPH = read_net("map3").graph
STEPS, STEP_S = 4, 0.5
MOTION = make_motion(GRAPH, STEP_S, lambda _metres, _loaded: STEPS, lambda _degrees, _loaded: 0, True)
COSTS = Costs(GRAPH, MOTION, np.zeros(len(GRAPH.names), dtype=np.uint8))
LANES = nx.DiGraph(zip(GRAPH.tail.tolist(), GRAPH.head.tolist(), strict=True))


def steps_from(vertex):
    return {v: STEPS * moves for v, moves in nx.single_source_shortest_path_length(LANES, vertex).items()}


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_costs_with_turns_are_the_distances_that_plans_are_made_with(data):
    graph = data.draw(garages(10))
    motion = bodies(graph)
    slots = np.zeros(len(graph.names), dtype=np.uint8)
    slots[list(graph.slots)] = 1
    around, through = Distances(Space(graph, motion), ends=slots), Distances(Space(graph, motion))
    around.update(slots)
    costs = Costs(graph, motion, np.zeros_like(slots))
    for goal in range(len(graph.names)):
        for loaded in (False, True):
            table = costs.turning_to(goal, loaded)
            for v in range(len(graph.names)):
                steps = around.distance(v, -1, goal, loaded)
                assert table[v] == (steps if steps < FOREVER else through.distance(v, -1, goal, loaded))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_costs_to_any_of_several_goals_are_the_least_of_those_to_each(data):
    graph = data.draw(st.one_of(st.just(GRAPH), garages(10)))
    costs = Costs(graph, bodies(graph), np.zeros(len(graph.names), dtype=np.uint8))
    goals = data.draw(st.lists(st.sampled_from(graph.slots or range(len(graph.names))), min_size=1, max_size=6))
    more = data.draw(st.lists(st.floats(0, 60), min_size=len(goals), max_size=len(goals)))
    least = np.min([costs.turning_to(goal) + extra for goal, extra in zip(goals, more, strict=True)], axis=0)
    np.testing.assert_allclose(np.minimum(costs.turning_to_any(goals, more), FOREVER), np.minimum(least, FOREVER))


def garage(cars=0):
    books = Garage(GRAPH, "bay", np.random.default_rng(1))
    books.place_initial([f"car{n}" for n in range(cars)], np.random.default_rng(2))
    return books


@pytest.mark.parametrize("bay", GRAPH.bays)
def test_the_slot_is_the_one_that_is_reached_first_though_the_way_back_may_be_long(bay):
    books, there = garage(cars=700), steps_from(bay)
    slot = choose_slot(books, bay, "", COSTS)
    assert books.slot_free[list(books.slots).index(slot)]
    assert there[slot] == min(there[v] for v in books.slots[books.slot_free])


def test_of_slots_as_near_the_one_on_the_way_to_a_car_that_is_asked_for():
    books = garage(cars=500)
    for n, car in enumerate(("car7", "car99", "car300")):
        books.request(Request(60.0 * n, RequestKind.RETRIEVE, car), 60.0 * n)
    for bay in GRAPH.bays:
        there, slot = steps_from(bay), choose_slot(books, bay, "", COSTS)

        def cost(v, there=there):
            onward = steps_from(int(v))
            younger = {j.origin: AGE_WEIGHT * j.requested_s / STEP_S for j in books.open}
            return there[v] + ONWARD_WEIGHT * min(onward[u] + younger[u] for u in younger)

        assert cost(slot) == min(cost(v) for v in books.slots[books.slot_free])


def test_a_zone_comes_before_nearness_and_is_left_when_it_is_full():
    books = garage()
    assert GRAPH.names[choose_slot(books, GRAPH.bays[0], "slot31_", COSTS)].startswith("slot31_")
    books.slot_free[[GRAPH.names[v].startswith("slot31_") for v in books.slots]] = False
    assert choose_slot(books, GRAPH.bays[0], "slot31_", COSTS) == choose_slot(books, GRAPH.bays[0], "", COSTS)
    books.slot_free[:] = False
    assert choose_slot(books, GRAPH.bays[0], "", COSTS) == -1


CORRIDOR = grid_graph("corridor", ["." * 40])
LINE = Costs(
    CORRIDOR,
    make_motion(CORRIDOR, STEP_S, lambda _metres, _loaded: STEPS, lambda _degrees, _loaded: 0, True),
    np.zeros(40, dtype=np.uint8),
)


def test_a_bay_goes_to_who_is_nearest_and_each_agv_gets_one():
    since = dict.fromkeys(range(3), 0.0)
    assert choose_bays({0: 10, 1: 2, 2: 30}, since, {0: 0}, {}, LINE) == {1: 0}
    assert choose_bays({0: 10, 1: 2, 2: 30}, since, {0: 0, 39: 0}, {}, LINE) == {1: 0, 2: 39}
    assert choose_bays({0: 10}, since, {0: 0, 39: 0}, {}, LINE) == {0: 0}
    assert choose_bays({0: 10}, since, {0: 29 * STEPS, 39: 0}, {}, LINE) == {0: 39}, (
        "a bay where a car stands takes longer"
    )


@pytest.mark.parametrize(("later_s", "first"), [(0.0, 1), (790.0, 1), (810.0, 0)])
def test_who_has_waited_long_goes_first_by_and_by(later_s, first):
    assert pytest.approx(8 * STEPS * STEP_S) == WAIT_WEIGHT * 800
    assert choose_bays({0: 12, 1: 4}, {0: 100.0, 1: 100.0 + later_s}, {0: 0}, {}, LINE) == {first: 0}


def test_while_all_bays_are_taken_cars_wait_at_the_agvs_homes(tmp_path):
    traffic = {"kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5.0, "initial_occupancy": 0.5}
    scenario = load_scenario(
        "map1", {"agvs": 8, "workload": traffic, "duration_s": 1200.0, "record": {"sample_s": 2.0}}
    )
    metrics = simulate(scenario, tmp_path / "run").metrics
    for nothing in ("deadlocks_found", "footprint_overlaps", "sumo_collisions"):
        assert metrics[nothing] == 0
    assert metrics["tasks_done"] > 20
    trajectory = load_run(tmp_path / "run").trajectory
    stands = trajectory[(trajectory["mode"] == "returning_with_car") & (trajectory["speed_mps"] < 0.01)]
    graph = read_net("map1").graph  # an AGV's front stands at the vertex
    metres = np.hypot(*(stands[["x_m", "y_m"]].to_numpy()[:, None] - graph.xy).transpose(2, 0, 1))
    at = metres.argmin(axis=1)
    at_home = np.isin(at, graph.homes)
    assert sum(at_home) > 2 * sum(np.isin(at, graph.slots)), "from the slots the way to a bay is long"
    assert sum(at_home) > 100


@pytest.mark.parametrize("plant", ["discrete", "sumo"])
def test_the_record_tells_of_each_promise_and_each_exchange_of_homes(tmp_path, plant):
    """Told once more from the events alone: who has which bay, and which home is whose."""
    traffic = {"kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5.0, "initial_occupancy": 0.5}
    keys = {"agvs": 24, "plant": plant, "workload": traffic, "duration_s": 1200.0, "record": {"replay": False}}
    simulate(load_scenario("map2", keys), tmp_path / "run")
    run = load_run(tmp_path / "run")
    graph = read_net("map2").graph
    bays = {graph.names[bay] for bay in graph.bays}
    homes = {n: graph.names[home] for n, home in enumerate(graph.homes[:24])}
    first, bay_of, traded = dict(homes), {}, 0
    for kind, agv, vertex, detail in run.events[["kind", "agv", "vertex", "detail"]].itertuples(index=False):
        told = json.loads(detail or "{}")
        if kind == "bay_promised":
            if told["instead_of"] >= 0:
                traded += 1
                assert bay_of.pop(told["instead_of"]) == vertex
            bay_of[agv] = vertex
            assert list(bay_of.values()).count(vertex) <= 2, "the holder, and the one that comes next"
        elif kind == "lower" and vertex in bays:
            assert bay_of.pop(agv) == vertex
        elif kind == "homes_exchanged":
            new = {int(n): home for n, home in told["homes"].items()}
            assert sorted(new.values()) == sorted(homes[n] for n in new)
            homes |= new
    assert sorted(homes.values()) == sorted(first.values())
    if plant == "sumo":  # in ticks nobody is so much nearer than another one
        assert traded, "no bay was traded"
        assert homes != first, "no homes were exchanged"


def test_who_would_be_at_a_bay_before_the_one_at_work_has_left_waits_where_it_is():
    since = dict.fromkeys(range(3), 0.0)
    assert choose_bays({0: 10, 1: 2, 2: 30}, since, {}, {0: 10 * STEPS}, LINE) == {0: 0}
    assert choose_bays({0: 10, 1: 2, 2: 30}, since, {}, {0: 31 * STEPS}, LINE) == {}
    assert choose_bays({0: 10, 1: 2, 2: 30}, since, {39: 0}, {0: 10 * STEPS}, LINE) == {2: 39, 0: 0}
    assert choose_bays({0: 10}, since, {}, {}, LINE) == {}


@pytest.mark.parametrize(("planner", "sets_out"), [("token", True), ("whca", False)])
def test_with_complete_plans_the_next_agv_sets_out_while_the_one_at_the_bay_works(tmp_path, planner, sets_out):
    traffic = {"kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5.0, "initial_occupancy": 0.5}
    keys = {"agvs": 8, "planner": planner, "workload": traffic, "duration_s": 1200.0, "record": {"sample_s": 1.0}}
    metrics = simulate(load_scenario("map1", keys), tmp_path / "run").metrics
    assert metrics["footprint_overlaps"] == metrics["sumo_collisions"] == metrics["deadlocks_unresolved"] == 0
    found = coming_next(load_run(tmp_path / "run"), read_net("map1").graph.names)
    assert (len(found) > 5) is sets_out
