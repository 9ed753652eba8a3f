from dataclasses import replace

import numpy as np
import pytest
from brute_force import bodies, classic, optimum, problems
from hypothesis import assume, given, settings
from test_planners_whca import LINE, SIDING, agent, problem

from controller.conflicts import validate
from controller.planners.cbs import PARTIAL, Cbs, CbsLimits, cbs
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import FOREVER, Path, Status
from sumo_nets.graph import make_graph


def cost(result):
    return sum(path.arrive[-1] for path in result.paths.values())


@settings(max_examples=60, deadline=None)
@given(problems(largest=6, agents=3, unit=True, window=FOREVER))
def test_optimal_on_classic_problems(p):
    best = optimum(p)
    assume(best is not None)
    result = cbs(p, CbsLimits(expansions=3000))
    assert validate(p, result) == [] or result.status is not Status.SOLVED
    assert (result.status, cost(result)) == (Status.SOLVED, best) or result.status is Status.TIMEOUT


@settings(max_examples=60, deadline=None)
@given(problems(largest=5, agents=2, unit=False, window=FOREVER))
def test_optimal_on_bodies_with_durations(p):
    best = optimum(p)
    assume(best is not None)
    result = cbs(p, CbsLimits(expansions=1000))
    assert (result.status, cost(result)) == (Status.SOLVED, best) or result.status is Status.TIMEOUT


@settings(max_examples=40, deadline=None)
@given(problems(largest=8, agents=4, window=30))
def test_partial_cbs_is_valid_and_not_cheaper_than_the_optimum(p):
    result = cbs(p, PARTIAL)
    if result.status is Status.SOLVED:
        assert validate(replace(p, window_steps=FOREVER), result) == []
        if len(p.agents) <= 2:
            assert cost(result) >= optimum(p)
    else:
        assert not result.paths


@pytest.mark.parametrize("limits", [CbsLimits(), PARTIAL])
@pytest.mark.parametrize("make_motion", [classic, bodies])
def test_head_on_agents_pass_at_the_siding_at_least_cost(limits, make_motion):
    p = problem(SIDING, [agent(1, 0, 4), agent(2, 4, 0)], make_motion(SIDING))
    result = cbs(p, limits)
    assert result.status is Status.SOLVED
    assert validate(p, result) == []
    if not limits.ranges:
        assert cost(result) == optimum(p)


def test_a_full_ring_turns_at_once():
    vertices = [(f"{x}{y}", 5.0 * x, 5.0 * y) for x in range(3) for y in range(2)]
    pairs = [(a, b) for a in vertices for b in vertices if abs(a[1] - b[1]) + abs(a[2] - b[2]) == 5]
    ladder = make_graph("ladder", vertices, [(a[0] + b[0], a[0], b[0], 5.0) for a, b in pairs])
    p = problem(ladder, [agent(1, 0, 2), agent(2, 2, 3), agent(3, 3, 1), agent(4, 1, 0)])
    result = cbs(p)
    assert validate(p, result) == []
    assert cost(result) == optimum(p) == 4


def test_keeps_clear_of_fixed_paths():
    fixed = Path(9, (1, 2), (0, 6), (5,), 12)
    p = problem(LINE, [agent(1, 0, 3)], fixed=[fixed])
    result = cbs(p)
    assert validate(p, result) == []
    assert cost(result) == optimum(p) == 13


@pytest.mark.parametrize(
    ("limits", "status"),
    [
        (CbsLimits(expansions=5), Status.TIMEOUT),
        (CbsLimits(nodes=5), Status.TIMEOUT),
        (CbsLimits(constraints=3), Status.INFEASIBLE),
    ],
)
def test_limits_end_a_hopeless_search(limits, status):
    result = cbs(problem(LINE, [agent(1, 0, 3), agent(2, 3, 0)]), limits)
    assert result.status is status
    assert not result.paths


def test_unreachable_goal_is_infeasible():
    assert cbs(problem(LINE, [agent(1, 0, 3)], blocked=[1])).status is Status.INFEASIBLE


def test_search_memory_is_shared_and_counted():
    distances = Distances(Space(LINE, classic(LINE)))
    planner = Cbs(distances)
    p = problem(LINE, [agent(1, 0, 3)])
    assert planner(p).paths == planner(p).paths
    assert planner(p).counters.expanded == np.diff([distances.counters[0], distances.counters[0] + 4])[0]
