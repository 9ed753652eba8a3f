"""Lifelong tasks on 4-connected grids, one move a tick: the setting in which public solvers are measured.

    python benchmarks/lifelong.py [--planner token,whca] [--map warehouse] [--agents 10,50] [--seeds 3] [--ticks 1000]
        [--repeats 3] [--goals any] [--shared]

On arrival an AGV gets a random new end point that nobody else has or heads for; with ``--goals any`` every cell is an
end point, with ``--shared`` several AGVs may have one goal. Turning costs nothing. Executor,
planner and deadlock handling are those of the product, called as the ACS calls them; there is no SUMO. One row for
each map, fleet and planner: tasks a tick (also without any conflict: ``ideal``), milliseconds of CPU a tick of planning
alone and of the whole control, deadlocks found and left, and the longest time that no task was done (a jam). Distances
to the end points are found before the clock runs, as public solvers do.
"""

from __future__ import annotations

import argparse
import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from rows import give_out

from controller.costs import Costs
from controller.deadlock.ladder import LadderLimits
from controller.events import Event
from controller.executor import Executor
from controller.flags import flags_of
from controller.fleet import Agv
from controller.planners.cbs import CbsLimits
from controller.planners.table import load_planner
from controller.planning import ControlOptions, Planning
from controller.rules import Rules
from controller.types import (
    FOREVER,
    Advance,
    AgvMode,
    AgvNumber,
    AgvState,
    Motion,
    Planner,
    PlanningProblem,
    PlanResult,
    make_motion,
)
from sumo_nets.graph import Graph
from sumo_nets.movingai import grid_graph, read_map
from sumo_nets.numbering import Numbered, NumberedList, Vertex, numbered

#: Fleets of each map.
FLEETS = {"warehouse": (10, 50, 100, 200), "garage": (4, 8, 16, 32, 64), "long_garage": (4, 8, 16, 32, 64)}
#: Options of the planners unless ``--options`` names others.
OPTIONS: dict[str, dict[str, object]] = {
    "token": {"through_slots_agvs": 10**6, "improvements": 2, "detours": True, "late_moves": 6}
}
#: Window in ticks, replanning period, and ticks without coming nearer to the goal that count as stuck. Agents of PIBT
#: go out of their way for long.
SETTINGS = {"pbs": (40, 5, 20), "whca": (40, 5, 20), "pibt": (5, 1, 100)}


def warehouse() -> Graph:
    """33 x 46 cells: three times eight blocks of ten shelves with end points above and below."""
    shelf = ".".join(["@" * 10] * 3)
    front = ".".join(["e" * 10] * 3)
    side = ".rr.rr."
    block = [f"{side}{front}{side[::-1]}", f"{side}{shelf}{side[::-1]}", f"{side}{front}{side[::-1]}", "." * 46]
    return grid_graph("warehouse", ["." * 46, *block * 8])


def garage(name: str = "garage", apart: int = 1) -> Graph:
    """13 single-width two-way aisles between two main roads, 390 dead-end slots, 6 bays at the lower road.

    Slots lie so many cells ``apart`` along their aisle.
    """
    aisle, wall = "@e.e" * 13 + "@", "@@.@" * 13 + "@"
    road = "." * len(aisle)
    bays = list("@" * len(aisle))
    for x in range(6):
        bays[4 + 9 * x] = "b"
    row = [aisle, *[wall] * (apart - 1)]
    return grid_graph(name, [road, wall, *(row * 15)[: 14 * apart + 1], wall, road, "".join(bays)])


def long_garage() -> Graph:
    """Aisles of 29 cells instead of 15, which makes trips as long as those of the public figures."""
    return garage("long_garage", 2)


MAPS = {"warehouse": warehouse, "garage": garage, "long_garage": long_garage}


@dataclass(slots=True)
class Timed:
    """A planner with a clock around it."""

    planner: Planner
    spent_s: float = 0.0

    @property
    def complete(self) -> bool:
        """As the planner says."""
        return flags_of(self.planner).complete

    @property
    def improves(self) -> bool:
        """As the planner says."""
        return flags_of(self.planner).improves

    def prepare(self, graph: Graph, motion: Motion, goals: Sequence[Vertex]) -> None:
        """Find the distances to all goals, as public solvers do before their clock runs."""
        nothing = np.zeros(len(graph.names), dtype=np.uint8)
        self.planner(PlanningProblem(graph, motion, (), (), nothing, nothing, FOREVER))
        if hasattr(self.planner, "distances"):
            self.planner.distances.prepare(goals)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan, and count the time."""
        start = process_time()
        result = self.planner(problem)
        self.spent_s += process_time() - start
        return result


@dataclass(frozen=True, slots=True)
class Goals:
    """Which goals are given.

    Attributes:
        anywhere: every cell may be one, not only the map's end points.
        shared: several agents may have one goal, or one where another agent is.
    """

    anywhere: bool = False
    shared: bool = False


class Lifelong:
    """One run.

    ``control`` are options of ``ControlOptions`` that differ from ``control_options``.

    Raises:
        ValueError: not every agent can have a place and a goal of its own.

    Attributes:
        done: tasks done so far.
        trips: start and goal of all tasks given so far.
        quiet: longest time without a task done.
    """

    def __init__(
        self,
        graph: Graph,
        agents: int,
        planner: str,
        seed: int,
        options: dict[str, object],
        goals: Goals = Goals(),
        **control: Any,
    ) -> None:
        self.graph, self.goals = graph, goals
        motion = ticks(graph)
        self.rng = random.Random(seed)
        ends = set() if goals.anywhere else {*graph.slots, *graph.bays}
        self.points = sorted(ends or graph.vertices)
        most = len(self.points) - 1 if goals.shared else (len(self.points) - 1) // 2
        if agents > most:
            raise ValueError(f"agents: {agents}: the {len(self.points)} end points of {graph.name} allow 1 to {most}")
        starts = self.rng.sample(self.points, agents)
        self.timed = Timed(load_planner(planner, graph, motion, options))
        self.timed.prepare(graph, motion, sorted(ends))
        self.agvs: Numbered[AgvNumber, Agv] = [
            Agv(AgvNumber(n), v, v, AgvMode.GOING_TO_COLLECT) for n, v in enumerate(starts)
        ]
        self.executor = Executor(graph, motion, starts)
        self.blocked = np.zeros(len(graph.names), dtype=np.uint8)
        self.costs = Costs(graph, motion, self.blocked)
        self.events: dict[str, int] = {}
        settings = replace(control_options(planner), **control)
        self.planning = Planning(
            self.timed, settings, self.agvs, self.executor, RULES, self.costs, self._log, perf_counter
        )
        self.rest = np.zeros(len(graph.names), dtype=np.uint8)
        self.count: NumberedList[AgvNumber, int] = [0] * agents
        self.done, self.quiet, self._last = 0, 0, 0
        self.trips: list[tuple[Vertex, Vertex]] = []
        for agv in self.agvs:
            self._new_goal(agv)

    def run(self, ticks: int) -> None:
        """So many ticks."""
        for step in range(ticks):
            self._tick(step)
        self.quiet = max(self.quiet, ticks - self._last)

    def alone(self) -> int:
        """Steps that all tasks given so far take without conflicts."""
        return sum(int(self.costs.to(goal)[start]) for start, goal in self.trips)

    def states(self, step: int) -> list[AgvState]:
        """What is seen of the AGVs."""
        return [AgvState(n, c, c, True) for n, c in numbered(self.count)]

    def _tick(self, step: int) -> None:
        self.executor.update(self.states(step), step)
        for agv in self.agvs:
            if self.executor.agvs[agv.number].last == agv.goal:
                self._arrived(agv, step)
        self.planning.step(step, self.blocked, lambda: self.rest)
        self.planning.take_calls()
        for command in self.executor.grants(step):
            if isinstance(command, Advance):
                self.count[command.agv] += 1

    def _arrived(self, agv: Agv, step: int) -> None:
        self.done += 1
        self.quiet, self._last = max(self.quiet, step - self._last), step
        self._new_goal(agv)

    def _new_goal(self, agv: Agv) -> None:
        taken = {self.executor.agvs[agv.number].last}
        if not self.goals.shared:
            taken |= {v for other in self.agvs for v in (other.goal, self.executor.agvs[other.number].last)}
        agv.goal = self.rng.choice([v for v in self.points if v not in taken])
        self.trips.append((self.executor.agvs[agv.number].last, agv.goal))
        self.planning.goal_changed()

    def _log(self, event: Event) -> None:
        self.events[event.kind] = self.events.get(event.kind, 0) + 1


RULES = Rules(
    lift_slot=0, lower_slot=0, lift_bay=0, lower_bay=0, charge_below=0.0, charge_to=1.0, charge_steps=0,
    charge_least_steps=0, assign_on_return=True, cell_steps=1,
)  # fmt: skip


def ticks(graph: Graph) -> Motion:
    """One tick a move, no turning cost."""
    return make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)


def control_options(planner: str) -> ControlOptions:
    """Window and period of a planner, limits of deadlock handling in ticks."""
    window, period, stuck = SETTINGS.get(planner, (5, 1, 20))
    return ControlOptions(
        period_steps=period, window_cells=window, window_min=window, window_max=window,
        ladder=LadderLimits(
            patience_steps=stuck // 10, stuck_steps=stuck,
            cbs=CbsLimits(expansions=64, nodes=128, constraints=64, ranges=True),
        ),
    )  # fmt: skip


def measure(
    graph: Graph,
    agents: int,
    planner: str,
    seeds: int,
    length: int,
    options: dict[str, object],
    repeats: int = 1,
    goals: Goals = Goals(),
) -> dict[str, object]:
    """One row: means over the seeds, the worst of what must not happen, times the least of some repeats."""
    runs, planning, control = [], 0.0, 0.0
    for seed in range(1, seeds + 1):
        clocks = []
        for _ in range(repeats):
            run = Lifelong(graph, agents, planner, seed, options, goals)
            start = process_time()
            run.run(length)
            clocks.append((run.timed.spent_s, process_time() - start))
        planning += min(clocks)[0]
        control += min(clocks)[1]
        runs.append(run)
    total = seeds * length
    found = sum(run.events.get("deadlock_found", 0) for run in runs)
    return {
        "map": graph.name, "agents": agents, "planner": planner,
        "tasks_per_tick": round(sum(run.done for run in runs) / total, 4),
        "ideal": round(agents * sum(len(run.trips) for run in runs) / sum(run.alone() for run in runs), 4),
        "planning_ms": round(1000 * planning / total, 3),
        "control_ms": round(1000 * control / total, 3),
        "deadlocks": found,
        "unresolved": found - sum(run.events.get("deadlock_resolved", 0) for run in runs),
        "rejected": sum(run.events.get("plan_rejected", 0) for run in runs),
        "longest_quiet": max(run.quiet for run in runs),
    }  # fmt: skip


def rows(given: argparse.Namespace) -> Iterator[dict[str, object]]:
    """All rows asked for; compiles first."""
    for name in given.map.split(","):
        graph = MAPS[name]() if name in MAPS else read_map(Path(name))
        fleets: Sequence[int] = [int(n) for n in given.agents.split(",")] if given.agents else FLEETS[name]
        for planner in given.planner.split(","):
            options = OPTIONS.get(planner, {}) | given.options
            goals = Goals(given.goals == "any", given.shared)
            measure(graph, 2, planner, 1, 20, options)
            for agents in fleets:
                yield measure(graph, agents, planner, given.seeds, given.ticks, options, given.repeats, goals)


def main() -> None:
    """Print a row each, and write them if asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--planner", default="token,pbs,whca,pibt")
    parser.add_argument("--map", default="warehouse,garage", help="also a MovingAI .map file, with --agents")
    parser.add_argument("--agents", default="")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=1, help="runs of each seed, of which the quickest counts")
    parser.add_argument("--goals", choices=("endpoints", "any"), default="endpoints")
    parser.add_argument("--shared", action="store_true", help="several agents may have one goal")
    parser.add_argument("--options", type=json.loads, default={}, help="of the planner, as JSON")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    try:
        give_out(rows(given), given.csv)
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
