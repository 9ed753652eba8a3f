"""Online MAPF of paper 000: who goes first, who gives way, where plans are cut; and the one-line grid."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from controller.planners.online_mapf import OnlineMapfOptions, current_goals, cut_at_wait, dead_ends, make_online_mapf
from controller.types import FOREVER, Motion, Path, PlanAgent, PlanningProblem, Status, make_motion
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.graph import Graph, make_graph
from sumo_nets.layout import LayoutError
from sumo_nets.one_line import OneLine, one_line_layout
from sumo_nets.plan import plan_garage


def line(bays: dict[str, str], cells: int = 6) -> Graph:
    """A row of cells 0, 1, ..., driven both ways, with a bay beside some of them."""
    names = [str(k) for k in range(cells)]
    places = [(n, 5.0 * k, 0.0) for k, n in enumerate(names)]
    places += [(bay, 5.0 * int(at), 5.0) for bay, at in bays.items()]
    links = [*pairwise(names), *bays.items()]
    return make_graph("line", places, [(f"{u}>{v}", u, v, 5.0) for a, b in links for u, v in ((a, b), (b, a))])


def motion(graph: Graph) -> Motion:
    return make_motion(graph, 1.0, lambda metres, loaded: 2, lambda degrees, loaded: 0, following=False)


def problem(graph: Graph, *ways: tuple[str, str]) -> PlanningProblem:
    agents = [PlanAgent(k, graph.index[u], -1, 0, graph.index[v], False) for k, (u, v) in enumerate(ways)]
    none = np.zeros(len(graph.names), dtype=np.uint8)
    return PlanningProblem(graph, motion(graph), tuple(agents), (), none, none, FOREVER)


def test_who_leaves_a_dead_end_goes_first_and_the_other_gives_way():
    graph = line({"a": "1", "b": "4"})
    asked = problem(graph, ("3", "2"), ("a", "b"))
    result = make_online_mapf(graph, asked.motion, OnlineMapfOptions(permutations=1))(asked)
    assert result.status is Status.SOLVED
    assert [graph.names[v] for v in result.paths[1].vertices] == ["a", "1", "2", "3", "4", "b"]


def test_a_dead_end_reaches_back_to_where_there_is_another_way():
    graph = line({"bay": "3"})
    assert {graph.names[v] for v in dead_ends(graph)} == {"0", "1", "2", "bay", "4", "5"}


def test_orders_are_permuted_until_all_have_a_path():
    """The nearer one would rest at 2 and shut the other one out; the other way round both arrive."""
    graph = line({"bay": "3"})
    asked = problem(graph, ("1", "2"), ("0", "4"))
    once = make_online_mapf(graph, asked.motion, OnlineMapfOptions(permutations=1))
    planner = make_online_mapf(graph, asked.motion)
    assert once(asked).status is Status.PARTIAL
    assert planner(asked).status is Status.SOLVED
    assert planner.tried == 2


def test_a_plan_is_cut_where_it_waits_for_the_first_time():
    graph = line({})
    asked = problem(graph, ("0", "3"))
    whole = Path(0, (0, 1, 2, 3), (0, 2, 9, 11), (0, 7, 9))
    assert cut_at_wait(whole, asked) == Path(0, (0, 1), (0, 2), (0,), until=9)
    assert cut_at_wait(Path(0, (0, 1, 2), (0, 2, 4), (0, 2)), asked).vertices == (0, 1, 2)


def test_way_points_are_given_by_distance_and_robots_move_up():
    final, way_points = {0: 9, 1: 9, 2: 9, 3: 5}, {9: [8, 7]}
    assert current_goals(final, {0: 4, 1: 2, 2: 9, 3: 1}, way_points) == {1: 9, 0: 8, 2: 7, 3: 5}
    assert current_goals({0: 9, 2: 9}, {0: 4, 2: 9}, way_points) == {0: 9, 2: 8}
    assert current_goals({0: 9, 1: 9}, {0: 1, 1: 1}, {}) == {0: 9, 1: 9}


def test_it_parks_and_retrieves_in_the_thesis_garage():
    summary = simulate(load_scenario("map1_thesis", {"plant": "discrete", "planner": "online_mapf"}), None)
    assert summary.metrics["tasks_done"] == 122
    assert summary.metrics["deadlocks_unresolved"] == 0


def test_the_one_line_grid_has_what_was_asked_for():
    plan = plan_garage(one_line_layout("grid", OneLine(robots=10, unloading=5, narrow=18, passing=2, picking=5)))
    assert len(plan.roles["home"]) == len(plan.roles["slot"]) == 10
    assert len(plan.roles["refuge"]) == 12
    assert plan.roles["home"][0] == "c9_2"
    for measures in (OneLine(robots=0), OneLine(narrow=2, passing=3), OneLine(picking=0)):
        with pytest.raises(LayoutError, match="is not valid"):
            one_line_layout("grid", measures)


@pytest.mark.parametrize(("short_moves", "cells"), [(0, ["0", "1"]), (1, ["0"])])
def test_what_is_too_short_to_be_worth_sending_is_not_sent(short_moves, cells):
    """The way is free as far as cell 1; whoever stands in cell 2 leaves for the bay later."""
    graph = line({"bay": "2"})
    leaves = Path(7, (graph.index["2"], graph.index["bay"]), (0, 20), (18,))
    asked = replace(problem(graph, ("0", "5")), fixed=(leaves,))
    result = make_online_mapf(graph, asked.motion, OnlineMapfOptions(short_moves=short_moves))(asked)
    assert [graph.names[v] for v in result.paths[0].vertices] == cells
