"""Windows of ``whca`` that are held, and the window that adapts; see docs/controllers.md."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from docs_tables import Row, Rows, RunSet, Table, groups, markdown

#: Windows that are held, in moves; 0 is the window that adapts.
WINDOWS = (5, 11, 21, 31, 0)
CAUSES = ("ring", "idle", "stuck")

CASES: tuple[Row, ...] = tuple(
    {"garage": garage, "agvs": agvs, "planner": planner, "window": window}
    for garage, agvs in (("map1", 4), ("map2", 4), ("map3", 8))
    for planner, window in (("astar", 0), ("dstar_lite", 0), *(("whca", window) for window in WINDOWS))
)


def run_window(case: Row) -> Row:
    """A row of the thesis under its rules, with the window held or not."""
    from analysis.tables import load_run
    from parking_sim.config import load_scenario
    from parking_sim.simulation import simulate

    held = case["window"]
    keys: Row = {
        "agvs": case["agvs"],
        "planner": case["planner"],
        "plant": "discrete",
        "rules": "thesis",
        "dispatch": "nearest",
        "workload": {"kind": "park_exit", "park_only": case["garage"] != "map1", "order": "parked"},
        "control": {"window_cells": held, "window_min": held, "window_max": held} if held else {},
        "record": {"replay": False},
    }
    with tempfile.TemporaryDirectory() as folder:
        summary = simulate(load_scenario(f"{case['garage']}_thesis", keys), Path(folder))
        run = load_run(Path(folder))
    found = Counter(run.details("deadlock_found").get("cause", ()))
    m = summary.metrics
    return {
        "status": summary.status,
        "tasks": m["tasks_done"],
        "steps": m["steps"],
        "expanded": m["nodes_expanded"],
        **{cause: found[cause] for cause in CAUSES},
    }


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
}

TABLES: Mapping[str, Table] = {"window": Table("window", show_windows)}
