"""Every planner on every garage at saturation, in SUMO: throughput, deadlocks, planning time, on paired seeds.

    python benchmarks/planners.py                      reduced: two garages, 15 minutes, 2 seeds
    python benchmarks/planners.py --full               every cell: 1 hour, 10 seeds; days of CPU, so give --workers
    python benchmarks/planners.py --garages map3 --planners token,whca --agvs 8,32 --minutes 60 --seeds 10
    python benchmarks/planners.py --dispatch nearest   another rule than the default

Mixed traffic: half the slots are taken at the start, cars arrive several times faster than any fleet could serve them
and are asked for after a short stay, so that there is always a car to park and one to fetch. One row a run, then means
over the seeds as a table and, with ``--figure``, a figure. With ``--csv`` rows are added to a file as they come, and
what is in there is not run again, so that a long table can be made in pieces. ``--workers`` is the number of processes.

Shares are of what was assigned after the first sixth of the time: the first tasks of a garage that just opens are few
and far apart. ``bound_share`` is the least work that these tasks can take (``analysis.bound.least_work``, by the
durations that plans are made with, which the plant undercuts by up to 5 %), from where the AGVs were, over the time of
all AGVs until each did its last one.
``alone_share`` is the same for each AGV's own tasks in the order in which it did them, as if it were alone and no
customer had to be waited for: what is lost there is lost to others, what lies between the two to dispatch.
``cars_at_bay`` is the mean number of cars at a bay: those to be parked, and those given back until they drive off.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.bound import least_work, work_alone
from analysis.tables import load_run
from controller.types import AgvNumber
from parking_sim.assembly import assemble
from parking_sim.config import Scenario, load_scenario
from sumo_nets.numbering import Vertex
from sumo_nets.read import read_net

GARAGES = ("map1", "map2", "map3", "map1_thesis", "map2_thesis", "map3_thesis")
PLANNERS = (
    "token", "pbs", "whca", "pibt", "lacam", "online_mapf", "astar", "dstar_lite", "binary_tree", "ga_two_stage", "cbs",
)  # fmt: skip
FLEETS = (1, 2, 4, 8, 16, 32, 64)
#: Part of the run after which shares are counted.
WARM_UP = 1 / 6
#: Planners that only go where they are meant for: plans grow out of hand with more AGVs.
MOST_AGVS = {"cbs": 4}

#: What tells runs apart; the first columns of the table.
KEYS = ("garage", "planner", "agvs", "seed", "minutes", "dispatch")
Case = tuple[str, str, int, int, float, str]

MEASURES = (
    "tasks_done", "deadlocks_found", "deadlocks_resolved", "deadlocks_unresolved", "sumo_collisions",
    "footprint_overlaps", "car_on_agv_max_s", "wall_planning_step_p50_ms", "wall_planning_step_p99_ms",
    "planning_calls",
)  # fmt: skip


def traffic(minutes: float) -> dict[str, object]:
    """More cars than can be served, both ways."""
    return {
        "kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5.0, "dwell_sigma": 0.5,
        "initial_occupancy": 0.5, "duration_min": minutes,
    }  # fmt: skip


def run(case: Case) -> dict[str, Any]:
    """One run, without a folder."""
    from parking_sim.simulation import simulate

    garage, planner, agvs, seed, minutes, dispatch = case
    given = {
        "agvs": agvs, "planner": planner, "seed": seed, "workload": traffic(minutes), "duration_s": 60 * minutes,
        "dispatch": dispatch,
    }  # fmt: skip
    scenario = load_scenario(garage, {**given, "record": {"sample_s": 60.0, "plans": False}})
    with tempfile.TemporaryDirectory() as folder:
        summary = simulate(scenario, Path(folder) / "run")
        tasks = load_run(Path(folder) / "run").tasks
    row: dict[str, Any] = dict(zip(KEYS, case, strict=True)) | {"status": summary.status}
    row |= {key: summary.metrics.get(key) for key in MEASURES}
    row["tasks_per_h"] = summary.metrics["tasks_done"] * 60 / minutes
    for p in ("p50", "p99"):
        row[f"planning_ms_per_agv_{p}"] = summary.metrics[f"wall_planning_step_{p}_ms"] / agvs
    return row | shares(scenario, tasks, minutes)


def shares(scenario: Scenario, tasks: pd.DataFrame, minutes: float) -> dict[str, float]:
    """How near the AGVs came to their bound after the warm-up, and how full the bays were."""
    world = assemble(scenario)
    graph, bays = world.net.graph, {world.net.graph.names[v] for v in world.net.graph.bays}
    step_s, warm_s = world.motion.step_s, 60 * minutes * WARM_UP
    starts: list[Vertex] = []
    places: list[tuple[Vertex, Vertex]] = []
    time_s = alone_s = 0.0
    for agv, all_of_it in tasks[tasks["delivered_s"].notna()].sort_values("assigned_s").groupby("agv"):
        before, own = (
            all_of_it[chosen] for chosen in (all_of_it["assigned_s"] < warm_s, all_of_it["assigned_s"] >= warm_s)
        )
        if own.empty:
            continue
        starts.append(
            world.homes[AgvNumber(int(str(agv)))] if before.empty else graph.index[before["destination"].iloc[-1]]
        )
        its = [(graph.index[a], graph.index[b]) for a, b in zip(own["origin"], own["destination"], strict=True)]
        places += its
        time_s += float(own["delivered_s"].max() - own["assigned_s"].min())
        alone_s += work_alone(graph, world.motion, world.rules, starts[-1], its) * step_s
    work_s = least_work(graph, world.motion, world.rules, starts, places) * step_s
    standing = pd.concat(
        [
            tasks["lifted_s"].fillna(60 * minutes)[tasks["origin"].isin(bays)] - tasks["at_bay_s"],
            tasks["done_s"].fillna(60 * minutes)[tasks["destination"].isin(bays)] - tasks["delivered_s"],
        ]
    )
    return {
        "bound_share": work_s / time_s if places else math.nan,
        "alone_share": alone_s / time_s if places else math.nan,
        "cars_at_bay": float(standing.sum()) / (len(bays) * 60 * minutes),
    }


def cases(given: argparse.Namespace) -> list[Case]:
    """The runs asked for, fleets as far as the garage has homes; the biggest first."""
    found = []
    for garage in given.garages:
        homes = len(read_net(garage).graph.homes)
        fleets = sorted({min(n, homes) for n in given.agvs})
        for planner in given.planners:
            found += [
                (garage, planner, n, seed, given.minutes, given.dispatch)
                for n in fleets
                if n <= MOST_AGVS.get(planner, n)
                for seed in range(1, given.seeds + 1)
            ]
    return sorted(found, key=lambda case: (-case[2], case))


def rows(todo: Sequence[Case], workers: int) -> Iterator[dict[str, Any]]:
    """Rows as they come."""
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(run, case) for case in todo]):
            yield future.result()


def means(done: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the seeds; what must not happen is added up instead."""
    cells: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for row in done:
        cells.setdefault((row["garage"], row["planner"], row["agvs"]), []).append(row)
    table = []
    for (garage, planner, agvs), group in sorted(cells.items()):
        line: dict[str, Any] = {"garage": garage, "planner": planner, "agvs": agvs, "runs": len(group)}
        for key in (
            "tasks_per_h",
            "bound_share",
            "alone_share",
            "cars_at_bay",
            "planning_ms_per_agv_p50",
            "planning_ms_per_agv_p99",
        ):
            line[key] = round(sum(row[key] for row in group) / len(group), 3)
        for key in ("deadlocks_found", "deadlocks_resolved", "deadlocks_unresolved", "footprint_overlaps"):
            line[key] = sum(row[key] for row in group)
        table.append(line)
    return table


def draw(table: Sequence[dict[str, Any]], path: Path) -> None:
    """Throughput over the size of the fleet, a panel for each garage and a line for each planner."""
    import matplotlib.pyplot as plt

    garages, planners = (sorted({line[key] for line in table}) for key in ("garage", "planner"))
    ticks = sorted({line["agvs"] for line in table})
    figure, panels = plt.subplots(
        -(-len(garages) // 3), 3, figsize=(13.5, 3.7 * -(-len(garages) // 3)), squeeze=False, layout="constrained"
    )
    for axes, garage in zip(panels.flat, garages, strict=False):
        for n, planner in enumerate(planners):
            mine = [line for line in table if line["garage"] == garage and line["planner"] == planner]
            fleets, tasks = ([line[key] for line in mine] for key in ("agvs", "tasks_per_h"))
            axes.plot(fleets, tasks, ".-" if n < 10 else ".--", color=f"C{n % 10}", label=planner)
        axes.set(title=garage, xlabel="AGVs", ylabel="tasks an hour", xscale="log")
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.minorticks_off()
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside right upper")
    figure.savefig(path, bbox_inches="tight")


def main() -> None:
    """Run the cells asked for, print the table, write CSV and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--garages", type=lambda text: text.split(","), default=["map1", "map3_thesis"])
    parser.add_argument("--planners", type=lambda text: text.split(","), default=["token", "pbs", "whca", "pibt"])
    parser.add_argument("--agvs", type=lambda text: [int(n) for n in text.split(",")], default=[1, 4, 8])
    parser.add_argument("--dispatch", default=Scenario.model_fields["dispatch"].default)
    parser.add_argument("--minutes", type=float, default=15)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    if given.full:
        given.garages, given.planners, given.agvs = GARAGES, PLANNERS, FLEETS
        given.minutes, given.seeds = 60, 10
    done: list[dict[str, Any]] = []
    if given.csv and given.csv.exists():
        done = [{str(key): value for key, value in row.items()} for row in pd.read_csv(given.csv).to_dict("records")]
    have = {tuple(row[key] for key in KEYS) for row in done}
    wanted = dict.fromkeys(cases(given))
    for row in rows([case for case in wanted if case not in have], given.workers):
        done.append(row)
        print(" ".join(f"{key}={value}" for key, value in row.items()), flush=True)
        if given.csv:
            pd.DataFrame(done).sort_values(list(KEYS)).to_csv(given.csv, index=False)
    table = means([row for row in done if tuple(row[key] for key in KEYS) in wanted])
    print("\n" + " | ".join(table[0]))
    for line in table:
        print(" | ".join(str(value) for value in line.values()))
    if given.figure:
        draw(table, given.figure)


if __name__ == "__main__":
    main()
