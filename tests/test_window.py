"""The planning window: its rules by hand, plans that are kept, distances that are repaired."""

import math
from dataclasses import replace

import numpy as np
import pytest
from brute_force import classic, problems
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import validate
from controller.planners.whca import make_whca
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import PlanAgent, PlanningProblem
from controller.window import Window, WindowRange, WindowRule, count_sccs
from sumo_nets.graph import make_graph

# --- the rules --------------------------------------------------------------------------------------------------------


def test_the_score_is_that_of_the_program():
    window = Window(WindowRange(5, 5, 11), WindowRule())
    course = []
    # floor(0.6 * old) + edges + 5 * SCCs: 30; 18 + 3 = 21; 12 + 13 = 25; 15; 9; 5; 3; 1
    for edges, sccs in ((20, 2), (3, 0), (8, 1), (0, 0), (0, 0), (0, 0), (0, 0), (0, 0)):
        window.take_conflicts(edges, sccs)
        course.append((window.score, window.cells))
    assert course == [(30, 7), (21, 7), (25, 9), (15, 9), (9, 7), (5, 5), (3, 5), (1, 5)]


@given(st.lists(st.tuples(st.integers(0, 64), st.integers(0, 4)), max_size=30), st.integers(5, 11), st.integers(1, 4))
def test_the_window_stays_in_its_range_and_moves_by_steps(calls, start, step):
    window = Window(WindowRange(start, 5, 11), WindowRule(step=step))
    score = 0
    for edges, sccs in calls:
        before = window.cells
        window.take_conflicts(edges, sccs)
        score = math.floor(0.6 * score) + edges + 5 * sccs
        change = step if score > 24 else -step if score < 10 else 0
        assert (window.score, window.cells) == (score, min(11, max(5, before + change)))


def test_the_first_window_is_the_one_that_is_given():
    assert [Window(WindowRange(n, 5, 11), WindowRule()).cells for n in (5, 8, 9, 10)] == [5, 8, 9, 10]


def test_traffic_opens_the_window_and_a_deadlock_opens_it_whole():
    window = Window(WindowRange(11, 11, 21), WindowRule(keep=0.5))
    for under_way, deadlock, level, cells in (
        (1, False, 0.0, 11),  # alone: nobody to look ahead for
        (4, False, 0.5, 15),  # 0.5 of 10 moves is 2.5 steps, rounded to even
        (4, False, 0.75, 19),
        (1, True, 0.875, 19),
        (1, True, 0.9375, 21),
        (0, False, 0.46875, 15),
    ):
        window.take_traffic(under_way, 4, deadlock)
        assert (window.level, window.cells) == (level, cells)


def test_rings_are_components_of_two_or_more():
    assert count_sccs([(0, 1), (1, 2), (2, 0), (3, 0), (4, 5), (5, 4), (6, 6)]) == 2
    assert count_sccs([]) == 0


# --- plans that are kept ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [True, False])
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_plans_that_hold_are_kept_without_a_search(unit, data):
    p = data.draw(problems(unit=unit, window=data.draw(st.sampled_from([4, 9]))))
    planner = make_whca(p.graph, p.motion)
    first = planner(p)
    again = planner(replace(p, carried=tuple(first.paths.values())))
    assert validate(p, again) == []
    goals = {a.agv: a.goal for a in p.agents}
    far = all(q.vertices[-1] == goals[n] or 2 * q.arrive[-1] >= p.window_steps for n, q in first.paths.items())
    if far and not first.failed:
        assert again.paths == first.paths
        assert again.counters.expanded == 0


@pytest.mark.parametrize("unit", [True, False])
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_new_end_is_free_of_conflicts(unit, data):
    p = data.draw(problems(unit=unit, window=4))
    planner = make_whca(p.graph, p.motion)
    first = planner(p)
    wider = replace(p, window_steps=20, carried=tuple(first.paths.values()))
    again = planner(wider)
    assert validate(wider, again) == []


def test_a_plan_is_given_up_for_a_new_goal_or_a_blocked_vertex():
    links = [(0, 1), (1, 2), (2, 3), (0, 4), (4, 5), (5, 3)]
    graph = make_graph(
        "two ways",
        [(str(v), x, y) for v, (x, y) in enumerate([(0, 0), (5, 0), (10, 0), (15, 0), (5, 5), (10, 5)])],
        [(f"{a}>{b}", str(a), str(b), 5.0) for u, v in links for a, b in ((u, v), (v, u))],
    )
    nobody = np.zeros(6, dtype=np.uint8)
    agent = PlanAgent(0, 0, -1, 0, 3, False)
    p = PlanningProblem(graph, classic(graph), (agent,), (), nobody, nobody, 8)
    planner = make_whca(graph, p.motion)
    way = planner(p).paths[0]
    assert way.vertices == (0, 1, 2, 3)
    kept = replace(p, carried=(way,))
    assert planner(kept).counters.expanded == 0
    assert planner(replace(kept, agents=(replace(agent, goal=4),))).paths[0].vertices == (0, 4)
    planner(p)
    assert planner(replace(kept, blocked=np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8))).paths[0].vertices == (
        0,
        4,
        5,
        3,
    )


# --- distances that are repaired --------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_repaired_distances_are_those_of_a_search_anew(data):
    p = data.draw(problems())
    n, space = len(p.graph.names), Space(p.graph, p.motion)
    goal = data.draw(st.integers(0, n - 1))
    kept = Distances(space)
    kept.prepare([goal])
    for _ in range(4):
        blocked = np.array(data.draw(st.lists(st.integers(0, 1), min_size=n, max_size=n)), dtype=np.uint8)
        kept.update(blocked)
        anew = Distances(space)
        anew.update(blocked)
        for vertex in range(n):
            for edge in (-1, *p.graph.in_edges(vertex)):
                for loaded in (False, True):
                    assert kept.distance(vertex, edge, goal, loaded) == anew.distance(vertex, edge, goal, loaded)


def test_a_parked_car_costs_a_repair_and_no_search():
    """On a lattice with a car at a corner only the two ways past it can change."""
    side = 12
    name = {(x, y): str(x + side * y) for x in range(side) for y in range(side)}
    links = [(u, (u[0] + dx, u[1] + dy)) for u in name for dx, dy in ((1, 0), (0, 1))]
    graph = make_graph(
        "lattice",
        [(name[v], 5.0 * v[0], 5.0 * v[1]) for v in name],
        [(f"{name[a]}>{name[b]}", name[a], name[b], 5.0) for u, v in links if v in name for a, b in ((u, v), (v, u))],
    )
    distances = Distances(Space(graph, classic(graph)))
    distances.prepare([0])
    whole = int(distances.counters[0])
    blocked = np.zeros(side * side, dtype=np.uint8)
    blocked[-1] = 1
    distances.update(blocked)
    assert int(distances.counters[0]) - whole < whole / 10
