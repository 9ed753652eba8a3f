"""Statistics that several reproductions need."""

from __future__ import annotations

import math
from collections.abc import Sequence


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
    """Wilcoxon's signed-rank test on pairs, one-sided.

    Args:
        a, b: the same measure of both, pair by pair.

    Returns:
        Probability of such ranks, or ones that speak more for it, if ``a`` is no less than ``b``; 1 if no pair differs.
    """
    from scipy.stats import wilcoxon

    if all(x == y for x, y in zip(a, b, strict=True)):
        return 1.0
    return float(wilcoxon(a, b, alternative="less", zero_method="wilcox").pvalue)
