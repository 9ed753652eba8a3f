"""Routes of the binary tree against a slow search, and the kinematics against closed forms."""

import math
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from brute_force import garages
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.routing.binary_tree import compile_tree, find_route, find_routes
from controller.routing.kinematics import ForkAgv, check_turns, drive, icr_distance_m, rates
from controller.routing.shortest import shortest_route
from sumo_nets.floors import ForkFloor, one_way_lattice
from sumo_nets.graph import FOLD_DEG, make_graph

DEG = math.pi / 180


def ways_on(graph, edge):
    """Edges that may follow an edge: no reversal, no fold."""
    v = int(graph.head[edge])
    return [
        f
        for f in range(int(graph.first_out[v]), int(graph.first_out[v + 1]))
        if f != graph.reverse[edge] and graph.bend_deg(edge, f) <= FOLD_DEG
    ]


def shortest(graph, start, goal):
    """Metres of the shortest way without reversals and folds, over a graph of edges; None if there is none."""
    lines = nx.DiGraph()
    lines.add_nodes_from(["start", "goal"])
    for e in range(len(graph.tail)):
        if graph.tail[e] == start:
            lines.add_edge("start", e, m=graph.length_m[e])
        if graph.head[e] == goal:
            lines.add_edge(e, "goal", m=0.0)
        for f in ways_on(graph, e):
            lines.add_edge(e, f, m=graph.length_m[f])
    if start == goal:
        return 0.0
    return nx.dijkstra_path_length(lines, "start", "goal", weight="m") if nx.has_path(lines, "start", "goal") else None


def recursive(graph, start, goal, left_first):
    """The paper's search as it is told, by recursion over edges; edges with the same ways on share a mark."""

    def left_to_right(ways, heading):
        return sorted(ways, key=lambda f: (-round(180 - (heading - graph.heading_deg[f] + 180) % 360, 6), f))

    def visit(v, ways):
        if v == goal:
            return [v]
        for k in range(len(ways)) if left_first else range(len(ways) - 1, -1, -1):
            f = ways[k]
            # a node stands for its ways on or the rest of them: what was seen is known by both
            w, nexts = int(graph.head[f]), tuple(left_to_right(ways_on(graph, f), graph.heading_deg[f]))
            if (w, nexts) not in marks:
                marks.add((w, nexts))
                rest = visit(w, nexts)
                if rest:
                    return [v, *rest]
        return []

    ways = tuple(left_to_right(range(int(graph.first_out[start]), int(graph.first_out[start + 1])), 90.0))
    marks = {(start, ways)}
    return tuple(visit(start, ways))


@settings(max_examples=150, deadline=None)
@given(garages(12), st.data())
def test_a_route_is_found_whenever_there_is_one_and_is_never_too_short(graph, data):
    n = len(graph.names)
    start, goal = data.draw(st.integers(0, n - 1)), data.draw(st.integers(0, n - 1))
    route, best = find_route(compile_tree(graph), start, goal), shortest(graph, start, goal)
    exact = shortest_route(graph, start, goal)
    assert (route is None) == (best is None) == (exact is None)
    if route is not None and exact is not None:
        assert exact.length_m == pytest.approx(best)
        assert route.length_m >= best - 1e-9
        assert (route.vertices[0], route.vertices[-1]) == (start, goal)
        edges = [graph.edge_index[pair] for pair in pairwise(route.vertices)]
        assert route.length_m == pytest.approx(sum(graph.length_m[e] for e in edges))
        assert all(f in ways_on(graph, e) for e, f in pairwise(edges))


@pytest.mark.parametrize("left_first", [True, False])
def test_both_searches_are_the_papers_where_no_vertex_has_more_than_two_ways(left_first):
    graph = one_way_lattice(6, 4)
    tree = compile_tree(graph)
    for start in range(24):
        for goal in range(24):
            routes = find_routes(tree, start, goal)
            route = routes[0 if left_first else 1]
            assert route is not None
            assert route.vertices == recursive(graph, start, goal, left_first)


def test_loading_nodes_are_entered_only_to_stay_and_one_way_nodes_are_single():
    graph = make_graph(
        "loop with two loading nodes",
        [(str(v), x, y) for v, (x, y) in enumerate([(0, 0), (5, 0), (5, 5), (0, 5), (5, -3), (8, 5)])],
        [(f"{a}>{b}", a, b, 5.0) for a, b in ("01", "12", "23", "30", "14", "41", "25", "52")],
    )
    tree = compile_tree(graph)
    entering = tree.start[: len(graph.tail)][graph.edge_index[1, 4]]
    assert tree.child[entering].tolist().count(-1) == 1  # one that starts there may leave
    assert np.count_nonzero(tree.vertex == 0) == 1
    route = find_route(tree, 4, 5)
    assert route is not None
    assert route.vertices == (4, 1, 2, 5)


def test_a_blocked_vertex_is_no_way_but_may_be_the_goal():
    graph = one_way_lattice(4, 4)
    tree = compile_tree(graph)
    free = find_route(tree, 0, 6)
    assert free is not None
    mask = np.zeros(16, dtype=np.uint8)
    mask[free.vertices[1]] = 1
    around = find_route(tree, 0, 6, blocked=mask)
    assert around is None or free.vertices[1] not in around.vertices
    assert find_route(tree, 0, free.vertices[1], blocked=mask) is not None


@settings(deadline=None)
@given(st.floats(5, 85), st.floats(0.3, 2.0), st.floats(0.5, 3.0))
def test_a_constant_steering_angle_drives_a_circle(steer_deg, v_d, l):  # noqa: E741
    d, steps, dt = steer_deg * DEG, 200, 0.02
    poses = drive(l, (0.0, 0.0, 0.0), np.full(steps, v_d), np.full(steps, d), dt)
    radius, omega = l / math.tan(d), v_d * math.sin(d) / l
    assert np.hypot(poses[:, 0], poses[:, 1] - radius) == pytest.approx(np.full(steps + 1, radius), rel=1e-6)
    assert poses[-1, 2] == pytest.approx(omega * steps * dt)
    # the drive wheel is h from the same centre, and turns about it at v_d
    assert icr_distance_m(l, d) == pytest.approx(math.hypot(radius, l))
    assert omega == pytest.approx(v_d / icr_distance_m(l, d))


def test_straight_on_and_turning_in_place():
    assert rates(1.4, 90 * DEG, 1.5, 0.0) == pytest.approx((0.0, 1.5, 0.0), abs=1e-12)
    assert icr_distance_m(1.4, 0.0) == math.inf
    assert rates(1.4, 0.0, 1.0, 90 * DEG) == pytest.approx((0.0, 0.0, 1 / 1.4), abs=1e-12)
    assert ForkAgv(steer_deg=90.0).least_radius_m == 0.0
    assert ForkAgv(l=1.0, steer_deg=45.0).least_radius_m == pytest.approx(1.0)


@settings(deadline=None)
@given(st.floats(0.6, 5.0), st.floats(20, 120))
def test_the_swept_ring_holds_every_corner_of_the_body(radius, bend_deg):
    agv = ForkAgv(front_m=1.7, rear_m=1.2, width_m=1.0)
    inner, outer = agv.swept_radii_m(radius)
    corners = [math.hypot(radius + side, along) for side in (-0.5, 0.5) for along in (-1.2, 0.0, 1.7)]
    assert inner == pytest.approx(min(corners))
    assert outer == pytest.approx(max(corners))
    assert agv.swept_width_m(radius) == pytest.approx(outer - inner)
    width = agv.aisle_width_m(radius, bend_deg)
    half_deg = bend_deg / 2 * DEG
    assert radius + width / 2 >= outer - 1e-9  # outer walls
    assert (radius - width / 2) / math.cos(half_deg) <= inner + 1e-9  # the corner between the aisles


def test_turns_of_a_corner():
    graph = make_graph(
        "corner", [("a", 0, 0), ("b", 4, 0), ("c", 4, 4)], [("ab", "a", "b", 4.0), ("bc", "b", "c", 4.0)]
    )
    (turn,) = check_turns(graph, ForkAgv(), 4.0)
    assert (turn.vertices, turn.bend_deg) == ((0, 1, 2), pytest.approx(90.0))
    assert turn.radius_m == pytest.approx(4.0)
    assert turn.drivable
    assert not any(t.drivable for t in check_turns(graph, ForkAgv(), 1.5))
    assert not any(t.drivable for t in check_turns(graph, ForkAgv(l=6.0, steer_deg=45.0, front_m=6.5), 40.0))


def test_the_fork_floor_is_the_papers_in_size_and_numbers_and_has_one_choice():
    graph = ForkFloor().graph()
    assert graph.xy.min() >= 0
    assert (graph.xy.max(axis=0) <= (70, 36)).all()
    assert len(graph.names) == 216
    assert len(graph.slots) == 147
    assert np.diff(graph.first_out).max() == 2  # a binary tree without further nodes
    tree, rng = compile_tree(graph), np.random.default_rng(0)
    for start, goal in rng.integers(0, 216, (100, 2)).tolist():
        route, best = find_route(tree, start, goal), shortest_route(graph, start, goal)
        assert route is not None
        assert best is not None
        assert route.length_m == pytest.approx(best.length_m)
