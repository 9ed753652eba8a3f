"""Events that ask for a plan, and orders that are switched for those who wait for a late AGV."""

from __future__ import annotations

from pathlib import Path

import pytest
from brute_force import bodies, problems
from hypothesis import given, settings, target
from late_plant import Drive, delays
from test_executor import CROSS, LINE, way

from controller.fleet import Agv
from controller.planners.whca import make_whca
from controller.reordering import reorder
from controller.replanning import anybody_stands, waits_ahead, without_plan
from controller.types import FOREVER
from parking_sim.config import check_scenario
from parking_sim.simulation import simulate


class Switching(Drive):
    """A drive in which orders are switched where it pays."""

    switches, least_gain = 0, 1

    def once(self, late=(), busy=()):
        self.switches += len(reorder(self.executor, self.step, self.least_gain))
        super().once(late, busy)


class SwitchingAnyway(Switching):
    """Wherever it can be done, whatever it costs."""

    least_gain = -1000


def crossing(kind: type[Drive] = Drive) -> Drive:
    """AGV 1 is planned behind AGV 0 over a crossing."""
    drive = kind.of(CROSS, bodies(CROSS), [CROSS.index["n"], CROSS.index["w"]])
    assert drive.executor.accept({0: way(CROSS, 0, "nxs"), 1: way(CROSS, 1, "wxe", 4)}) is None
    return drive


@settings(max_examples=60, deadline=None)
@given(problems(largest=9, agents=4, window=FOREVER), delays)
def test_with_orders_switched_nobody_meets_and_everybody_arrives(problem, late):
    """The plant checks that nobody meets; ``run`` fails if somebody never gets to the end of its path."""
    paths = make_whca(problem.graph, problem.motion)(problem).paths
    drive = SwitchingAnyway.of(problem.graph, problem.motion, [agent.vertex for agent in problem.agents])
    drive.executor.lookahead = 1
    for agent, a in zip(problem.agents, drive.executor.agvs, strict=True):
        a.in_edge, a.loaded = agent.in_edge, agent.loaded
    assert drive.executor.accept(paths) is None
    drive.run(late)
    ends = {agent.agv: agent.vertex for agent in problem.agents} | {n: p.vertices[-1] for n, p in paths.items()}
    assert drive.ends == [ends[n] for n in range(len(ends))]
    target(float(drive.switches))


@pytest.mark.parametrize(("kind", "goes_first"), [(Drive, False), (Switching, True)])
def test_who_waits_for_a_late_one_goes_first_only_with_orders_switched(kind, goes_first):
    drive = crossing(kind)
    for _ in range(30):
        drive.once(busy=[0])
    assert (drive.ends[1] == CROSS.index["e"]) == goes_first
    drive.run([])
    assert drive.ends == [CROSS.index["s"], CROSS.index["e"]]


def test_no_switch_makes_two_meet_head_on():
    """The one that waits can't go first: it would stand in the other one's way for ever."""
    drive = SwitchingAnyway.of(LINE, bodies(LINE), [LINE.index["b"], LINE.index["d"]])
    assert drive.executor.accept({0: way(LINE, 0, "ba"), 1: way(LINE, 1, "dcb", 4)}) is None
    for _ in range(30):
        drive.once(busy=[0])
    assert drive.switches == 0
    drive.run([])
    assert drive.ends == [LINE.index["a"], LINE.index["b"]]


def test_a_wait_that_was_not_planned_is_seen_ahead():
    drive = crossing()
    drive.executor.update(drive.plant.states(), 0)
    planned = waits_ahead(drive.executor, 0, 100, 2)
    drive.once(busy=[0])
    for _ in range(4):
        drive.plant.acting[0] = drive.executor.agvs[0].acting_until = 40
        drive.once(late=[0])
    assert waits_ahead(drive.executor, drive.step, 100, 2) - planned <= {(1, CROSS.index["x"])}
    assert (1, CROSS.index["x"]) in waits_ahead(drive.executor, drive.step, 100, 2)


def test_who_has_no_plan_and_who_stands():
    drive = crossing()
    agvs = [Agv(0, CROSS.index["n"], CROSS.index["s"]), Agv(1, CROSS.index["w"], CROSS.index["w"])]
    assert without_plan(drive.executor, agvs) == frozenset()
    assert anybody_stands(drive.executor, agvs)
    drive.run([])
    drive.executor.update(drive.plant.states(), drive.step)
    assert without_plan(drive.executor, agvs) == {1}
    agvs[1].immobile = True
    assert without_plan(drive.executor, agvs) == frozenset()
    assert not anybody_stands(drive.executor, agvs)


@pytest.mark.parametrize(
    ("planner", "control"),
    [("whca", {"replanning": "events"}), ("token", {"replanning": "both", "reorder": True})],
)
def test_every_policy_serves_everybody_with_late_agvs(planner, control):
    data = {"garage": "map1", "agvs": 4, "planner": planner, "control": control, "faults": {"travel_noise": 0.2}}
    data["workload"] = {"kind": "poisson", "arrivals_per_h": 20, "dwell_median_min": 10, "duration_min": 5}
    metrics = simulate(check_scenario(data, "test", Path()), None).metrics
    assert metrics["tasks_done"] == metrics["tasks_wanted"] > 0
    assert metrics["deadlocks_unresolved"] == metrics["footprint_overlaps"] == metrics["sumo_collisions"] == 0
