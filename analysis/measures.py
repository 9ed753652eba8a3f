"""What runs are compared by: a few measures of each run after a warm-up, and intervals for their means.

Without a warm-up these are the metrics of a single run. A wait that has not ended when the run does counts with its
length so far, so that a controller that serves some customers quickly and others never does not look good. Customers
who were turned away have no wait; their share is a measure of its own. Sizing and tuning count each of them as one who
waits without end, so that nothing looks good because customers are turned away.

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

from analysis.statistic import statistic
from analysis.turned_away import SQL_CAME, SQL_TURNED_AWAY

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
#: Statistics of waits: the mean, quantiles, the longest.
_STATISTICS = ("mean", "p50", "p90", "p95", "p99", "max")

#: Key -> measure: waits of customers in seconds, then what the garage did.
MEASURES: Mapping[str, Measure] = {
    **{
        f"{wait}_{statistic}_s": Measure(f"{words}, {statistic}", "s")
        for wait, (_, _, words) in _WAITS.items()
        for statistic in _STATISTICS
    },
    "turned_away_share": Measure("customers turned away, of those who came", "share"),
    "tasks_per_hour": Measure("tasks served an hour", "tasks/h", False),
    "queue_mean": Measure("cars that wait for a bay, mean over time", "cars"),
    "deadlocks_per_hour": Measure("deadlocks found an hour", "1/h"),
}


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over runs and its two-sided confidence interval.

    Attributes:
        mean, low, high: the mean and the ends of the interval; infinite ends for a single run. All three are infinite
            if a value is.
        runs: number of runs.
    """

    mean: float
    low: float
    high: float
    runs: int

    @property
    def half(self) -> float:
        """Half the interval's length; infinite if the mean is."""
        return math.inf if math.isinf(self.mean) else (self.high - self.low) / 2


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
    if math.isinf(mean):
        return Interval(mean, mean, mean, len(known))
    if len(known) == 1:
        return Interval(mean, -math.inf, math.inf, 1)
    half = t_quantile(0.5 + confidence / 2, len(known) - 1) * float(known.std(ddof=1)) / math.sqrt(len(known))
    return Interval(mean, mean - half, mean + half, len(known))


def t_quantile(probability: float, degrees: int) -> float:
    """Quantile of Student's t distribution."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))


def measure_runs(runs: Runs, warmup_s: float = 0.0, *, endless: bool = False) -> pd.DataFrame:
    """The measures of each run.

    Args:
        runs: the runs.
        warmup_s: requests made, and time spent, before this simulated second don't count.
        endless: each customer who was turned away counts in every wait, as one who waits without end.

    Returns:
        A row for each run with the columns ``run``, ``seed`` and those of ``MEASURES``, in the order of the runs; NaN
        where a run had nothing to measure, infinite where a wait without end decides.
    """
    frame = runs.sql("SELECT run, seed FROM runs").df().set_index("run")
    frame = frame.join(_waits(runs, warmup_s, endless))
    for query in (_turned_away_query, _served_query, _queue_query, _deadlocks_query):
        frame = frame.join(runs.sql(query(warmup_s)).df().set_index("run"))
    missing = frame[["tasks_per_hour", "deadlocks_per_hour"]].fillna(0.0)
    frame[["tasks_per_hour", "deadlocks_per_hour"]] = missing
    result: pd.DataFrame = frame.loc[list(runs.folders), ["seed", *MEASURES]].reset_index()
    return result


def _waits(runs: Runs, warmup_s: float, endless: bool) -> pd.DataFrame:
    """The statistics of all waits, a row for each run that has customers."""
    import pandas as pd

    columns = ", ".join(
        f"list_sort(list(coalesce({end}, simulated_s) - requested_s)"
        f" FILTER (kind = '{kind}' AND state IN ('served', 'waiting'))) AS {wait}"
        for wait, (kind, end, _) in _WAITS.items()
    )
    query = (
        f"SELECT run, count(*) FILTER {SQL_TURNED_AWAY} AS away, {columns} FROM tasks JOIN runs USING (run)"
        f" WHERE requested_s >= {warmup_s!r} GROUP BY run"
    )
    rows = {
        run: {
            f"{wait}_{name}_s": statistic(name, () if values is None else values, away if endless else 0)
            for wait, values in zip(_WAITS, waits, strict=True)
            for name in _STATISTICS
        }
        for run, away, *waits in runs.sql(query).fetchall()
    }
    keys = [f"{wait}_{name}_s" for wait in _WAITS for name in _STATISTICS]
    return pd.DataFrame.from_dict(rows, orient="index", columns=keys, dtype=float)


def _turned_away_query(warmup_s: float) -> str:
    return (
        f"SELECT run, count(*) FILTER {SQL_TURNED_AWAY} / nullif(count(*) FILTER {SQL_CAME}, 0) AS turned_away_share"
        f" FROM tasks WHERE requested_s >= {warmup_s!r} GROUP BY run"
    )


def _served_query(warmup_s: float) -> str:
    return (
        f"SELECT run, count(*) * 3600.0 / (any_value(simulated_s) - {warmup_s!r}) AS tasks_per_hour"
        " FROM tasks JOIN runs USING (run)"
        f" WHERE state = 'served' AND done_s >= {warmup_s!r} AND simulated_s > {warmup_s!r} GROUP BY run"
    )


def _queue_query(warmup_s: float) -> str:
    held = "coalesce(lead(time_s) OVER (PARTITION BY run ORDER BY time_s), simulated_s) - time_s"
    return (
        "SELECT run, sum(queue * held_s) / nullif(sum(held_s), 0) AS queue_mean FROM ("
        f"SELECT run, queue, {held} AS held_s FROM timeline JOIN runs USING (run) WHERE time_s >= {warmup_s!r}"
        ") GROUP BY run"
    )


def _deadlocks_query(warmup_s: float) -> str:
    return (
        f"SELECT run, count(*) * 3600.0 / (any_value(simulated_s) - {warmup_s!r}) AS deadlocks_per_hour"
        " FROM events JOIN runs USING (run)"
        f" WHERE kind = 'deadlock_found' AND time_s >= {warmup_s!r} AND simulated_s > {warmup_s!r} GROUP BY run"
    )
