"""All planners in all garages with every fault on at once, piece by piece: nothing may meet, lock up or get lost.

    python benchmarks/soak.py --plant discrete --steps 1e7
    python benchmarks/soak.py --plant sumo --steps 1e6 --workers 2
    python benchmarks/soak.py --sum                          what the ledger says
    python benchmarks/soak.py --plant sumo --piece 17        one piece again

Each call adds pieces to the ledger, ``benchmarks/results/soak_ledger.csv``, until they have made ``--steps``
AGV-steps; it goes on with the number after the last one. A piece's number draws everything: a shipped garage or a
random one of ``garages.py``, its fleet, the planner, the demand, rates of all faults far above those of a real garage,
and a script of an operator's commands (stops of everything and of zones, places closed and opened again). In discrete
ticks a watcher looks at each tick that no AGVs share or exchange places; in SUMO the footprint check and SUMO's
collisions do. In both a watcher looks at each grant that it leads through no parked car. Exit code 1 if anything was
found.

``run`` makes a single hour with faults at given rates, for the table in docs/faults.md.
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import random
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from datetime import date
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import garages
import pandas as pd

from analysis.tables import load_run
from parking_sim.versions import code_version
from sumo_nets.graph import Graph
from sumo_nets.numbering import Places

LEDGER = Path(__file__).parent / "results" / "soak_ledger.csv"

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


# --- pieces -----------------------------------------------------------------------------------------------------------

#: Planners with how often they are drawn. In ticks those that plan in every tick are drawn more rarely: they are slow.
PLANNERS = {
    "sumo": {
        "token": 6, "whca": 3, "pbs": 2, "pibt": 2, "lacam": 1, "online_mapf": 1, "astar": 1, "dstar_lite": 1, "cbs": 1,
        "binary_tree": 1,
    },
    "discrete": {
        "token": 40, "whca": 2, "pbs": 2, "pibt": 2, "lacam": 1, "online_mapf": 2, "astar": 1, "dstar_lite": 1,
        "cbs": 1, "binary_tree": 1,
    },
}  # fmt: skip
#: The greatest fleets of planners that search long.
SMALL_FLEETS = {
    "sumo": {"cbs": 3, "lacam": 8, "pbs": 16, "binary_tree": 4, "astar": 6, "dstar_lite": 6, "online_mapf": 8},
    "discrete": {
        "cbs": 3, "lacam": 4, "pbs": 6, "binary_tree": 4, "astar": 6, "dstar_lite": 6, "online_mapf": 6, "whca": 8,
        "pibt": 16,
    },
}  # fmt: skip
#: Shipped garages with their greatest fleets here, and how many random ones are drawn beside them.
SHIPPED = {"map1": 8, "map2": 32, "map3": 64}
#: Cars of the start for each AGV at most, and slots: all of them leave, which takes a small fleet days.
CARS_PER_AGV, SLOTS = 20, {"map1": 61, "map2": 390, "map3": 900}
RANDOM_SHARE = 0.35
#: What an operator's script does.
KINDS = ("all_stop", "zone_stop", "blocked", "bay", "charger", "breakdown", "battery", "stop", "slow")
#: Simulated seconds of demand, and those after which a piece that has not ended has failed.
DEMAND_S, GIVE_UP_S = {"discrete": 14_400.0, "sumo": 3600.0}, {"discrete": 60_000.0, "sumo": 80_000.0}
COLUMNS = (
    "plant", "piece", "garage", "agvs", "planner", "demand", "rate", "script", "agv_steps", "tasks_done", "status",
    "finds", "version", "code", "date",
)  # fmt: skip


def piece(plant: str, number: int) -> dict[str, Any]:
    """Keys of the scenario with a number."""
    rng = random.Random(f"{plant} {number}")
    weights = PLANNERS[plant]
    planner = rng.choices(list(weights), list(weights.values()))[0]
    if rng.random() < RANDOM_SHARE:
        drawn = rng.randrange(10**6)
        garage, agvs = f"random {drawn}", garages.draw(drawn).keys["agvs"]
        per_h, share = 40.0, rng.choice((0.0, 0.5, 1.0))
    else:
        garage = rng.choice(list(SHIPPED))
        agvs = rng.randint(2, min(SHIPPED[garage], SMALL_FLEETS[plant].get(planner, 99)))
        per_h, share = 6.0 * agvs, rng.choice((0.2, 0.5, 0.9))
        share = round(min(share, CARS_PER_AGV * agvs / SLOTS[garage]), 3)
    minutes = DEMAND_S[plant] / 60
    demand: dict[str, Any] = {"kind": rng.choice(("poisson", "bursts")), "duration_min": minutes}
    demand |= {"arrivals_per_h": round(per_h * rng.uniform(0.5, 1.5), 1), "dwell_median_min": rng.choice((5, 20, 60))}
    demand["initial_occupancy"] = share
    if demand["kind"] == "bursts":
        cars = max(1, int(per_h / 4))
        burst = [{"at_min": minutes / 4, "cars": cars, "spread_min": 5}]
        demand["bursts"] = [*burst, {"at_min": minutes / 2, "cars": cars, "spread_min": 5, "wish": "retrieve"}]
    return {"garage": garage, "agvs": agvs, "planner": planner, "seed": number % 2**31, "workload": demand,
            "rate": rng.choice((0.3, 1.0, 3.0)), "script": rng.randint(0, 12)}  # fmt: skip


def commands(
    names: Mapping[str, Sequence[str]], agvs: int, number: int, most: int, until_s: float
) -> list[dict[str, Any]]:
    """A script of an operator who stops, closes and opens at random, and of AGVs that break down meanwhile.

    Args:
        names: places by role, and all of them as "".
        agvs: size of the fleet.
        number: draws the script.
        most: commands.
        until_s: they come before this second.
    """
    rng = random.Random(f"script {number}")
    script = []
    for _ in range(most):
        kind = rng.choice(KINDS)
        row: dict[str, Any] = {"at_s": round(rng.uniform(0, until_s), 1), "kind": kind}
        row["for_s"] = rng.choice((1.0, 30.0, 400.0))
        places = names.get(kind if kind in ("bay", "charger") else "", ())
        if kind in ("bay", "charger", "blocked", "zone_stop"):
            if not places:
                continue
            row["place"] = rng.choice(places)
        elif kind != "all_stop":
            row["agv"] = rng.randrange(agvs)
        script.append(row)
    return script


def scenario_keys(plant: str, number: int) -> dict[str, Any]:
    """A piece as a scenario: its garage built, its faults and its script written out."""
    from sumo_nets.read import read_net

    drawn = piece(plant, number)
    keys = {key: drawn[key] for key in ("garage", "agvs", "planner", "seed", "workload")}
    if keys["garage"].startswith("random "):
        keys["garage"] = str(garages.net_of(int(keys["garage"].split()[1])))
    graph = read_net(keys["garage"]).graph
    names = {"bay": _named(graph, graph.bays), "charger": _named(graph, graph.chargers), "": [*graph.names]}
    script = commands(names, drawn["agvs"], number, drawn["script"], DEMAND_S[plant])
    keys["faults"] = {**faults(drawn["rate"]), "script": script}
    keys |= {"plant": plant, "max_time_s": GIVE_UP_S[plant], "record": {"sample_s": 600.0, "plans": False}}
    return keys


def _named(graph: Graph, places: Places) -> list[str]:
    return [graph.names[v] for v in places]


@contextmanager
def watched_ticks() -> Iterator[list[str]]:
    """Within, each tick of a discrete plant is looked at; what is wrong comes into the list, a line each."""
    from parking_sim.plants.discrete import DiscretePlant

    finds: list[str] = []
    step = DiscretePlant.step

    def watched(plant: DiscretePlant) -> None:
        before = list(plant.at)
        step(plant)
        if len(set(plant.at)) < len(plant.at):
            finds.append(f"{plant.time_s:g} s: two AGVs on one place")
        moved = {(u, v) for u, v in zip(before, plant.at, strict=True) if u != v}
        if any((v, u) in moved for u, v in moved):
            finds.append(f"{plant.time_s:g} s: two AGVs pass through each other")

    DiscretePlant.step = watched  # type: ignore[assignment, method-assign]
    try:
        yield finds
    finally:
        DiscretePlant.step = step  # type: ignore[method-assign]


@contextmanager
def watched_cars() -> Iterator[list[str]]:
    """Within, each grant of a vertex with a parked car is looked at: the AGV has to be the one that works there."""
    from controller.acs import Acs
    from controller.types import Advance

    finds: list[str] = []
    step = Acs.step

    def watched(acs: Acs, now: int, states: Any) -> Any:
        given = step(acs, now, states)
        slots = {v: c.agv for c in given if isinstance(c, Advance) for v in c.vertices if v in acs.garage.slot_of}
        for v in slots.keys() & acs.garage.parked.values() if slots else ():
            task = acs.agvs[slots[v]].task
            if task is None or v not in (task.origin, task.destination):
                finds.append(f"step {now}: AGV {slots[v]} drives through the car in {acs.graph.names[v]}")
        return given

    Acs.step = watched  # type: ignore[assignment, method-assign]
    try:
        yield finds
    finally:
        Acs.step = step  # type: ignore[method-assign]


def make(plant: str, number: int) -> dict[str, Any]:
    """Make a piece: a row of the ledger."""
    from parking_sim.config import check_scenario
    from parking_sim.errors import RunFailedError
    from parking_sim.simulation import simulate
    from sumo_nets.errors import InputError

    drawn = piece(plant, number)
    row: dict[str, Any] = {"plant": plant, "piece": number, **{k: drawn[k] for k in ("garage", "agvs", "planner")}}
    row |= {"demand": drawn["workload"]["kind"], "rate": drawn["rate"], "script": drawn["script"], "agv_steps": 0}
    row |= {"tasks_done": 0, "finds": ""}
    with watched_ticks() as met, watched_cars() as through:
        try:
            summary = simulate(check_scenario(scenario_keys(plant, number), f"piece {number}", Path()))
        except InputError as refusal:  # random garages that can't work, each with its reason
            return _stamped({**row, "status": f"refused: {str(refusal).split(': ', 1)[-1][:100]}"})
        except RunFailedError as error:
            return _stamped({**row, "status": "failed", "finds": str(error)})
        except Exception as error:
            return _stamped({**row, "status": "traceback", "finds": f"{type(error).__name__}: {error}"})
    m = summary.metrics
    row |= {"agv_steps": round(drawn["agvs"] * m["simulated_s"] / (1.0 if plant == "discrete" else 0.5))}
    finds = [*met[:3], *through[:3], *(f"{m[key]} {key}" for key in MUST_BE_ZERO if m[key])]
    finds += [key for key in ("requests_conserved", "cars_conserved") if not m[key]]
    if summary.status != "finished":
        finds += [f"{summary.status}: {m['requests_waiting']} requests are left", *summary.held]
    return _stamped({**row, "tasks_done": m["tasks_done"], "status": summary.status, "finds": "; ".join(finds)})


def _stamped(row: dict[str, Any]) -> dict[str, Any]:
    return {**row, "version": version("parking-sim"), "code": code_version(), "date": date.today().isoformat()}


# --- the ledger -------------------------------------------------------------------------------------------------------


def read_ledger(path: Path) -> pd.DataFrame:
    """All pieces so far."""
    return pd.read_csv(path, keep_default_na=False) if path.is_file() else pd.DataFrame(columns=list(COLUMNS))


def add_pieces(plant: str, steps: float, workers: int, path: Path) -> list[dict[str, Any]]:
    """Make pieces with so many AGV-steps, from the number after the ledger's last one; write each as it ends."""
    ledger = read_ledger(path)
    numbers = count(int(ledger[ledger.plant == plant].piece.max()) + 1 if (ledger.plant == plant).any() else 0)
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), max_tasks_per_child=40) as pool:
        running: set[Future[dict[str, Any]]] = set()
        while running or sum(row["agv_steps"] for row in rows) < steps:
            while len(running) < workers and sum(row["agv_steps"] for row in rows) < steps:
                running.add(pool.submit(make, plant, next(numbers)))
            over, running = wait(running, return_when=FIRST_COMPLETED)
            for row in (future.result() for future in over):
                rows.append(row)
                _append(path, row)
                print("FIND" if row["finds"] else "ok", *(row[key] for key in COLUMNS[:-3]), flush=True)
    return rows


def _append(path: Path, row: Mapping[str, Any]) -> None:
    new = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def in_sum(ledger: pd.DataFrame) -> pd.DataFrame:
    """AGV-steps, pieces, refused ones and finds by plant and planner."""
    ledger = ledger.assign(refused=ledger.status.str.startswith("refused"), found=ledger.finds != "")
    return ledger.groupby(["plant", "planner"]).agg(
        pieces=("piece", "size"), refused=("refused", "sum"), agv_steps=("agv_steps", "sum"),
        tasks=("tasks_done", "sum"), finds=("found", "sum"),
    )  # fmt: skip


def main() -> int:
    """Add pieces, or show one, or the sum."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--plant", choices=("discrete", "sumo"), default="discrete")
    parser.add_argument("--steps", type=float, default=1e6)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--ledger", type=Path, default=LEDGER)
    parser.add_argument("--piece", type=int, help="make this piece only, and write nothing")
    parser.add_argument("--sum", action="store_true", help="show what the ledger says")
    given = parser.parse_args()
    if given.sum:
        table = in_sum(read_ledger(given.ledger))
        print(table.to_string(), table.groupby("plant").sum().to_string(), sep="\n")
        return int(table.finds.any())
    if given.piece is not None:
        row = make(given.plant, given.piece)
        print(json.dumps(scenario_keys(given.plant, given.piece), indent=1), row, sep="\n")
        return int(bool(row["finds"]))
    return int(any(row["finds"] for row in add_pieces(given.plant, given.steps, given.workers, given.ledger)))


if __name__ == "__main__":
    sys.exit(main())
