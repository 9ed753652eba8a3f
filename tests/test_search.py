"""The parts of the single-agent search, each against a plain counterpart."""

import os
import sys
import time
from dataclasses import replace
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from brute_force import bodies, classic, garages, optimum, problems
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import NumbaError

from controller.conflicts import validate
from controller.kernel import forget_stale_code, kernel
from controller.planners.lns import Improvement
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import FOREVER, NEVER, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import make_graph


def edge_state_graph(graph, motion, loaded, goal_and_start, blocked):
    """Arcs from an edge to the next one, and from an edge that ends at the goal to "goal"."""
    goal = goal_and_start[0]
    g = nx.DiGraph()
    for e, w in enumerate(graph.head.tolist()):
        g.add_node(e)
        if w == goal:
            g.add_edge(e, "goal", weight=0)
        for out in range(graph.first_out[w], graph.first_out[w + 1]):
            turn = motion.turn(graph, e, out, loaded)
            if turn < NEVER and (not blocked[graph.head[out]] or graph.head[out] in goal_and_start):
                g.add_edge(e, out, weight=turn + int(motion.edge_steps[int(loaded), out]))
    return g


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_distances_equal_dijkstra_on_edges_in_any_order_of_questions(data):
    graph = data.draw(garages(12))
    motion = data.draw(st.sampled_from([classic(graph), bodies(graph)]))
    distances = Distances(Space(graph, motion))
    vertex = st.integers(0, len(graph.names) - 1)
    for _ in range(4):
        blocked = np.isin(np.arange(len(graph.names)), list(data.draw(st.sets(vertex, max_size=3)))).astype(np.uint8)
        distances.update(blocked)
        for goal in data.draw(st.lists(vertex, min_size=1, max_size=3)):
            loaded = data.draw(st.booleans())
            for e in data.draw(st.permutations(range(len(graph.tail))))[:4]:
                arcs = edge_state_graph(graph, motion, loaded, (goal,), blocked)
                try:
                    expected = nx.dijkstra_path_length(arcs, e, "goal")
                except (nx.NetworkXNoPath, nx.NodeNotFound):
                    expected = FOREVER
                if graph.head[e] == goal:
                    expected = 0
                v = int(graph.head[e])
                bounds = [distances.known(v, came, goal, loaded) for came in (e, -1)]
                assert bounds[0] <= expected
                assert distances.distance(v, e, goal, loaded) == expected
                assert bounds[1] <= distances.distance(v, -1, goal, loaded)
                assert bounds[0] <= distances.known(v, e, goal, loaded) <= expected
                check_way(distances.way(v, e, goal, loaded).tolist(), v, goal, expected, graph)


def test_a_lasting_field_gives_no_way_through_what_is_blocked_now():
    space = Space(CROSS, classic(CROSS))
    distances = Distances(space, whole=True)
    distances.prepare([2])
    into_0 = int(np.flatnonzero((CROSS.tail == 1) & (CROSS.head == 0))[0])
    assert distances.way(0, into_0, 2, False).tolist() == [[0, 0], [1, 1], [2, 2]]
    distances.update(np.isin(np.arange(5), [1]).astype(np.uint8))
    assert len(distances.way(0, into_0, 2, False)) == 0


def check_way(way, start, goal, steps, graph):
    """A way is empty if there is none; else it leads from start to goal over lanes in so many steps."""
    assert bool(way) == (steps < FOREVER)
    if way:
        lanes = set(zip(graph.tail.tolist(), graph.head.tolist(), strict=True))
        assert way[0] == [start, 0]
        assert way[-1] == [goal, steps]
        assert all((u, v) in lanes and s < t for (u, s), (v, t) in pairwise(way))


def test_a_first_move_needs_no_turn_and_unreachable_is_for_ever():
    corner = make_graph(
        "corner",
        [("0", 0.0, 0.0), ("1", 5.0, 0.0), ("2", 5.0, 5.0)],
        [("a", "0", "1", 5.0), ("b", "1", "2", 5.0)],
    )
    distances = Distances(Space(corner, bodies(corner)))
    assert distances.distance(1, -1, 2, False) == 1
    assert distances.distance(1, 0, 2, False) == 2
    assert distances.distance(2, -1, 0, False) == FOREVER
    assert distances.distance(2, -1, 2, False) == 0


def test_the_search_goes_only_as_far_as_asked():
    n = 40
    vertices = [(f"{x},{y}", 5.0 * x, 5.0 * y) for x in range(n) for y in range(n)]
    names = {v[0] for v in vertices}
    steps = ((1, 0), (-1, 0), (0, 1), (0, -1))
    links = [(f"{x},{y}", f"{x + i},{y + j}") for x in range(n) for y in range(n) for i, j in steps]
    grid = make_graph("grid", vertices, [(u + ">" + v, u, v, 5.0) for u, v in links if v in names])
    distances = Distances(Space(grid, classic(grid)))
    assert distances.distance(grid.index["20,20"], -1, grid.index["20,26"], False) == 6
    assert distances.counters[0] < 30
    before = distances.counters[0]
    assert distances.distance(grid.index["20,21"], -1, grid.index["20,26"], False) == 5
    assert distances.counters[0] - before < 30


class Steps:
    """A reservation table as a dict of single steps."""

    def __init__(self):
        self.owners = {}

    def add(self, vertex, start, end, agv):
        for t in range(start, min(end, 60)):
            self.owners.setdefault((vertex, t), agv)

    def remove(self, agv):
        self.owners = {key: who for key, who in self.owners.items() if who != agv}


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 5), st.integers(0, 2), st.integers(0, 30), st.integers(0, 30), st.booleans()),
        max_size=40,
    ),
    st.booleans(),
)
def test_reservations_equal_a_table_of_steps(actions, following):
    table, steps = ReservationTable(3, following, capacity=2), Steps()
    for agv, vertex, start, length, remove in actions:
        if remove:
            table.remove(agv)
            steps.remove(agv)
        elif start % 2:
            table.hold(vertex, start, start + length, agv)
            steps.add(vertex, start, start + length, agv)
        else:
            other = (vertex + 1) % 3
            path = Path(agv, (vertex, other), (0, start + 3), (start,), start + length + 3)
            table.add(path)
            steps.add(vertex, 0, start + 3, agv)
            steps.add(other, start + 3 if following else start, path.until, agv)
        for v in range(3):
            rows = list(table.intervals(v))
            assert all(a < b for a, b, _ in rows)
            assert all(first[1] <= second[0] for first, second in pairwise(rows))
            for t in range(60):
                assert table.owner(v, t) == steps.owners.get((v, t), -1)
    table.reset()
    assert not any(list(table.intervals(v)) for v in range(3))


@given(st.lists(st.tuples(st.permutations(range(4)), st.integers(0, 9), st.integers(1, 4)), max_size=12), st.booleans())
def test_paths_reserved_at_once_are_as_reserved_one_by_one(drawn, following):
    paths = []
    for agv, (vertices, start, steps) in enumerate(drawn):
        arrive = tuple(start + 2 * steps * k for k in range(len(vertices)))
        depart = tuple(t + steps for t in arrive[:-1])
        paths.append(Path(agv, tuple(vertices), arrive, depart, arrive[-1] + steps))
    one, all_ = (ReservationTable(4, following, capacity=2) for _ in range(2))
    all_.hold(0, 0, 5, 99)
    for path in paths:
        one.add(path)
    all_.reset(paths)
    assert [list(one.intervals(v)) for v in range(4)] == [list(all_.intervals(v)) for v in range(4)]
    for path in paths[::2]:
        one.remove(path.agv)
        all_.remove(path.agv)
    assert [list(one.intervals(v)) for v in range(4)] == [list(all_.intervals(v)) for v in range(4)]


def search(problem, agent, fixed=()):
    distances = Distances(Space(problem.graph, problem.motion))
    finder = PathSearch(distances)
    finder.begin(problem)
    table = ReservationTable(len(problem.graph.names), problem.motion.following)
    table.reset(fixed)
    return finder, table


@st.composite
def crossings(draw):
    """A problem of one agent among others that wander about, free of conflicts with each other."""
    p = draw(problems(largest=7, agents=3, window=FOREVER))
    finder, table = search(p, p.agents[0])
    table.hold(p.agents[0].vertex, 0, FOREVER if draw(st.booleans()) else draw(st.integers(1, 9)), p.agents[0].agv)
    fixed = []
    for other in p.agents[1:]:
        path = finder.find_path(p, other, table)
        if path is not None:
            path = replace(path, until=draw(st.sampled_from([FOREVER, path.arrive[-1] + 2])))
            table.add(path)
            fixed.append(path)
    return replace(p, agents=p.agents[:1], fixed=tuple(fixed))


def intervals(table):
    return [list(table.intervals(v)) for v in range(len(table.reserved.counts))]


@settings(max_examples=200, deadline=None)
@given(crossings(), st.integers(0, 5))
def test_quickest_path_among_others_and_with_slack_little_later(p, slack):
    agent = p.agents[0]
    finder, table = search(p, agent, p.fixed)
    finder.slack = slack
    path = finder.find_path(p, agent, table)
    best = optimum(p)
    if path is None:
        assert best is None
    else:
        assert validate(p, PlanResult(Status.SOLVED, {agent.agv: path})) == []
        assert best <= path.arrive[-1] <= best + slack


@settings(max_examples=100, deadline=None)
@given(crossings(), st.sampled_from([5, 20, FOREVER]), st.sampled_from([1, 8]))
def test_a_path_reserved_where_it_is_found_is_the_one_that_is_found(p, window, capacity):
    agent = p.agents[0]
    p = replace(p, window_steps=window)
    finder, table = search(p, agent, p.fixed)
    other = ReservationTable(len(p.graph.names), p.motion.following, capacity)
    other.reset(p.fixed)
    path = finder.find_path(p, agent, table)
    assert finder.reserve_path(p, agent, other) == (-1 if path is None else path.arrive[-1])
    if path is not None:
        table.add(path)
        assert other.path(agent.agv) == path
    assert intervals(other) == intervals(table)


@settings(max_examples=100, deadline=None)
@given(crossings(), st.sets(st.integers(1, 2)), st.booleans())
def test_paths_taken_out_of_a_table_and_put_back_leave_it_as_it_was(p, taken, in_turn):
    table, rest = search(p, p.agents[0], p.fixed)[1], search(p, p.agents[0])[1]
    before = intervals(table)
    words = table.take(sorted(taken))
    for path in p.fixed:
        if path.agv not in taken:
            rest.add(path)
    assert intervals(table) == intervals(rest)
    if in_turn:
        table.put(words, len(taken))
    else:
        for agv in taken & {path.agv for path in p.fixed}:
            table.hold(0, 0, 3, agv)
        table.put_back(words, len(taken))
    assert intervals(table) == before
    assert [table.path(path.agv) for path in p.fixed] == list(p.fixed)
    stay = [path for path in p.fixed if path.until == FOREVER]
    assert sorted(table.rests(but=1)) == sorted(path.vertices[-1] for path in stay if path.agv != 1)


@settings(max_examples=100, deadline=None)
@given(crossings(), st.integers(0, 12))
def test_a_path_that_arrives_in_time_is_found_though_later_ones_are_not_looked_for(p, sooner):
    agent = p.agents[0]
    finder, table = search(p, agent, p.fixed)
    arrival = finder.reserve_path(p, agent, table)
    table.remove(agent.agv)
    again = finder.reserve_path(p, agent, table, latest=arrival - sooner)
    assert again == arrival or (sooner and again < 0)


@settings(max_examples=50, deadline=None)
@given(problems(largest=8, agents=1, window=FOREVER))
def test_distances_prepared_are_those_found_when_asked_for(p):
    masks = p.blocked, np.zeros_like(p.blocked), p.blocked
    prepared, lazy = (Distances(Space(p.graph, p.motion)) for _ in range(2))
    prepared.update(p.blocked)
    prepared.prepare(range(len(p.graph.names)))
    for blocked in masks:
        prepared.update(blocked)
        lazy.update(blocked)
        for goal in range(len(p.graph.names)):
            for edge, head in enumerate(p.graph.head.tolist()):
                assert prepared.distance(head, edge, goal, True) == lazy.distance(head, edge, goal, True)


@settings(max_examples=100, deadline=None)
@given(crossings(), st.integers(0, 20))
def test_paths_in_a_window_are_valid_and_end_with_it(p, window):
    agent = p.agents[0]
    p = replace(p, window_steps=window)
    finder, table = search(p, agent, p.fixed)
    path = finder.find_path(p, agent, table)
    if path is not None:
        assert validate(p, PlanResult(Status.SOLVED, {agent.agv: path})) == []
        assert all(step < max(window, 1) for step in path.depart)


CROSS = make_graph(
    "cross",
    [("0", 0.0, 0.0), ("1", 5.0, 0.0), ("2", 10.0, 0.0), ("a", 5.0, 5.0), ("b", 5.0, -5.0)],
    [(f"{x}>{y}", x, y, 5.0) for u, v in ("01", "12", "1a", "1b") for x, y in ((u, v), (v, u))],
)


def crossing(no_rest=(), window=FOREVER):
    masks = [np.isin(np.arange(5), vs).astype(np.uint8) for vs in ((), list(no_rest))]
    agent = PlanAgent(1, 1, -1, 0, 1, False)
    return PlanningProblem(CROSS, classic(CROSS), (agent,), (), *masks, window)


@pytest.mark.parametrize(("late", "tried"), [(2, 1), (3, 0)])
def test_who_has_turned_before_setting_out_has_not_waited_less_for_it(late, tried):
    motion = bodies(CROSS)
    back = int(np.flatnonzero((CROSS.tail == 1) & (CROSS.head == 0))[0])
    agent = PlanAgent(1, 0, back, 0, 2, False)
    waits_at_1 = Path(1, (0, 1, 2), (0, 1, 5), (0, 4))
    p = replace(crossing(), motion=motion, agents=(), fixed=(waits_at_1,), carrying=(agent,))
    finder, table = search(p, agent, p.fixed)
    improvement = Improvement(p, {1: agent}, table, finder, {})
    improvement.run(8, late)
    assert improvement.tried == tried


@pytest.mark.parametrize("window", [10, FOREVER])
def test_refuge_is_the_nearest_vertex_in_nobodys_way(window):
    through = Path(2, (0, 1, 2), (0, 3, 4), (2, 3))
    ends = []
    for no_rest in ((), (3,), (3, 4)):
        p = crossing(no_rest, window)
        finder, table = search(p, p.agents[0], [through])
        path = finder.find_refuge(p, p.agents[0], table)
        assert path is not None
        ends.append((path.vertices[-1], path.arrive[-1]))
    assert ends == [(3, 1), (4, 1), (1, 4)]  # with no place to rest it steps aside and comes back behind the other


def test_no_refuge_names_who_is_in_the_way():
    p = crossing()
    finder, table = search(p, p.agents[0], [Path(2, (0, 1), (0, 3), (2,)), Path(3, (2,), (0,), ())])
    table.hold(3, 0, FOREVER, 4)
    table.hold(4, 0, FOREVER, 4)
    assert finder.find_refuge(p, p.agents[0], table) is None
    assert finder.blocker == 2


def test_forbidden_arrivals_and_limits():
    p = crossing()
    agent = replace(p.agents[0], goal=2)
    finder, table = search(p, agent)
    edge = CROSS.edge_index[1, 2]
    path = finder.find_path(p, agent, table, forbidden={(edge, 1), (edge, 2), (edge, 4)})
    assert path is not None
    assert path.arrive == (0, 3)
    assert finder.find_path(p, replace(agent, vertex=0), table, max_expansions=1) is None
    assert finder.limited


def test_the_memory_grows_when_a_search_needs_it():
    p = crossing()
    agent = replace(p.agents[0], goal=2)
    finder, table = search(p, agent)
    for k in range(2000):
        table.hold(2, 2 * k, 2 * k + 1, 7)
    path = finder.find_path(p, agent, table)
    assert path is not None
    assert path.arrive[-1] == 3999


def test_searches_leave_the_references_to_their_tables_as_they_were():
    p = crossing()
    agent = replace(p.agents[0], goal=2)
    finder, table = search(p, agent)
    field = finder.distances.field(agent.goal, agent.loaded, agent.vertex)
    arrays = [*table.reserved, *field, *finder.distances.space.lanes]
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(1000):
        assert finder.find_path(p, agent, table) is not None
        assert finder.reserve_path(p, agent, table) >= 0
        table.put(table.take((agent.agv,)), 1)
        table.remove(agent.agv)
    assert [sys.getrefcount(array) for array in arrays] == before


def test_a_kernel_can_not_make_an_array():
    @kernel
    def make(n):
        return np.zeros(n)[0]

    with pytest.raises(NumbaError):
        make(3)


def test_machine_code_is_forgotten_when_a_source_changes_that_it_is_made_of(tmp_path):
    folder = tmp_path / "search"
    folder.mkdir()
    texts = {
        "sipp": "import numba\nfrom search.heap import put\n",
        "heap": "from search import costs\n",
        "report": "",
        "costs": "",
    }
    code = folder / "__pycache__" / "sipp.find-3.py311.nbi"
    code.parent.mkdir()
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text)

    def kept_after(name, text):
        file = folder / f"{name}.py"
        file.write_text(text)
        os.utime(file, ns=(time.time_ns(), time.time_ns()))
        code.write_text("")
        forget_stale_code(tmp_path, ["search"])
        return code.exists()

    assert not kept_after("report", "")  # seen for the first time
    assert kept_after("report", "x = 1")
    assert not kept_after("costs", "x = 1")
    assert kept_after("costs", "x = 1")
    assert not kept_after("sipp", "import numba\n")
    assert kept_after("heap", "x = 2")
