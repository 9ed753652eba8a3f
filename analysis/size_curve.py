"""The curve of a sizing: the target's measure against the number of AGVs, bays or chargers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.figures import BLUE, GREY, RED, Drawing, new_figure, style, svg

if TYPE_CHECKING:
    from parking_sim.sizing import Sizing


def size_curve(sizing: Sizing) -> Drawing:
    """Draw what each number that was tried reaches, with intervals and the limit.

    Args:
        sizing: the answer, see ``parking_sim.sizing``.

    Returns:
        The figure for a page.
    """
    from parking_sim.sizing import SIZED

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
    path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n' + drawing.svg + "\n", encoding="utf-8")
