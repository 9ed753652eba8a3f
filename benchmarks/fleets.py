"""Every garage and fleet size parks all cars and brings all back: what was done, how safely, how fast.

    python benchmarks/fleets.py [--planner token] [--workers 2] [--csv FILE] [--only map3]

One row a run. A run that leaves a task undone, a deadlock unresolved, or lets bodies or cells overlap is marked.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import pandas as pd

from parking_sim.config import DEFAULT_PLANNER, load_scenario

#: Biggest first, so that the longest run does not start last.
CASES = (
    *(("map3", n, "sumo") for n in (1, 2, 4, 8, 16, 32)),
    ("map3_thesis", 8, "sumo"),
    ("map3_thesis", 8, "discrete"),
    ("map2", 4, "sumo"),
    ("map2_thesis", 4, "sumo"),
    ("map2_thesis", 4, "discrete"),
    *(("map1", n, "sumo") for n in (1, 2, 3, 4)),
    *(("map1_thesis", n, plant) for n in (1, 2, 3, 4) for plant in ("sumo", "discrete")),
)

COLUMNS = (
    "tasks_done",
    "tasks_wanted",
    "sumo_collisions",
    "footprint_overlaps",
    "least_clearance_m",
    "deadlocks_found",
    "deadlocks_resolved",
    "deadlocks_unresolved",
    "simulated_s",
    "throughput",
    "retrieval_wait_p95_s",
    "nodes_expanded",
    "wall_speed",
)


def run(case: tuple[str, int, str], planner: str) -> dict[str, object]:
    """One run, without a folder."""
    from parking_sim.simulation import simulate

    garage, agvs, plant = case
    summary = simulate(load_scenario(garage, {"agvs": agvs, "plant": plant, "planner": planner}), None)
    row: dict[str, object] = {"garage": garage, "agvs": agvs, "plant": plant, "status": summary.status}
    return row | {key: summary.metrics[key] for key in COLUMNS}


def rows(cases: list[tuple[str, int, str]], planner: str, workers: int) -> Iterator[dict[str, object]]:
    """Rows as they come."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context) as pool:
        for future in as_completed([pool.submit(run, case, planner) for case in cases]):
            yield future.result()


def is_good(row: dict[str, object]) -> bool:
    """Everything done and nothing overlapped."""
    undone = row["status"] != "finished" or row["tasks_done"] != row["tasks_wanted"] or row["deadlocks_unresolved"]
    return not (undone or row["sumo_collisions"] or row["footprint_overlaps"])


def main() -> int:
    """Run the cases asked for and print a row each; 1 if one of them was not good."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="garages whose name begins so")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    cases = [case for case in CASES if case[0].startswith(given.only)]
    done = []
    for row in rows(cases, given.planner, given.workers):
        done.append(row)
        mark = "" if is_good(row) else "  <-- not good"
        values = (f"{v:.6g}" if isinstance(v, float) else str(v) for v in (row[key] for key in COLUMNS))
        shown = " ".join(f"{key}={value}" for key, value in zip(COLUMNS, values, strict=True))
        print(f"{row['garage']} x {row['agvs']} in {row['plant']}: {shown}{mark}", flush=True)
    if given.csv:
        pd.DataFrame(done).sort_values(["garage", "plant", "agvs"]).to_csv(given.csv, index=False)
    return 0 if all(is_good(row) for row in done) else 1


if __name__ == "__main__":
    sys.exit(main())
