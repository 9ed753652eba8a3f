"""Conflicts as they happened, from nothing but where each AGV stood in each tick; no plan, no controller is asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from controller.types import AgvNumber

if TYPE_CHECKING:
    import pandas as pd


class Meeting(NamedTuple):
    """Two AGVs in one place, or changing places, in one tick."""

    kind: str
    time_s: float
    agvs: tuple[AgvNumber, AgvNumber]


def meetings(trajectory: pd.DataFrame) -> list[Meeting]:
    """Vertex and swap conflicts of a run in discrete ticks.

    Args:
        trajectory: the record's table, sampled in every tick: ``time_s``, ``agv``, ``x_m``, ``y_m``.

    Returns:
        In order of time: a "vertex" for each pair of AGVs in one place, a "swap" for each pair that changed places
        between one tick and the next.
    """
    xy = trajectory.pivot(index="time_s", columns="agv", values=["x_m", "y_m"])
    times, agvs = xy.index.to_numpy(), xy["x_m"].columns.to_numpy()
    _, place = np.unique(
        np.round(np.stack([xy["x_m"].to_numpy(), xy["y_m"].to_numpy()], axis=-1), 3).reshape(-1, 2),
        axis=0,
        return_inverse=True,
    )
    place = place.reshape(len(times), len(agvs))
    found = []
    for i in range(len(agvs)):
        for j in range(i):
            a, b = place[:, j], place[:, i]
            same = np.flatnonzero(a == b)
            swap = np.flatnonzero((a[1:] == b[:-1]) & (b[1:] == a[:-1]) & (a[1:] != a[:-1])) + 1
            pair = (AgvNumber(int(agvs[j])), AgvNumber(int(agvs[i])))
            found += [Meeting("vertex", float(times[t]), pair) for t in same]
            found += [Meeting("swap", float(times[t]), pair) for t in swap]
    return sorted(found, key=lambda m: (m.time_s, m.agvs, m.kind))
