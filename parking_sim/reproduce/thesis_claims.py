"""The thesis's claims about its pipeline, judged for the pipeline, for our WHCA* and for the default planner.

A row is one run, as in the thesis: nothing in it is left to chance, so that what decides is whether the rows that the
claim is about are there. Whether a lead holds under other demands is judged over seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pandas as pd

from parking_sim.reproduce.findings import Finding, Verdict, settled
from parking_sim.reproduce.statistics import is_below
from parking_sim.reproduce.thesis_paper import printed
from parking_sim.reproduce.thesis_runs import CONTENDERS, DEFAULT, FAIR, PLANNERS, ROWS, SUMO, THESIS
from parking_sim.reproduce.thesis_tables import SOURCES, heading

_LOW = frozenset((garage, agvs) for garage, agvs, *_ in ROWS if garage == "map1")
_HIGH = frozenset((garage, agvs) for garage, agvs, *_ in ROWS if garage != "map1")
#: With one AGV the thesis's pipeline and its D* Lite do the same search.
_SEVERAL = frozenset((garage, agvs) for garage, agvs, *_ in ROWS if agvs > 1)

#: Words, rows that the claim is about, metric, and whether it holds in a row of A*, D* Lite and the contender.
_CLAIMS: tuple[tuple[str, frozenset[tuple[str, int]], str, Callable[[float, float, float], bool]], ...] = (
    (
        "low density: A* or D* Lite has a higher throughput than {}",
        _LOW,
        "throughput",
        lambda astar, dstar_lite, ours: max(astar, dstar_lite) > ours,
    ),
    (
        "high density: {} has the highest throughput",
        _HIGH,
        "throughput",
        lambda astar, dstar_lite, ours: ours > max(astar, dstar_lite),
    ),
    (
        "expansions: {} < D* Lite < A*, from 2 AGVs on",
        _SEVERAL,
        "nodes_expanded",
        lambda astar, dstar_lite, ours: ours < dstar_lite < astar,
    ),
)


def claims(runs: pd.DataFrame) -> Iterator[Finding]:
    """Each claim for each contender and each set of rules, and whether all runs are sound.

    Args:
        runs: one run for each row, planner and set of rules.
    """
    whole = runs[runs["cars"].isna()] if "cars" in runs else runs
    for rules in (THESIS, FAIR, SUMO):
        for words, about, metric, holds in _CLAIMS:
            table = whole[whole["rules"] == rules].pivot_table(
                index=["garage", "agvs"], columns="planner", values=metric, sort=False
            )
            for contender in CONTENDERS:
                what = f"{SOURCES[rules]}: {words.format(heading(contender))}"
                yield _claim(what, table, contender, about, holds)
    yield from _ratios(whole)
    for planner in PLANNERS:
        own = runs[runs["planner"] == planner]
        sound = (own["completion"] == 1) & (own["conflicts"] == 0)
        ours = f"{int(sound.sum())} of {len(own)}"
        yield Finding(
            f"{heading(planner)}: every run completes without a conflict", "", ours, "", settled(bool(sound.all()))
        )


def _claim(
    what: str,
    table: pd.DataFrame,
    contender: str,
    about: frozenset[tuple[str, int]],
    holds: Callable[[float, float, float], bool],
) -> Finding:
    """A claim about rows; it is judged if all of them are there."""
    rows = table.reindex(columns=["astar", "dstar_lite", contender]).dropna()
    said = {str(g): holds(*map(float, row)) for g, row in zip(rows.index, rows.to_numpy(), strict=True) if g in about}
    judged = settled(all(said.values())) if len(said) == len(about) else Verdict.TOO_FEW
    return Finding(what, f"{len(about)} of {len(about)} rows", f"{sum(said.values())} of {len(said)} rows", "", judged)


def _ratios(whole: pd.DataFrame) -> Iterator[Finding]:
    """How many times the contender's expansions A* needs in the last row."""
    garage, agvs, *_ = ROWS[-1]
    row = whole[(whole["garage"] == garage) & (whole["agvs"] == agvs)]
    paper = [printed("nodes_expanded", planner, garage, agvs) for planner in ("astar", "pipeline")]
    for rules in (THESIS, FAIR, SUMO):
        work = row[row["rules"] == rules].set_index("planner")["nodes_expanded"]
        for contender in CONTENDERS:
            if {"astar", contender} <= set(work.index):
                what = f"{SOURCES[rules]}: A*'s expansions / {heading(contender)}'s, {garage.upper()} x {agvs}"
                said = f"{paper[0] / paper[1]:.1f}" if contender == "pipeline" and paper[0] and paper[1] else ""
                yield Finding(what, said, f"{work['astar'] / work[contender]:.1f}")


def best_planners(seeded: pd.DataFrame) -> Iterator[Finding]:
    """For each row the best planner over the demand seeds, and the default's lead over the best other one, by seed."""
    from analysis.measures import interval

    for garage, agvs in seeded[["garage", "agvs"]].drop_duplicates().itertuples(index=False):
        group = seeded[(seeded["garage"] == garage) & (seeded["agvs"] == agvs)]
        table = group.pivot_table(index="seed", columns="planner", values="throughput") * 1000.0
        others = table.drop(columns=DEFAULT, errors="ignore")
        if DEFAULT not in table or others.empty:
            continue
        rival = str(others.mean().idxmax())
        lead = interval(list(table[DEFAULT] - table[rival]))
        yield Finding(
            f"{str(garage).upper()} x {agvs}, {lead.runs} seeds: {heading(DEFAULT)} is the best; its lead over "
            f"{heading(rival)}, tasks in 1,000 steps", "", f"{lead.mean:+.2f}", f"{lead.low:+.2f} to {lead.high:+.2f}",
            is_below(interval(list(table[rival] - table[DEFAULT])), 0.0),
        )  # fmt: skip
