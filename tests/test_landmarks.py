"""Landmarks, and cuts by those who rest in the way, each against a plain counterpart."""

from dataclasses import replace

import networkx as nx
import numpy as np
from brute_force import bodies, classic, garages
from hypothesis import given, settings
from hypothesis import strategies as st
from test_search import edge_state_graph

from controller.planners.table import load_planner
from controller.search.cut import closed_around
from controller.search.distances import Distances
from controller.search.landmarks import at_least
from controller.search.space import Space
from controller.types import FOREVER, NEVER, Path, PlanAgent, PlanningProblem, Status, make_motion
from sumo_nets.movingai import grid_graph


def steps_between(graph, motion, start, in_edge, goal, loaded, blocked):
    """By Dijkstra's algorithm; the first move is without a turn if ``in_edge`` is -1."""
    arcs = edge_state_graph(graph, motion, loaded, (goal,), blocked)
    arcs.add_node("goal")
    best = 0 if start == goal else FOREVER
    for e in range(graph.first_out[start], graph.first_out[start + 1]):
        turn = 0 if in_edge < 0 else motion.turn(graph, in_edge, e, loaded)
        if turn < NEVER and (not blocked[graph.head[e]] or graph.head[e] == goal) and nx.has_path(arcs, e, "goal"):
            first = turn + int(motion.edge_steps[int(loaded), e])
            best = min(best, first + nx.dijkstra_path_length(arcs, e, "goal"))
    return best


def some(data, graph, most):
    vertices = st.integers(0, len(graph.names) - 1)
    return sorted(data.draw(st.sets(vertices, min_size=1, max_size=most)))


def mask(graph, vertices):
    return np.isin(np.arange(len(graph.names)), vertices).astype(np.uint8)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_from_a_landmark_a_way_is_read_as_long_as_nothing_else_is_asked(data):
    graph = data.draw(garages(10))
    homes = some(data, graph, 3)
    graph = replace(graph, roles={**graph.roles, "home": tuple(homes), "bay": (), "charger": ()})
    motion = data.draw(st.sampled_from([classic(graph), bodies(graph)]))
    distances = Distances(Space(graph, motion))
    for _ in range(3):
        blocked = mask(graph, some(data, graph, 3)) if data.draw(st.booleans()) else mask(graph, [])
        distances.update(blocked)
        for _ in range(4):
            start = data.draw(st.sampled_from(homes)) if data.draw(st.booleans()) else some(data, graph, 1)[0]
            into = [e for e, w in enumerate(graph.head.tolist()) if w == start]
            in_edge = data.draw(st.sampled_from([-1, *into]))
            goal, loaded = some(data, graph, 1)[0], data.draw(st.booleans())
            if blocked[start]:
                continue
            expected = steps_between(graph, motion, start, in_edge, goal, loaded, blocked)
            assert distances.distance(start, in_edge, goal, loaded) == expected


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_bounds_are_never_above_the_distance(data):
    graph = data.draw(garages(10))
    graph = replace(graph, roles={**graph.roles, "home": tuple(some(data, graph, 3)), "bay": (), "charger": ()})
    motion = data.draw(st.sampled_from([classic(graph), bodies(graph)]))
    distances = Distances(Space(graph, motion))
    for home in graph.roles["home"]:
        for goal in range(len(graph.names)):
            distances.distance(home, -1, goal, False)
            distances.distance(home, -1, goal, True)
    blocked = mask(graph, some(data, graph, 3))
    for goal in range(len(graph.names)):
        loaded = data.draw(st.booleans())
        bounds = distances.bounds(goal, loaded)
        arcs = edge_state_graph(graph, motion, loaded, (goal,), blocked)
        arcs.add_node("goal")
        for e in range(len(graph.head)):
            if nx.has_path(arcs, e, "goal"):
                assert at_least(e, bounds) <= nx.dijkstra_path_length(arcs, e, "goal")


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_whole_field_is_exact_on_the_open_floor_and_a_bound_once_cars_are_parked(data):
    graph = data.draw(garages(10))
    homes = some(data, graph, 2)
    graph = replace(graph, roles={**graph.roles, "home": tuple(homes), "bay": (), "charger": ()})
    motion = data.draw(st.sampled_from([classic(graph), bodies(graph)]))
    distances = Distances(Space(graph, motion), whole=True)
    home, loaded = data.draw(st.sampled_from(homes)), data.draw(st.booleans())
    start = data.draw(st.integers(0, len(graph.names) - 1))
    nothing = mask(graph, [])
    assert distances.distance(start, -1, home, loaded) == steps_between(graph, motion, start, -1, home, loaded, nothing)
    work = int(distances.counters[0])
    parked = mask(graph, [v for v in some(data, graph, 3) if v != start])
    distances.update(parked)
    assert distances.distance(start, -1, home, loaded) <= steps_between(graph, motion, start, -1, home, loaded, parked)
    assert distances.counters[0] == work


def test_on_a_corridor_a_bound_is_the_distance():
    graph = grid_graph("corridor", ["." * 9])
    graph = replace(graph, roles={**graph.roles, "home": (0,), "bay": (), "charger": ()})
    motion = make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)
    distances = Distances(Space(graph, motion))
    assert distances.distance(0, -1, 8, False) == 8
    bounds = distances.bounds(8, False)
    assert [at_least(graph.edge_index[v, v + 1], bounds) for v in range(8)] == [7, 6, 5, 4, 3, 2, 1, 0]


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_cut_is_there_if_and_only_if_there_is_no_way_and_holds_until_it_opens(data):
    graph = data.draw(garages(12))
    closed = mask(graph, some(data, graph, 5))
    start, goal = some(data, graph, 1)[0], some(data, graph, 1)[0]
    lanes = Space(graph, classic(graph)).lanes
    around = closed_around(start, goal, closed, lanes, np.zeros(4, dtype=np.int64)).tolist()
    open_places = nx.DiGraph()
    open_places.add_nodes_from([start, *(v for v in range(len(graph.names)) if not closed[v])])
    links = zip(graph.tail.tolist(), graph.head.tolist(), strict=True)
    open_places.add_edges_from((u, v) for u, v in links if not closed[v] and u in open_places)
    if start == goal:
        return
    way = goal in open_places and nx.has_path(open_places, start, goal)
    assert all(closed[v] for v in around)
    assert not (way and around)
    if around:
        everything = nx.DiGraph(zip(graph.tail.tolist(), graph.head.tolist(), strict=True))
        everything.add_nodes_from(range(len(graph.names)))
        everything.remove_nodes_from([v for v in around if v != start])
        assert goal not in everything or not nx.has_path(everything, start, goal)


def test_who_is_cut_off_is_searched_for_again_only_when_somebody_rests_elsewhere():
    graph = grid_graph("corridor", ["." * 9])
    motion = make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)
    planner = load_planner("token", graph, motion, {"improvements": 0})
    free = np.zeros(9, dtype=np.uint8)
    agent = PlanAgent(0, 0, -1, 0, 8, False)

    def plan(rest):
        fixed = (Path(0, (0,), (0,), ()), Path(1, (rest,), (0,), ()))
        return planner(PlanningProblem(graph, motion, (agent,), fixed, free, free, FOREVER))

    first, second, elsewhere = plan(4), plan(4), plan(5)
    assert [r.status for r in (first, second, elsewhere)] == [Status.PARTIAL] * 3
    assert [r.failed for r in (first, second, elsewhere)] == [{0: 1}] * 3
    assert [r.counters.expanded > 0 for r in (first, second, elsewhere)] == [True, False, True]
