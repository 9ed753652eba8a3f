"""What stops and delays cost: throughput kept under random stops, and under noise for each way to replan.

    python benchmarks/stops.py [--part warehouse,map3,noise] [--planner token,whca] [--seeds 3] [--loads 0.7,0.8,0.9]
                               [--agvs 8,16,32,64] [--csv FILE] [--figure FILE]

- *warehouse*: lifelong tasks on a warehouse grid, a cell a tick (see ``lifelong.py``); AGVs stop for 2 to 8 ticks.
- *map3*: SUMO, an hour, all cars wanted in at once; AGVs stop for as long as 2 to 8 moves take.
- *noise*: SUMO, map2, 20 minutes; log-normal noise on the time of each move, replanning periodically, at events or
  both, with orders kept and with orders switched.

Stops take about 14 % of the AGVs' time, and nobody is told how long they last. Runs are paired: the same seed, so the
same tasks and stops, or moves. As an AGV that stops does nothing, ``ceiling`` is what is left of its time: a fleet that
is never idle can't keep more, one that waits for bays or customers can. Therefore the first two are also run at each of
the loads: then tasks come one by one (in map3 as a Poisson process), so many as are that part of what the fleet does
without stops when there is always more to do.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from lifelong import OPTIONS, Lifelong, warehouse
from rows import give_out

from analysis.measures import interval
from analysis.tables import load_run
from controller.fleet import Agv
from controller.types import AgvState
from sumo_nets.numbering import numbered

FLEETS = (8, 16, 32, 64)
LOADS = (0.7, 0.8, 0.9)
SHARE, MOVES = 0.14, (2, 8)
TICKS = 600
SECONDS = {"map2": 1200.0, "map3": 3600.0}
#: Seconds of a move in SUMO on map3: 7 m with a car.
MOVE_S = 7.0
SIGMAS = (0.0, 0.1, 0.2, 0.4)
POLICIES = ("periodic", "events", "both")
#: Replanning and reordering: the default, and all at once.
DEFAULT, EVERYTHING = ("periodic", False), ("both", True)
Row = dict[str, Any]


class Stopping(Lifelong):
    """Lifelong tasks of AGVs that stop now and then.

    Attributes:
        stood: ticks that AGVs stood because of a stop.
        rate: tasks that come in a tick; each AGV's first one is there from the start.
    """

    stood = 0
    rate = math.inf

    def stop(self, share: float, seed: int) -> None:
        """Let each AGV stop for 2 to 8 ticks, in all for a share of its time."""
        mean = sum(MOVES) / 2
        self._stops = random.Random(seed)
        self._chance = share / (1 - share) / mean
        self._until = [0] * len(self.agvs)
        self._idle: set[int] = set()

    def _arrived(self, agv: Agv, step: int) -> None:
        self.done += agv.number not in self._idle
        self._idle.add(agv.number)
        if len(self.trips) < self.rate * step:
            self._idle.remove(agv.number)
            self._new_goal(agv)

    def states(self, step: int) -> list[AgvState]:
        """AGVs that stop take no orders."""
        for n, until in enumerate(self._until):
            if until <= step and self._stops.random() < self._chance:
                self._until[n] = step + self._stops.randint(*MOVES)
        able = [until <= step for until in self._until]
        self.stood += able.count(False)
        return [AgvState(n, c, c, True, able=able[n]) for n, c in numbered(self.count)]


def in_warehouse(planner: str, agvs: int, share: float, seed: int, tasks: float, control: Row) -> Row:
    """Tasks done on the warehouse grid of so many that come, and the share of time that stops took."""
    run = Stopping(warehouse(), agvs, planner, seed, OPTIONS.get(planner, {}), watch_steps=1, **control)
    run.stop(share, seed)
    run.rate = tasks / TICKS
    run.run(TICKS)
    return {"done": run.done, "stopped": run.stood / (agvs * TICKS)}


def in_sumo(garage: str, agvs: int, planner: str, seed: int, tasks: float, faults: Row, control: Row) -> Row:
    """Tasks done in a garage in SUMO of so many that come, and the share of time that stops took."""
    from parking_sim.config import check_scenario
    from parking_sim.simulation import simulate

    data: Row = {"garage": garage, "agvs": agvs, "planner": planner, "seed": seed, "duration_s": SECONDS[garage]}
    workload = {"kind": "park_exit"} if tasks == math.inf else _parking(tasks, SECONDS[garage])
    data |= {"workload": workload, "faults": faults, "control": control, "record": {"sample_s": 60.0}}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        metrics = simulate(check_scenario(data, "stops", Path()), out).metrics
        events = load_run(out).events
    stood, begun = 0.0, {}
    seen = events[events["kind"].isin(("fault_start", "fault_end"))]
    for time_s, kind, detail in seen[["time_s", "kind", "detail"]].itertuples(index=False):
        fault = json.loads(detail)
        if fault["cause"] == "stop" and kind == "fault_start":
            begun[fault["fault"]] = time_s
        elif fault["cause"] == "stop":
            stood += time_s - begun.pop(fault["fault"])
    stood += sum(SECONDS[garage] - time_s for time_s in begun.values())
    if metrics["sumo_collisions"] or metrics["footprint_overlaps"]:
        raise RuntimeError(f"{garage}, {agvs} AGVs, seed {seed}: AGVs met")
    return {"done": metrics["tasks_done"], "stopped": stood / (agvs * SECONDS[garage])}


def _parking(tasks: float, seconds: float) -> Row:
    """So many cars that come in the run, and stay."""
    return {
        "kind": "poisson",
        "arrivals_per_h": tasks * 3600 / seconds,
        "dwell_median_min": 10000,
        "duration_min": seconds / 60,
    }


def stops_in_sumo() -> Row:
    """Stops as long as 2 to 8 moves that take ``SHARE`` of an AGV's time."""
    least_s, most_s = (n * MOVE_S for n in MOVES)
    per_h = 3600.0 * SHARE / (1 - SHARE) / ((least_s + most_s) / 2)
    return {"stop": {"per_h": per_h, "least_s": least_s, "most_s": most_s}}


def runs(given: argparse.Namespace) -> Iterator[Row]:
    """A row for each run; pairs differ in ``stops`` or ``control`` alone."""
    for part in given.part.split(","):
        for planner in given.planner.split(","):
            most: dict[int, float] = {}
            for key in noise_cases() if part == "noise" else stop_cases(given.agvs, given.loads):
                tasks = math.inf if key["load"] == math.inf else key["load"] * most[key["agvs"]]
                done = []
                for seed in range(1, given.seeds + 1):
                    row = {"part": part, "planner": planner, "seed": seed, **key}
                    row |= _run(part, planner, seed, tasks, key)
                    done.append(row["done"])
                    yield row
                if tasks == math.inf and not key["stops"]:
                    most[key["agvs"]] = float(np.mean(done))


def stop_cases(fleets: Sequence[int], loads: Sequence[float]) -> Iterator[Row]:
    """Fleets without stops, with stops, and with stops answered by everything; this only where there is always more."""
    for agvs in fleets:
        for load in (math.inf, *loads):
            for stops, replanning, reorder in ((False, *DEFAULT), (True, *DEFAULT), (True, *EVERYTHING)):
                if load == math.inf or not reorder:
                    yield {
                        "agvs": agvs, "load": load, "stops": stops, "sigma": 0.0, "replanning": replanning,
                        "reorder": reorder,
                    }  # fmt: skip


def noise_cases() -> Iterator[Row]:
    """Noise and the ways to answer it."""
    for sigma in SIGMAS:
        for replanning in POLICIES:
            for reorder in (False, True):
                yield {
                    "agvs": 16,
                    "load": math.inf,
                    "stops": False,
                    "sigma": sigma,
                    "replanning": replanning,
                    "reorder": reorder,
                }


def _run(part: str, planner: str, seed: int, tasks: float, key: Row) -> Row:
    control = {"replanning": key["replanning"], "reorder": key["reorder"]}
    if part == "warehouse":
        return in_warehouse(planner, key["agvs"], SHARE * key["stops"], seed, tasks, control)
    faults: Row = stops_in_sumo() if key["stops"] else {"travel_noise": key["sigma"]}
    return in_sumo("map3" if part == "map3" else "map2", key["agvs"], planner, seed, tasks, faults, control)


def print_stops(rows: Sequence[Row], part: str) -> None:
    """Throughput kept under stops by fleet, load and planner; intervals over the pairs."""
    words = "planner", "AGVs", "load", "stopped", "tasks without", "with stops", "kept", "ceiling", "switched: kept"
    print(f"\n{part}\n\n| {' | '.join(words)} |\n" + "|---" * len(words) + "|")
    ours = [r for r in rows if r["part"] == part]
    for planner, agvs, load in dict.fromkeys((r["planner"], r["agvs"], r["load"]) for r in ours):
        same = [r for r in ours if (r["planner"], r["agvs"], r["load"]) == (planner, agvs, load)]
        calm = {r["seed"]: r["done"] for r in same if not r["stops"]}
        hard, switched = ([r for r in same if r["stops"] and r["reorder"] is answer] for answer in (False, True))
        stood = float(np.mean([r["stopped"] for r in hard]))
        cells = f"{planner} | {agvs} | {load:.0%}" if load < math.inf else f"{planner} | {agvs} | always more"
        cells += f" | {stood:.1%} | {np.mean(list(calm.values())):.0f} | {np.mean([r['done'] for r in hard]):.0f}"
        print(f"| {cells} | {_kept(hard, calm)} | {1 - stood:.0%} | {_kept(switched, calm) if switched else ''} |")


def _kept(hard: Sequence[Row], calm: Row) -> str:
    kept = interval([r["done"] / calm[r["seed"]] for r in hard])
    return f"{kept.mean:.0%}" + (f" ({kept.low:.0%} to {kept.high:.0%})" if kept.runs > 1 else "")


def print_noise(rows: Sequence[Row]) -> None:
    """Tasks by noise and policy, and what each changes against replanning periodically with orders kept."""
    print(
        "\n| planner | replanning | orders | "
        + " | ".join(f"sigma {s:g}" for s in SIGMAS)
        + " |\n|---"
        + "|---" * 6
        + "|"
    )
    for planner in dict.fromkeys(row["planner"] for row in rows):
        done = {
            (r["replanning"], r["reorder"], r["sigma"], r["seed"]): r["done"]
            for r in rows if r["part"] == "noise" and r["planner"] == planner
        }  # fmt: skip
        seeds = sorted({key[3] for key in done})
        for policy in POLICIES:
            for reorder in (False, True):
                cells = []
                for sigma in SIGMAS:
                    ours = [done[policy, reorder, sigma, s] for s in seeds]
                    change = interval(
                        [a / done["periodic", False, sigma, s] - 1 for a, s in zip(ours, seeds, strict=True)]
                    )
                    first = policy == "periodic" and not reorder
                    words = "" if first else f" ({change.mean:+.1%}, {change.low:+.0%} to {change.high:+.0%})"
                    cells.append(f"{np.mean(ours):.0f}{words}")
                print(f"| {planner} | {policy} | {'switched' if reorder else 'kept'} | {' | '.join(cells)} |")


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw tasks done against noise, a panel for each planner."""
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, GREEN, ORANGE, WIDTH_IN, style

    noise = [r for r in rows if r["part"] == "noise"]
    planners = list(dict.fromkeys(r["planner"] for r in noise))
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        for axes, planner in zip(
            figure.subplots(1, len(planners), sharey=True, squeeze=False)[0], planners, strict=True
        ):
            for policy, colour in zip(POLICIES, (BLUE, ORANGE, GREEN), strict=True):
                for reorder in (False, True):
                    ours = [
                        r for r in noise if (r["planner"], r["replanning"], r["reorder"]) == (planner, policy, reorder)
                    ]
                    means = [np.mean([r["done"] for r in ours if r["sigma"] == sigma]) for sigma in SIGMAS]
                    label = f"{policy}, orders {'switched' if reorder else 'kept'}"
                    axes.plot(SIGMAS, means, "--s" if reorder else "-o", color=colour, markersize=4, label=label)
            axes.set(title=f"{planner}: tasks in {SECONDS['map2'] / 60:.0f} minutes", xlabel="sigma of the noise")
        axes.legend(fontsize=7)
        figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Make the runs, print the tables, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--part", default="warehouse,map3,noise")
    parser.add_argument("--planner", default="token,whca")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--agvs", type=lambda text: [int(n) for n in text.split(",")], default=FLEETS)
    parser.add_argument("--loads", type=lambda text: [float(x) for x in text.split(",")], default=LOADS)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    parts = given.part.split(",")
    rows = give_out(runs(given), given.csv)
    for part in (part for part in parts if part != "noise"):
        print_stops(rows, part)
    if "noise" in parts:
        print_noise(rows)
        if given.figure:
            draw(rows, given.figure)


if __name__ == "__main__":
    main()
