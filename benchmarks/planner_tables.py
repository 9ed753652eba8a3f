"""Planners side by side: batches of departures, the optimum, lifelong tasks, ten thousand slots, sizing."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from docs_tables import Row, Rows, RunSet, Table, groups, markdown, percent, total

# --- departures -------------------------------------------------------------------------------------------------------


def run_departures(case: Row) -> Row:
    """Batches of loaded departures, planned at once."""
    from departures import measure

    return measure(case["garage"], case["agvs"], case["planner"])


def show_departures(rows: Rows) -> list[str]:
    """A line a garage and fleet, then the time."""
    by_planner = {planner: own for (planner,), own in groups(rows, "planner").items()}
    lines = []
    for garage, agvs in groups(rows, "garage", "agvs"):
        fleet = [row for row in rows if (row["garage"], row["agvs"]) == (garage, agvs)]
        delays = {row["planner"]: f"{row['delay']:.2f}" for row in fleet}
        lines.append([f"{garage}, {agvs} AGVs: delay in moves", *(delays.get(planner, "") for planner in by_planner)])
    times = [[row["cpu_ms"] for row in own] for own in by_planner.values()]
    lines.append(["CPU milliseconds a batch", *(f"{min(own):.1f} to {max(own):.0f}" for own in times)])
    lines.append(["agents that hold their place", *(f"{total(own, 'held')}" for own in by_planner.values())])
    return markdown(["means of 10 batches, 40 moves ahead", *(f"`{planner}`" for planner in by_planner)], lines)


# --- sizing -----------------------------------------------------------------------------------------------------------


def run_sizing(case: Row) -> Row:
    """Sizing beside a grid of all fleets with 30 seeds."""
    from sizing import SEEDS, both, grid, scenario, spread

    from parking_sim.sizing import parse_target

    target = parse_target(case["target"])
    with tempfile.TemporaryDirectory() as folder:  # of its own: several cases may be made at once
        given = argparse_of(case, Path(folder))
        values = grid(scenario(given, target.goes_on_s), [target], given)[target.key]
    found, best = both(target, values)
    whole = len(SEEDS) * case["most"]
    pairs = [both(one, values) for one in spread(target.key, values, 60)]
    shares = [one.runs / whole for one, _ in pairs]
    return {
        "grid": "none" if best is None else str(best),
        "answer": "none" if found.number is None else str(found.number),
        "runs": found.runs,
        "grid_runs": whole,
        "limits_agree": sum(best == one.number for one, best in pairs),
        "limits": len(pairs),
        "share_mean": float(np.mean(shares)),
        "share_most": max(shares),
    }


def argparse_of(case: Row, folder: Path) -> Any:
    """The options of ``sizing.py``."""
    from argparse import Namespace

    return Namespace(
        garage=case["garage"], most=case["most"], profile="mall-saturday", scale=case["scale"], hours=0.5,
        plant=case["plant"], folder=folder, workers=1,
    )  # fmt: skip


def show_sizing(rows: Rows) -> list[str]:
    """The answers side by side, and how many runs they took."""
    lines = [
        [
            f"{row['garage']}, 1 to {row['most']} AGVs, {row['grid_runs']} runs",
            row["target"],
            f"{row['grid']}",
            f"{row['answer']}",
            f"{row['runs']}",
            percent(row["runs"] / row["grid_runs"]),
            f"{row['limits_agree']} of {row['limits']}",
            f"{percent(row['share_mean'])}, {percent(row['share_most'])}",
        ]
        for row in rows
    ]
    headings = ["garage, grid", "target", "grid", "sizing", "runs", "of the grid", "other limits: answers agree"]
    return markdown([*headings, "of the grid, mean and most"], lines)


# --- lifelong, optimality, large ---

#: Map and fleet -> figures of public solvers: share of the ideal of PBS, WHCA* and PIBT.
PUBLIC: Mapping[tuple[str, int], tuple[str, str, str]] = {
    ("garage", 4): (".96", ".97", ".49"),
    ("garage", 8): (".91", ".89", ".52"),
    ("garage", 16): (".92", ".84", ".31"),
    ("garage", 32): (".83", ".69", ".23"),
    ("garage", 64): (".65", "jams", ".07"),
    ("warehouse", 10): (".96", ".98", ".94"),
    ("warehouse", 50): (".88", ".80", ".77"),
    ("warehouse", 100): (".76", ".61", ".54"),
    ("warehouse", 200): ("jams", "jams", ".31"),
}
LIFELONG = ("token", "pbs", "whca", "pibt")
#: Fleets from which on PBS, which takes long, is given one seed.
PBS_ONE_SEED = {"garage": 64, "long_garage": 64, "warehouse": 100}


def run_lifelong(case: Row) -> Row:
    """Lifelong tasks on a grid, one move a tick."""
    from lifelong import MAPS, OPTIONS, measure

    graph, planner = MAPS[case["map"]](), case["planner"]
    options = OPTIONS.get(planner, {})
    measure(graph, 2, planner, 1, 20, options)
    row = measure(graph, case["agents"], planner, case["seeds"], 1000, options, case["repeats"])
    return {key: value for key, value in row.items() if key not in case} | {
        "share": float(str(row["tasks_per_tick"])) / float(str(row["ideal"]))
    }


def show_lifelong(rows: Rows) -> list[str]:
    """Shares of the ideal beside public ones, and milliseconds of planning a tick."""
    lines = []
    for (name, agents), own in groups(rows, "map", "agents").items():
        found = {row["planner"]: row for row in own}
        shares = [f"{found[p]['share']:.2f}".removeprefix("0") if p in found else "" for p in LIFELONG]
        times = [_brief(found[p]["planning_ms"]) if p in found else "" for p in LIFELONG[:3]]
        lines.append(
            [name.replace("_", " "), f"{agents}", *PUBLIC[name.removeprefix("long_"), agents], *shares, *times]
        )
    headings = ["map", "AGVs", "public PBS", "public WHCA*", "public PIBT", *(f"`{planner}`" for planner in LIFELONG)]
    return markdown([*headings, "ms a tick: `token`", "`pbs`", "`whca`"], lines)


def _brief(value: float) -> str:
    """Two digits that tell."""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def run_optimality(case: Row) -> Row:
    """Ratios to CBS of some random problems, of those that CBS solves; null where a planner finds no plan."""
    from optimality import PLANNERS as ASKED
    from optimality import rows

    done = list(rows(range(case["first"], case["first"] + case["problems"])))
    found = {name: [None if math.isnan(r := float(str(row[name]))) else r for row in done] for name in ASKED}
    return {"solved": len(done), "ratios": json.dumps(found)}


def show_optimality(rows: Rows) -> list[str]:
    """A line a planner."""
    ratios: dict[str, list[float]] = {}
    for row in rows:
        for planner, found in json.loads(row["ratios"]).items():
            ratios.setdefault(planner, []).extend(math.nan if ratio is None else ratio for ratio in found)
    lines = []
    for planner, every in ratios.items():
        solved = np.array([ratio for ratio in every if not math.isnan(ratio)])
        shares = [f"{share:.2f}".removeprefix("0") for share in (len(solved) / len(every), np.mean(solved < 1 + 1e-9))]
        worst = [f"{value:.2f}" for value in (*np.quantile(solved, (0.9, 0.99)), solved.max())]
        lines.append([f"`{planner}`", *shares, f"{solved.mean():.3f}", *worst])
    known, asked = total(rows, "solved"), total(rows, "problems")
    headings = ["solves", "optimal, of what it solves", "mean ratio", "p90", "p99", "worst"]
    return markdown([f"of {known} of {asked} problems, solved by CBS", *headings], lines)


def run_large(case: Row) -> Row:
    """A garage of 10,000 slots in SUMO."""
    from large import net_in, run

    row = run(net_in(Path(tempfile.gettempdir()) / "parking-sim-large"), case["agvs"], "token", "sumo", case["minutes"])
    return {key: value for key, value in row.items() if key not in case}


def show_large(rows: Rows) -> list[str]:
    """A line a fleet."""
    lines = [
        [
            f"{row['agvs']}",
            f"{row['cpu_ms']:.1f}",
            f"{row['cpu_us_per_agv']:.0f}",
            f"{row['cpu_times_real']:.0f}",
            f"{row['memory_mb']:,}",
            f"{row['deadlocks']}",
        ]
        for row in rows
    ]
    return markdown(
        ["AGVs", "CPU a step, ms", "of an AGV, microseconds", "times real time, by CPU", "memory, MB", "deadlocks"],
        lines,
    )


#: Sets in the order in which they are made.
SETS: Mapping[str, RunSet] = {
    "departures": RunSet(
        "batches of departures planned at once",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": planner}
            for garage, agvs in (("map1", 4), ("map1", 8), ("map2", 8), ("map2", 16))
            for planner in ("whca", "ga_single", "ga_two_stage", "binary_tree")
        ),
        run_departures,
    ),
    "optimality": RunSet(
        "random small garages, sum of arrivals over the optimum",
        tuple({"first": first, "problems": 20} for first in range(0, 200, 20)),
        run_optimality,
    ),
    "large": RunSet(
        "a garage of 10,000 slots, in SUMO",
        tuple({"agvs": agvs, "minutes": 10} for agvs in (8, 50, 200, 500)),
        run_large,
    ),
    "lifelong": RunSet(
        "lifelong tasks on grids",
        tuple(
            {
                "map": name,
                "agents": agents,
                "planner": planner,
                "seeds": 1 if planner == "pbs" and agents >= PBS_ONE_SEED[name] else 3,
                "repeats": 3 if planner in ("token", "whca") else 1,
            }
            for name, fleets in (
                ("garage", (4, 8, 16, 32, 64)),
                ("long_garage", (4, 8, 16, 32, 64)),
                ("warehouse", (10, 50, 100, 200)),
            )
            for agents in fleets
            for planner in LIFELONG
        ),
        run_lifelong,
    ),
    "sizing": RunSet(
        "sizing against a grid of all fleets, in ticks",
        tuple(
            {"garage": "map1", "most": 8, "scale": 0.25, "plant": "discrete", "target": target}
            for target in (
                "retrieval p95 < 60 s",
                "retrieval p95 < 52 s",
                "retrieval mean < 50 s",
                "retrieval p95 < 45 s",
            )
        ),
        run_sizing,
    ),
}

TABLES: Mapping[str, Table] = {
    "departures": Table("departures", show_departures),
    "sizing": Table("sizing", show_sizing),
    "optimality": Table("optimality", show_optimality),
    "large": Table("large", show_large),
    "lifelong": Table("lifelong", show_lifelong),
}
