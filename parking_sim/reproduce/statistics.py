"""Statistics that several reproductions need, and what samples say about claims by them.

A claim is shown, or its contrary is, at the level of 5 % to that side. A sample that reaches the level to neither side
tells nothing: four pairs never do, since the least p value that they can have is 1/16.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from analysis.measures import Interval
from parking_sim.reproduce.findings import Verdict, verdict

#: Probability of finding a difference to one side where there is none.
LEVEL = 0.05


def wilson(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval for a share; with the default it holds 95 %.

    Args:
        successes, trials: counts, at least one trial.
        z: quantile of the normal distribution.

    Returns:
        Lower and upper end, from 0 to 1.
    """
    p = successes / trials
    centre = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


def fewer(a: Sequence[float], b: Sequence[float]) -> float:
    """Wilcoxon's signed-rank test on pairs, one-sided and exact, ties included; pairs that don't differ don't count.

    Exact because counts of collisions tie so often that the usual normal approximation finds too much.

    Args:
        a, b: the same measure of both, pair by pair.

    Returns:
        Probability of these ranks, or ones that speak more for ``a`` being less, if either sign were as likely; 1 if no
        pair differs.
    """
    differences = np.round(np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64), 9)
    differences = differences[differences != 0]
    size = np.abs(differences)
    twice_rank = [int(2 * (size < s).sum() + (size == s).sum() + 1) for s in size]
    chance = np.zeros(sum(twice_rank) + 1)  # of each sum of the doubled ranks that have a plus
    chance[0] = 1.0
    for rank in twice_rank:
        chance[rank:] += chance[:-rank]
        chance /= 2
    plus = sum(rank for rank, d in zip(twice_rank, differences, strict=True) if d > 0)
    return float(chance[: plus + 1].sum())


def is_less(a: Sequence[float], b: Sequence[float]) -> Verdict:
    """Whether ``a`` is less than ``b``, by the signed-rank test on pairs to either side."""
    return verdict(fewer(a, b) < LEVEL, fewer(b, a) < LEVEL)


def is_below(value: Interval, limit: float) -> Verdict:
    """Whether a mean is below a limit, by its interval; a single value has none."""
    return verdict(value.high < limit, value.low > limit)


def is_most(cases: int, trials: int) -> Verdict:
    """Whether something happens in more than half of all cases, by Wilson's interval for its share."""
    low, high = wilson(cases, trials)
    return verdict(low > 0.5, high < 0.5)
