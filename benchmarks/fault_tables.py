"""Faults, noise and stops: what is kept of the throughput."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import numpy as np
from docs_tables import Row, Rows, RunSet, Table, groups, markdown, mean, percent, total

# --- faults -----------------------------------------------------------------------------------------------------------


def run_noise(case: Row) -> Row:
    """All cars wanted in at once, with noise on the time of every move."""
    from stops import in_sumo

    control = {"replanning": case["replanning"], "reorder": case["reorder"]}
    faults = {"travel_noise": case["sigma"]}
    return in_sumo(case["garage"], case["agvs"], case["planner"], case["seed"], math.inf, faults, control)


def show_noise(rows: Rows) -> list[str]:
    """Tasks done by noise and way to answer it."""
    sigmas = sorted({row["sigma"] for row in rows})
    lines = []
    for (replanning, reorder), own in groups(rows, "replanning", "reorder").items():
        by_sigma = groups(own, "sigma")
        cells = [f"{mean(by_sigma[sigma,], 'done'):.1f}" if (sigma,) in by_sigma else "" for sigma in sigmas]
        lines.append([replanning, "switched" if reorder else "kept", *cells])
    return markdown(["replanning", "orders", *(f"sigma {sigma:g}" for sigma in sigmas)], lines)


def run_soak(case: Row) -> Row:
    """An hour with every fault on at once, or with none."""
    from soak import run

    row = run(
        (case["garage"], case["agvs"], case["demand"], case["minutes"]), case["seed"], case["planner"], case["rate"]
    )
    kept = ("tasks_per_h", "agv_steps", "sumo_collisions", "footprint_overlaps", "lost", "deadlocks_found")
    figures: Row = {key: row[key] for key in (*kept, "deadlocks_unresolved", "status")}
    return figures | {"faults": json.dumps({kind: [round(s) for s in row["faults"][kind]] for kind in row["faults"]})}


def show_soak(rows: Rows) -> list[str]:
    """What is kept of the throughput, and what must not happen."""
    lines = []
    for (garage, agvs, demand), own in groups(rows, "garage", "agvs", "demand").items():
        hard, calm = [row for row in own if row["rate"]], [row for row in own if not row["rate"]]
        if hard and calm:
            with_faults, without = mean(hard, "tasks_per_h"), mean(calm, "tasks_per_h")
            lines.append(
                [
                    garage,
                    f"{agvs}",
                    "steady" if demand == "poisson" else demand,
                    f"{total(hard, 'agv_steps'):,}",
                    f"{total(hard, 'sumo_collisions', 'footprint_overlaps')}",
                    f"{total(hard, 'lost')}",
                    f"{total(hard, 'deadlocks_found')}, {total(hard, 'deadlocks_unresolved')}",
                    f"{with_faults:.1f}",
                    f"{without:.1f}",
                    percent(with_faults / without),
                ]
            )
    headings = [
        "garage",
        "AGVs",
        "demand",
        "AGV-steps",
        "collisions, overlaps",
        "requests, cars lost",
        "deadlocks found, left",
    ]
    return markdown([*headings, "tasks an hour with faults", "without", "kept"], lines)


def show_recovery(rows: Rows) -> list[str]:
    """How long faults last, by kind."""
    seconds: dict[str, list[float]] = {}
    for row in rows:
        for kind, found in json.loads(row["faults"]).items():
            seconds.setdefault(kind.replace("_", " "), []).extend(found)
    lines = [
        [kind, f"{len(found):,}", *(f"{value:,.0f}" for value in np.quantile(found, (0.5, 0.95)))]
        for kind, found in sorted(seconds.items())
        if found
    ]
    return markdown(["fault", "times", "seconds from begin to end, p50", "p95"], lines)


# --- stops ---


def run_stops(case: Row) -> Row:
    """The warehouse grid without stops, with stops, and with stops when fewer tasks come."""
    from stops import DEFAULT, EVERYTHING, SHARE, in_warehouse

    def done(share: float, answer: tuple[str, bool], tasks: float = math.inf) -> Row:
        control = {"replanning": answer[0], "reorder": answer[1]}
        return in_warehouse("token", case["agvs"], share, case["seed"], tasks, control)

    calm, hard, switched = done(0.0, DEFAULT), done(SHARE, DEFAULT), done(SHARE, EVERYTHING)
    kept = {
        f"kept_at_{load:.0%}": done(SHARE, DEFAULT, load * calm["done"])["done"]
        / done(0.0, DEFAULT, load * calm["done"])["done"]
        for load in (0.8, 0.9)
    }
    return {"calm": calm["done"], "hard": hard["done"], "switched": switched["done"], "stopped": hard["stopped"]} | kept


def show_stops(rows: Rows) -> list[str]:
    """A line a fleet."""
    lines = []
    for (agvs,), own in groups(rows, "agvs").items():
        calm, hard, stopped = mean(own, "calm"), mean(own, "hard"), mean(own, "stopped")
        shares = [
            hard / calm,
            1 - stopped,
            mean(own, "switched") / calm,
            mean(own, "kept_at_80%"),
            mean(own, "kept_at_90%"),
        ]
        lines.append([f"{agvs}", percent(stopped), f"{calm:,.0f}", f"{hard:,.0f}", *map(percent, shares)])
    headings = ["AGVs", "stopped", "tasks without", "with stops", "kept", "ceiling", "kept, switched"]
    return markdown([*headings, "kept at 80 % of the load", "at 90 %"], lines)


#: Sets in the order in which they are made.
SETS: Mapping[str, RunSet] = {
    "noise": RunSet(
        "all cars wanted in at once on map2 with 16 AGVs, 20 minutes, noise on the time of each move, in SUMO",
        tuple(
            {
                "garage": "map2",
                "agvs": 16,
                "planner": "token",
                "sigma": sigma,
                "replanning": replanning,
                "reorder": reorder,
                "seed": seed,
            }
            for seed in (1, 2, 3)
            for replanning, reorder in (("periodic", False), ("events", False), ("both", True))
            for sigma in (0.0, 0.2, 0.4)
        ),
        run_noise,
    ),
    "soak": RunSet(
        "all faults at once, in SUMO",
        tuple(
            {
                "garage": garage,
                "agvs": agvs,
                "demand": demand,
                "minutes": 60.0,
                "planner": "token",
                "seed": 0,
                "rate": rate,
            }
            for garage, agvs in (("map1", 8), ("map2", 8), ("map2", 16))
            for demand in ("poisson", "bursts")
            for rate in (0.0, 1.0)
        ),
        run_soak,
    ),
    "stops": RunSet(
        "lifelong tasks on a warehouse grid with AGVs that stop",
        tuple({"agvs": agvs, "seed": seed} for agvs in (8, 16, 32, 64) for seed in (1, 2, 3)),
        run_stops,
    ),
}

TABLES: Mapping[str, Table] = {
    "noise": Table("noise", show_noise),
    "soak": Table("soak", show_soak),
    "recovery": Table("soak", show_recovery),
    "stops": Table("stops", show_stops),
}
