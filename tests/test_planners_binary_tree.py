"""The binary-tree planner: valid whatever the garage, and true to its routes."""

from dataclasses import replace

import numpy as np
import pytest
from brute_force import bodies, classic, problems
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import validate
from controller.planners.binary_tree import make_binary_tree
from controller.routing.binary_tree import compile_tree, find_route
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem, Status
from sumo_nets.graph import make_graph

RING = make_graph(
    "ring with a short cut",
    [(str(v), 5.0 * x, 5.0 * y) for v, (x, y) in enumerate([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)])],
    [(f"{a}>{b}", a, b, 5.0) for a, b in ("01", "12", "23", "34", "45", "50", "14")],
)


def problem(agents, window, motion=None, blocked=()):
    mask = np.isin(np.arange(6), list(blocked)).astype(np.uint8)
    nowhere = np.zeros(6, dtype=np.uint8)
    return PlanningProblem(RING, motion or classic(RING), tuple(agents), (), mask, nowhere, window)


def agent(agv, vertex, goal, **rest):
    return PlanAgent(agv, vertex, -1, 0, goal, False, **rest)


@pytest.mark.parametrize("make_motion", [classic, bodies])
@pytest.mark.parametrize("window", [6, FOREVER])
def test_two_on_the_ring_follow_their_routes(make_motion, window):
    p = problem([agent(0, 0, 5), agent(1, 4, 1)], window, make_motion(RING))
    result = make_binary_tree(RING, p.motion)(p)
    assert validate(p, result) == []
    assert result.status is Status.SOLVED
    for a in p.agents:
        route = find_route(compile_tree(RING), a.vertex, a.goal)
        assert route is not None
        path = result.paths[a.agv].vertices
        assert path == route.vertices[: len(path)]


def test_a_fault_on_the_route_is_driven_around():
    planner = make_binary_tree(RING, classic(RING))
    before = planner(problem([agent(0, 0, 4)], FOREVER))
    assert before.paths[0].vertices == (0, 1, 4)
    p = replace(problem([agent(0, 0, 5)], FOREVER, blocked=[4]))
    assert planner(p).failed == {0: -1}
    assert planner(problem([agent(0, 0, 3)], FOREVER, blocked=[4])).paths[0].vertices == (0, 1, 2, 3)


def test_a_route_lasts_until_the_goal_is_reached():
    planner = make_binary_tree(RING, classic(RING))
    planner(problem([agent(0, 0, 5)], FOREVER))
    on_the_way = planner(problem([agent(0, 1, 5)], FOREVER))
    assert on_the_way.paths[0].vertices == (1, 4, 5)


def test_one_that_rests_on_the_route_is_named():
    p = problem([agent(0, 0, 4, priority=1), agent(1, 1, 1)], FOREVER)
    result = make_binary_tree(RING, p.motion)(p)
    assert validate(p, result) == []
    assert result.status is Status.PARTIAL
    assert result.failed[0] == 1


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_every_plan_is_valid(data):
    p = data.draw(problems(largest=12, agents=6))
    starts = {a.vertex for a in p.agents}
    walls = data.draw(st.permutations(range(len(p.graph.names))))[:2]
    until = data.draw(st.integers(1, 12))
    p = replace(p, fixed=tuple(Path(90 + i, (v,), (0,), (), until) for i, v in enumerate(walls) if v not in starts))
    result = make_binary_tree(p.graph, p.motion)(p)
    assert validate(p, result) == []
    assert (result.status is Status.PARTIAL) == bool(result.failed)
