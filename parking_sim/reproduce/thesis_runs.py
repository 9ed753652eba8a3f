"""The runs of ``reproduce thesis``: the rows of its tables, and what goes beyond them."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import pandas as pd

from parking_sim.config import Scenario, load_scenario

#: What a scenario gets that names no planner.
DEFAULT = str(Scenario.model_fields["planner"].default)
#: Planners of the tables, and what each of them is.
PLANNERS: Mapping[str, str] = {
    "astar": "`astar`, the thesis's A*: a fresh search for each move",
    "dstar_lite": "`dstar_lite`, the thesis's D* Lite: each AGV's search is kept and repaired",
    "pipeline": "the thesis's pipeline after its pseudo-code 3 (wait-for graph, partial CBS, leader, pull-over)",
    "whca": "our WHCA*: a complete search in the window, deadlocks are the controller's work",
    DEFAULT: "the default planner of this program: token passing",
}
#: Each of the thesis's claims about its pipeline is judged for these.
CONTENDERS = tuple(planner for planner in PLANNERS if planner not in ("astar", "dstar_lite"))
THESIS, FAIR, SUMO = "thesis", "fair", "sumo"

#: Metric -> heading. Completion and conflicts go first.
METRICS: Mapping[str, str] = {
    "completion": "share of tasks done",
    "conflicts": "vertex and swap conflicts seen (SUMO: collisions and overlaps)",
    "throughput": "table 2-1: throughput, tasks a step (SUMO: a second)",
    "movement_cost": "table 2-2: movement cost, cells",
    "nodes_expanded": "table 2-3: nodes expanded",
    "heap_moves": "table 2-4: heap moves",
    "nodes_generated": "table 2-5: nodes generated",
    "valid_expansions": "table 2-6: valid expansions",
    "valid_ratio": "table 2-7: valid expansions / generated",
    "steps": "steps (SUMO: seconds)",
    "bound_share": "throughput as a share of the bound",
    "slot_choice_expanded": "nodes expanded to choose slots",
    "deadlocks_found": "deadlocks found",
    "deadlocks_unresolved": "deadlocks left",
    "wait_edges": "wait-for edges (`pipeline`: met while planning; else of AGVs that really wait), summed over calls",
    "wait_rings": "rings of these edges, summed over calls",
}

#: Planners of what goes beyond the tables. A* takes the same moves as D* Lite.
BEYOND = tuple(planner for planner in PLANNERS if planner != "astar")
#: Demand seeds of the comparison of planners: fewer where a run takes a minute.
SEEDS: Mapping[str, int] = {"map1": 10, "map2": 3, "map3": 3}
#: Garages and AGVs of park and fetch: the thesis's, and four times as many.
MORE: Sequence[tuple[str, int]] = (("map2", 4), ("map2", 16), ("map3", 8), ("map3", 32))
#: Simulated seconds after which a run in SUMO is given up, and bounds on its steps after which one in ticks is.
SUMO_LIMIT_S, LIMIT_BOUNDS = 1_000_000.0, 4


@dataclass(frozen=True, slots=True)
class Case:
    """One run.

    Attributes:
        garage: map1, map2 or map3; the run is on its thesis grid.
        agvs: number of AGVs.
        planner: a name of ``PLANNERS``.
        rules: "thesis", "fair" or "sumo".
        park_only: the run ends with the last car parked.
        cars: cars to park; None for as many as there are slots.
        seed: seed of the order in which cars are fetched; None for the order in which they came.
        homes: homes of the AGVs by name, with blanks between; empty for the first ones.
    """

    garage: str
    agvs: int
    planner: str
    rules: str
    park_only: bool = False
    cars: int | None = None
    seed: int | None = None
    homes: str = ""

    def scenario(self) -> Scenario:
        """The run's scenario."""
        order = "parked" if self.seed is None else "random"
        workload = {"kind": "park_exit", "cars": self.cars, "park_only": self.park_only, "order": order}
        plant = "sumo" if self.rules == SUMO else "discrete"
        keys: dict[str, object] = {
            "agvs": self.agvs,
            "plant": plant,
            "planner": self.planner,
            "dispatch": "nearest",
            "workload": workload,
            "seed": self.seed or 0,
            "homes": self.homes.split() or None,
            "record": {"sample_s": 2.0 if plant == "sumo" else 1.0},
        }
        keys |= {"max_time_s": SUMO_LIMIT_S} if plant == "sumo" else {"rules": self.rules}
        return load_scenario(f"{self.garage}_thesis", keys)


#: (garage, AGVs, park only, cars) of the tables' rows; the quick form has 40 cars on MAP2 and leaves MAP3 out.
Row = tuple[str, int, bool, int | None]
ROWS: Sequence[Row] = (
    *(("map1", n, False, None) for n in (1, 2, 3, 4)),
    ("map2", 4, True, None),
    ("map3", 8, True, None),
)
QUICK_ROWS: Sequence[Row] = (*ROWS[:4], ("map2", 4, True, 40))


#: Homes of MAP1. The thesis doesn't say which of them its fleets of two and three AGVs have.
HOMES = ("c0_2", "c0_3", "c0_4", "c0_1")


def table_cases(rows: Sequence[Row], rules: Sequence[str] = (THESIS, FAIR, SUMO)) -> Iterator[Case]:
    """Each row under each set of rules and each planner; what takes longest comes last."""
    for each in rules:
        for garage, agvs, park_only, cars in rows:
            for planner in PLANNERS:
                yield Case(garage, agvs, planner, each, park_only, cars)


def quick_cases() -> Iterator[Case]:
    """The quick form: its rows under the thesis's rules, the last two under fair ones, the contenders once in SUMO."""
    yield from table_cases(QUICK_ROWS, (THESIS,))
    yield from table_cases(QUICK_ROWS[3:], (FAIR,))
    yield from (Case("map1", 4, planner, SUMO) for planner in CONTENDERS)


def more_cases() -> Iterator[Case]:
    """Park and fetch under fair rules on MAP2 and MAP3, with the thesis's AGVs and with more."""
    for garage, agvs in MORE:
        for planner in BEYOND:
            yield Case(garage, agvs, planner, FAIR)


def seed_cases() -> Iterator[Case]:
    """Every row with cars fetched by name in a random order, under fair rules, over the demand seeds."""
    for garage, agvs, _, _ in ROWS:
        for seed in range(SEEDS[garage]):
            for planner in BEYOND:
                yield Case(garage, agvs, planner, FAIR, seed=seed)


def home_cases() -> Iterator[Case]:
    """MAP1 under the thesis's rules with its homes dealt out to the AGVs in every way."""
    for agvs in (2, 3, 4):
        for homes in permutations(HOMES, agvs):
            for planner in ("dstar_lite", "pipeline"):
                yield Case("map1", agvs, planner, THESIS, homes=" ".join(homes))


def run_cases(cases: Sequence[Case], workers: int, file: Path) -> pd.DataFrame:
    """Run cases in parallel processes; a row for each, in their order, which is in the file as soon as it is known."""
    from parking_sim.workers import open_executor

    rows = []
    with open_executor(workers) as executor:
        for row in executor.map(run_case, cases):
            rows.append(row)
            first = len(rows) == 1
            pd.DataFrame([row]).to_csv(file, mode="w" if first else "a", header=first, index=False, float_format="%.6g")
            if sys.stderr.isatty():
                print(f"\r{len(rows)} of {len(cases)} runs", end="", file=sys.stderr, flush=True)
    return pd.DataFrame(rows)


def run_case(case: Case) -> dict[str, Any]:
    """Run one case, and look at what happened independently of the controller.

    Returns:
        The case, the run's status and ``METRICS``; AGVs that give way to each other for ever are stopped.
    """
    from analysis.tables import load_run
    from analysis.tick_conflicts import meetings
    from parking_sim.simulation import simulate

    scenario, bound = case.scenario(), float("nan")
    if case.rules != SUMO:
        bound = bound_steps(scenario)
        scenario = scenario.model_copy(update={"max_time_s": LIMIT_BOUNDS * bound})
    with tempfile.TemporaryDirectory() as name:
        summary = simulate(scenario, Path(name))
        m = dict(summary.metrics)
        if case.rules == SUMO:
            m["conflicts"] = m["sumo_collisions"] + m["footprint_overlaps"]
            m["steps"], m["throughput"] = m["simulated_s"], m["tasks_done"] / m["simulated_s"]
        else:
            m["conflicts"] = len(meetings(load_run(Path(name)).trajectory))
    m["completion"] = m["tasks_done"] / m["tasks_wanted"]
    m["bound_share"] = m["throughput"] * bound / m["tasks_wanted"]
    return {**asdict(case), "status": summary.status, **{metric: m[metric] for metric in METRICS}}


def bound_steps(scenario: Scenario) -> int:
    """Steps that no controller can do a discrete park-and-fetch scenario in."""
    from analysis.bound import least_steps
    from parking_sim.assembly import assemble

    world = assemble(scenario)
    parks = world.demand.phases[0]
    return least_steps(
        world.net.graph, world.motion, world.rules, world.homes, len(parks), park_only=len(world.demand.phases) == 1
    )
