"""How deadlocks were found and which rung of the ladder resolved them; see docs/deadlocks.md."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from docs_tables import Row, Rows, RunSet, Table, markdown, percent

#: The smallest window of ``whca``: the larger it is, the fewer deadlocks there are to resolve.
WINDOW = 5
CAUSES = ("ring", "idle", "stuck")
RUNGS = ("replanned", "partial_cbs", "leader", "pull_over", "lacam")

CASES: tuple[Row, ...] = (
    *(
        {"garage": garage, "agvs": agvs, "rules": rules}
        for rules in ("thesis", "fair")
        for garage, agvs in (("map1", 1), ("map1", 2), ("map1", 3), ("map1", 4), ("map2", 4), ("map3", 8))
    ),
    *({"garage": garage, "agvs": agvs, "rules": "sumo"} for garage, agvs in (("map1", 4), ("map2", 4), ("map3", 8))),
)


def run_rungs(case: Row) -> Row:
    """``whca`` with its window held: deadlocks by cause, and by the rung that ended them.

    Under the thesis's and fair rules the thesis's demand on its grids, in SUMO our garage of that name with a third of
    its cars.
    """
    from analysis.tables import load_run
    from parking_sim.config import load_scenario
    from parking_sim.simulation import simulate

    sumo = case["rules"] == "sumo"
    keys: Row = {
        "agvs": case["agvs"],
        "planner": "whca",
        "control": {"window_cells": WINDOW, "window_min": WINDOW, "window_max": WINDOW},
        "plant": "sumo" if sumo else "discrete",
        "workload": {"kind": "park_exit", "park_only": not sumo and case["garage"] != "map1"},
        "record": {"replay": False},
    }
    if sumo:
        keys["workload"]["cars"] = 60
    else:
        keys |= {"rules": case["rules"], "dispatch": "nearest"}
        keys["workload"]["order"] = "parked"
    with tempfile.TemporaryDirectory() as folder:
        summary = simulate(load_scenario(case["garage"] if sumo else f"{case['garage']}_thesis", keys), Path(folder))
        run = load_run(Path(folder))
        found = Counter(run.details("deadlock_found").get("cause", ()))
        ended = Counter(run.details("deadlock_resolved").get("stage", ()))
    m = summary.metrics
    return {
        "status": summary.status,
        "tasks": m["tasks_done"],
        "steps": m["steps"],
        **{cause: found[cause] for cause in CAUSES},
        **{rung: ended[rung] for rung in RUNGS},
        "median_s": m["deadlock_p50_s"],
    }


def show_rungs(rows: Rows) -> list[str]:
    """A row for each run, then all of them together."""
    headings = ["run", "rules", "rings", "chains to an idle AGV", "stuck", "rings and chains", *RUNGS]
    headings = [heading.replace("_", " ") for heading in headings]
    total: Row = {key: sum(row[key] for row in rows) for key in (*CAUSES, *RUNGS)}
    lines = [[f"{row['garage'].upper()} x {row['agvs']}", row["rules"], *_counts(row)] for row in rows]
    return markdown(headings, [*lines, ["all", "", *_counts(total)]])


def _counts(row: Row) -> list[str]:
    found = sum(int(row[cause]) for cause in CAUSES)
    at_once = percent((found - row["stuck"]) / found) if found else ""
    return [*(str(int(row[cause])) for cause in CAUSES), at_once, *(str(int(row[rung])) for rung in RUNGS)]


SETS: Mapping[str, RunSet] = {
    "rungs": RunSet("whca with its least window: how deadlocks are found, and what resolves them", CASES, run_rungs),
}

TABLES: Mapping[str, Table] = {"rungs": Table("rungs", show_rungs)}
