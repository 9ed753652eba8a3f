"""The executor: whatever a plan says and however late everybody is, no two AGVs meet, and all of them arrive."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from brute_force import bodies, classic, problems, simulate
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from late_plant import Drive, delays, walks

from controller.executor import Executor
from controller.planners.astar import make_astar
from controller.planners.cbs import CbsLimits, cbs
from controller.planners.dstar_lite import make_dstar_lite
from controller.planners.token import make_token
from controller.planners.whca import make_whca
from controller.retiming import retime
from controller.types import FOREVER, AgvState, Path, PlanAgent, PlanningProblem
from controller.visits import Refusal
from sumo_nets.graph import Graph, make_graph

PLANNERS = {
    "whca": lambda problem: make_whca(problem.graph, problem.motion)(problem),
    "token": lambda problem: make_token(problem.graph, problem.motion)(replace(problem, fixed=stays(problem))),
    "cbs": lambda problem: cbs(problem, CbsLimits(expansions=100)),
}


def lanes(places: dict[str, tuple[float, float]], ways: str) -> Graph:
    """A graph of named places; ``ab`` is a lane from a to b, ``a-b`` one for both directions."""
    links = [(way[0], way[-1]) for way in ways.split()]
    links += [(way[-1], way[0]) for way in ways.split() if "-" in way]
    vertices = [(name, 5.0 * x, 5.0 * y) for name, (x, y) in places.items()]
    return make_graph("drawn", vertices, [(f"{u}>{v}", u, v, 5.0) for u, v in links])


RING = lanes({"a": (0, 0), "b": (1, 0), "c": (1, 1), "d": (0, 1)}, "ab bc cd da")
LINE = lanes({"a": (0, 0), "b": (1, 0), "c": (2, 0), "d": (3, 0)}, "a-b b-c c-d")
CROSS = lanes({"n": (1, 2), "w": (0, 1), "x": (1, 1), "e": (2, 1), "s": (1, 0)}, "n-x w-x e-x s-x")


def stays(problem: PlanningProblem) -> tuple[Path, ...]:
    """Token passing is told what each AGV carries out so far: to keep its place."""
    return tuple(Path(agent.agv, (agent.vertex,), (0,), ()) for agent in problem.agents)


def way(graph: Graph, agv: int, names: str, start: int = 0) -> Path:
    """A path over named places, a step a move, setting off at step ``start``."""
    steps = range(start, start + len(names) - 1)
    vertices = tuple(graph.index[name] for name in names)
    return Path(agv, vertices, (0, *(t + 1 for t in steps)), tuple(steps))


def orders(executor: Executor) -> tuple[object, ...]:
    return deepcopy((executor.order, [a.pending for a in executor.agvs], executor.owner))


# --- any delay only delays ------------------------------------------------------------------------------------------


@settings(max_examples=250, deadline=None)
@given(walks(), delays)
def test_a_plan_is_refused_when_agvs_meet_in_it_and_is_carried_out_otherwise_however_late(plan, late):
    """Whether they meet is looked for step by step; what is accepted is driven to its end under any delays."""
    drive = Drive.of(plan.graph, plan.motion, plan.starts)
    end = max(path.arrive[-1] for path in plan.paths.values()) + 2
    meetings = simulate(list(plan.paths.values()), plan.motion, end)
    refusal = drive.executor.accept(plan.paths)
    assert bool(refusal) == bool(meetings)
    if refusal:
        assert any(set(refusal.agents) <= members for _, members in meetings)
    else:
        drive.run(late)
        assert drive.ends == [path.vertices[-1] for path in plan.paths.values()]
        assert drive.plant.visits == planned_visits(plan.paths)


def planned_visits(paths: Mapping[int, Path]) -> dict[int, list[int]]:
    """Who comes to each vertex, in order of the planned arrivals."""
    rows = [(t, v, agv) for agv, path in paths.items() for v, t in zip(path.vertices, path.arrive, strict=True) if t]
    return {v: [agv for _, w, agv in sorted(rows) if w == v] for _, v, _ in rows}


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(PLANNERS)), problems(largest=9, agents=4, window=FOREVER), delays)
def test_plans_of_all_planners_are_carried_out_however_late(name, problem, late):
    result = PLANNERS[name](problem)
    assume(result.paths)
    drive = start(problem)
    assert drive.executor.accept(result.paths) is None
    drive.run(late)
    ends = {agent.agv: agent.vertex for agent in problem.agents}
    ends |= {agv: path.vertices[-1] for agv, path in result.paths.items()}
    assert drive.ends == [ends[agv] for agv in range(len(ends))]


@settings(max_examples=40, deadline=None)
@given(problems(largest=9, agents=4), delays, st.integers(1, 8))
def test_plans_replaced_halfway_are_as_safe(problem, late, every):
    """A new plan every few steps, from where authority ends: the plant checks that nobody meets."""
    planner = make_whca(problem.graph, problem.motion)
    drive = start(problem)
    for first in range(0, 40, every):
        agents = tuple(
            replace(agent, vertex=a.last, in_edge=a.in_edge, ready_step=drive.executor.ready_step(agent.agv, first))
            for agent, a in zip(problem.agents, drive.executor.agvs, strict=True)
        )
        assert drive.executor.accept(planner(replace(problem, agents=agents)).paths) is None
        for digits in late[first : first + every]:
            drive.once(() if problem.motion.following else [i for i in range(4) if digits >> i & 1])


def start(problem: PlanningProblem) -> Drive:
    drive = Drive.of(problem.graph, problem.motion, [agent.vertex for agent in problem.agents])
    for agent, a in zip(problem.agents, drive.executor.agvs, strict=True):
        a.in_edge, a.loaded = agent.in_edge, agent.loaded
    return drive


def test_the_order_at_a_place_outlasts_a_delay():
    """The first one is busy for 30 steps; the second one, planned behind it, still waits for it."""
    drive = Drive.of(CROSS, bodies(CROSS), [CROSS.index["n"], CROSS.index["w"]])
    first, second = way(CROSS, 0, "nxs"), way(CROSS, 1, "wxe", 4)
    assert drive.executor.accept({0: first, 1: second}) is None
    for _ in range(30):
        drive.once(busy=[0])
    assert drive.ends[1] == CROSS.index["w"]
    drive.run([])
    assert drive.ends == [CROSS.index["s"], CROSS.index["e"]]


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("graph", "starts", "paths", "kind", "reason"),
    [
        (CROSS, "nw", {0: "nxs", 1: "wxe"}, "conflict", "AGVs 0 and 1 both plan to be on x"),
        (LINE, "ab", {0: "ab", 1: "ba"}, "swap", "AGVs 0 and 1 would have to change places"),
        (LINE, "ad", {0: "abcd", 1: "dcba"}, "swap", "AGVs 0 and 1 would have to change places"),
        (LINE, "da", {0: "dcba", 1: "abcd"}, "swap", "AGVs 0 and 1 would have to change places"),
        (LINE, "ac", {0: "abc", 1: "cba"}, "conflict", "AGVs 0 and 1 both plan to be on b"),
        (RING, "ab", {0: "abc"}, "conflict", ""),
        (RING, "a", {0: "ac"}, "edge", "no lane from a to c"),
        (RING, "a", {0: "ad"}, "edge", "no lane from a to d"),
        (RING, "a", {0: "bc"}, "start", "does not start where the authority ends"),
    ],
    ids=[
        "crossing",
        "swap",
        "meeting between",
        "meeting between, from the other side",
        "meeting at",
        "rest in the way",
        "jump",
        "one-way",
        "start",
    ],
)
def test_what_cannot_be_driven_is_refused_with_the_reason(graph, starts, paths, kind, reason):
    drive = Drive.of(graph, classic(graph), [graph.index[name] for name in starts])
    plan = {agv: way(graph, agv, names) for agv, names in paths.items()}
    if kind == "conflict" and not reason:  # the one in the way has a path: to stay
        plan[1] = Path(1, (graph.index["b"],), (0,), ())
        reason = "AGVs 1 and 0 both plan to be on b at step 1"
    before = orders(drive.executor)
    refusal = drive.executor.accept(plan)
    assert isinstance(refusal, Refusal)
    assert refusal.kind == kind
    assert reason in refusal.reason
    assert orders(drive.executor) == before
    drive.run([])
    assert drive.ends == [graph.index[name] for name in starts]


@pytest.mark.parametrize("late", [(), (2,)], ids=["in time", "one late"])
def test_a_full_ring_moves_on_as_one_when_all_are_ready(late):
    drive = Drive.of(RING, classic(RING), [RING.index[name] for name in "abcd"])
    plan = {n: way(RING, n, names) for n, names in enumerate(("abc", "bcd", "cda", "dab"))}
    assert drive.executor.accept(plan) is None
    timed = retime(drive.executor, 0)
    assert {n: (p.arrive, p.depart) for n, p in timed.items()} == dict.fromkeys(range(4), ((0, 1, 2), (0, 1)))
    for _ in range(5 if late else 0):
        drive.once(busy=late)
        assert drive.ends == [RING.index[name] for name in "abcd"], "nobody moves while one of them is not ready"
    drive.run([])
    assert drive.ends == [RING.index[name] for name in "cdab"]


def test_bodies_never_move_on_in_a_ring():
    plan = {n: way(RING, n, names) for n, names in enumerate(("ab", "bc", "cd", "da"))}
    refusal = Executor(RING, bodies(RING), [RING.index[name] for name in "abcd"]).accept(plan)
    assert isinstance(refusal, Refusal)


def test_bodies_that_need_both_places_cannot_follow_at_once():
    plan = {0: way(LINE, 0, "bc"), 1: way(LINE, 1, "ab")}
    starts = [LINE.index["b"], LINE.index["a"]]
    assert Executor(LINE, classic(LINE), starts).accept(plan) is None
    refusal = Executor(LINE, bodies(LINE), starts).accept(plan)
    assert refusal
    assert refusal.kind == "conflict"


@pytest.mark.parametrize(
    "path",
    [
        Path(0, (), (), ()),
        Path(0, (0, 1), (0,), (0,)),
        Path(0, (0, 1), (0, 1), ()),
        Path(0, (0, 1, 2), (0, 2, 1), (1, 0)),
        Path(0, (0, 1), (0, -1), (-2,)),
        Path(0, (0, 1), (0, 3), (3,)),
        Path(1, (0, 1), (0, 1), (0,)),
    ],
    ids=["no vertices", "few arrivals", "few departures", "back in time", "before now", "no time", "another's"],
)
def test_a_path_without_sense_is_refused(path):
    drive = Drive.of(RING, classic(RING), [0, 2])
    before = orders(drive.executor)
    refusal = drive.executor.accept({0: path})
    assert refusal
    assert refusal.agents == (0,)
    assert orders(drive.executor) == before


@pytest.mark.parametrize("agv", [-1, 7])
def test_a_path_for_an_agv_that_is_not_there_is_refused(agv):
    executor = Executor(RING, classic(RING), [0])
    refusal = executor.accept({agv: Path(agv, (0, 1), (0, 1), (0,))})
    assert refusal
    assert refusal.agents == (agv,)


@settings(max_examples=40, deadline=None)
@given(walks(), st.data())
def test_a_refused_plan_leaves_the_accepted_one_as_it_was(plan, data):
    """Somebody is to drive from its place to its place; the plan before is carried out all the same."""
    drive = Drive.of(plan.graph, plan.motion, plan.starts)
    assume(drive.executor.accept(plan.paths) is None)
    before = orders(drive.executor)
    agv = data.draw(st.sampled_from(sorted(plan.paths)))
    here = plan.starts[agv]
    refusal = drive.executor.accept({**plan.paths, agv: Path(agv, (here, here), (0, 1), (0,))})
    assert refusal
    assert (refusal.kind, refusal.agents) == ("edge", (agv,))
    assert orders(drive.executor) == before
    drive.run([])
    assert drive.ends == [path.vertices[-1] for path in plan.paths.values()]


# --- orders given a clock again ---------------------------------------------------------------------------------------


class Punctual:
    """AGVs that take exactly the tabulated steps: when each front arrives, with no plan and no orders."""

    def __init__(self, drive: Drive) -> None:
        self.drive, self.motion = drive, drive.plant.motion
        self.way = [[v] for v in drive.ends]
        self.front = [0] * len(self.way)
        self.due = [0] * len(self.way)
        self.arrivals: list[list[int]] = [[0] for _ in self.way]
        self.acting = [0] * len(self.way)

    def states(self, step: int) -> list[AgvState]:
        for i, way in enumerate(self.way):
            if self.front[i] < len(way) - 1 and self.due[i] == step:
                self.front[i] += 1
                self.arrivals[i].append(step)
                self._set_off(i, step)
        return [
            AgvState(i, front, front, front == len(way) - 1 and self.acting[i] <= step)
            for i, (way, front) in enumerate(zip(self.way, self.front, strict=True))
        ]

    def execute(self, command, step: int) -> None:
        i = command.agv
        if not hasattr(command, "vertices"):
            self.acting[i] = step + command.steps
            return
        standing = self.front[i] == len(self.way[i]) - 1
        self.way[i] += command.vertices
        if standing:
            self._set_off(i, step)

    def _set_off(self, i: int, step: int) -> None:
        if self.front[i] < len(self.way[i]) - 1:
            graph = self.drive.plant.graph
            u, v = self.way[i][self.front[i] : self.front[i] + 2]
            loaded = int(self.drive.executor.agvs[i].loaded)
            self.due[i] = step + int(self.motion.edge_steps[loaded, graph.edge_index[u, v]])


@settings(max_examples=150, deadline=None)
@given(problems(largest=9, agents=4, window=FOREVER))
def test_retimed_orders_say_when_everybody_arrives_if_nobody_is_late(problem):
    assume(not problem.motion.following or (problem.motion.edge_steps == 1).all())
    result = make_whca(problem.graph, problem.motion)(problem)
    drive = start(problem)
    ex = drive.executor
    assert ex.accept(result.paths) is None
    timed = retime(ex, 0)
    plant = Punctual(drive)
    for step in range(200):
        ex.update(plant.states(step), step)
        for command in ex.grants(step):
            plant.execute(command, step)
    for agv, path in timed.items():
        assert list(path.vertices) == plant.way[agv]
        assert list(path.arrive) == plant.arrivals[agv]


FORK = lanes({"r": (0, 0), "a": (1, 0.3), "b": (1, -0.3)}, "r-a r-b")


def test_a_turn_that_would_fold_the_body_is_refused():
    """From one slot straight into the one beside it; the whole plan is as before, and the way round is taken."""
    agv, b = FORK.index["a"], FORK.index["b"]
    executor = Executor(FORK, bodies(FORK), [agv])
    refusal = executor.accept({0: way(FORK, 0, "arb")})
    assert isinstance(refusal, Refusal)
    assert (refusal.kind, refusal.agents, refusal.vertex) == ("edge", (0,), b)
    assert refusal.reason == "no AGV can turn at r, as it comes, towards b"
    assert executor.grants(0) == []
    assert executor.accept({0: way(FORK, 0, "ar")}) is None


def test_a_fold_at_the_start_of_a_path_is_refused_by_the_edge_it_came_by():
    drive = Drive.of(FORK, bodies(FORK), [FORK.index["a"]])
    assert drive.executor.accept({0: way(FORK, 0, "ar")}) is None
    drive.run([])
    refusal = drive.executor.accept({0: way(FORK, 0, "rb")})
    assert isinstance(refusal, Refusal)
    assert refusal.kind == "edge"
    assert drive.executor.accept({0: way(FORK, 0, "ra")}) is None


def test_a_turn_in_place_does_not_open_the_fold():
    """Out of slot a, turned towards c, then planned into slot b instead: the body still lies on the lane out of a."""
    graph = lanes({"r": (0, 0), "a": (1, 0.3), "b": (1, -0.3), "c": (0, 1)}, "r-a r-b r-c")
    drive = Drive.of(graph, bodies(graph), [graph.index["a"]])
    assert drive.executor.accept({0: way(graph, 0, "arc")}) is None
    while drive.executor.agvs[0].turned_to != graph.index["c"]:
        drive.once()
    assert drive.executor.agvs[0].last == graph.index["r"]
    refusal = drive.executor.accept({0: way(graph, 0, "rb")})
    assert isinstance(refusal, Refusal)
    assert refusal.kind == "edge"
    assert drive.executor.accept({0: way(graph, 0, "rcrb")}) is None


@pytest.mark.parametrize("make", [make_astar, make_dstar_lite])
def test_planners_blind_to_turns_do_not_plan_a_fold(make):
    into = FORK.edge_index[FORK.index["a"], FORK.index["r"]]
    free = np.zeros(3, dtype=np.uint8)
    agent = PlanAgent(0, FORK.index["r"], into, 0, FORK.index["b"], False)
    motion = bodies(FORK)
    result = make(FORK, motion)(PlanningProblem(FORK, motion, (agent,), (), free, free, 20))
    assert Executor(FORK, motion, [agent.vertex]).accept(result.paths) is None
    assert result.paths[0].vertices != (FORK.index["r"], FORK.index["b"])


def test_an_agv_that_takes_no_orders_is_expected_to_go_on_so_for_as_long_as_stops_took_so_far():
    executor = Executor(LINE, classic(LINE), [LINE.index["a"], LINE.index["d"]])
    expected = []
    for step in range(20):
        able = [not (2 <= step < 8 or step >= 15), not 3 <= step < 5]
        executor.update([AgvState(n, 0, 0, True, able=able[n]) for n in range(2)], step)
        expected.append([executor.ready_step(n, step) for n in range(2)])
    assert [e for e, _ in expected] == [0] * 5 + [2] * 3 + [0] * 7 + [4] * 5  # nothing known, then 2, then (2 + 6) / 2
    assert {e for _, e in expected} == {0}


def test_when_an_agv_will_have_left_each_vertex_is_the_sum_of_its_moves():
    """Three moves of 1, 2 and 3 steps, a step more each with a car, from the grant, then from the last report."""
    names = "abcd"
    vertices = [(name, float(x), 0.0) for name, x in zip(names, (0, 5, 15, 30), strict=True)]
    graph = make_graph(
        "long", vertices, [(u + v, u, v, m) for u, v, m in (("a", "b", 5), ("b", "c", 10), ("c", "d", 15))]
    )
    for loaded, (first, second, third) in ((False, (1, 2, 3)), (True, (2, 3, 4))):
        executor = Executor(graph, bodies(graph), [graph.index["a"]])
        executor.agvs[0].loaded = loaded
        assert executor.leave_steps(0, 7) == [0]
        assert executor.accept({0: way(graph, 0, names)}) is None
        executor.grants(7)
        assert executor.leave_steps(0, 7) == [first, first + second, first + second + third, first + second + third]
        executor.update([AgvState(0, reached=1, left=0, standing=False)], 9)  # the rear is still on a
        assert executor.leave_steps(0, 9) == [1, second, second + third, second + third]
        executor.update([AgvState(0, reached=1, left=1, standing=False)], 10)
        assert executor.leave_steps(0, 10) == [max(second - 1, 1), second + third - 1, second + third - 1]
        executor.update([AgvState(0, reached=3, left=3, standing=True)], 20)
        assert executor.leave_steps(0, 25) == [0]


def test_a_grant_that_goes_on_with_a_drive_does_not_count_from_anew():
    """The clock starts when an AGV sets off; vertices granted on its way are reckoned from the last one reached."""
    executor = Executor(LINE, bodies(LINE), [LINE.index["a"]], lookahead=2)
    assert executor.accept({0: way(LINE, 0, "abcd")}) is None
    executor.grants(4)
    assert executor.leave_steps(0, 4) == [1, 2, 2]
    executor.update([AgvState(0, reached=1, left=0, standing=False)], 5)
    executor.grants(6)  # a step late: d is granted now
    assert executor.agvs[0].last == LINE.index["d"]
    assert executor.leave_steps(0, 6) == [1, 1, 1, 1]


@pytest.mark.parametrize("late", [0, 1])
def test_a_swap_is_found_by_the_side_of_others_that_follow_each_other(late):
    """AGVs 0 and 1 follow each other round a ring, which is no swap; 2 and 3 change places on a lane beside it."""
    places = {"a": (0, 0), "b": (1, 0), "c": (1, 1), "d": (0, 1), "p": (3, 0), "q": (4, 0)}
    graph = lanes(places, "ab bc cd da p-q")
    paths = {agv: way(graph, agv, names) for agv, names in enumerate(("abc", "dab", "pq", "qp"))}
    paths[3] = way(graph, 3, "qp", start=late)
    executor = Executor(graph, classic(graph), [graph.index[name] for name in "adpq"])
    refusal = executor.accept(paths)
    assert refusal is not None
    assert (refusal.kind, {*refusal.agents}) == (("conflict" if late else "swap"), {2, 3})
    assert executor.accept({agv: paths[agv] for agv in (0, 1)}) is None
