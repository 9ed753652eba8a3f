"""A wrong planner may stop the garage, it cannot make two AGVs meet; a broken executor is seen by the checks."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import pytest
from test_sumo_plant import _crossing, _two_way_run
from whole_runs import check_whole, run

import controller.executor
from controller.executor import Executor
from controller.types import Path as Way
from parking_sim.footprint import FootprintCheck
from parking_sim.plants.sumo import SumoPlant
from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.read import read_net

WRONG = '''
import random
from itertools import accumulate

import networkx as nx

from controller.types import Path, PlanResult, Status

CALLS = random.Random(1)


def timed(problem, agent, vertices):
    """Not a thought about turns, nor about anybody else."""
    steps = [int(problem.motion.edge_steps[0, problem.graph.edge_index.get(move, 0)]) for move in pairs(vertices)]
    arrive = (0, *accumulate(steps))
    return Path(agent.agv, tuple(vertices), arrive, arrive[:-1], problem.window_steps)


def pairs(vertices):
    return list(zip(vertices, vertices[1:], strict=False))


def solved(problem, ways):
    paths = {a.agv: timed(problem, a, way) for a, way in zip(problem.agents, ways, strict=True)}
    return PlanResult(Status.SOLVED, paths)


def selfish(problem):
    """Everybody takes the shortest way as if alone."""
    model = problem.graph.to_networkx()
    return solved(problem, [nx.shortest_path(model, a.vertex, a.goal, weight="length_m") for a in problem.agents])


def wandering(problem):
    """Everybody goes anywhere."""
    ways = []
    for agent in problem.agents:
        way = [agent.vertex]
        for _ in range(CALLS.randrange(6)):
            way.append(CALLS.choice(problem.graph.successors[way[-1]]))
        ways.append(way)
    return solved(problem, ways)
'''


@pytest.fixture
def wrong(tmp_path: Path) -> Path:
    path = tmp_path / "wrong.py"
    path.write_text(WRONG, encoding="utf-8")
    return path


@pytest.mark.usefixtures("ticks_watched")
@pytest.mark.parametrize("plant", ["sumo", "discrete"])
@pytest.mark.parametrize("planner", ["selfish", "wandering"])
def test_whatever_a_planner_returns_nobody_meets(tmp_path, wrong, plant, planner):
    """Colliding plans are refused, the rest is carried out; cars are conserved however little gets done."""
    record = run(
        tmp_path / "run", garage="map1", agvs=4, plant=plant, planner=f"{wrong}:{planner}", duration_s=400.0,
        workload={"kind": "park_exit", "cars": 12}, customers={"handling_median_s": 5.0},
    )  # fmt: skip
    check_whole(record)
    assert (record.events.kind == "plan_rejected").any()
    assert record.agvs.moves.sum() > 0


# --- the same, with the executor broken on purpose --------------------------------------------------------------------


@pytest.fixture
def broken_executor(monkeypatch: pytest.MonkeyPatch) -> None:
    """An executor that takes every plan and grants every vertex, whoever is there."""

    def unchecked(paths, *_):
        order: dict[int, deque[int]] = {}
        for agv, path in paths.items():
            for v in path.vertices[1:]:
                order.setdefault(v, deque()).append(agv)
        return order

    def claim(self: Executor, agv: int, vertex: int) -> bool:
        self.order[vertex].remove(agv)
        self.owner[vertex] = agv
        return True

    monkeypatch.setattr(controller.executor, "visiting_order", unchecked)
    monkeypatch.setattr(Executor, "_claim", claim)


def carried_out(garage_name: str, starts: tuple[int, ...], ways: list[tuple[int, ...]]) -> tuple[int, int]:
    """Plans given to an executor and driven in SUMO: SUMO's collisions, overlaps of the footprint check."""
    garage = read_net(garage_name)
    plant = SumoPlant(garage, starts, AgvType(), 1)
    executor, check = Executor(garage.graph, plant.motion, starts), FootprintCheck()
    try:
        paths = {i: Way(i, way, tuple(range(len(way))), tuple(range(len(way) - 1))) for i, way in enumerate(ways)}
        executor.accept(paths)
        for step in range(120):
            executor.update(plant.states(), step)
            for command in executor.grants(step):
                plant.execute(command)
            plant.step()
            check.step(plant.time_s, plant.bodies())
        return plant.collisions, check.result().overlaps
    finally:
        plant.close()


def head_on() -> tuple[str, tuple[int, ...], list[tuple[int, ...]]]:
    lane = _two_way_run(read_net("map1").graph)
    return "map1", (lane[0], lane[-1]), [tuple(lane), tuple(reversed(lane))]


def crossing() -> tuple[str, tuple[int, ...], list[tuple[int, ...]]]:
    starts, ways = _crossing(read_net("map1_thesis").graph)
    return "map1_thesis", starts, [(start, *way) for start, way in zip(starts, ways, strict=True)]


@pytest.mark.usefixtures("broken_executor")
def test_a_broken_executor_head_on_is_caught_by_sumo_and_by_the_footprint_check():
    collisions, overlaps = carried_out(*head_on())
    assert collisions > 0
    assert overlaps > 0


@pytest.mark.usefixtures("broken_executor")
def test_a_broken_executor_at_a_crossing_is_caught_by_the_footprint_check_alone():
    collisions, overlaps = carried_out(*crossing())
    assert collisions == 0
    assert overlaps > 0


@pytest.mark.parametrize("meeting", [head_on, crossing])
def test_the_executor_as_it_is_lets_neither_happen(meeting):
    assert carried_out(*meeting()) == (0, 0)


@pytest.mark.usefixtures("broken_executor")
def test_a_run_says_that_its_executor_was_broken(tmp_path, wrong):
    record = run(
        tmp_path / "run", garage="map1", agvs=4, planner=f"{wrong}:selfish", duration_s=300.0,
        workload={"kind": "park_exit", "cars": 12}, customers={"handling_median_s": 5.0},
    )  # fmt: skip
    assert record.meta["footprint_overlaps"] > 0
    assert (record.events.kind == "overlap").sum() == record.meta["footprint_overlaps"]
