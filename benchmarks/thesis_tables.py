"""The thesis's tables, row by row, with the seeds and the larger fleets beyond them; see docs/thesis.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import pandas as pd
from docs_tables import Row, Rows, RunSet, Table, groups, markdown, percent

from parking_sim.reproduce.findings import findings_table
from parking_sim.reproduce.thesis_claims import best_planners, claims
from parking_sim.reproduce.thesis_paper import program
from parking_sim.reproduce.thesis_runs import (
    BEYOND,
    FAIR,
    METRICS,
    ROWS,
    Case,
    home_cases,
    more_cases,
    run_case,
    seed_cases,
    table_cases,
)
from parking_sim.reproduce.thesis_tables import heading, metric_table, program_table, slips_table

#: Keys of a case of each set; what they leave out is the same in all cases.
_TABLE = ("garage", "agvs", "planner", "rules", "park_only")
_MORE = ("garage", "agvs", "planner")
_SEEDED = (*_MORE, "seed")
_HOMES = (*_MORE, "rules", "homes")


def _cases(cases: Sequence[Case], keys: Sequence[str]) -> tuple[Row, ...]:
    return tuple({key: asdict(case)[key] for key in keys} for case in cases)


def run_thesis(case: Row) -> Row:
    """A run of the thesis's experiment; fair rules unless the case says otherwise."""
    found = run_case(Case(**{"rules": FAIR, **case}))
    return {key: found[key] for key in ("status", *METRICS)}


def show_seeds(rows: Rows) -> list[str]:
    """Tasks in 1,000 steps of each planner, then the default's lead."""
    frame = pd.DataFrame(rows)
    means = 1000 * frame.groupby(["garage", "agvs", "planner"], sort=False)["throughput"].mean()
    lines = [
        [f"{garage.upper()} x {agvs}", *(_tasks(means, (garage, agvs, planner)) for planner in BEYOND)]
        for garage, agvs in dict.fromkeys((row["garage"], row["agvs"]) for row in rows)
    ]
    leads = findings_table([*best_planners(frame)], full=True).splitlines()
    return [*markdown(["row", *map(heading, BEYOND)], lines), "", *leads]


def _tasks(means: pd.Series, key: tuple[str, int, str]) -> str:
    return f"{means[key]:.2f}" if key in means.index else ""


def show_more(rows: Rows) -> list[str]:
    """Throughput with its share of the bound, then expansions."""
    lines = []
    for garage, agvs in dict.fromkeys((row["garage"], row["agvs"]) for row in rows):
        own = {row["planner"]: row for row in rows if (row["garage"], row["agvs"]) == (garage, agvs)}
        done = [
            f"{own[p]['throughput']:.4f}, {percent(own[p]['bound_share'])}{_left(own[p])}" if p in own else ""
            for p in BEYOND
        ]
        work = [f"{own[p]['nodes_expanded']:,}" if p in own else "" for p in BEYOND]
        lines.append([f"{garage.upper()} x {agvs}", *done, *work])
    names = list(map(heading, BEYOND))
    return markdown(["row", *names, *(f"expanded: {name}" for name in names)], lines)


def _left(row: Row) -> str:
    """What a run leaves undone."""
    return "" if row["completion"] == 1 else f", stops at {percent(row['completion'])}"


def show_homes(rows: Rows) -> list[str]:
    """Least, mean and most steps and moves over all ways to deal out the homes, beside the program's."""
    lines = []
    for (agvs, planner), own in sorted(groups(rows, "agvs", "planner").items()):
        spreads = [
            f"{min(values):,.0f} / {sum(values) / len(values):,.0f} / {max(values):,.0f}"
            for values in ([row[metric] for row in own] for metric in ("steps", "movement_cost"))
        ]
        theirs = [f"{program(metric, planner, 'map1', agvs):,.0f}" for metric in ("steps", "movement_cost")]
        whole = sum(row["completion"] == 1 for row in own)
        cells = [spreads[0], theirs[0], spreads[1], theirs[1]]
        lines.append([f"MAP1 x {agvs}", heading(planner), f"{whole} of {len(own)}", *cells])
    return markdown(["row", "planner", "complete", "steps", "program", "moves", "program"], lines)


def _metric(metric: str) -> Table:
    return Table("thesis", lambda rows: metric_table(pd.DataFrame(rows), metric).splitlines())


SETS: Mapping[str, RunSet] = {
    "thesis": RunSet(
        "the thesis's tables: each row under the thesis's rules, fair rules and in SUMO",
        _cases([*table_cases(ROWS)], _TABLE),
        run_thesis,
    ),
    "thesis_seeds": RunSet(
        "the thesis's rows, cars fetched by name in a random order, fair rules, over demand seeds",
        _cases([*seed_cases()], _SEEDED),
        run_thesis,
    ),
    "thesis_more": RunSet(
        "park and fetch on MAP2 and MAP3 with more AGVs, fair rules", _cases([*more_cases()], _MORE), run_thesis
    ),
    "thesis_homes": RunSet(
        "MAP1 under the thesis's rules, its homes dealt out to the AGVs in every way",
        _cases([*home_cases()], _HOMES),
        run_thesis,
    ),
}

TABLES: Mapping[str, Table] = {
    "thesis-program": Table("thesis", lambda rows: program_table(pd.DataFrame(rows)).splitlines()),
    "thesis-claims": Table("thesis", lambda rows: findings_table([*claims(pd.DataFrame(rows))], True).splitlines()),
    "thesis-throughput": _metric("throughput"),
    "thesis-steps": _metric("steps"),
    "thesis-moves": _metric("movement_cost"),
    "thesis-expanded": _metric("nodes_expanded"),
    "thesis-heap": _metric("heap_moves"),
    "thesis-generated": _metric("nodes_generated"),
    "thesis-ratio": _metric("valid_ratio"),
    "thesis-bound": _metric("bound_share"),
    "thesis-deadlocks": _metric("deadlocks_found"),
    "thesis-rings": _metric("wait_rings"),
    "thesis-slips": Table("thesis", lambda rows: slips_table().splitlines()),
    "thesis-seeds": Table("thesis_seeds", show_seeds),
    "thesis-more": Table("thesis_more", show_more),
    "thesis-homes": Table("thesis_homes", show_homes),
}
