"""The shipped garages: the demonstration, traffic, saturation, where the time goes, the thesis's grids."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from docs_tables import Row, Rows, RunSet, Table, groups, markdown, mean, total

# --- whole: every car parked, then every car brought back -------------------------------------------------------------

DEMO = (("map1", 4, "token"), ("map1", 4, "whca"), ("map2", 4, "token"), ("map2", 4, "whca"), ("map3", 8, "token"))


def run_whole(case: Row) -> Row:
    """Every car is parked, then every car is brought back."""
    from analysis.replay import write_replay
    from parking_sim.config import load_scenario
    from parking_sim.demo import complaints_of
    from parking_sim.simulation import simulate

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        summary = simulate(load_scenario(case["garage"], case_keys(case)), folder)
        replay = write_replay(folder, report=False).stat().st_size
    kept = (
        "tasks_done", "tasks_wanted", "sumo_collisions", "footprint_overlaps", "least_clearance_m", "deadlocks_found",
        "deadlocks_resolved", "deadlocks_unresolved", "simulated_s", "retrieval_wait_p95_s",
    )  # fmt: skip
    figures: Row = {key: summary.metrics[key] for key in kept}
    return figures | {"replay_mb": replay / 1e6, "complaints": "; ".join(complaints_of(summary))}


def case_keys(case: Row) -> Row:
    """A case's keys of a scenario."""
    return {key: value for key, value in case.items() if key in ("agvs", "planner", "plant", "seed")}


def show_demo(rows: Rows) -> list[str]:
    """A column a run."""
    runs = {(row["garage"], row["agvs"], row["planner"]): row for row in rows if row["plant"] == "sumo"}
    known = [runs[key] for key in DEMO if key in runs]
    lines: dict[str, Callable[[Row], str]] = {
        "AGVs": lambda row: f"{row['agvs']}",
        "tasks done": lambda row: f"{row['tasks_done']:,} of {row['tasks_wanted']:,}",
        "SUMO collisions, overlaps": lambda row: f"{row['sumo_collisions']:.0f}, {row['footprint_overlaps']:.0f}",
        "least clearance, m": lambda row: f"{row['least_clearance_m']:.2f}",
        "deadlocks found, resolved": lambda row: f"{row['deadlocks_found']}, {row['deadlocks_resolved']}",
        "tasks an hour": lambda row: f"{3600 * row['tasks_done'] / row['simulated_s']:.1f}",
        "simulated hours": lambda row: f"{row['simulated_s'] / 3600:.1f}",
    }
    names = [row["garage"] + ("" if row["planner"] == "token" else f", `{row['planner']}`") for row in known]
    return markdown(["", *names], [[name, *map(show, known)] for name, show in lines.items()] if known else [])


def show_fleets(rows: Rows) -> list[str]:
    """A line for each garage and plant of the default planner."""
    lines = []
    ours = sorted((row for row in rows if row["planner"] == "token"), key=lambda row: row["agvs"])
    for (garage, plant), own in sorted(groups(ours, "garage", "plant").items()):
        clearance = min(row["least_clearance_m"] for row in own)
        lines.append(
            [
                garage,
                " / ".join(str(row["agvs"]) for row in own),
                "SUMO" if plant == "sumo" else "ticks",
                " / ".join(f"{row['simulated_s']:,.0f}" for row in own),
                "" if math.isnan(clearance) else f"{clearance:.2f}",
                f"{total(own, 'deadlocks_found')}, {total(own, 'deadlocks_unresolved')}",
                f"{total(own, 'sumo_collisions', 'footprint_overlaps')}",
                "yes" if all(row["tasks_done"] == row["tasks_wanted"] for row in own) else "no",
            ]
        )
    headings = ["garage", "AGVs", "plant", "simulated s (ticks)", "least clearance, m", "deadlocks found, left"]
    return markdown([*headings, "collisions and overlaps", "all tasks done"], lines)


def show_replay_sizes(rows: Rows) -> list[str]:
    """Size of the replay's page."""
    lines = []
    for row in rows:
        if (row["garage"], row["agvs"], row["planner"]) in DEMO and (row["planner"], row["plant"]) == ("token", "sumo"):
            run = f"{row['garage']}, {row['agvs']} AGVs, {row['simulated_s'] / 3600:.1f} hours"
            lines.append([f"{run}, {row['tasks_done']:,} tasks", f"{row['replay_mb']:.2f} MB"])
    return markdown(["run", "file"], lines)


# --- poisson ----------------------------------------------------------------------------------------------------------

#: Two hours of requests for half-full garages; the run goes on until everybody has been served.
TRAFFIC = {
    "kind": "poisson",
    "arrivals_share_per_h": 0.1,
    "dwell_median_min": 40,
    "initial_occupancy": 0.5,
    "duration_min": 120,
}


def run_poisson(case: Row) -> Row:
    """Two hours of Poisson traffic with retrievals by name."""
    from parking_sim.config import load_scenario
    from parking_sim.demo import complaints_of
    from parking_sim.simulation import simulate

    summary = simulate(load_scenario(case["garage"], {**case_keys(case), "workload": TRAFFIC}), None)
    kept = (
        "requests",
        "tasks_done",
        "cars_arrived",
        "cars_left",
        "deadlocks_found",
        "deadlocks_resolved",
        "simulated_s",
    )
    figures: Row = {key: summary.metrics[key] for key in kept}
    return figures | {"complaints": "; ".join(complaints_of(summary))}


def show_poisson(rows: Rows) -> list[str]:
    """A line a garage."""
    lines = [
        [
            row["garage"],
            f"{row['agvs']}",
            f"{row['requests']}",
            f"{row['tasks_done']}",
            f"{row['cars_arrived']}, {row['cars_left']}",
            f"{row['deadlocks_found']}, {row['deadlocks_resolved']}",
            f"{row['simulated_s']:,.0f}",
            row["complaints"] or "all well",
        ]
        for row in rows
    ]
    headings = [
        "garage",
        "AGVs",
        "requests",
        "served",
        "cars arrived, left",
        "deadlocks found, resolved",
        "simulated s",
    ]
    return markdown([*headings, "checks"], lines)


# --- saturation -------------------------------------------------------------------------------------------------------

PLANNERS = ("token", "pbs", "whca")


def run_saturation(case: Row) -> Row:
    """More cars than can be served, both ways."""
    from planners import run

    return run((case["garage"], case["planner"], case["agvs"], case["seed"], case["minutes"], "nearest-task"))


def show_saturation(rows: Rows) -> list[str]:
    """Tasks an hour, with the deadlocks found and left."""
    planners = [planner for planner in PLANNERS if any(row["planner"] == planner for row in rows)]
    lines = []
    for (garage, agvs), own in sorted(groups(rows, "garage", "agvs").items()):
        by_planner = groups(own, "planner")
        lines.append([garage, f"{agvs}", *(_throughput(by_planner.get((planner,), [])) for planner in planners)])
    return markdown(["garage", "AGVs", *(f"`{planner}`" for planner in planners)], lines)


def _throughput(rows: Rows) -> str:
    if not rows:
        return ""
    found, left = total(rows, "deadlocks_found"), total(rows, "deadlocks_unresolved")
    words = f" ({found}{f', {left} left' if left else ''})" if found else ""
    return f"{mean(rows, 'tasks_per_h'):.0f}{words}"


def show_bound(rows: Rows) -> list[str]:
    """How near the default planner comes to the bound."""
    keys = ("bound_share", "alone_share", "cars_at_bay")
    ours = groups([row for row in rows if row["planner"] == "token"], "garage", "agvs")
    lines = [[key[0], f"{key[1]}", *(f"{mean(own, name):.2f}" for name in keys)] for key, own in sorted(ours.items())]
    return markdown(["garage", "AGVs", "`bound_share`", "`alone_share`", "cars at a bay"], lines)


# --- speed ------------------------------------------------------------------------------------------------------------

PARTS = {
    "sumo": "SUMO's own step",
    "plant": "rest of the plant: reading, granting, stops",
    "planning": "planning",
    "execution": "execution: orders, dispatch, garage",
    "record": "recording",
    "check": "footprint check",
}


def run_speed(case: Row) -> Row:
    """Seconds of each part of a run; a short one first compiles the kernels."""
    from speed import measure

    measure(case["garage"], {**case_keys(case), "max_time_s": 200.0})
    found = measure(case["garage"], {**case_keys(case), "max_time_s": case["seconds"]})
    return {f"{part}_s": found["wall_s"][part] for part in PARTS} | {"simulated_s": found["simulated_s"]}


def show_speed(rows: Rows) -> list[str]:
    """Medians of each part as a ratio to SUMO alone."""
    by_planner = {planner: own for (planner,), own in groups(rows, "planner").items()}
    ratios = {
        planner: [float(np.median([row[f"{part}_s"] / row["sumo_s"] for row in own])) for part in PARTS]
        for planner, own in by_planner.items()
    }
    speeds = [
        float(np.median([row["simulated_s"] / sum(row[f"{part}_s"] for part in PARTS) for row in own]))
        for own in by_planner.values()
    ]
    lines = [[words, *(f"{own[n]:.2f}" for own in ratios.values())] for n, words in enumerate(PARTS.values())]
    lines.append(["**all but SUMO**", *(f"**{sum(own) - 1:.2f}**" for own in ratios.values())])
    lines.append(["simulated seconds a wall second, beside other work", *(f"{speed:.0f}" for speed in speeds)])
    return markdown(["part, as a ratio to SUMO alone", *(f"`{planner}`" for planner in by_planner)], lines)


# --- grids ---


def run_grids(case: Row) -> Row:
    """The default planner on a grid of the thesis, in ticks."""
    from grids import measure

    return measure(case["garage"], case["agvs"], case["park_only"])


def show_grids(rows: Rows) -> list[str]:
    """A line a grid."""
    lines = []
    for (garage, agvs), own in groups(rows, "garage", "agvs").items():
        by_end = {row["park_only"]: row for row in own}
        if len(by_end) == 2:
            whole, parking = by_end[False], by_end[True]
            figures = (whole["steps"], whole["nodes_expanded"], parking["nodes_expanded"])
            lines.append([garage.removesuffix("_thesis").upper(), f"{agvs}", *(f"{value:,}" for value in figures)])
    return markdown(["grid", "AGVs", "ticks", "nodes expanded", "while parking"], lines)


def _whole(garage: str, fleets: Sequence[int], plant: str = "sumo", planner: str = "token") -> list[Row]:
    return [{"garage": garage, "agvs": n, "plant": plant, "planner": planner} for n in fleets]


#: Sets in the order in which they are made.
SETS: Mapping[str, RunSet] = {
    "whole": RunSet(
        "every car parked, then every car brought back",
        (
            *_whole("map1", (1, 2, 3, 4)),
            *_whole("map1", (4,), planner="whca"),
            *_whole("map1_thesis", (1, 2, 3, 4)),
            *_whole("map1_thesis", (1, 2, 3, 4), "discrete"),
            *_whole("map3", (8,)),
            *_whole("map2", (4,)),
            *_whole("map2", (4,), planner="whca"),
            *_whole("map2_thesis", (4,), "discrete"),
            *_whole("map3_thesis", (8,), "discrete"),
        ),
        run_whole,
    ),
    "poisson": RunSet(
        "two hours of Poisson traffic, in SUMO",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": "token", "seed": 3}
            for garage, agvs in (("map1", 4), ("map2", 4), ("map3", 8), ("map1_thesis", 4))
        ),
        run_poisson,
    ),
    "saturation": RunSet(
        "mixed traffic, more cars than any fleet could serve, in SUMO",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": planner, "seed": seed, "minutes": 20}
            for garage, fleets in (("map1", (2, 4, 8)), ("map2", (4, 8, 16)))
            for seed in (1, 2, 3)
            for agvs in fleets
            for planner in PLANNERS
        ),
        run_saturation,
    ),
    "speed": RunSet(
        "seconds of each part of a run on map3 with 8 AGVs",
        tuple(
            {"garage": "map3", "agvs": 8, "planner": planner, "seconds": 5000, "repeat": repeat}
            for planner in ("token", "whca")
            for repeat in (1, 2, 3)
        ),
        run_speed,
    ),
    "grids": RunSet(
        "the default planner on the thesis's grids, in ticks",
        tuple(
            {"garage": garage, "agvs": agvs, "park_only": park_only}
            for garage, agvs in (("map1_thesis", 4), ("map2_thesis", 4), ("map3_thesis", 8))
            for park_only in (True, False)
        ),
        run_grids,
    ),
}

TABLES: Mapping[str, Table] = {
    "demo": Table("whole", show_demo),
    "fleets": Table("whole", show_fleets),
    "replay-sizes": Table("whole", show_replay_sizes),
    "poisson": Table("poisson", show_poisson),
    "saturation": Table("saturation", show_saturation),
    "bound": Table("saturation", show_bound),
    "speed": Table("speed", show_speed),
    "grids": Table("grids", show_grids),
}
