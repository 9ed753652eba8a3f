"""Demand profiles as a picture: expected occupancy, what the source says, arrivals and departures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.figures import BLUE, GREEN, GREY, ORANGE, style
from demand.profiles import Profile
from sumo_nets.errors import InputError
from sumo_nets.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def write_profiles_figure(profiles: Mapping[str, Profile], path: Path) -> Path:
    """Draw profiles, one beside the other.

    Args:
        profiles: name -> profile.
        path: file to write, .svg or .png.

    Returns:
        ``path``.

    Raises:
        InputError: it can't be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(2, len(profiles))
    rows = -(-len(profiles) // columns)
    with style():
        figure = Figure(figsize=(4.6 * columns, 2.4 * rows))
        FigureCanvasAgg(figure)
        axes: list[Axes] = list(figure.subplots(rows, columns, squeeze=False).ravel())
        for one, (name, profile) in zip(axes, profiles.items(), strict=False):
            _draw(one, name, profile)
        for one in axes[len(profiles) :]:
            one.set_visible(False)
        axes[0].legend(fontsize=7, loc="upper left")
        try:
            with whole_file(path) as part:
                figure.savefig(part, dpi=160, metadata={"Date": None} if path.suffix == ".svg" else None)
        except OSError as error:
            raise InputError(f"--figure: {path}: can't be written: {error.strerror}") from None
    return path


def _draw(axes: Axes, name: str, profile: Profile) -> None:
    hours = np.arange(profile.hours[0], profile.hours[-1] + 1e-9, 0.25)
    axes.plot(hours, [100 * profile.occupancy_at(h) for h in hours], color=BLUE, label="occupied")
    edges = np.append(np.arange(profile.hours[0], profile.hours[-1]), profile.hours[-1])
    pairs = list(itertools.pairwise(edges))
    came = [100 * profile.arrivals_between(a, b) / (b - a) for a, b in pairs]
    left = [100 * profile.departures_between(a, b) / (b - a) for a, b in pairs]
    axes.stairs(came, edges, color=GREEN, label="arrive an hour")
    axes.stairs(left, edges, color=ORANGE, label="leave an hour")
    seen = profile.observed
    axes.plot(list(seen), [100 * level for level in seen.values()], "o", color=GREY, markersize=4, label="source")
    axes.set_title(name)
    axes.set_xlabel("hour of the day")
    axes.set_ylabel("% of slots")
    axes.set_ylim(0, 100)
