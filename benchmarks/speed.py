"""Where the wall time of a run goes, and how much everything else costs against SUMO alone.

    python benchmarks/speed.py [--garage map3] [--agvs 8] [--planner token] [--seconds 20000] [--repeats 3]

The parts are measured side by side in one run: SUMO's own step, the rest of the plant, planning, execution (the rest of
the controller), recording and the footprint check. A short run first compiles the kernels.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from parking_sim.config import DEFAULT_PLANNER, load_scenario
from parking_sim.simulation import simulate

PARTS = ("sumo", "plant", "planning", "execution", "record", "check")


def main() -> None:
    """Print seconds, microseconds a step and the ratio to SUMO alone for each part; medians over the repeats."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--garage", default="map3")
    parser.add_argument("--agvs", type=int, default=8)
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    parser.add_argument("--seconds", type=float, default=20000.0)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    asked = {"agvs": given.agvs, "planner": given.planner}
    measure(given.garage, {**asked, "max_time_s": 200.0})
    runs = [measure(given.garage, {**asked, "max_time_s": given.seconds}) for _ in range(given.repeats)]
    steps = runs[0]["simulated_s"] / runs[0]["step_s"]
    walls = [run["wall_s"] for run in runs]
    sumo = median(wall["sumo"] for wall in walls)
    print(f"{given.garage}, {given.agvs} AGVs, {given.planner}, {steps:.0f} steps, median of {len(runs)} runs")
    print(f"{'part':12}{'s':>9}{'us/step':>10}{'ratio to SUMO':>15}")
    for part in PARTS:
        seconds = median(wall[part] for wall in walls)
        print(f"{part:12}{seconds:9.2f}{seconds / steps * 1e6:10.1f}{seconds / sumo:15.2f}")
    rest = median(sum(wall[part] for part in PARTS[1:]) / wall["sumo"] for wall in walls)
    speed = median(run["simulated_s"] / sum(run["wall_s"][part] for part in PARTS) for run in runs)
    print(f"all the rest to SUMO alone: {rest:.2f}")
    print(f"simulated seconds per wall second: {speed:.0f}")


def measure(garage: str, asked: dict[str, object]) -> dict[str, Any]:
    """What a run says of itself in run.json."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(load_scenario(garage, asked), Path(folder))
        found: dict[str, Any] = json.loads((Path(folder) / "run.json").read_text())
    return found


if __name__ == "__main__":
    main()
