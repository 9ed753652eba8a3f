"""A sizing, and its curve: the target's measure against the number of AGVs, bays or chargers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from analysis.figures import BLUE, GREY, RED, Drawing, new_figure, style, svg
from analysis.measures import Interval, interval
from analysis.turned_away import TurnedAway
from sumo_nets.whole_file import write_whole

#: What can be sized: the scenario's key, and its word.
SIZED = {"agvs": "AGVs", "bays": "bays", "chargers": "chargers"}


@dataclass(frozen=True, slots=True)
class Target:
    """What shall be reached.

    Attributes:
        words: as it was asked for.
        key: the measure, one of ``analysis.measures.MEASURES``, of which the mean over seeds counts.
        limit: it must be less than this, in the unit of the measure.
    """

    words: str
    key: str
    limit: float

    @property
    def unit(self) -> str:
        """Unit in which its values are shown."""
        return "%" if self.key == "turned_away_share" else "s"

    @property
    def goes_on_s(self) -> float:
        """How long a run goes on after the last request until all is known, seconds."""
        return self.limit if self.unit == "s" else 0.0

    def shown(self, value: float) -> str:
        """A value of the measure as a number of ``unit``."""
        if math.isinf(value):
            return "endless"
        return f"{100 * value:.1f}" if self.unit == "%" else f"{value:.0f}"


@dataclass(frozen=True, slots=True)
class Tried:
    """A number of AGVs, bays or chargers that was tried.

    Attributes:
        number: how many.
        meets: whether it meets the target.
        values: the measure of each seed, in the order of the seeds; infinite where customers turned away decide.
    """

    number: int
    meets: bool
    values: tuple[float, ...]

    @property
    def mean(self) -> Interval:
        """Mean over the seeds with its 95 % interval."""
        return interval(self.values)


@dataclass(frozen=True, repr=False)
class Sizing:
    """The answer: the least number that meets the target.

    Attributes:
        target: what it shall reach.
        number: the least that does, None if none does.
        tried: all numbers tried, in order.
        what: of what, a key of ``SIZED``.
        given: what was sized before, and is kept.
        away: number tried -> the customers turned away in all its runs.
    """

    target: Target
    number: int | None
    tried: tuple[Tried, ...]
    what: str = "agvs"
    given: Mapping[str, int] = field(default_factory=dict)
    away: Mapping[int, TurnedAway] = field(default_factory=dict)

    def __repr__(self) -> str:
        """The answer in a few words."""
        found = "no number" if self.number is None else count_of(self.number, self.what)
        return f"<Sizing: {found} for '{self.target.words}', {self.runs} runs>"

    @property
    def runs(self) -> int:
        """Number of runs that were needed."""
        return sum(len(tried.values) for tried in self.tried)


def count_of(number: int, what: str) -> str:
    """A number with its word, such as "1 AGV"."""
    return f"{number} {SIZED[what].removesuffix('s') if number == 1 else SIZED[what]}"


def size_curve(sizing: Sizing) -> Drawing:
    """Draw what each number that was tried reaches, with intervals and the limit.

    Args:
        sizing: the answer.

    Returns:
        The figure for a page.
    """
    word, name = SIZED[sizing.what], f"size-{sizing.what}"
    scale = 100.0 if sizing.target.unit == "%" else 1.0
    limit = scale * sizing.target.limit
    means = [tried.mean.mean if math.isfinite(tried.mean.mean) else math.nan for tried in sizing.tried]
    with style():
        figure, (axes,) = new_figure(3.0)
        for tried in (tried for tried in sizing.tried if math.isfinite(tried.mean.mean)):
            mean, half = scale * tried.mean.mean, scale * tried.mean.half
            color = BLUE if tried.meets else GREY
            axes.errorbar(tried.number, mean, half if math.isfinite(half) else 0.0, color=color, marker="o", capsize=3)
        axes.plot([t.number for t in sizing.tried], [scale * m for m in means], color=GREY, linewidth=1)
        axes.axhline(limit, color=RED, linestyle="--", label=f"{limit:g} {sizing.target.unit}")
        endless = [tried.number for tried in sizing.tried if math.isinf(tried.mean.mean)]
        if endless:
            top, told = axes.get_xaxis_transform(), "waits without end: too many turned away"
            axes.plot(endless, [0.97] * len(endless), "x", color=RED, transform=top, label=told)
        axes.set_xticks([tried.number for tried in sizing.tried])
        axes.set_xlabel(word)
        axes.set_ylabel(f"{sizing.target.words.partition(' <')[0]}, {sizing.target.unit}")
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=8)
        text = svg(figure, name, f"Number of {word}")
    caption = "Mean over the seeds and its 95 % interval; blue meets the target, grey does not; dashed: the limit."
    return Drawing(name, f"{sizing.target.words}, by number of {word}", caption, text)


def write_curve(drawing: Drawing, path: Path) -> None:
    """Write a figure as an SVG file.

    Args:
        drawing: the figure.
        path: the file.
    """
    write_whole(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{drawing.svg}\n')
