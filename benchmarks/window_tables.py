"""Windows of ``whca`` that are held, and the window that adapts; see docs/controllers.md."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from docs_tables import Row, Rows, RunSet, Table, groups, markdown, mean, total

#: Windows that are held, in moves; 0 is the window that adapts.
WINDOWS = (5, 11, 21, 31, 0)
CAUSES = ("ring", "idle", "stuck")

CASES: tuple[Row, ...] = (
    *(
        {"garage": garage, "agvs": 4, "planner": planner, "window": window}
        for garage in ("map1", "map2")
        for planner, window in (("astar", 0), ("dstar_lite", 0), *(("whca", window) for window in WINDOWS))
    ),
    *({"garage": "map3", "agvs": 8, "planner": planner, "window": 0} for planner in ("astar", "dstar_lite", "whca")),
)

#: Least and greatest window of ``whca``, and how far boost and partial CBS follow the traffic.
RANGES = (
    *((*moves, 1, 1) for moves in ((11, 21), (5, 11), (5, 31), (11, 31), (21, 31), (5, 5))),
    (5, 5, 3, 1),
    (5, 5, 1, 4),
)
SEEDED: tuple[Row, ...] = tuple(
    {"least": least, "most": most, "boost": boost, "cbs": cbs, "seed": seed}
    for least, most, boost, cbs in RANGES
    for seed in range(5)
)


def run_window(case: Row) -> Row:
    """A row of the thesis under its rules, with the window held or not."""
    held = case["window"]
    keys: Row = {
        "agvs": case["agvs"],
        "planner": case["planner"],
        "rules": "thesis",
        "workload": {"kind": "park_exit", "park_only": case["garage"] != "map1", "order": "parked"},
        "control": {"window_cells": held, "window_min": held, "window_max": held} if held else {},
    }
    return _figures(case["garage"], keys)


def run_range(case: Row) -> Row:
    """MAP1 with 4 AGVs under fair rules, cars fetched by name in a random order."""
    keys: Row = {
        "agvs": 4,
        "planner": "whca",
        "rules": "fair",
        "seed": case["seed"],
        "workload": {"kind": "park_exit", "order": "random"},
        "control": {
            "window_min": case["least"],
            "window_max": case["most"],
            "adapt_boost": case["boost"],
            "adapt_cbs": case["cbs"],
        },
    }
    return _figures("map1", keys)


def _figures(garage: str, keys: Row) -> Row:
    from analysis.tables import load_run
    from parking_sim.config import load_scenario
    from parking_sim.simulation import simulate

    keys = {**keys, "plant": "discrete", "dispatch": "nearest", "record": {"replay": False}}
    with tempfile.TemporaryDirectory() as folder:
        summary = simulate(load_scenario(f"{garage}_thesis", keys), Path(folder))
        found = Counter(load_run(Path(folder)).details("deadlock_found").get("cause", ()))
    m = summary.metrics
    return {
        "status": summary.status,
        "tasks": m["tasks_done"],
        "steps": m["steps"],
        "expanded": m["nodes_expanded"],
        **{cause: found[cause] for cause in CAUSES},
    }


def show_ranges(rows: Rows) -> list[str]:
    """A row for each range: steps of each seed, then means."""
    seeds = sorted({int(row["seed"]) for row in rows})
    headings = ["window", "adapt_boost", "adapt_cbs", *(f"seed {seed}" for seed in seeds)]
    headings += ["mean steps", "expanded", "deadlocks"]
    lines = []
    for (least, most, boost, cbs), own in groups(rows, "least", "most", "boost", "cbs").items():
        steps = {int(row["seed"]): f"{int(row['steps']):,}" for row in own}
        means = [f"{mean(own, key):,.0f}" for key in ("steps", "expanded")]
        cells = [f"{least} to {most}", str(boost), str(cbs), *(steps.get(seed, "") for seed in seeds)]
        lines.append([*cells, *means, str(total(own, *CAUSES))])
    return markdown(headings, lines)


def show_windows(rows: Rows) -> list[str]:
    """A row for each planner and window: steps, expansions and deadlocks in each garage."""
    garages = list(groups(rows, "garage", "agvs"))
    headings = ["planner", "window, cells"]
    headings += [
        f"{garage.upper()} x {agvs}: {what}" for garage, agvs in garages for what in ("steps", "expanded", "deadlocks")
    ]
    lines = []
    for (planner, window), own in groups(rows, "planner", "window").items():
        found = {(row["garage"], row["agvs"]): row for row in own}
        cells = [cell for key in garages for cell in (_cells(found[key]) if key in found else [""] * 3)]
        lines.append([f"`{planner}`", _window(planner, int(window)), *cells])
    return markdown(headings, lines)


def _cells(row: Row) -> list[str]:
    causes = "/".join(str(int(row[cause])) for cause in CAUSES)
    return [f"{int(row['steps']):,}", f"{int(row['expanded']):,}", causes if row["planner"] == "whca" else ""]


def _window(planner: str, window: int) -> str:
    if planner != "whca":
        return ""
    return str(window) if window else "adapts"


SETS: Mapping[str, RunSet] = {
    "window": RunSet("whca with windows that are held, and with the one that adapts", CASES, run_window),
    "window_seeds": RunSet(
        "whca's range of windows, boost and CBS by traffic, on MAP1 x 4 over demand seeds", SEEDED, run_range
    ),
}

TABLES: Mapping[str, Table] = {
    "window": Table("window", show_windows),
    "window-seeds": Table("window_seeds", show_ranges),
}
