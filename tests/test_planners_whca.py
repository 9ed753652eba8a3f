from dataclasses import replace

import numpy as np
import pytest
from brute_force import bodies, classic, optimum, problems
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import validate
from controller.planners.whca import WhcaOptions, make_whca
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem, Status
from sumo_nets.graph import make_graph


def chain(links, n):
    """A graph of vertices 0..n-1 in a row, two-way edges between the given pairs."""
    return make_graph(
        "chain",
        [(str(v), 5.0 * v, 0.0) for v in range(n)],
        [(f"{a}>{b}", str(a), str(b), 5.0) for u, v in links for a, b in ((u, v), (v, u))],
    )


LINE = chain([(0, 1), (1, 2), (2, 3)], 4)
SIDING = make_graph(
    "siding",
    [(str(v), 5.0 * v, 0.0) for v in range(5)] + [("s", 10.0, 5.0)],
    [(f"{a}>{b}", a, b, 5.0) for u, v in ("01", "12", "23", "34", "2s") for a, b in ((u, v), (v, u))],
)


def problem(graph, agents, motion=None, window=FOREVER, fixed=(), blocked=(), no_rest=()):
    n = len(graph.names)
    masks = [np.isin(np.arange(n), list(vs)).astype(np.uint8) for vs in (blocked, no_rest)]
    return PlanningProblem(graph, motion or classic(graph), tuple(agents), tuple(fixed), *masks, window)


def agent(agv, vertex, goal, priority=0, ready_step=0):
    return PlanAgent(agv, vertex, -1, ready_step, goal, False, priority=priority)


def solve(p, **options):
    result = make_whca(p.graph, p.motion, WhcaOptions(**options))(p)
    assert validate(p, result) == []
    return result


@pytest.mark.parametrize("make_motion", [classic, bodies])
@pytest.mark.parametrize("window", [4, 20, FOREVER])
def test_an_idle_agent_is_pushed_into_the_siding_and_comes_back(make_motion, window):
    p = problem(SIDING, [agent(1, 0, 4, priority=5), agent(2, 2, 2)], make_motion(SIDING), window)
    result = solve(p)
    assert result.status is Status.SOLVED
    if window == FOREVER:
        assert 5 in result.paths[2].vertices
        assert result.paths[2].vertices[-1] == 2


@pytest.mark.parametrize("make_motion", [classic, bodies])
def test_head_on_agents_pass_at_the_siding(make_motion):
    p = problem(SIDING, [agent(1, 0, 4, ready_step=5), agent(2, 3, 0)], make_motion(SIDING))
    result = solve(p)
    assert result.status is Status.SOLVED
    assert any(5 in path.vertices for path in result.paths.values())


def test_without_a_siding_somebody_fails_and_names_the_other():
    result = solve(problem(LINE, [agent(1, 0, 3), agent(2, 3, 0)]))
    assert result.status is Status.PARTIAL
    assert set(result.failed.items()) <= {(1, 2), (2, 1)}
    assert result.paths.keys() | result.failed.keys() == {1, 2}


def test_a_window_hides_the_meeting():
    result = solve(problem(LINE, [agent(1, 0, 3), agent(2, 3, 0)], window=2))
    assert result.status is Status.SOLVED
    assert [path.until for path in result.paths.values()] == [2, 2]


def test_one_without_a_way_out_of_the_corridor_goes_first():
    dead_end = chain([(0, 1), (1, 2), (2, 3), (2, 4)], 5)  # agent 2 stands at the dead end that agent 1 wants
    p = problem(dead_end, [agent(1, 2, 0, priority=9), agent(2, 0, 3)])
    assert solve(p, raises=0).status is Status.PARTIAL
    assert solve(p).status is Status.SOLVED


def test_an_unreachable_goal_leaves_the_agent_where_it_is_and_others_wait():
    result = solve(problem(LINE, [agent(1, 0, 3), agent(2, 1, 0)], blocked=[2], window=10))
    assert result.failed == {1: -1}
    assert result.paths[2].vertices == (1,)


def test_bays_of_others_are_no_place_to_wait_unless_nothing_else_is_left():
    fork = make_graph(
        "fork",
        [(v, x, y) for v, x, y in (("0", 0, 0), ("1", 5, 0), ("2", 10, 0), ("a", 5, 5), ("b", 5, -5))],
        [(f"{a}>{b}", a, b, 5.0) for u, v in ("01", "12", "1a", "1b") for a, b in ((u, v), (v, u))],
    )
    agents = [agent(1, 0, 1, priority=1), agent(2, 1, 0)]  # 2 can't reach its goal past 1 and has to make room
    rests = ([2, 3], [2, 4], [2, 3, 4])
    ends = [solve(problem(fork, agents, window=8, no_rest=rest)).paths[2].vertices[-1] for rest in rests]
    assert ends[:2] == [4, 3]
    assert ends[2] in (2, 3, 4)


def test_equal_problems_equal_plans_whatever_was_planned_before():
    p = problem(SIDING, [agent(1, 0, 4), agent(2, 4, 0)], bodies(SIDING), 30)
    planner = make_whca(p.graph, p.motion)
    first = planner(p)
    planner(problem(SIDING, [agent(1, 3, 1), agent(2, 0, 5)], p.motion, 30, blocked=[4]))
    again = planner(p)
    assert again.paths == first.paths


def clear_of(paths, p):
    """The fixed paths that don't touch what the agents own at the beginning."""
    starts = {a.vertex for a in p.agents}
    return tuple(path for path in paths if not starts & set(path.vertices))


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_every_plan_is_valid(data):
    p = data.draw(problems(largest=12, agents=6))
    walls = data.draw(st.permutations(range(len(p.graph.names))))[:2]
    until = data.draw(st.integers(1, 12))
    p = replace(p, fixed=clear_of([Path(90 + i, (v,), (0,), (), until) for i, v in enumerate(walls)], p))
    result = make_whca(p.graph, p.motion)(p)
    assert validate(p, result) == []
    assert (result.status is Status.PARTIAL) == bool(result.failed)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_every_plan_around_driving_agents_is_valid(data):
    p = data.draw(problems(largest=12, agents=6))
    planner = make_whca(p.graph, p.motion)
    half = len(p.agents) // 2
    first = planner(replace(p, agents=p.agents[:half]))
    second = replace(
        p, agents=p.agents[half:], fixed=clear_of(first.paths.values(), replace(p, agents=p.agents[half:]))
    )
    assert validate(second, planner(second)) == []


@settings(max_examples=100, deadline=None)
@given(problems(largest=6, agents=2, window=FOREVER))
def test_never_cheaper_than_the_optimum_and_equal_to_it_for_one_agent(p):
    result = make_whca(p.graph, p.motion)(p)
    best = optimum(p)
    if result.status is Status.SOLVED:
        cost = sum(path.arrive[-1] for path in result.paths.values())
        assert best is not None
        assert cost == best if len(p.agents) == 1 else cost >= best
    elif len(p.agents) == 1:
        assert best is None


def test_counters_count_this_call_only():
    p = problem(SIDING, [agent(1, 0, 4)])
    planner = make_whca(p.graph, p.motion)
    first, second = planner(p).counters, planner(p).counters
    assert 0 < second.expanded < first.expanded  # the distances are known by then
    assert second.valid <= second.expanded <= second.generated
