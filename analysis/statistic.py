"""Statistics of waits. Some waits may have no end."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def statistic(name: str, waits: Sequence[float], endless: int = 0) -> float:
    """A statistic of waits.

    Args:
        name: mean, max, or p with a number of percent; quantiles interpolate linearly between order statistics.
        waits: seconds, in rising order.
        endless: number of waits without end, which come on top.

    Returns:
        Seconds; infinite if a wait without end has a part in it, NaN without waits.
    """
    count = len(waits) + endless
    if count == 0:
        return math.nan
    if name == "mean":
        return math.inf if endless else float(np.mean(waits))
    at = (count - 1) * (1.0 if name == "max" else int(name[1:]) / 100)
    if at > len(waits) - 1 + 1e-9:
        return math.inf
    return float(np.interp(at, range(len(waits)), waits))
