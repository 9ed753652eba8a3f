"""A* and D* Lite of the thesis: the search behind them, their moves, and the thesis's figures on its first map."""

import heapq
from collections import deque
from dataclasses import replace

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from brute_force import classic
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.bound import least_steps
from analysis.tick_conflicts import meetings
from controller.conflicts import find_conflicts
from controller.fleet import Agv, StuckBoost, priority
from controller.planners.astar import AStar, make_astar
from controller.planners.dstar_lite import DStarLite, make_dstar_lite
from controller.planners.one_step import STAY
from controller.search.space import Space
from controller.types import FOREVER, AgvMode, AgvNumber, PlanAgent, PlanningProblem
from parking_sim.config import load_scenario
from parking_sim.reproduce.thesis_runs import FAIR, PLANNERS, THESIS, Case, run_case
from parking_sim.rulesets import RULE_SETS
from parking_sim.simulation import simulate
from sumo_nets.graph import make_graph
from sumo_nets.read import read_net

SIDE = 5


def grid(width, height, slots=(), home="0,0"):
    cells = [(x, y) for y in range(height) for x in range(width)]
    links = [
        (f"{x},{y}", f"{x + dx},{y + dy}")
        for x, y in cells
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
        if 0 <= x + dx < width and 0 <= y + dy < height
    ]
    return make_graph(
        "grid",
        [(f"{x},{y}", 5.0 * x, -5.0 * y) for x, y in cells],
        [(f"{a}>{b}", a, b, 5.0) for a, b in links],
        {"slot": slots, "home": (home,), "bay": (home,)},
    )


GRID = grid(SIDE, SIDE)
SPACE = Space(GRID, classic(GRID))
vertices = st.integers(0, SIDE * SIDE - 1)


def true_cost(closed, start, goal):
    g = nx.DiGraph(GRID.to_networkx())
    g.remove_edges_from([(u, v) for u, v in list(g.edges) if v in closed])
    return nx.shortest_path_length(g, start, goal) if nx.has_path(g, start, goal) else FOREVER


@settings(max_examples=80, deadline=None)
@given(
    start=vertices,
    goals=st.lists(vertices, min_size=1, max_size=2),
    changes=st.lists(st.tuples(st.sets(vertices, max_size=8), st.sets(vertices, max_size=4)), min_size=1, max_size=8),
)
def test_dstar_lite_costs_what_a_fresh_search_costs_after_every_change(start, goals, changes):
    kept = DStarLite(SPACE)
    for goal in goals:
        for blocked, announced in changes:
            if start == goal:
                break
            mask = np.isin(np.arange(SIDE * SIDE), list(blocked)).astype(np.uint8)
            agent = PlanAgent(0, start, -1, 0, goal, False)
            edge, cost = kept.announced_edge(agent, mask, np.array(sorted(announced), dtype=np.int32))
            fresh = AStar(SPACE).next_edge(agent, mask, announced)
            closed = (blocked - {goal}) | announced
            assert cost == true_cost(closed, start, goal)
            assert (edge == STAY) == (fresh == STAY)
            for one in {edge, fresh} - {STAY}:  # of two shortest paths they need not take the same one
                assert GRID.head[one] not in closed
                assert true_cost(closed, int(GRID.head[one]), goal) == cost - 1
            if edge != STAY:
                start = int(GRID.head[edge])


@settings(max_examples=60, deadline=None)
@given(data=st.data(), make=st.sampled_from([make_astar, make_dstar_lite]))
def test_moves_of_one_call_are_free_of_conflicts(data, make):
    starts = data.draw(st.lists(vertices, min_size=2, max_size=8, unique=True))
    goals = data.draw(st.lists(vertices, min_size=len(starts), max_size=len(starts)))
    pairs = enumerate(zip(starts, goals, strict=True))
    agents = tuple(PlanAgent(i, s, -1, 0, g, False, priority=i % 3) for i, (s, g) in pairs)
    none = np.zeros(SIDE * SIDE, dtype=np.uint8)
    result = make(GRID, SPACE.motion)(PlanningProblem(GRID, SPACE.motion, agents, (), none, none, 1))
    paths = [replace(path, until=2) for path in result.paths.values()]
    assert sorted(result.paths) == list(range(len(agents)))
    assert find_conflicts(paths, SPACE.motion) == []


def run(planner, rules, agvs=1, cars=None, seed=None):
    return run_case(Case("map1", agvs, planner, rules, cars=cars, seed=seed))


class Shortest:
    """Counts vertices with f = g + h not above the length of the shortest path; g by breadth-first search."""

    def __init__(self, graph):
        self.before = [[] for _ in graph.names]
        for u, v in graph.ends:
            self.before[v].append(u)
        pitch = np.diff(np.unique(graph.xy[:, 0].round(3))).min()
        self.cell = [tuple(c) for c in np.rint(graph.xy / pitch).astype(int).tolist()]

    def count(self, start, goal, closed):
        g, queue = {goal: 0}, deque([goal])
        while queue:
            v = queue.popleft()
            for u in self.before[v] if v != start else ():
                if u not in g and (u == start or u not in closed):
                    g[u] = g[v] + 1
                    queue.append(u)
        x, y = self.cell[start]
        return sum(g[v] + abs(self.cell[v][0] - x) + abs(self.cell[v][1] - y) <= g[start] for v in g)


def test_the_first_row_of_the_thesis_exactly_and_dstar_lite_expands_fewer(monkeypatch):
    """A* expands every node that a queue may take in any order before the start, so that no order explains 176,450."""
    counts = []
    search, shortest = AStar.next_edge, Shortest(read_net("map1_thesis").graph)

    def count(self, agent, blocked, obstacles):
        closed = ({int(v) for v in np.flatnonzero(blocked)} - {agent.goal}) | set(obstacles)
        counts.append(shortest.count(agent.vertex, agent.goal, closed))
        return search(self, agent, blocked, obstacles)

    monkeypatch.setattr(AStar, "next_edge", count)
    a, d = (run(planner, THESIS) for planner in ("astar", "dstar_lite"))
    assert (len(counts), sum(counts)) == (6946, 154_001)
    assert sum(counts) - len(counts) == a["nodes_expanded"] == 147_055
    for row in (a, d):
        assert (row["status"], row["steps"], row["movement_cost"]) == ("finished", 8490, 6260)
        assert row["conflicts"] == 0
        assert 0 < row["bound_share"] <= 1
    assert d["nodes_expanded"] * 5 < a["nodes_expanded"]


@pytest.mark.parametrize("planner", PLANNERS)
def test_park_and_fetch_by_name_under_fair_rules_without_a_conflict(planner):
    row = run(planner, FAIR, agvs=4, cars=30, seed=1)
    assert (row["completion"], row["conflicts"]) == (1.0, 0)
    assert row["bound_share"] <= 1


def test_priority_is_that_of_the_formula():
    agv = Agv(AgvNumber(3), home=0, goal=1, mode=AgvMode.RETURNING_WITH_CAR)
    assert [priority(agv, stuck, StuckBoost()) for stuck in (0, 1, 4, 5, 9)] == [297, 307, 337, 1297, 1297]
    assert [priority(agv, stuck, StuckBoost(7, 2, 50)) for stuck in (0, 1, 2, 3)] == [297, 304, 347, 347]


def test_each_key_of_the_boost_changes_the_record():
    def record(control):
        keys = {"agvs": 4, "plant": "discrete", "planner": "astar", "control": control}
        keys["workload"] = {"kind": "park_exit", "cars": 20}
        m = simulate(load_scenario("map1_thesis", keys), None).metrics
        return m["steps"], m["movement_cost"]

    others = [record(control) for control in ({"boost_step": 40}, {"boost_after": 2}, {"boost_max": 0})]
    assert record({"boost_step": 10, "boost_after": 5, "boost_max": 1000}) == record({})
    assert record({}) not in others


@pytest.mark.parametrize("planner", ["astar", "dstar_lite"])
def test_they_work_in_sumo(planner):
    workload = {"kind": "park_exit", "cars": 3}
    m = simulate(load_scenario("map1_thesis", {"agvs": 2, "planner": planner, "workload": workload}), None).metrics
    assert (m["tasks_done"], m["sumo_collisions"], m["footprint_overlaps"]) == (6, 0, 0)


def test_meetings_are_seen_from_positions_alone():
    where = {0: [0, 1, 2, 2], 1: [3, 2, 1, 1], 2: [5, 5, 5, 2]}
    rows = [(float(t), agv, float(x), 0.0) for agv, xs in where.items() for t, x in enumerate(xs)]
    found = meetings(pd.DataFrame(rows, columns=["time_s", "agv", "x_m", "y_m"]))
    assert [(m.kind, m.time_s, m.agvs) for m in found] == [("swap", 2.0, (0, 1)), ("vertex", 3.0, (0, 2))]


# --- the bound --------------------------------------------------------------------------------------------------------

TICKS = replace(RULE_SETS[FAIR], lift=2, lower=3)


def quickest(graph, slots, park_only):
    """Least ticks for one AGV, which takes tasks at home, to park a car in each slot and fetch them; tries all."""
    motion, rules = TICKS.motion(graph, ""), TICKS.rules()
    (home,) = graph.homes
    start = (home, -1, "", frozenset(), 0)  # vertex, edge it came by, what it carries, slots with a car, cars fetched
    best, heap = {start: 0}, [(0, 0, start)]
    count = 1
    while heap:
        t, _, state = heapq.heappop(heap)
        v, came, load, full, fetched = state
        if t > best[state]:
            continue
        if (len(full) == len(slots) and not load) if park_only else fetched == len(slots):
            return t
        steps = []
        for e in range(int(graph.first_out[v]), int(graph.first_out[v + 1])):
            w = int(graph.head[e])
            if w not in full or load in ("", "fetching"):
                steps.append((1 + motion.turn(graph, came, e, load in ("in", "out")), (w, e, load, full, fetched)))
        if v == home and not load and len(full) + fetched < len(slots) and not fetched:
            steps.append((rules.lift_bay, (v, came, "in", full, fetched)))
        if v in slots and load == "in" and v not in full:
            steps.append((rules.lower_slot, (v, came, "", full | {v}, fetched)))
        if v == home and not load and len(full) + fetched == len(slots):
            steps.append((0, (v, came, "fetching", full, fetched)))
        if v in full and load == "fetching":
            steps.append((rules.lift_slot, (v, came, "out", full - {v}, fetched)))
        if v == home and load == "out":
            steps.append((rules.lower_bay, (v, came, "", full, fetched + 1)))
        for cost, after in steps:
            if t + cost < best.get(after, FOREVER):
                best[after] = t + cost
                count += 1
                heapq.heappush(heap, (t + cost, count, after))
    raise AssertionError("no way")


@pytest.mark.parametrize("park_only", [True, False])
@pytest.mark.parametrize("slots", [("2,0",), ("2,0", "0,2"), ("2,2", "1,2", "2,0")])
def test_nobody_beats_the_bound(slots, park_only):
    graph = grid(3, 3, slots)
    motion, rules = TICKS.motion(graph, ""), TICKS.rules()
    bound = least_steps(graph, motion, rules, graph.homes, len(slots), park_only)
    least = quickest(graph, set(graph.slots), park_only)
    assert 0.5 * least < bound <= least
