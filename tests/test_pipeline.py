"""The thesis's pipeline: its pseudo-code on grids drawn by hand, single agents against networkx, and its first row."""

import networkx as nx
import numpy as np
import pytest
from brute_force import classic
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import find_conflicts
from controller.planners.pipeline import PipelineOptions, make_pipeline
from controller.types import PlanAgent, PlanningProblem
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.movingai import grid_graph


def drive(rows, trips, steps=40, window=5, blocked=(), **options):
    """Plan and move until everybody is at the goal.

    Returns:
        Moves needed or None, how often each stage was used, and after each move places and wait-for edges.
    """
    graph = grid_graph("drawn", rows)
    planner = make_pipeline(graph, classic(graph), PipelineOptions(**options))
    closed = np.array([name in blocked for name in graph.names], dtype=np.uint8)
    at, goals = ([graph.index[trip[k]] for trip in trips] for k in (0, 1))
    log = []
    for t in range(steps):
        if at == goals:
            return t, dict(planner.stages), log
        agents = tuple(
            PlanAgent(n, v, -1, 0, goal, False, priority=-n) for n, (v, goal) in enumerate(zip(at, goals, strict=True))
        )
        none = np.zeros_like(closed)
        result = planner(PlanningProblem(graph, planner.floor.motion, agents, (), closed, none, window))
        assert find_conflicts(result.paths.values(), planner.floor.motion) == []
        at = [result.paths[n].vertices[-1] for n in range(len(at))]
        assert len(set(at)) == len(at)
        log.append(([graph.names[v] for v in at], result.waits))
    return None, dict(planner.stages), log


def places(log):
    return [at for at, _ in log]


cells = st.sampled_from([f"{x},{y}" for x in range(5) for y in range(5)])


@settings(max_examples=60, deadline=None)
@given(trip=st.tuples(cells, cells), parked=st.sets(cells, max_size=9), window=st.integers(1, 11))
def test_alone_it_drives_a_shortest_way_round_parked_cars(trip, parked, window):
    parked -= set(trip)
    graph = grid_graph("open", ["....."] * 5)
    free = nx.DiGraph(graph.to_networkx())
    free.remove_nodes_from([graph.index[name] for name in parked])
    start, goal = (graph.index[name] for name in trip)
    moves, _, log = drive(["....."] * 5, [trip], blocked=parked, window=window)
    if nx.has_path(free, start, goal):
        assert moves == nx.shortest_path_length(free, start, goal)
    else:
        assert moves is None
        assert all(at == [trip[0]] for at in places(log))
    assert all(waits == () for _, waits in log)


CROSS = ["@@@.@@@", "@@@.@@@", "@@@.@@@", ".......", "@@@.@@@", "@@@.@@@", "@@@.@@@"]


def test_a_wait_edge_leads_to_the_holder_of_a_cell_within_the_next_h():
    """Both reach the crossing, 3 cells ahead, at once; the first one has it reserved if the window reaches so far."""
    trips = [("0,3", "6,3"), ("3,0", "3,6")]
    for window, edges in ((2, []), (3, [(1, 0)])):
        _, _, ((at, waits),) = drive(CROSS, trips, steps=1, window=window, sidestep=False)
        assert at == ["1,3", "3,1"]
        assert list(waits) == edges


@pytest.mark.parametrize("sidestep", [True, False])
def test_four_in_a_ring_move_on_at_once(sidestep):
    ring = ["0,0", "1,0", "1,1", "0,1"]
    trips = list(zip(ring, ring[1:] + ring[:1], strict=True))
    assert drive(["..", ".."], trips, sidestep=sidestep)[0] == 1


def test_head_on_in_two_lanes_the_second_one_changes_lane_or_cbs_does_it():
    trips = [("0,0", "6,0"), ("6,0", "0,0")]
    moves, stages, _ = drive(["......."] * 2, trips)
    assert (moves, stages) == (10, {})
    moves, stages, log = drive(["......."] * 2, trips, sidestep=False)
    assert (moves, stages) == (9, {"partial_cbs": 1})
    assert any({(0, 1), (1, 0)} <= set(waits) for _, waits in log)


TEE = ["...", "@.@"]
SWAP = [("0,0", "2,0"), ("2,0", "0,0")]


def fewest_moves(rows, trips):
    """By breadth-first search over where all are."""
    graph = grid_graph("drawn", rows)
    start, goal = (tuple(graph.index[trip[k]] for trip in trips) for k in (0, 1))
    near = [(v, *graph.successors[v]) for v in graph.vertices]
    joint = nx.DiGraph(
        (((a, b), (c, d)))
        for a in graph.vertices for b in graph.vertices if a != b
        for c in near[a] for d in near[b] if c != d and (c, d) != (b, a)
    )  # fmt: skip
    return nx.shortest_path_length(joint, start, goal)


def test_cbs_beats_waiting_only_if_waiting_is_not_the_cheaper_plan():
    """By the thesis's weights a move costs 1 and saves 0.1 to go, a wait costs 0.5: whoever stays is cheaper."""
    moves, stages, log = drive(TEE, SWAP)
    assert (moves, list(stages)) == (None, ["pull_over"])
    assert places(log)[-1] == ["1,0", "2,0"]
    moves, stages, _ = drive(TEE, SWAP, wait_cost=1.0, residual_cost=1.0)
    assert (moves, stages) == (fewest_moves(TEE, SWAP), {"partial_cbs": 1})


@pytest.mark.parametrize(("last", "refuge"), [("e", "1,1"), (".", "2,0")])
def test_the_other_pulls_over_to_the_right_then_down_but_never_to_anothers_slot(last, refuge):
    """The leader wants the other's place. To its right is the leader's goal: a slot, or nothing but a cell."""
    _, stages, log = drive([".." + last, "@.@"], [("0,0", "2,0"), ("1,0", "0,0")], steps=1, sidestep=False)
    assert stages == {"pull_over": 1}
    assert places(log) == [["1,0", refuge]]


def test_an_agv_without_anything_to_do_keeps_its_place_and_others_go_round_it():
    moves, stages, log = drive([".....", "@...@"], [("0,0", "4,0"), ("2,0", "2,0")])
    assert (moves, stages) == (6, {})
    assert {at[1] for at in places(log)} == {"2,0"}
    _, _, log = drive(["....."], [("0,0", "4,0"), ("2,0", "2,0")], steps=5)
    assert places(log) == [["0,0", "2,0"]] * 5


FULL = (["....", "@..@"], [("3,0", "1,1"), ("2,1", "3,0"), ("0,0", "2,1"), ("1,0", "1,0")])
ISLAND = (["...", "@.@", "..."], [("2,0", "1,2"), ("2,2", "1,0"), ("1,0", "2,2"), ("0,2", "0,2")])


@pytest.mark.parametrize(
    ("case", "options", "change"),
    [
        ((TEE, SWAP), {}, {"wait_cost": 1.0}),
        ((TEE, SWAP), {}, {"residual_cost": 1.0}),
        ((TEE, SWAP), {"wait_cost": 1.0}, {"move_cost": 5.0}),
        ((TEE, SWAP), {"wait_cost": 1.0}, {"sidestep": False}),
        ((TEE, SWAP), {"wait_cost": 1.0}, {"wait_edges": 0}),
        ((TEE, SWAP), {"wait_cost": 1.0}, {"expansions": 1}),
        ((TEE, SWAP), {"wait_cost": 1.0}, {"constraints": 1}),
        (FULL, {}, {"nodes": 1}),
        (ISLAND, {}, {"group": 2}),
    ],
)
def test_each_option_acts(case, options, change):
    assert drive(*case, steps=8, **options) != drive(*case, steps=8, **options, **change)


def first_row(planner):
    keys = {"agvs": 1, "plant": "discrete", "rules": "thesis", "planner": planner, "dispatch": "nearest"}
    return simulate(load_scenario("map1_thesis", keys), None)


def test_the_first_row_of_the_thesis_with_the_programs_dearer_turns_and_dstar_lites_search():
    ours, kept = first_row("pipeline"), first_row("dstar_lite")
    assert ours.status == "finished"
    assert (ours.metrics["steps"], ours.metrics["movement_cost"]) == (9176, 6260)
    for work in ("nodes_expanded", "nodes_generated", "valid_expansions", "heap_moves"):
        assert ours.metrics[work] == kept.metrics[work] > 0


def test_it_works_in_sumo():
    workload = {"kind": "park_exit", "cars": 3}
    m = simulate(load_scenario("map1_thesis", {"agvs": 2, "planner": "pipeline", "workload": workload}), None).metrics
    assert (m["tasks_done"], m["sumo_collisions"], m["footprint_overlaps"]) == (6, 0, 0)
