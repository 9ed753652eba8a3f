"""The tables and figures of ``reproduce thesis``: each cell as the thesis prints it, beside our planners' runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from parking_sim.reproduce.findings import aligned
from parking_sim.reproduce.thesis_paper import cause, contradictions, printed, program, published, rerun, slips
from parking_sim.reproduce.thesis_runs import FAIR, METRICS, PLANNERS, SUMO, THESIS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Where a line's figures come from: ours by set of rules.
SOURCES = {THESIS: "thesis rules", FAIR: "fair rules", SUMO: "SUMO"}
PAPER, AGAIN = "paper", "its program run again"
#: Metrics that a contradiction between the paper's own tables concerns.
_CONTRADICTED = ("nodes_generated", "valid_ratio")
#: Share by which steps or moves may differ from the program's before a cause is asked for.
NEAR = 0.03


def legend() -> str:
    """Which planner is which, a line each."""
    return "".join(f"{heading(name)}: {words}\n" for name, words in PLANNERS.items())


def heading(planner: str) -> str:
    """A planner's name in the tables."""
    return {"astar": "A*", "dstar_lite": "D* Lite"}.get(planner, f"`{planner}`")


def metric_table(runs: pd.DataFrame, metric: str, paper: bool = True) -> str:
    """One metric as a Markdown table: for each row the paper's figures, then ours by set of rules, a column a planner.

    Args:
        runs: one run for each row, planner and set of rules; what is missing is left out.
        metric: name of the metric.
        paper: the paper has such rows.

    Returns:
        The table.
    """
    lines = [["row", "", *map(heading, PLANNERS)]]
    for garage, agvs, cars, own in _rows(runs):
        row = f"{garage.upper()} x {agvs}" + ("" if pd.isna(cars) else f", {cars:g} cars")
        if paper and pd.isna(cars):
            for source, said in ((PAPER, printed), (AGAIN, rerun)):
                values = [said(metric, planner, garage, agvs) for planner in PLANNERS]
                if any(value is not None for value in values):
                    marks = [_mark(metric, planner, garage, agvs) if source == PAPER else "" for planner in PLANNERS]
                    lines.append([row, source, *(_short(v) + m for v, m in zip(values, marks, strict=True))])
        for rules, source in SOURCES.items():
            by_planner = own[own["rules"] == rules].set_index("planner")[metric]
            if by_planner.notna().any():
                lines.append([row, source, *(_short(by_planner.get(planner)) for planner in PLANNERS)])
    return aligned(lines)


def _rows(runs: pd.DataFrame) -> Iterator[tuple[str, int, float, pd.DataFrame]]:
    """Garage, AGVs, cars (NaN: all) and the runs of each row, in their order."""
    cells = runs["cars"] if "cars" in runs else pd.Series(float("nan"), runs.index)
    cells = cells.astype(float)
    for garage, agvs in runs[["garage", "agvs"]].drop_duplicates().itertuples(index=False):
        chosen = (runs["garage"] == garage) & (runs["agvs"] == agvs)
        yield str(garage), int(agvs), float(cells[chosen].iloc[0]), runs[chosen]


def _mark(metric: str, planner: str, garage: str, agvs: int) -> str:
    return " (!)" if metric in _CONTRADICTED and (planner, garage, agvs) in contradictions() else ""


def _short(value: float | None) -> str:
    if value is None or pd.isna(value):
        return "-"
    number = float(value)
    return f"{number:,.0f}" if number == round(number) and number != 0 else f"{number:.4f}" if number else "0"


def program_table(runs: pd.DataFrame) -> str:
    """Steps and moves under the thesis's rules beside those of the authors' program, and why they differ where they do.

    A figure that was not run again is what the print says: its moves, and its tasks over its throughput.
    """
    lines = [["row", "planner", "steps", "program", "", "moves", "program", "", f"cause, beyond {NEAR:.0%}"]]
    for garage, agvs, cars, own in _rows(runs[runs["rules"] == THESIS]):
        runs_of_row = own.set_index("planner") if pd.isna(cars) else own.iloc[:0]
        for planner in (str(p) for p in runs_of_row.index if p in published()["printed"]):
            cells: list[str] = []
            far = False
            for metric in ("steps", "movement_cost"):
                theirs = program(metric, planner, garage, agvs)
                if theirs is None:
                    raise ValueError(f"thesis.yaml: {metric} of {planner}, {garage} x {agvs}: missing")
                ours = float(runs_of_row[metric][planner])
                apart = ours / theirs - 1
                far = far or abs(apart) > NEAR
                source = "" if rerun(metric, planner, garage, agvs) is not None else " (print)"
                cells += [f"{ours:,.0f}", f"{theirs:,.0f}{source}", _apart(apart)]
            why = (cause(planner, garage, agvs) or "not known") if far else ""
            lines.append([f"{garage.upper()} x {agvs}", heading(planner), *cells, why])
    return aligned(lines)


def _apart(share: float) -> str:
    words = f"{100 * share:+.1f} %" if round(1000 * share) else "0"
    return f"**{words}**" if abs(share) > NEAR else words


def slips_table() -> str:
    """Printed figures that look like slips, and what the thesis's own tables say about them."""
    lines = [["row", "planner", "figure", "printed", "likely", "what speaks for it"]]
    for slip in slips():
        row, what = f"{slip.garage.upper()} x {slip.agvs}", METRICS[slip.metric].partition(": ")[2]
        lines.append([row, heading(slip.planner), what, f"{slip.printed:,}", f"{slip.likely:,}", slip.evidence])
    return aligned(lines)


def draw(runs: pd.DataFrame, metric: str) -> Figure:
    """One metric: a panel a planner, bars for each row, the paper's and ours under either set of rules."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.2 * len(PLANNERS), 3.2), layout="constrained")
    axes = figure.subplots(1, len(PLANNERS), sharey=True)
    for ax, planner in zip(axes, PLANNERS, strict=True):
        cells = [(g, n, cars, own[own["planner"] == planner]) for g, n, cars, own in _rows(runs)]
        for k, source in enumerate((PAPER, THESIS, FAIR)):
            if source == PAPER:
                heights = [printed(metric, planner, g, n) or 0.0 if pd.isna(cars) else 0.0 for g, n, cars, _ in cells]
            else:
                heights = [_only(own[own["rules"] == source][metric]) for *_, own in cells]
            ax.bar([i + (k - 1) * 0.27 for i in range(len(cells))], heights, 0.25, label=SOURCES.get(source, source))
        ax.set_xticks(range(len(cells)), [f"{g} x {n}" for g, n, *_ in cells], rotation=45, ha="right")
        ax.set_title(planner)
        if metric in ("nodes_expanded", "heap_moves", "nodes_generated", "valid_expansions", "slot_choice_expanded"):
            ax.set_yscale("log")
    axes[0].set_ylabel(metric)
    axes[-1].legend()
    return figure


def _only(values: Sequence[float] | pd.Series) -> float:
    return float(next(iter(values), 0.0))
