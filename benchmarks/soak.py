"""All garages under mixed demand with every fault on at once: nothing may meet, lock up or get lost.

    python benchmarks/soak.py [--full] [--steps 10e6] [--workers 1] [--planner token,whca] [--csv FILE]

The full form goes on with new seeds, and the next planner, until the runs with faults have made ``--steps`` AGV-steps;
the small form makes one case per garage. The cases of the first seed are also run without faults on the same demand.
Rows are written as runs end. Exit code 1 if anything was not good.

Rates are far above a real garage's, so that each fault meets each other; an AGV is out of order for about a tenth of
its time. The times to recover are those from ``fault_start`` to ``fault_end`` (a breakdown: until it is repaired).
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import nullcontext
from itertools import count, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from analysis.tables import load_run

NOISE = "travel_noise"
FAULTS: Mapping[str, Any] = {
    NOISE: 0.15,
    "commands": {"late": 0.01, "lost": 0.005},
    "stop": {"per_h": 2, "least_s": 5, "most_s": 40},
    "slow": {"per_h": 0.5, "least_s": 30, "most_s": 180},
    "stale": {"per_h": 0.5, "least_s": 20, "most_s": 120},
    "breakdown": {"per_h": 0.05, "least_s": 120, "most_s": 600, "repair_s": 600},
    "battery": {"per_h": 0.03, "least_s": 120, "most_s": 600},
    "blocked": {"per_h": 4, "least_s": 20, "most_s": 180},
    "bay": {"per_h": 0.5, "least_s": 60, "most_s": 600},
    "charger": {"per_h": 0.5, "least_s": 60, "most_s": 600},
    "zone_stop": {"per_h": 0.5, "least_s": 10, "most_s": 60},
    "all_stop": {"per_h": 0.2, "least_s": 10, "most_s": 60},
}


def workload(kind: str, garage: str, minutes: float) -> dict[str, Any]:
    """Steady traffic, or the same with bursts of arrivals and of wishes."""
    per_h = {"map1": 12, "map2": 30, "map3": 45}[garage]
    options: dict[str, Any] = {"arrivals_per_h": per_h, "dwell_median_min": 60, "initial_occupancy": 0.5}
    options |= {"kind": kind, "duration_min": minutes}
    if kind == "bursts":
        cars = per_h // 4
        burst = [{"at_min": minutes / 4, "cars": cars, "spread_min": 5}]
        options["bursts"] = [*burst, {"at_min": minutes / 2, "cars": cars, "spread_min": 5, "wish": "retrieve"}]
    return options


#: In the short runs of the small form faults are so many times as frequent.
SMALL_RATE = 6.0
#: Garage, AGVs, kind of demand, minutes of demand.
SMALL = (("map1", 4, "poisson", 20.0), ("map2", 8, "bursts", 15.0))
FULL = tuple(
    (garage, agvs, kind, 240.0)
    for garage, agvs in (("map3", 32), ("map2", 16), ("map3", 16), ("map2", 8), ("map3", 8), ("map1", 8))
    for kind in ("poisson", "bursts")
)
Case = tuple[str, int, str, float]
MUST_BE_ZERO = ("sumo_collisions", "footprint_overlaps", "deadlocks_unresolved")


def faults(rate: float) -> dict[str, Any]:
    """What goes wrong, so many times as often; none at rate 0."""
    more = {k: {**v, "per_h": v["per_h"] * rate} if "per_h" in v else v for k, v in FAULTS.items() if k != NOISE}
    return {NOISE: FAULTS[NOISE], **more} if rate else {}


def run(case: Case, seed: int, planner: str, rate: float) -> dict[str, Any]:
    """One run: its metrics, AGV-steps and the seconds of its faults by kind."""
    from parking_sim.config import check_scenario
    from parking_sim.simulation import simulate

    garage, agvs, kind, minutes = case
    data: dict[str, Any] = {"garage": garage, "agvs": agvs, "planner": planner, "seed": seed}
    data |= {"workload": workload(kind, garage, minutes), "faults": faults(rate)}
    data["record"] = {"sample_s": 60.0, "plans": False}
    with tempfile.TemporaryDirectory() as folder:
        summary = simulate(check_scenario(data, "soak", Path()), Path(folder) / "run")
        seconds = fault_seconds(Path(folder) / "run")
    m = summary.metrics
    kept = ("tasks_done", "tasks_wanted", "simulated_s", "retrieval_wait_p95_s", "deadlocks_found", *MUST_BE_ZERO)
    row = {"garage": garage, "agvs": agvs, "demand": kind, "planner": planner, "seed": seed, "faulty": rate > 0}
    row["status"] = summary.status
    row |= {key: m[key] for key in kept}
    row["lost"] = int(not (m["requests_conserved"] and m["cars_conserved"]))
    row["tasks_per_h"] = m["tasks_done"] / m["simulated_s"] * 3600.0
    return {**row, "agv_steps": round(agvs * m["simulated_s"] / 0.5), "faults": seconds}


def fault_seconds(folder: Path) -> dict[str, list[float]]:
    """Seconds from begin to end of each fault that ended, by kind; a breakdown lasts until it is repaired."""
    events = load_run(folder).events
    faults = events[events["kind"].isin(("fault_start", "fault_end"))]
    began: dict[int, tuple[float, str]] = {}
    broken: dict[int, float] = {}
    seconds: dict[str, list[float]] = {}
    for time_s, kind, agv, detail in faults[["time_s", "kind", "agv", "detail"]].itertuples(index=False):
        fault = json.loads(detail)
        if kind == "fault_start":
            began[fault["fault"]] = (time_s, fault["cause"])
            if fault["cause"] == "breakdown":
                broken.setdefault(agv, time_s)
            continue
        start, cause = began.pop(fault["fault"])
        if cause == "repair":
            seconds.setdefault("breakdown", []).append(time_s - broken.pop(agv, start))
        elif cause not in ("breakdown", "tow"):
            seconds.setdefault(cause, []).append(time_s - start)
    return seconds


def is_good(row: Mapping[str, Any]) -> bool:
    """Everything was done, and nothing met, locked up or got lost."""
    done = row["status"] == "finished" and row["tasks_done"] == row["tasks_wanted"]
    return done and not row["lost"] and not any(row[key] for key in MUST_BE_ZERO)


def cases(full: bool) -> Iterator[tuple[Case, int]]:
    """Cases with their seeds; endless in the full form."""
    for seed in count() if full else range(1):
        for case in FULL if full else SMALL:
            yield case, seed


def plan_runs(full: bool, steps: float, planners: Sequence[str]) -> Iterator[tuple[Case, int, str, float]]:
    """Case, seed, planner and rate of faults of each run, until enough AGV-steps are planned with faults."""
    planned = 0.0
    for case, seed in cases(full):
        if full and planned >= steps:
            return
        planned += case[1] * case[3] * 120.0
        planner = planners[seed % len(planners)]
        yield case, seed, planner, 1.0 if full else SMALL_RATE
        if seed == 0:
            yield case, seed, planner, 0.0


def soak(runs: Iterator[tuple[Case, int, str, float]], workers: int, file: TextIO | None) -> list[dict[str, Any]]:
    """Make the runs; prints and writes a line for each as it ends."""
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
        running: set[Future[dict[str, Any]]] = set()
        while True:
            running |= {pool.submit(run, *chosen) for chosen in islice(runs, workers - len(running))}
            if not running:
                return rows
            over, running = wait(running, return_when=FIRST_COMPLETED)
            for row in (future.result() for future in over):
                rows.append(row)
                shown = " ".join(f"{key}={_short(value)}" for key, value in row.items() if key != "faults")
                print("ok " if is_good(row) else "BAD", shown, flush=True)
                if file:
                    writer = csv.DictWriter(file, list(row))
                    if len(rows) == 1:
                        writer.writeheader()
                    writer.writerow({**row, "faults": json.dumps(row["faults"])})
                    file.flush()


def _short(value: object) -> object:
    return f"{value:.4g}" if isinstance(value, float) else value


def print_tables(rows: list[dict[str, Any]]) -> None:
    """Faults by kind with their times to recover, and what was kept of the throughput."""
    by_kind: dict[str, list[float]] = {}
    for row in rows:
        for kind, seconds in row["faults"].items():
            by_kind.setdefault(kind, []).extend(seconds)
    print("\n| fault | times | recovery p50 (s) | p95 (s) |\n|---|---|---|---|")
    for kind, seconds in sorted(by_kind.items()):
        p50, p95 = np.quantile(seconds, (0.5, 0.95))
        print(f"| {kind} | {len(seconds)} | {p50:.1f} | {p95:.1f} |")
    calm = {(r["garage"], r["agvs"], r["demand"], r["seed"]): r for r in rows if not r["faulty"]}
    print("\n| garage | AGVs | demand | planner | tasks/h | without faults | kept |\n|---|---|---|---|---|---|---|")
    for r in rows:
        pair = calm.get((r["garage"], r["agvs"], r["demand"], r["seed"]))
        if r["faulty"] and pair:
            kept = r["tasks_per_h"] / pair["tasks_per_h"]
            what = f"{r['garage']} | {r['agvs']} | {r['demand']} | {r['planner']}"
            print(f"| {what} | {r['tasks_per_h']:.1f} | {pair['tasks_per_h']:.1f} | {kept:.0%} |")
    hard = [r for r in rows if r["faulty"]]
    sums = ", ".join(f"{sum(r[key] for r in hard)} {key}" for key in (*MUST_BE_ZERO, "lost", "deadlocks_found"))
    print(f"\nwith faults: {sum(r['agv_steps'] for r in hard):,} AGV-steps in {len(hard)} runs; {sums}")


def main() -> int:
    """Run the cases and print the tables; 1 if a run was not good."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--steps", type=float, default=10e6)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--planner", default="token,whca")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    runs = plan_runs(given.full, given.steps, given.planner.split(","))
    with given.csv.open("w", newline="", encoding="utf-8") if given.csv else nullcontext() as file:
        rows = soak(runs, given.workers, file)
    print_tables(rows)
    return 0 if all(map(is_good, rows)) else 1


if __name__ == "__main__":
    sys.exit(main())
