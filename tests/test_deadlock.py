"""Deadlock on graphs drawn by hand: what counts as one, which stage ends it, and what is left alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations, pairwise
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from brute_force import garages
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.metrics import run_metrics
from analysis.record import Recorder
from analysis.tables import recorded_run
from controller.costs import Costs
from controller.deadlock.cut_off import CutOff, find_cut_off
from controller.deadlock.ladder import LadderLimits
from controller.deadlock.waits import WaitGraph, rings, wait_graph
from controller.events import KINDS, Event
from controller.executor import Executor
from controller.fleet import Agv
from controller.planners.cbs import PARTIAL, CbsLimits
from controller.planners.lacam import LacamOptions
from controller.planners.whca import make_whca
from controller.planning import ControlOptions, Planning
from controller.types import Action, AgvMode, Path, PlanningProblem, PlanResult, Status
from parking_sim.plants.discrete import DiscretePlant
from parking_sim.rulesets import RULE_SETS
from sumo_nets.graph import Graph, make_graph

LIMITS = LadderLimits(patience_steps=3, stuck_steps=12, cbs=PARTIAL)
TICKS = RULE_SETS["fair"]


def drawn(picture: str) -> Graph:
    """A graph from a picture: letters are places, ``-`` and ``|`` two-way lanes, ``> < v ^`` one-way ones."""
    rows = picture.strip("\n").splitlines()
    at = {(x, y): c for y, row in enumerate(rows) for x, c in enumerate(row)}
    places = {spot: c for spot, c in at.items() if c.isupper()}
    links = []
    for (x, y), c in at.items():
        ends = ((x - 1, y), (x + 1, y)) if c in "-<>" else ((x, y - 1), (x, y + 1)) if c in "|v^" else ()
        if ends:
            u, v = (places[end] for end in ends)
            links += [(u, v)] if c in "->|v" else []
            links += [(v, u)] if c in "-<|^" else []
    vertices = [(name, 2.5 * x, -2.5 * y) for (x, y), name in sorted(places.items(), key=lambda item: item[1])]
    return make_graph("drawn", vertices, [(f"{u}>{v}", u, v, 5.0) for u, v in links])


RING = drawn("""
A>B
^ v
D<C
""")
ROUNDABOUT = drawn("""
  E
  |
A>B-F
^ v
D<C
""")
CORRIDOR = drawn("A-B-C-D-E")
SIDING = drawn("""
A-B-C-D-E
    |
    S
""")
DEEP_SIDING = drawn("""
A-B-C-D-E
    |
    S
    |
    T
""")
SQUARE = drawn("""
A-B
| |
D-C
""")


def nobody_moves(problem: PlanningProblem) -> PlanResult:
    """A planner that leaves all work to deadlock handling."""
    return PlanResult(Status.PARTIAL, {}, {agent.agv: -1 for agent in problem.agents})


class Yard:
    """AGVs with goals under the controller's planning in discrete ticks; ``AC`` is one at A that has to go to C."""

    def __init__(
        self, graph: Graph, ways: str, limits: LadderLimits = LIMITS, planner: Any = nobody_moves, **options: Any
    ) -> None:
        self.graph = graph
        self.ends = [(graph.index[way[0]], graph.index[way[-1]]) for way in ways.split()]
        starts = [start for start, _ in self.ends]
        motion = TICKS.motion(graph, "whca")
        self.executor = Executor(graph, motion, starts)
        self.agvs = [
            Agv(i, start, goal, AgvMode.IDLE if start == goal else AgvMode.GOING_TO_PARK)
            for i, (start, goal) in enumerate(self.ends)
        ]
        self.nobody = np.zeros(len(graph.names), dtype=np.uint8)
        self.costs = Costs(graph, motion, self.nobody)
        self.events: list[tuple[int, Event]] = []
        self.resolved: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
        self.step = 0
        control = ControlOptions(period_steps=1, ladder=limits, **options)
        self.planning = Planning(
            planner, control, self.agvs, self.executor, TICKS.rules(), self.costs, self.log, perf_counter
        )
        self.plant = DiscretePlant(graph, motion, starts, 10**6)

    def log(self, event: Event) -> None:
        detail: Mapping[str, Any] = event.detail
        self.events.append((self.step, event))
        if event.kind == "deadlock_resolved" and detail["stage"] != "replanned":
            state = (detail["members"], tuple(self.plant.at))
            assert state not in self.resolved, "what was resolved has been undone"
            self.resolved.append(state)

    def waits(self) -> WaitGraph:
        return wait_graph(self.executor, self.agvs, self.costs)

    def tick(self) -> None:
        self.executor.update(self.plant.states(), self.step)
        self.planning.step(self.step, self.nobody, lambda: self.nobody)
        for command in self.executor.grants(self.step):
            self.plant.execute(command)
        before = list(self.plant.at)
        self.plant.step()
        for i, j in combinations(range(len(before)), 2):
            assert self.plant.at[i] != self.plant.at[j]
            assert (before[i], self.plant.at[i]) != (self.plant.at[j], before[j])
        self.step += 1

    def run(self, limit: int = 300) -> bool:
        """To the end; False when time is up first."""
        while self.step < limit:
            self.tick()
            if self.plant.at == [goal for _, goal in self.ends] and not self.planning.resolving:
                return True
        return False

    def of_kind(self, kind: str) -> list[Mapping[str, Any]]:
        return [event.detail for _, event in self.events if event.kind == kind]

    @property
    def stages(self) -> list[str]:
        return [detail["stage"] for detail in self.of_kind("deadlock_resolved")]


# --- who waits for whom -----------------------------------------------------------------------------------------------


def test_a_ring_of_waits_is_one_deadlock():
    yard = Yard(RING, "AB BC CD DA")
    assert yard.waits().edges == {0: 1, 1: 2, 2: 3, 3: 0}
    assert yard.waits().rings == ((0, 1, 2, 3),)
    assert yard.waits().blocked_by_idle == ()


def test_three_in_a_ring_with_a_gap_are_none():
    waits = Yard(RING, "AB BC CD").waits()
    assert waits.edges == {0: 1, 1: 2}
    assert (waits.rings, waits.blocked_by_idle) == ((), ())


@pytest.mark.parametrize("doing", ["driving", "lifting"])
def test_a_chain_behind_one_that_has_something_to_do_is_none(doing):
    yard = Yard(CORRIDOR, "AE BE CE" if doing == "driving" else "AE BE CC")
    last = yard.executor.agvs[2]
    if doing == "driving":
        last.standing = False
    else:
        yard.executor.act(2, Action.LIFT, 10, 0)
        yard.agvs[2].action = Action.LIFT
    waits = yard.waits()
    assert waits.edges == {0: 1, 1: 2}
    assert (waits.rings, waits.blocked_by_idle) == ((), ())


def test_a_chain_that_ends_at_an_idle_agv_is_one():
    waits = Yard(CORRIDOR, "AE BE CC EA").waits()
    assert waits.edges == {0: 1, 1: 2, 3: 2}, "the free place next to the last one does not hide what is behind it"
    assert waits.rings == ()
    assert waits.blocked_by_idle == ((2, 0, 1, 3),)
    assert waits.vertices == {0: CORRIDOR.index["B"], 1: CORRIDOR.index["C"], 3: CORRIDOR.index["C"]}


def test_an_idle_agv_that_one_can_drive_round_is_none():
    waits = Yard(SQUARE, "AC BB").waits()
    assert (waits.edges, waits.blocked_by_idle) == ({}, ())


def test_one_that_is_driven_back_by_another_one_is_in_a_ring_with_it():
    """The AGV at C drives on towards E, the one at D gives way to it though it has to go to A."""
    yard = Yard(CORRIDOR, "BE DA")
    b, c, d, e = (yard.graph.index[name] for name in "BCDE")
    assert yard.executor.accept({0: Path(0, (b, c, d), (0, 1, 2), (0, 1)), 1: Path(1, (d, e), (0, 1), (0,))}) is None
    assert yard.waits().edges == {0: 1, 1: 0}
    assert yard.waits().rings == ((0, 1),)


def test_one_that_gets_out_of_the_way_in_time_is_in_no_ring():
    yard = Yard(SIDING, "BE DA")
    b, c, d, s = (yard.graph.index[name] for name in "BCDS")
    plan = {0: Path(0, (b, c, d), (0, 3, 4), (2, 3)), 1: Path(1, (d, c, s), (0, 1, 2), (0, 1))}
    assert yard.executor.accept(plan) is None
    assert yard.waits().rings == ()


def test_a_head_on_pair_is_a_ring_of_two_and_one_behind_is_no_member():
    waits = Yard(CORRIDOR, "AE BE CA").waits()
    assert waits.edges == {0: 1, 1: 2, 2: 1}
    assert waits.rings == ((1, 2),)


def test_who_is_promised_a_free_place_first_is_waited_for():
    """Nobody stands on C, but the AGV at D goes there first."""
    yard = Yard(CORRIDOR, "BC DD")
    motion = yard.executor.motion
    assert motion.following
    b, c, d = (yard.graph.index[name] for name in "BCD")
    paths = {1: Path(1, (d, c, d), (0, 2, 3), (1, 2)), 0: Path(0, (b, c), (0, 6), (5,))}
    assert yard.executor.accept(paths) is None
    assert yard.waits().edges == {0: 1}
    assert yard.waits().rings == ()


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(st.integers(0, 7), st.integers(0, 7)).map(lambda d: {u: v for u, v in d.items() if u != v}))
def test_rings_are_those_who_come_back_to_themselves(edges: Mapping[int, int]):
    found = set()
    for start in edges:
        path, v = [start], edges[start]
        while v in edges and v not in path:
            path.append(v)
            v = edges[v]
        if v == start:
            found.add(tuple(sorted(path)))
    assert set(rings(edges)) == found


# --- the ladder -------------------------------------------------------------------------------------------------------

NO_CBS = replace(LIMITS, group=1)
HASTY_CBS = replace(LIMITS, cbs=CbsLimits(expansions=0, ranges=True))

SOLVABLE = {
    "ring": (ROUNDABOUT, "AE BC CD DA", LIMITS, "ring", "partial_cbs"),
    "ring without CBS": (ROUNDABOUT, "AE BC CD DA", NO_CBS, "ring", "pull_over"),
    "head-on": (SIDING, "BE CA", LIMITS, "ring", "partial_cbs"),
    "head-on, CBS out of time": (SIDING, "BE CA", HASTY_CBS, "ring", "pull_over"),
    "a way round": (SQUARE, "AC BD", NO_CBS, "ring", "leader"),
    "idle AGV": (SIDING, "BE CC", LIMITS, "idle", "partial_cbs"),
    "idle AGV without CBS": (SIDING, "BE CC", NO_CBS, "idle", "pull_over"),
    "one behind": (SIDING, "AD BE CA", LIMITS, "ring", "pull_over"),
    "left alone": (CORRIDOR, "AE", LIMITS, "stuck", "leader"),
}


@pytest.mark.parametrize("name", SOLVABLE)
def test_what_can_be_solved_is_solved_by_the_stage_that_can(name):
    graph, ways, limits, cause, stage = SOLVABLE[name]
    yard = Yard(graph, ways, limits)
    assert yard.run()
    first = yard.of_kind("deadlock_found")[0]
    assert first["cause"] == cause
    assert yard.stages[0] == stage
    found = [detail["deadlock"] for detail in yard.of_kind("deadlock_found")]
    assert sorted(detail["deadlock"] for detail in yard.of_kind("deadlock_resolved")) == found
    climbed = [d["stage"] for d in yard.of_kind("stage_failed") if d["deadlock"] == 0]
    ladder = ["partial_cbs", "leader", "pull_over"]
    expected = ladder[: ladder.index(stage)]
    assert climbed == [s for s in expected if s != "partial_cbs" or (limits.group > 1 and len(ways.split()) > 1)]


@pytest.mark.parametrize("limits", [LIMITS, NO_CBS], ids=["CBS", "pull-over"])
def test_who_is_in_the_way_of_any_solution_joins(limits):
    """The pocket is taken by an idle AGV: it goes deeper, one of the pair gets in, and all get where they want."""
    yard = Yard(DEEP_SIDING, "BE CA SS", limits)
    assert yard.run()
    assert yard.of_kind("deadlock_found")[0]["members"] == (0, 1)
    failed = [d["stage"] for d in yard.of_kind("stage_failed")]
    assert failed[-2:] == ["leader", "pull_over"] or failed[:2] == ["leader", "pull_over"]
    assert yard.executor.moves[2] >= 2


def test_three_in_a_dead_end_are_sorted_like_a_sliding_puzzle():
    """Whoever leads has to give way first: one leader after the other is not enough."""
    yard = Yard(DEEP_SIDING, "DD BS TB", NO_CBS)
    assert yard.run(60)
    assert "lacam" in yard.stages
    alone = Yard(DEEP_SIDING, "DD BS TB", replace(NO_CBS, lacam=LacamOptions(proposals=0)))
    assert not alone.run(60)


@pytest.mark.parametrize("planner", [nobody_moves, None], ids=["nobody moves", "whca"])
def test_without_any_pocket_a_deadlock_stays_open_and_is_counted(planner):
    graph = CORRIDOR
    motion = TICKS.motion(graph, "whca")
    yard = Yard(graph, "BE CA", LIMITS, planner or make_whca(graph, motion))
    assert not yard.run(200)
    assert yard.planning.resolving
    assert len(yard.of_kind("deadlock_found")) == 1
    assert yard.stages == []
    assert {d["stage"] for d in yard.of_kind("stage_failed")} == {
        "partial_cbs",
        "leader",
        "pull_over",
        "widen",
        "lacam",
    }
    numbers = metrics(yard)
    assert (numbers["deadlocks_found"], numbers["deadlocks_unresolved"]) == (1, 1)
    assert numbers["deadlocks_resolved"] == 0


@pytest.mark.parametrize("patience", [3, 7])
def test_the_ladder_is_climbed_again_when_its_patience_is_over(patience):
    """Four times after as long, then each time after twice as long; a hope that is gone would end the climbing."""
    yard = Yard(CORRIDOR, "BE CA", replace(LIMITS, patience_steps=patience))
    climbs: list[int] = []
    yard.planning._ladder._stages = lambda *_: (climbs.append(yard.step), (None, set()))[1]
    yard.planning._ladder._together = lambda *_: (None, False)
    assert not yard.run(40 * patience)
    assert len(climbs) > 5
    gaps = [later - earlier for earlier, later in pairwise(climbs)]
    assert gaps[:6] == [patience * times for times in (1, 1, 1, 1, 2, 4)][: len(gaps)]


def metrics(yard: Yard) -> Mapping[str, float | int]:
    recorder = Recorder()
    recorder.floor(yard.graph)
    for step, event in yard.events:
        recorder.event(float(step), event.kind, event.agv, **event.detail)
    return run_metrics(recorded_run(recorder, {"simulated_s": float(yard.step), "tasks_wanted": 0, "step_s": 1.0}))


def test_a_deadlock_that_dissolves_by_itself_is_over():
    """Nothing was done, the members were just let go on: that is a resolution by replanning."""
    planner = make_whca(SIDING, TICKS.motion(SIDING, "whca"))

    def late(problem: PlanningProblem) -> PlanResult:
        return nobody_moves(problem) if yard.step < 12 else planner(problem)

    yard = Yard(SIDING, "BE CA", replace(LIMITS, group=1, widen=0), late)
    yard.planning._ladder._stages = lambda *_: (None, set())
    yard.planning._ladder._together = lambda *_: (None, False)
    assert yard.run()
    assert yard.stages == ["replanned"]


def test_what_a_fault_cuts_off_is_no_deadlock():
    """AGV 1 is cut off by the broken AGV 0, AGV 2 barred by AGV 1, AGV 3 free; without the fault nobody is."""
    yard = Yard(DEEP_SIDING, "DD BE AB TS")
    assert find_cut_off(yard.executor, yard.agvs, yard.costs, yard.nobody) == CutOff()
    yard.agvs[0].immobile = True
    blocked = yard.nobody.copy()
    blocked[yard.graph.index["D"]] = 1
    found = find_cut_off(yard.executor, yard.agvs, yard.costs, blocked)
    assert (found.by_fault, found.barred) == ({1}, {2})
    assert yard.waits().edges == {2: 1}, "an AGV that cannot move waits for no AGV"


def test_a_closed_place_cuts_off_who_has_to_go_there_or_through_it():
    """No AGV is broken: B is closed, AGV 0 has to go to it, AGV 1 through it, and neither of the others."""
    yard = Yard(CORRIDOR, "AB CA DD EE")
    yard.executor.close(frozenset({yard.graph.index["B"]}))
    blocked = yard.nobody.copy()
    blocked[yard.graph.index["B"]] = 1
    found = find_cut_off(yard.executor, yard.agvs, yard.costs, blocked)
    assert (found.by_fault, found.barred) == ({0, 1}, frozenset())


def test_room_is_made_behind_a_broken_agv_and_no_deadlock_counted():
    yard = Yard(DEEP_SIDING, "DD BE AS")
    yard.agvs[0].immobile = True
    yard.nobody = yard.nobody.copy()  # parked cars stay as they were
    yard.nobody[yard.graph.index["D"]] = 1
    yard.run(100)
    kinds = [event.kind for _, event in yard.events]
    assert "obstruction_found" in kinds
    assert "obstruction_resolved" in kinds
    assert not {"deadlock_found", "deadlock_resolved", "stage_failed"} & {*kinds}
    assert yard.plant.at[2] == yard.graph.index["S"]


def test_events_say_what_the_record_explains():
    seen = set()
    for graph, ways, limits, _, _ in [*SOLVABLE.values(), (CORRIDOR, "BE CA", LIMITS, "", "")]:
        yard = Yard(graph, ways, limits)
        yard.run(100)
        for _, event in yard.events:
            assert KINDS[event.kind].fits(event.detail), event
            seen.add(event.kind)
    assert seen == {"deadlock_found", "deadlock_resolved", "stage_failed", "plan_partial"}


@settings(max_examples=15, deadline=None)
@given(garages(8), st.data())
def test_whatever_the_garage_nobody_meets_and_no_resolution_is_without_progress(graph, data):
    """Random places with all work left to the ladder; the yard checks each tick and each resolution."""
    n = len(graph.names)
    starts = data.draw(st.permutations(range(n)))[: data.draw(st.integers(2, min(5, n)))]
    goals = data.draw(st.permutations(range(n)))[: len(starts)]
    limits = data.draw(st.sampled_from([LIMITS, NO_CBS, HASTY_CBS]))
    renamed = make_graph(
        "letters",
        [(chr(65 + v), *graph.xy[v]) for v in range(n)],
        [(f"{u}>{v}", chr(65 + u), chr(65 + v), 5.0) for u, v in zip(graph.tail.tolist(), graph.head.tolist(),
                                                                     strict=True)],
    )  # fmt: skip
    yard = Yard(renamed, " ".join(chr(65 + s) + chr(65 + g) for s, g in zip(starts, goals, strict=True)), limits)
    arrived = yard.run(80)
    found, closed = yard.of_kind("deadlock_found"), yard.of_kind("deadlock_resolved")
    assert {d["deadlock"] for d in closed} <= {d["deadlock"] for d in found}
    if arrived:
        assert len(found) == len(closed)
    for earlier, later in pairwise(found):
        assert earlier["deadlock"] < later["deadlock"]
