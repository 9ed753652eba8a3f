"""A garage of 10,000 slots: how fast it runs, what a step costs from 8 to 500 AGVs, and how much memory it takes.

    python benchmarks/large.py [--agvs 8,50,200,500] [--minutes 10] [--plant sumo] [--planner token] [--csv FILE]

The garage is generated (65 aisles, 64 bays, 500 homes) and built once into ``--folder``. Half the slots are taken at
the start; requests come in proportion to the fleet, more than it can serve, so that every AGV is always busy. Each run
has a process of its own. A step's time is that from the run's first report of progress, after two minutes, to its last
one, so without loading the net and sending everybody off; the kernels are compiled before. Printed: simulated seconds
per second of CPU and of wall time, CPU a step, also per AGV, the parts' shares of the wall time, tasks done, deadlocks,
and the most memory held.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import process_time
from typing import Any

from rows import give_out

from parking_sim.config import DEFAULT_PLANNER, load_scenario
from parking_sim.simulation import simulate
from sumo_nets.build import build_net
from sumo_nets.generate import generate_layout

SLOTS = 10_000
#: Requests of either kind an hour and AGV; an AGV alone does about ten of both.
REQUESTS = 30.0
PARTS = ("sumo", "plant", "planning", "execution", "record", "check")
#: Simulated seconds of the run that compiles the kernels.
COMPILE_S = 30.0
#: Shortest run that has two reports of progress with enough time between them.
LEAST_MIN = 5.0


def run(net: Path, agvs: int, planner: str, plant: str, minutes: float) -> dict[str, Any]:
    """One row."""
    given: dict[str, object] = {
        "agvs": agvs, "planner": planner, "plant": plant, "seed": 1,
        "workload": {
            "kind": "poisson", "arrivals_share_per_h": REQUESTS * agvs / SLOTS, "dwell_median_min": 5.0,
            "dwell_sigma": 0.5, "initial_occupancy": 0.5, "duration_min": minutes,
        },
    }  # fmt: skip
    seen: list[tuple[float, float, float]] = []
    for end_s in (COMPILE_S, 60 * minutes):
        seen.clear()
        with tempfile.TemporaryDirectory() as folder:
            summary = simulate(
                load_scenario(str(net), {**given, "duration_s": end_s}), Path(folder),
                progress=lambda now: seen.append((now.time_s, now.wall_s, process_time())),
            )  # fmt: skip
            found = json.loads((Path(folder) / "run.json").read_text())
    spent = {part: found["wall_s"][part] for part in PARTS}
    total = sum(spent.values())
    simulated_s, wall_s, cpu_s = (last - first for first, last in zip(seen[0], seen[-1], strict=True))
    cpu_ms = 1000 * cpu_s * found["step_s"] / simulated_s
    return {
        "agvs": agvs, "plant": plant, "planner": planner, "status": summary.status,
        "cpu_times_real": round(1000 * found["step_s"] / cpu_ms, 1),
        "cpu_ms": round(cpu_ms, 2),
        "cpu_us_per_agv": round(1000 * cpu_ms / agvs, 1),
        "wall_times_real": round(simulated_s / wall_s, 1),
        **{f"{part}_share": round(spent[part] / total, 3) for part in PARTS},
        "tasks_done": summary.metrics["tasks_done"],
        "deadlocks": summary.metrics["deadlocks_found"],
        "unresolved": summary.metrics["deadlocks_unresolved"],
        "overlaps": summary.metrics["footprint_overlaps"],
        "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }  # fmt: skip


def net_in(folder: Path) -> Path:
    """The net, built if it is not there yet."""
    net = folder / "large.net.xml.gz"
    if not net.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        build_net(generate_layout("large", SLOTS, 64, 500, 64, aisles=65), folder, "large")
    return net


def rows(given: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A row for each fleet."""
    net = net_in(given.folder)
    for agvs in given.agvs:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            yield pool.submit(run, net, agvs, given.planner, given.plant, given.minutes).result()


def main() -> None:
    """Print a row for each fleet, and write them if asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--agvs", type=lambda text: [int(n) for n in text.split(",")], default=[8, 50, 200, 500])
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--plant", default="sumo")
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "parking-sim-large")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    if given.minutes < LEAST_MIN:
        parser.error(f"--minutes: {given.minutes:g}: give {LEAST_MIN:g} or more, what comes before does not count")
    give_out(rows(given), given.csv)


if __name__ == "__main__":
    main()
