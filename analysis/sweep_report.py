"""One offline page for a sweep: what was asked, what came out, in words, a table and curves, and how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from analysis.checks import RULES
from analysis.clock import Clock
from analysis.figures import Drawing, style, svg
from analysis.json_files import read_object
from analysis.measures import MEASURES, Interval, interval, measure_runs
from analysis.report import environment, number, write_page
from analysis.runs import Runs, load_runs
from analysis.tables import load_run
from analysis.turned_away import percent
from analysis.variants import NAME, Variant, label, value_text
from analysis.words import counted

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

#: Measures of the table and the figures.
SHOWN = (
    "turned_away_share", "retrieval_wait_p50_s", "retrieval_wait_p95_s", "park_queue_mean_s", "park_total_mean_s",
    "tasks_per_hour", "queue_mean", "deadlocks_per_hour",
)  # fmt: skip
_DRAWN = ("retrieval_wait_p95_s", "turned_away_share", "tasks_per_hour", "deadlocks_per_hour")
_MOST_LINES = 6
#: Letters of a variant's name on a line of a figure.
_WIDEST = 36


@dataclass(frozen=True)
class Measured:
    """The runs of one variant, which differ in nothing but the seed.

    Attributes:
        variant: its name, and the keys that vary in the sweep with their values here.
        runs: number of runs.
        means: key of ``MEASURES`` -> mean over the runs with its interval.
    """

    variant: Variant
    runs: int
    means: Mapping[str, Interval]


def write_sweep_report(folder: Path, answers: Sequence[str] = (), answer_drawings: Sequence[Drawing] = ()) -> Path:
    """Write ``report.html`` into the folder of a sweep.

    Args:
        folder: folder of a sweep with one finished run at least.
        answers: what comes before everything else, such as the answers of a sizing.
        answer_drawings: figures to them.

    Returns:
        Path of the report.

    Raises:
        FileNotFoundError: no run has finished.
        OSError: the folder can't be written.
    """
    runs = load_runs(folder)
    frame = runs.runs
    variants = sweep_variants(runs)
    meta = load_run(next(iter(runs.folders.values()))).meta
    plan = folder / "sweep.json"
    page = environment().get_template("sweep.html").render(
        title=f"Sweep {folder.resolve().name}",
        asked=[*_asked(runs, frame), *_starts(runs)],
        headlines=[*answers, *_headlines(runs, variants, frame)],
        heads=[*runs.varied, "runs", *(f"{MEASURES[key].words} ({MEASURES[key].unit})" for key in SHOWN)],
        rows=[_row(measured, runs.varied) for measured in variants],
        drawings=[*answer_drawings, *_drawings(variants, runs.varied)],
        checks=_checks(frame),
        failures=runs.failures,
        code=read_object(plan).get("code", "") if plan.is_file() else "",
        versions=sorted((meta.get("versions") or {}).items()),
        links=[(run, (path / "run.json").relative_to(folder).as_posix()) for run, path in runs.folders.items()],
        runs=frame[["run", "variant", "seed", "status"]].astype(str).to_numpy().tolist(),
    )  # fmt: skip
    return write_page(folder / "report.html", page)


def sweep_variants(runs: Runs, warmup_s: float = 0.0) -> list[Measured]:
    """The measures of a sweep by variant.

    Args:
        runs: the runs of a sweep.
        warmup_s: simulated seconds at the start that don't count.

    Returns:
        One for each variant with a finished run, in the order of the sweep.
    """
    values = measure_runs(runs, warmup_s).drop(columns="seed").set_index("run")
    groups: dict[str, list[str]] = {}
    for run, variant in runs.variants.items():
        groups.setdefault(variant.name, []).append(run)
    return [
        Measured(
            runs.variants[members[0]],
            len(members),
            {key: interval(values.loc[members, key].tolist()) for key in MEASURES},
        )
        for members in groups.values()
    ]


def _asked(runs: Runs, frame: pd.DataFrame) -> list[tuple[str, str]]:
    """What varies, the seeds, what is the same in all runs, and what stands behind the variants' names."""
    variants = {variant.name: variant for variant in runs.variants.values()}
    rows = [
        (key, "; ".join(dict.fromkeys(value_text(v.shown[key]) for v in variants.values() if key in v.shown)))
        for key in runs.varied
    ]
    seeds = sorted(int(seed) for seed in frame["seed"].unique())
    whole = len(seeds) > 1 and seeds[-1] - seeds[0] == len(seeds) - 1
    rows.append(("seeds", f"{seeds[0]}..{seeds[-1]}" if whole else ", ".join(map(str, seeds))))
    same = [str(key) for key in frame if frame[key].nunique(dropna=False) == 1 and frame[key].notna().all()]
    for key in ("garage", "agvs", "planner", "plant", "dispatch", "duration_s"):
        if key in same and key not in runs.varied:
            rows.append((key, _cell_text(frame[key].iloc[0])))
    workload = [key for key in same if key.startswith("workload.")]
    if workload:
        told = (f"{key.partition('.')[2]} {_cell_text(frame[key].iloc[0])}" for key in workload)
        rows.append(("workload", ", ".join(told)))
    if NAME in runs.varied:
        scenarios = Runs(runs.folders).variants  # by the keys in which they differ
        meant = {variant.name: scenarios[run].shown for run, variant in runs.variants.items()}
        rows += [(name, label({k: v for k, v in shown.items() if v is not None})) for name, shown in meant.items()]
    return rows


def _starts(runs: Runs) -> list[tuple[str, str]]:
    """The times of day at which runs start, and that some have none; nothing if no run has any."""
    clocks = [Clock.of(load_run(folder).meta) for folder in runs.folders.values()]
    starts = dict.fromkeys(clock.at(0.0) for clock in clocks if clock.day_start_h is not None)
    if starts and any(clock.day_start_h is None for clock in clocks):
        starts["none for some variants"] = None
    return [("time of day at the start", ", ".join(starts))] if starts else []


def _cell_text(value: Any) -> str:
    """A cell of a table in words; ``null`` for one without a value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "null"
    plain = value.item() if hasattr(value, "item") else value
    return value_text(int(plain) if isinstance(plain, float) and plain.is_integer() else plain)


def _headlines(runs: Runs, variants: Sequence[Measured], frame: pd.DataFrame) -> list[str]:
    lines = [f"{len(frame)} runs of {len(variants)} variants have finished; {len(runs.failures)} failed."]
    waits = {i: v.means["retrieval_wait_p95_s"] for i, v in enumerate(variants)}
    known = {i: w for i, w in waits.items() if w.runs}
    if known and len(variants) > 1:
        best = min(known, key=lambda i: known[i].mean)
        tied = sum(w.low <= known[best].high for w in known.values()) - 1
        others = counted(tied, "other variant")
        also = f"; {others} may be as good: the intervals overlap" if tied and known[best].runs > 1 else ""
        if known[best].runs == 1 < variants[best].runs:
            also = "; only one of its runs had retrievals, so that there is no interval"
        lines.append(
            f"Customers waited least with {variants[best].variant.name}: 19 of 20 had their car within"
            f" {_interval_words(known[best])} s of asking, mean over runs{also}.{_away(variants[best])}"
        )
    if variants and max(variant.runs for variant in variants) < 2:
        lines.append("With one seed a variant there are no intervals: give more seeds.")
    return lines


def _away(measured: Measured) -> str:
    """A sentence on the customers that a variant turned away; empty if there are none."""
    share = measured.means["turned_away_share"].mean
    return f" {percent(share)} of its customers were turned away." if share > 0 else ""


def _interval_words(value: Interval) -> str:
    if value.runs < 2:
        return number(value.mean)
    return f"{number(value.mean)} ± {number(value.half)}"


def _row(measured: Measured, varied: Sequence[str]) -> list[str]:
    means = [_interval_words(measured.means[key]) if measured.means[key].runs else "–" for key in SHOWN]
    shown = measured.variant.shown
    return [*(value_text(shown[key]) if key in shown else "–" for key in varied), str(measured.runs), *means]


def _checks(frame: pd.DataFrame) -> list[tuple[str, bool, str]]:
    """What must hold in every run: what, whether it does, and in how many it doesn't."""
    rows = []
    for text, (key, right) in RULES.items():
        wrong = int((frame[key].fillna(right) != right).sum())
        rows.append(
            (text, wrong == 0, f"not in {wrong} of {len(frame)} runs" if wrong else f"in all {len(frame)} runs")
        )
    return rows


def _drawings(variants: Sequence[Measured], varied: Sequence[str]) -> list[Drawing]:
    """A figure for each measure: against the number that varies most, one line for each combination of the rest."""
    if not varied or len(variants) < 2:
        return []
    drawings = []
    with style():
        for key in _DRAWN:
            if any(variant.means[key].runs and variant.means[key].mean for variant in variants):
                title = MEASURES[key].words.capitalize()
                drawings.append(Drawing(key, title, _CAPTION, _draw(variants, varied, key, title)))
    return drawings


_CAPTION = "Mean over the seeds; bars: 95 % interval of the mean."


def _draw(variants: Sequence[Measured], varied: Sequence[str], key: str, title: str) -> str:
    from analysis.figures import new_figure

    across = _numeric(variants, varied)
    figure, (axes,) = new_figure(2.9 if across else 0.9 + 0.24 * len(variants))
    if across:
        _curves(axes, variants, across, key)
    else:
        _dots(axes, variants, key)
    return svg(figure, key, title)


def _numeric(variants: Sequence[Measured], varied: Sequence[str]) -> str:
    """The key with the most numbers as values; "" if there is none with several."""
    counts = {
        key: len({v.variant.shown[key] for v in variants})
        for key in varied
        if all(type(v.variant.shown.get(key)) in (int, float) for v in variants)
    }
    best = max(counts, key=lambda key: counts[key], default="")
    return best if best and counts[best] > 1 else ""


def _curves(axes: Axes, variants: Sequence[Measured], across: str, key: str) -> None:
    from analysis.figures import BLUE, GREEN, ORANGE, PINK, RED, SKY

    lines: dict[str, list[Measured]] = {}
    for variant in variants:
        rest = {name: value for name, value in variant.variant.shown.items() if name != across}
        lines.setdefault(fill(label(rest), _WIDEST) if rest else "", []).append(variant)
    colors = (BLUE, ORANGE, GREEN, RED, PINK, SKY)
    for (name, members), color in zip(list(lines.items())[:_MOST_LINES], colors, strict=False):
        members = sorted((m for m in members if m.means[key].runs), key=lambda m: m.variant.shown[across])
        means = [m.means[key] for m in members]
        bars = [m.half if math.isfinite(m.half) else 0.0 for m in means]
        at = [m.variant.shown[across] for m in members]
        axes.errorbar(at, [m.mean for m in means], bars, color=color, marker="o", markersize=4, capsize=2, label=name)
    axes.set_xlabel(across)
    axes.set_ylabel(MEASURES[key].unit)
    axes.set_ylim(bottom=0)
    if len(lines) > 1:
        axes.legend(fontsize=8)


def _dots(axes: Axes, variants: Sequence[Measured], key: str) -> None:
    from analysis.figures import BLUE

    for row, variant in enumerate(variants):
        mean = variant.means[key]
        half = mean.half if math.isfinite(mean.half) else 0.0
        axes.errorbar(mean.mean, row, xerr=half, color=BLUE, marker="o", capsize=2)
    names = [fill(measured.variant.name, _WIDEST) for measured in variants]
    axes.set_yticks(range(len(variants)), names, fontsize=8)
    axes.set_ylim(len(variants) - 0.5, -0.5)
    axes.set_xlabel(MEASURES[key].unit)
