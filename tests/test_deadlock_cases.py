"""Deadlocks drawn by hand: everybody is at the goal within so many ticks, by the rung that the drawing is made for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brute_force import problems
from hypothesis import given, settings
from hypothesis import strategies as st
from test_deadlock import CORRIDOR, DEEP_SIDING, LIMITS, NO_CBS, RING, SIDING, SQUARE, TICKS, Yard, drawn, nobody_moves

from controller.conflicts import find_conflicts
from controller.fleet import StuckBoost
from controller.planners.lacam import LacamOptions, make_lacam
from controller.planners.whca import make_whca
from controller.types import FOREVER, AgvMode, Path, PlanResult, Status

TWO_RINGS = drawn("""
A>B
^ v
D<C>F
  ^ v
  H<G
""")

FAR_POCKET = drawn("""
  T
  |
  S     K
  |     |
A-B-C-D-E-F
""")

#: Graph, ways, limits, first cause and members, rungs in their order, ticks at most; nobody moves but by the ladder.
BY_THE_LADDER = {
    "a full ring turns": (RING, "AB BC CD DA", LIMITS, "ring", (0, 1, 2, 3), ["partial_cbs"], 2),
    "a full ring turns twice": (RING, "AC BD CA DB", LIMITS, "ring", (0, 1, 2, 3), ["partial_cbs"], 4),
    "head-on with a pocket": (SIDING, "BE CA", LIMITS, "ring", (0, 1), ["partial_cbs", "leader"], 25),
    "a chain of three": (SIDING, "AD BE CC", LIMITS, "idle", (2, 0, 1), ["partial_cbs"], 5),
    "a chain of three, by pulling over": (SIDING, "AD BE CC", NO_CBS, "idle", (2, 0, 1), ["pull_over"], 5),
    "an idle AGV, its pocket behind the other one": (SIDING, "AE DD", LIMITS, "idle", (1, 0), ["lacam"], 8),
    "two rings that share an AGV": (
        TWO_RINGS, "BF CD DA AB FG GH HC", LIMITS, "ring", (0, 1, 2, 3), ["pull_over", "partial_cbs"], 6,
    ),
    "an idle AGV that has to go to the far end": (FAR_POCKET, "SS TT BB FA", LIMITS, "idle", (2, 3), ["lacam"], 13),
}  # fmt: skip

#: Graph, ways, ticks at most, and the rungs used, under the planner ``whca``.
UNDER_WHCA = {
    "a full ring turns": (RING, "AB BC CD DA", 1, []),
    "two rings that share an AGV": (TWO_RINGS, "BF CD DA AB FG GH HC", 3, []),
    "head-on, the pocket between them": (SIDING, "BE DA", 8, ["lacam"]),
    "a chain of three": (SIDING, "AD BE CC", 3, []),
    "an idle AGV, its pocket behind the other one": (SIDING, "AE DD", 10, ["lacam"]),
    "three meet, two of them from one side": (SIDING, "AE BD EA", 25, ["leader", "lacam"]),
    "three in a dead end": (DEEP_SIDING, "DD BS TB", 16, []),
}


@pytest.mark.parametrize("name", BY_THE_LADDER)
def test_the_ladder_alone(name):
    graph, ways, limits, cause, members, rungs, ticks = BY_THE_LADDER[name]
    yard = Yard(graph, ways, limits)
    assert yard.run(ticks), f"not at the goals after {ticks} ticks"
    first = yard.of_kind("deadlock_found")[0]
    assert (first["cause"], first["members"], first["since_s"]) == (cause, members, 0.0)
    assert yard.events[0][0] == 0, "found at once"
    assert yard.stages == rungs


@pytest.mark.parametrize("name", UNDER_WHCA)
def test_with_whca(name):
    graph, ways, ticks, rungs = UNDER_WHCA[name]
    yard = Yard(graph, ways, LIMITS, make_whca(graph, TICKS.motion(graph, "whca")))
    assert yard.run(ticks), f"not at the goals after {ticks} ticks"
    assert yard.stages == rungs
    assert all(d["cause"] != "stuck" for d in yard.of_kind("deadlock_found"))


def test_the_leader_drives_round_who_keeps_its_place():
    yard = Yard(SQUARE, "AC BD", NO_CBS)
    yard.tick()
    assert [d["stage"] for d in yard.of_kind("stage_failed")] == []
    assert yard.planning.resolving
    assert yard.run(40)
    assert yard.stages[0] == "leader"


def test_an_idle_agv_stands_aside_until_both_others_have_passed():
    """The idle one at C may not come back from S between the two that pass."""
    yard = Yard(SIDING, "AD BE CC", NO_CBS)
    passed, back = {}, None
    at_c = yard.graph.index["C"]
    while not yard.run(yard.step + 1):
        for n in (0, 1):
            if yard.plant.at[n] == at_c:
                passed[n] = yard.step
        if passed and yard.plant.at[2] == at_c:
            back = yard.step
        assert yard.step < 10
    assert back is None or back > max(passed.values())
    assert set(passed) == {0, 1}


def test_without_a_pocket_nothing_is_called_resolved():
    """An idle AGV at the end of a corridor can't let anybody pass; driving to and fro is no resolution."""
    yard = Yard(CORRIDOR, "AE DD", LIMITS, make_whca(CORRIDOR, TICKS.motion(CORRIDOR, "whca")))
    assert not yard.run(100)
    assert yard.stages == []
    assert yard.planning.resolving


def test_limits_may_change_during_a_run():
    yard = Yard(RING, "AB BC CD DA", replace(LIMITS, group=1), nobody_moves)
    yard.planning._ladder.limits = LIMITS
    assert yard.run(3)
    assert yard.stages == ["partial_cbs"]


def test_what_has_no_solution_is_said_to_have_none_and_is_not_tried_again_where_nothing_changes():
    yard = Yard(CORRIDOR, "BE CA")
    assert not yard.run(100)
    failed = [(d["stage"], d["reason"]) for d in yard.of_kind("stage_failed")]
    assert failed.count(("lacam", "no solution")) == 1
    assert failed[-1] == ("lacam", "no solution")
    assert yard.planning.resolving


def test_agvs_that_cannot_pass_each_other_on_their_way_home_exchange_homes():
    yard = Yard(CORRIDOR, "BE CA")
    for agv in yard.agvs:
        agv.mode, agv.home = AgvMode.RETURNING_HOME_EMPTY, agv.goal
    yard.ends = [(start, goal) for (start, _), (_, goal) in zip(yard.ends, reversed(yard.ends), strict=True)]
    assert yard.run(30)
    assert yard.stages == ["homes"]
    assert [d["homes"] for d in yard.of_kind("homes_exchanged")] == [{0: "A", 1: "E"}]
    assert [agv.home for agv in yard.agvs] == [goal for _, goal in yard.ends]


def test_an_agv_with_a_task_keeps_its_home():
    yard = Yard(CORRIDOR, "BE CA")
    yard.agvs[0].mode, yard.agvs[0].home = AgvMode.RETURNING_HOME_EMPTY, yard.agvs[0].goal
    assert not yard.run(60)
    assert yard.of_kind("homes_exchanged") == []


@settings(max_examples=40, deadline=None)
@given(problems(largest=6, agents=3, unit=True, window=FOREVER), st.data())
def test_lacam_brings_a_leader_to_its_goal_where_that_is_possible(problem, data):
    """And says so where it is not: looked for among all positions, one move into an empty place after the other."""
    free = np.zeros(len(problem.graph.names), dtype=np.uint8)
    all_bends = np.zeros_like(problem.motion.turn_steps)
    motion = replace(problem.motion, turn_steps=all_bends, rotation_steps=all_bends)
    problem = replace(problem, motion=motion, blocked=free, no_rest=free)
    leader = data.draw(st.sampled_from(range(len(problem.agents))))
    start, goal = tuple(agent.vertex for agent in problem.agents), problem.agents[leader].goal
    queue, seen = [start], {start}
    for at in queue:
        for i, v in enumerate(at):
            for w in problem.graph.successors[v]:
                after = (*at[:i], w, *at[i + 1 :])
                if w not in at and after not in seen:
                    seen.add(after)
                    queue.append(after)
    lacam = make_lacam(problem.graph, motion, LacamOptions(proposals=10**6, improve=0.0))
    result = lacam.resolve(problem, problem.agents[leader].agv)
    if any(at[leader] == goal for at in seen):
        assert result.paths[problem.agents[leader].agv].vertices[-1] == goal
        assert find_conflicts(result.paths.values(), motion) == []
    else:
        assert (result.status, result.paths) == (Status.INFEASIBLE, {})


def test_partial_cbs_takes_larger_groups_the_more_traffic_there_is():
    """A ring of four, groups of two, and a window that begins at its greatest, where the level is 1."""
    stages = []
    for times in (1.0, 2.0):
        yard = Yard(RING, "AB BC CD DA", replace(LIMITS, group=2), window_cells=11, adapt_cbs=times)
        assert yard.run(30)
        stages.append(yard.stages)
    assert stages == [["pull_over"], ["partial_cbs"]]


def test_priority_rises_sooner_while_a_deadlock_is_open():
    """Of AGVs that can't move, the planner is told priorities: StuckBoost is that of a wait twice as long."""

    def course(**options):
        seen = []

        def planner(problem):
            seen.append([agent.priority for agent in problem.agents])
            return nobody_moves(problem)

        Yard(CORRIDOR, "AE EA", replace(LIMITS, group=1), planner, boost=StuckBoost(10, 50, 1000), **options).run(40)
        return seen

    same, raised = course(), course(adapt_boost=2.0)
    waits = [tick[0] - same[0][0] for tick in same]
    assert waits[20] == 200
    assert raised[20][0] - same[0][0] == pytest.approx(400, abs=4)
    assert raised[30][0] - same[0][0] == 1000, "half of 50 ticks is over"


def test_driving_to_and_fro_does_not_dissolve_a_deadlock():
    """The planner drives the AGV from B to A and back for ever, and no stage has an answer."""
    a, b = CORRIDOR.index["A"], CORRIDOR.index["B"]

    def to_and_fro(problem):
        ways = {agent.agv: (agent.vertex, b if agent.vertex == a else a) for agent in problem.agents}
        return PlanResult(Status.SOLVED, {n: Path(n, way, (0, 1), (0,)) for n, way in ways.items()})

    yard = Yard(CORRIDOR, "BE", LIMITS, to_and_fro)
    yard.planning._ladder._stages = lambda *_: (None, set())
    yard.planning._ladder._together = lambda *_: (None, False)
    assert not yard.run(60)
    assert [d["cause"] for d in yard.of_kind("deadlock_found")] == ["stuck"]
    assert yard.stages == []
