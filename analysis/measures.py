"""What runs are compared by: a few measures of each run after a warm-up, and intervals for their means.

Unlike the metrics of a single run, a wait that has not ended when the run does counts with its length so far, so that a
controller that serves some customers quickly and others never does not look good.

Means over seeds get Student's t interval: each run is one independent observation, however many customers it had. With
the few runs one can afford it keeps its confidence better than the bootstrap, whose intervals are too short for ten
values; see Law, *Simulation Modeling and Analysis*, chapter 9.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

    from analysis.runs import Runs

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Measure:
    """Something measured in each run.

    Attributes:
        words: what it is.
        unit: its unit.
        lower_is_better: which way is good.
    """

    words: str
    unit: str
    lower_is_better: bool = True


_WAITS: Mapping[str, tuple[str, str, str]] = {
    "retrieval_wait": ("retrieve", "delivered_s", "retrieval wait"),
    "retrieval_total": ("retrieve", "done_s", "retrieval until driven off"),
    "park_queue": ("park", "at_bay_s", "wait for a bay"),
    "park_total": ("park", "delivered_s", "parking, arrival to slot"),
}
#: Statistic -> SQL aggregate over a column of waits.
_STATISTICS = {
    "mean": "avg({0})",
    **{f"p{q}": f"quantile_cont({{0}}, {q / 100})" for q in (50, 90, 95, 99)},
    "max": "max({0})",
}

#: Key -> measure: waits of customers in seconds, then what the garage did.
MEASURES: Mapping[str, Measure] = {
    **{
        f"{wait}_{statistic}_s": Measure(f"{words}, {statistic}", "s")
        for wait, (_, _, words) in _WAITS.items()
        for statistic in _STATISTICS
    },
    "tasks_per_hour": Measure("tasks served an hour", "tasks/h", False),
    "queue_mean": Measure("cars that wait for a bay, mean over time", "cars"),
    "deadlocks_per_hour": Measure("deadlocks found an hour", "1/h"),
}


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over runs and its two-sided confidence interval.

    Attributes:
        mean, low, high: the mean and the ends of the interval; infinite ends for a single run.
        runs: number of runs.
    """

    mean: float
    low: float
    high: float
    runs: int

    @property
    def half(self) -> float:
        """Half the interval's length."""
        return (self.high - self.low) / 2


def interval(values: Sequence[float], confidence: float = CONFIDENCE) -> Interval:
    """Student's t interval for the mean of independent values.

    Args:
        values: one for each run; NaN values are left out.
        confidence: two-sided, between 0 and 1.

    Returns:
        The interval; NaN without values.
    """
    known = np.array([value for value in values if not math.isnan(value)])
    if len(known) == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    mean = float(known.mean())
    if len(known) == 1:
        return Interval(mean, -math.inf, math.inf, 1)
    half = t_quantile(0.5 + confidence / 2, len(known) - 1) * float(known.std(ddof=1)) / math.sqrt(len(known))
    return Interval(mean, mean - half, mean + half, len(known))


def t_quantile(probability: float, degrees: int) -> float:
    """Quantile of Student's t distribution."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))


def measure_runs(runs: Runs, warmup_s: float = 0.0) -> pd.DataFrame:
    """The measures of each run.

    Args:
        runs: the runs.
        warmup_s: requests made, and time spent, before this simulated second don't count.

    Returns:
        A row for each run with the columns ``run``, ``seed`` and those of ``MEASURES``, in the order of the runs; NaN
        where a run had nothing to measure.
    """

    frame = runs.sql("SELECT run, seed FROM runs").df().set_index("run")
    for query in (_waits_query(warmup_s), _served_query(warmup_s), _queue_query(warmup_s), _deadlocks_query(warmup_s)):
        frame = frame.join(runs.sql(query).df().set_index("run"))
    missing = frame[["tasks_per_hour", "deadlocks_per_hour"]].fillna(0.0)
    frame[["tasks_per_hour", "deadlocks_per_hour"]] = missing
    result: pd.DataFrame = frame.loc[list(runs.folders), ["seed", *MEASURES]].reset_index()
    return result


def _waits_query(warmup_s: float) -> str:
    columns = ", ".join(
        f"{aggregate.format(f'coalesce({end}, simulated_s) - requested_s')} FILTER (kind = '{kind}') AS {wait}_{name}_s"
        for wait, (kind, end, _) in _WAITS.items()
        for name, aggregate in _STATISTICS.items()
    )
    return (
        f"SELECT run, {columns} FROM tasks JOIN runs USING (run)"
        f" WHERE tasks.state <> 'refused' AND requested_s >= {warmup_s!r} GROUP BY run"
    )


def _served_query(warmup_s: float) -> str:
    return (
        f"SELECT run, count(*) * 3600.0 / (any_value(simulated_s) - {warmup_s!r}) AS tasks_per_hour"
        f" FROM tasks JOIN runs USING (run) WHERE done_s >= {warmup_s!r} AND simulated_s > {warmup_s!r} GROUP BY run"
    )


def _queue_query(warmup_s: float) -> str:
    return f"SELECT run, avg(queue) AS queue_mean FROM timeline WHERE time_s >= {warmup_s!r} GROUP BY run"


def _deadlocks_query(warmup_s: float) -> str:
    return (
        f"SELECT run, count(*) * 3600.0 / (any_value(simulated_s) - {warmup_s!r}) AS deadlocks_per_hour"
        " FROM events JOIN runs USING (run)"
        f" WHERE kind = 'deadlock_found' AND time_s >= {warmup_s!r} AND simulated_s > {warmup_s!r} GROUP BY run"
    )
