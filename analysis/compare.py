"""Two variants on the same customers: differences paired by seed, in words, in numbers and in a figure.

Both variants run with the same seeds and so meet the same customers. The difference is taken seed by seed and its mean
gets Student's t interval over the seeds; what makes a day hard is the same on both sides and cancels, so that far fewer
runs are needed than for two separate intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.measures import MEASURES, Interval, interval, measure_runs, t_quantile
from analysis.run_files import check_ended
from analysis.runs import Runs, load_runs
from analysis.variants import value_text
from sumo_nets.errors import InputError
from sumo_nets.whole_file import whole_file

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Values = NDArray[np.float64]

#: Measures that a comparison shows when nothing else is asked.
HEADLINES = (
    "turned_away_share", "retrieval_wait_mean_s", "retrieval_wait_p50_s", "retrieval_wait_p95_s", "park_queue_mean_s",
    "park_total_mean_s", "tasks_per_hour", "queue_mean", "deadlocks_per_hour",
)  # fmt: skip

#: Variants that a complaint names at most.
_NAMED = 8

#: An interval is short enough when half of it is at most this share of the first variant's mean.
PRECISION = 0.05


@dataclass(frozen=True)
class Difference:
    """One measure of two variants.

    Attributes:
        key: key of ``analysis.measures.MEASURES``.
        a, b: means of both with their own intervals.
        change: b - a, paired by seed.
        pairs: b - a of each seed.
        needed: number of seeds after which half the interval is about ``PRECISION`` of a's mean.
    """

    key: str
    a: Interval
    b: Interval
    change: Interval
    pairs: tuple[float, ...]
    needed: int

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out 0."""
        return self.change.low > 0 or self.change.high < 0

    @property
    def is_precise(self) -> bool:
        """Whether half the interval is at most ``PRECISION`` of a's mean."""
        return self.change.half <= PRECISION * abs(self.a.mean)


@dataclass(frozen=True)
class Comparison:
    """Two variants, named as asked for, the seeds they share and the differences."""

    names: tuple[str, str]
    seeds: tuple[int, ...]
    warmup_s: float
    differences: tuple[Difference, ...]


def select_runs(choice: str) -> Runs:
    """The runs of one variant.

    Args:
        choice: a folder, and behind a colon what picks a variant in it: its name (``runs/sweep:breakdown at noon``), or
            parts of it and keys of its scenarios (``runs/sweep:saturday,agvs=4``).

    Returns:
        Its runs, each with a seed of its own.

    Raises:
        InputError: no such runs, those of several variants, or one that was killed.
    """
    folder, wanted = split_choice(choice)
    check_ended(Path(folder))
    try:
        runs = load_runs(Path(folder))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{choice}: {error}") from None
    frame = runs.runs
    if "seed" not in frame:
        raise InputError(f"{choice}: run.json: scenario: holds no seed by which runs could be paired")
    names = list(dict.fromkeys(frame["variant"]))
    if wanted in names:
        return runs.only(frame["run"][frame["variant"] == wanted].tolist())
    for condition in filter(None, wanted.split(",")):
        frame = _where(frame, runs, condition.strip(), choice)
    left = list(dict.fromkeys(frame["variant"]))
    if len(left) > 1:
        others = "; ".join(left[:_NAMED]) + ("; ..." if len(left) > _NAMED else "")
        raise InputError(f"{choice}: has several variants: pick one, such as {folder}:{left[0]}; there are {others}")
    return runs.only(frame["run"].tolist())


def split_choice(choice: str) -> tuple[str, str]:
    """The folder and what picks a variant in it, "" for all; colons may be in the names of both."""
    if Path(choice).is_dir():
        return choice, ""
    places = [place for place, letter in enumerate(choice) if letter == ":"]
    folder = next((choice[:at] for at in reversed(places) if Path(choice[:at]).is_dir()), choice.partition(":")[0])
    return folder, choice[len(folder) + 1 :]


def _where(frame: pd.DataFrame, runs: Runs, condition: str, choice: str) -> pd.DataFrame:
    """The rows of runs that meet a condition: ``key=value``, or a variant's name or a part of the name."""
    key, equals, value = condition.partition("=")
    shown = [runs.variants[run].shown for run in frame["run"]]
    cells: list[list[object]]
    if equals and any(key in of for of in shown):
        cells = [[of.get(key)] for of in shown]
    elif equals and key in frame:
        cells = [[cell] for cell in frame[key].tolist()]
    elif equals:
        raise InputError(f"{choice}: {key}: no such key; these vary: {', '.join(runs.varied) or 'none'}")
    else:
        key, value = "variant", condition
        cells = [[name, *of.values()] for name, of in zip(frame["variant"], shown, strict=True)]
    found = frame[[any(_same(cell, value) for cell in row) for row in cells]]
    if found.empty:
        given = "; ".join(dict.fromkeys(value_text(row[0]) for row in cells))
        raise InputError(f"{choice}: {key}: {value!r}: no such run; there are {given}")
    return found


def compare(
    a: Runs, b: Runs, names: tuple[str, str] = ("A", "B"), warmup_s: float = 0.0, keys: Sequence[str] = HEADLINES
) -> Comparison:
    """Compare two variants by the seeds they share.

    Args:
        a, b: runs of the two, see :func:`select_runs`.
        names: what to call them.
        warmup_s: simulated seconds at the start that don't count.
        keys: measures, keys of ``analysis.measures.MEASURES``.

    Returns:
        The comparison; measures that either variant has nothing for are left out.

    Raises:
        InputError: fewer than two seeds in common, a seed twice in one variant, or a warm-up that leaves nothing.
    """
    for runs, name in zip((a, b), names, strict=True):
        ((shortest_s,),) = runs.sql("SELECT min(simulated_s) FROM runs").fetchall()
        if warmup_s >= shortest_s:
            raise InputError(f"--warmup: {warmup_s / 60:g} minutes: {name} has a run of {shortest_s / 60:g} minutes")
    tables = [measure_runs(runs, warmup_s) for runs in (a, b)]
    for table, name in zip(tables, names, strict=True):
        if table["seed"].duplicated().any():
            raise InputError(f"{name}: has seed {table['seed'][table['seed'].duplicated()].iloc[0]} more than once")
    first, second = (table.set_index("seed") for table in tables)
    seeds = sorted(seed for seed in first.index if seed in second.index)
    if len(seeds) < 2:
        raise InputError(f"{names[0]} and {names[1]} share {len(seeds)} seeds: run both with the same seeds, 2 or more")
    found = (_difference(key, first.loc[seeds, key].to_numpy(), second.loc[seeds, key].to_numpy()) for key in keys)
    return Comparison(names, tuple(int(seed) for seed in seeds), warmup_s, tuple(d for d in found if d.change.runs > 1))


def in_words(comparison: Comparison) -> list[str]:
    """What the comparison says, one sentence a measure, then whether the seeds were enough.

    Args:
        comparison: see :func:`compare`.

    Returns:
        Sentences.
    """
    lines = [_sentence(difference, comparison) for difference in comparison.differences]
    return [*lines, _verdict(comparison)]


def draw_comparison(comparison: Comparison) -> Figure:
    """The differences as shares of A's mean, with their intervals and each seed's own.

    Args:
        comparison: see :func:`compare`.

    Returns:
        A figure; call it within ``analysis.figures.style()``.
    """
    from analysis.figures import BLUE, GREY, ORANGE, new_figure

    shown = [d for d in comparison.differences if d.a.mean]
    figure, (axes,) = new_figure(0.9 + 0.42 * max(1, len(shown)))
    for row, d in enumerate(shown):
        scale = 100 / abs(d.a.mean)
        pairs = np.array(d.pairs) * scale
        axes.plot(pairs, np.full(len(pairs), row + 0.18), "|", color=GREY, markersize=6, alpha=0.7)
        color = (BLUE if (d.change.mean < 0) == MEASURES[d.key].lower_is_better else ORANGE) if d.is_clear else GREY
        axes.plot([d.change.low * scale, d.change.high * scale], [row, row], color=color, linewidth=3)
        axes.plot(d.change.mean * scale, row, "o", color=color)
    axes.axvline(0, color=GREY, linewidth=1)
    axes.set_yticks(range(len(shown)), [MEASURES[d.key].words for d in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlabel(f"{comparison.names[1]} minus {comparison.names[0]}, % of the mean of {comparison.names[0]}")
    return figure


def _difference(key: str, a: Values, b: Values) -> Difference:
    pairs = b - a
    change = interval(pairs.tolist())
    needed = _seeds_needed(pairs[~np.isnan(pairs)], PRECISION * abs(float(np.nanmean(a))) if change.runs else math.nan)
    return Difference(
        key, interval(a.tolist()), interval(b.tolist()), change, tuple(float(pair) for pair in pairs), needed
    )


def _seeds_needed(pairs: Values, half: float) -> int:
    """Seeds after which half of the interval is about as long as asked, by the spread seen so far; 0: not known."""
    if len(pairs) < 2 or not half > 0:
        return 0
    spread, seeds = float(pairs.std(ddof=1)), 2
    while seeds < 100_000 and t_quantile(0.975, seeds - 1) * spread / math.sqrt(seeds) > half:
        seeds = max(seeds + 1, math.floor(seeds * 1.02))
    return seeds


def _sentence(d: Difference, comparison: Comparison) -> str:
    measure, (first, second) = MEASURES[d.key], comparison.names
    means = f"{_number(d.a.mean)} with {first}, {_number(d.b.mean)} {measure.unit} with {second}"
    span = f"{_number(d.change.mean)} (95 %: {_number(d.change.low)} to {_number(d.change.high)}) {measure.unit}"
    if not d.is_clear:
        return f"{measure.words}: {means}; no clear difference, {span}."
    better = "better" if (d.change.mean < 0) == measure.lower_is_better else "worse"
    return f"{measure.words}: {means}; {second} is {better}, by {span}."


def _verdict(comparison: Comparison) -> str:
    seeds = len(comparison.seeds)
    vague = [d for d in comparison.differences if not d.is_clear and not d.is_precise and d.a.mean]
    if not vague:
        known = f"known to {PRECISION:.0%} of {comparison.names[0]}'s mean"
        return f"{seeds} seeds are enough: every difference is clear, or {known}."
    needed = max(d.needed for d in vague)
    names = ", ".join(MEASURES[d.key].words for d in vague)
    return (
        f"{seeds} seeds are not enough for: {names}. About {needed} seeds would show differences of {PRECISION:.0%} of"
        f" {comparison.names[0]}'s mean."
    )


def _number(value: float) -> str:
    return f"{value:.4g}"


def _same(cell: object, wanted: str) -> bool:
    try:
        return float(value_text(cell)) == float(wanted)
    except ValueError:
        return value_text(cell) == wanted


def table_rows(comparison: Comparison) -> list[Mapping[str, str]]:
    """The comparison as rows of text for a table.

    Args:
        comparison: see :func:`compare`.

    Returns:
        For each measure: ``measure`` with its unit, the two names, ``difference``, ``95 % interval``, ``seeds needed``.
    """
    return [
        {
            "measure": ", ".join(filter(None, (MEASURES[d.key].words, MEASURES[d.key].unit))),
            comparison.names[0]: _number(d.a.mean),
            comparison.names[1]: _number(d.b.mean),
            "difference": _number(d.change.mean),
            "95 % interval": f"{_number(d.change.low)} .. {_number(d.change.high)}",
            "seeds needed": str(d.needed or "-"),
        }
        for d in comparison.differences
    ]


def write_comparison(comparison: Comparison, path: Path) -> Path:
    """Write the figure of a comparison.

    Args:
        comparison: see :func:`compare`.
        path: file to write, .svg or .png.

    Returns:
        ``path``.

    Raises:
        InputError: it can't be written.
    """
    from analysis.figures import style

    try:
        with style(), whole_file(path) as part:
            draw_comparison(comparison).savefig(part, dpi=160)
    except OSError as error:
        raise InputError(f"--figure: {path}: can't be written: {error.strerror}") from None
    return path


def variant_names(a: str, b: str) -> tuple[str, str]:
    """Short names of two variants that differ: what picks them, or their folders' names, or all that was given."""
    (folder_a, wanted_a), (folder_b, wanted_b) = split_choice(a), split_choice(b)
    for names in ((wanted_a, wanted_b), (Path(folder_a).name, Path(folder_b).name)):
        if all(names) and names[0] != names[1]:
            return names
    return a, b
