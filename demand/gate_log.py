"""Gate logs: what a garage's barriers wrote down, and the profile that fits it.

A log is a CSV file with a header and the columns

| column | content |
|---|---|
| ``time`` | moment, ISO 8601 such as ``2024-05-04 13:07:30``; a time zone is ignored |
| ``event`` | ``in`` or ``out`` |
| ``car`` | ticket or plate, if known; not needed, and not read |

Rows may come in any order. To run a logged day itself instead of a profile, see the traffic kind ``csv``.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from pathlib import Path

import numpy as np

from demand.profiles import Floats, Profile
from parking_sim.errors import InputError

_DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
#: Days of the week that a profile can be fitted to, by name.
DAYS = {
    "all": frozenset(range(7)),
    "weekdays": frozenset(range(5)),
    **{name: frozenset({number}) for number, name in enumerate(_DAYS)},
}


@dataclass(frozen=True)
class GateLog:
    """Movements through the gates, in order of time.

    Attributes:
        first_day: the day of the first movement.
        hours: hours since the begin of that day.
        steps: +1 for each car in, -1 for each out.
    """

    first_day: date
    hours: Floats
    steps: Floats

    @property
    def days(self) -> int:
        """Number of days from the first movement's to the last's."""
        return int(self.hours[-1] // 24) + 1


def read_gate_log(path: Path) -> GateLog:
    """Read a gate log.

    Args:
        path: a CSV file, see the module's text.

    Returns:
        Its movements.

    Raises:
        InputError: it can't be read, a column is missing, or a value is not valid.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = reader.fieldnames or ()
            if not {"time", "event"} <= set(columns):
                raise InputError(f"{path}: row 1: {','.join(columns)!r}: the columns are time, event (in or out), car")
            rows = [_movement(row, reader.line_num, path) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
        raise InputError(f"{path}: can't be read as a CSV file: {reason}") from None
    if not rows:
        raise InputError(f"{path}: has no movements")
    rows.sort(key=lambda row: (row[0], -row[1]))  # of the same moment: in before out
    start = datetime.combine(rows[0][0].date(), datetime.min.time())
    hours = np.array([(time - start) / timedelta(hours=1) for time, _ in rows])
    return GateLog(start.date(), hours, np.array([float(step) for _, step in rows]))


def fit_profile(log: GateLog, slots: int, source: str, days: str = "all", initial: int | None = None) -> Profile:
    """The profile whose hourly rates are most likely to have made a log.

    Arrivals of an hour of the day are counted and divided by the days; the leaving rate is the cars that left divided
    by the hours that all cars together were there, which is its maximum-likelihood estimate.

    Args:
        log: the movements.
        slots: slots of the garage that was logged.
        source: where the log comes from, for the profile's provenance.
        days: one of ``DAYS``.
        initial: cars in the garage before the first movement; default: as few as the log allows.

    Returns:
        A profile of 24 hours.

    Raises:
        InputError: the log has none of these days, more cars leave than were there, or more stay than there are slots.
    """
    if days not in DAYS:
        raise InputError(f"--days: {days!r}: give one of {', '.join(DAYS)}")
    least = int(max(0, -np.min(np.cumsum(log.steps))))
    if initial is not None and initial < least:
        raise InputError(f"--initial: {initial}: at least {least} cars were there before the first movement")
    chosen = [d for d in range(log.days) if (log.first_day + timedelta(d)).weekday() in DAYS[days]]
    if not chosen:
        raise InputError(f"--days: {days}: the log has no such day")
    there = (least if initial is None else initial) + np.concatenate(([0.0], np.cumsum(log.steps)))
    if there.max() > slots:
        raise InputError(f"--slots: {slots}: up to {int(there.max())} cars were there at once")
    came, left, present = (_by_hour(log, there, chosen, what) for what in ("in", "out", "present"))
    at_midnight = np.mean([there[np.searchsorted(log.hours, 24 * day)] for day in chosen])
    levels = present.mean(axis=0) / slots
    return Profile(
        words=f"fitted to {len(chosen)} days of a gate log ({days})",
        source=source,
        licence="",
        hours=tuple(range(25)),
        arrivals=tuple((came.mean(axis=0) / slots).tolist()),
        leaving=tuple((left.sum(axis=0) / np.maximum(present.sum(axis=0), 1e-9)).tolist()),
        occupancy=float(at_midnight / slots),
        observed={hour + 0.5: float(level) for hour, level in enumerate(levels)},
    )


def _movement(row: dict[str, str], number: int, path: Path) -> tuple[datetime, int]:
    try:
        time = datetime.fromisoformat((row["time"] or "").strip()).replace(tzinfo=None)
    except ValueError:
        raise InputError(f"{path}: row {number}: time: {row['time']!r}: give such as 2024-05-04 13:07:30") from None
    event = (row["event"] or "").strip()
    if event not in ("in", "out"):
        raise InputError(f"{path}: row {number}: event: {event!r}: give in or out")
    return time, 1 if event == "in" else -1


def _by_hour(log: GateLog, there: Floats, days: list[int], what: str) -> Floats:
    """Cars that came or left, or car-hours present, in each hour of the chosen days: a row a day."""
    edges = np.arange(24 * log.days + 1, dtype=np.float64)
    if what == "present":
        times = np.concatenate(([0.0], log.hours, [edges[-1]]))
        area = np.concatenate(([0.0], np.cumsum(np.diff(times) * there)))
        values = np.diff(np.interp(edges, times, area))
    else:
        values = np.histogram(log.hours[log.steps == (1 if what == "in" else -1)], edges)[0].astype(np.float64)
    return np.asarray(values.reshape(-1, 24)[days])
