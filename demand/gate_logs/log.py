"""A gate log as a whole: its movements, mended, and the hours that it covers.

A log has a header and a row for each movement: when, in or out, and, if known, the ticket or plate. The rows may come
in any order; see :mod:`demand.gate_logs.dialect` for what is recognised, :mod:`demand.gate_logs.mending` for how missed
reads are mended and :mod:`demand.gate_logs.coverage` for gaps.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from pathlib import Path

import numpy as np

from demand.gate_logs.coverage import Stretch, cover, ends, in_words, outages, without
from demand.gate_logs.dialect import Dialect, read_movements
from demand.gate_logs.mending import Move, mend
from demand.profiles import Floats
from sumo_nets.errors import InputError

#: Days from a log's first movement to its last: ten years.
_MOST_DAYS = 3660


@dataclass(frozen=True)
class GateLog:
    """Movements through the gates.

    Attributes:
        first_day: the day at whose midnight the hours begin.
        hours: when, in order.
        steps: +1 for each car in, -1 for each out.
        cars: the car of each movement; "" if it was not read. The movements of a car alternate.
        inside: cars inside when the log begins, as far as their plates tell.
        covered: stretches of time in which movements were read, in order.
        notes: what was recognised, mended and left out, in words.
    """

    first_day: date
    hours: Floats
    steps: Floats
    cars: tuple[str, ...]
    inside: tuple[str, ...]
    covered: tuple[Stretch, ...]
    notes: tuple[str, ...]

    @property
    def days(self) -> int:
        """Number of days that the log touches."""
        return int(-(-self.covered[-1][1] // 24))

    def covered_hours(self) -> Floats:
        """How much of each hour is covered: a row a day, a column for each hour of the day."""
        return cover(list(self.covered), self.days).reshape(-1, 24)

    def least_inside(self) -> int:
        """The fewest cars that can have been inside when the log begins: those known, and as many as left unread."""
        unread = np.array([not car for car in self.cars])
        order = np.lexsort((-self.steps, self.hours))  # of the same moment: in before out
        return len(self.inside) + int(max(0, -np.min(np.cumsum((self.steps * unread)[order]), initial=0)))


def read_gate_log(path: Path, dialect: Dialect | None = None, keep_gaps: bool = False) -> GateLog:
    """Read a gate log.

    Args:
        path: a text file with separated values.
        dialect: what the file doesn't say about itself.
        keep_gaps: count every silence as no demand, instead of leaving outages out.

    Returns:
        The log, mended.

    Raises:
        InputError: it can't be read, or something in it can't be understood.
    """
    movements = read_movements(path, dialect or Dialect())
    table = movements.table.sort_values("time", kind="stable")
    first_day, last_day = (table["time"].iloc[place].date() for place in (0, -1))
    if (last_day - first_day).days > _MOST_DAYS:
        raise InputError(f"{path}: time: from {first_day} to {last_day}: at most {_MOST_DAYS} days are valid")
    hours = np.asarray((table["time"] - np.datetime64(first_day)) / np.timedelta64(1, "h"), dtype=np.float64)
    whole = ends(hours)
    holes = [] if keep_gaps else outages(hours, first_day, whole)
    unread: list[Move] = []
    cars: dict[str, list[Move]] = {}
    names: dict[str, str] = {}
    for hour, step, car in zip(hours.tolist(), table["step"].tolist(), table["car"].tolist(), strict=True):
        if car:
            name = names.setdefault(re.sub(r"[\W_]+", "", car).upper(), car)
            cars.setdefault(name, []).append((hour, step))
        else:
            unread.append((hour, step))
    mended = mend(cars, unread, *whole)
    moves_of = {"": mended.unread, **mended.moves}
    rows = sorted(
        ((hour, step, car) for car, moves in moves_of.items() for hour, step in moves),
        key=lambda row: row[0],  # stable: a car's movements keep their order
    )
    gaps = tuple(
        f"outage: {in_words(hole, first_day)}, {hole[1] - hole[0]:.1f} h without a movement; the other days have many"
        for hole in holes
    )
    return GateLog(
        first_day=first_day,
        hours=np.array([row[0] for row in rows]),
        steps=np.array([float(row[1]) for row in rows]),
        cars=tuple(row[2] for row in rows),
        inside=tuple(car for car, moves in mended.moves.items() if moves[0][1] == -1),
        covered=tuple(without(whole, holes)),
        notes=(*movements.notes, *mended.notes, *gaps),
    )


def cut(log: GateLog, begin: datetime | None, end: datetime | None) -> GateLog:
    """A part of a log, taken to be covered from begin to end, outages aside.

    Args:
        log: the log.
        begin: when the part begins; default: with the log.
        end: when it ends; default: with the log.

    Returns:
        The part; the cars inside are those that came before and had not left.

    Raises:
        InputError: it ends before it begins, or the log has no movement in it.
    """
    first = _hour(begin, log) if begin else log.covered[0][0]
    last = _hour(end, log) if end else log.covered[-1][1]
    within = (log.hours >= first) & (log.hours < last)
    whole = in_words((log.covered[0][0], log.covered[-1][1]), log.first_day)
    if not within.any():
        raise InputError(f"--from, --to: no movement in this time; the log covers {whole}")
    beyond = first < log.covered[0][0] - 1 or last > log.covered[-1][1] + 1
    holes = [(a[1], b[0]) for a, b in zip(log.covered, log.covered[1:], strict=False)]
    kept = [(max(a, first), min(b, last)) for a, b in holes if a < last and b > first]
    shift = 24 * (first // 24)
    inside = dict.fromkeys(log.inside)
    for place in np.flatnonzero(log.hours < first).tolist():
        car = log.cars[place]
        if car and log.steps[place] > 0:
            inside[car] = None
        elif car:
            inside.pop(car)
    return replace(
        log,
        first_day=log.first_day + timedelta(days=first // 24),
        hours=log.hours[within] - shift,
        steps=log.steps[within],
        cars=tuple(car for car, there in zip(log.cars, within.tolist(), strict=True) if there),
        inside=tuple(inside),
        covered=tuple((a - shift, b - shift) for a, b in without((first, last), kept)),
        notes=(*log.notes, f"note: by its movements the log covers {whole} only") if beyond else log.notes,
    )


def window(day: str | None, begin: str | None, end: str | None) -> tuple[datetime | None, datetime | None]:
    """Begin and end as a user gives them.

    Args:
        day: a date, or None.
        begin, end: moments such as ``2026-03-07 08:00``; of the day, clock times such as ``08:00`` and ``24:00``.

    Returns:
        Both moments; None is the log's own.

    Raises:
        InputError: one is no moment, or the end is not after the begin.
    """
    try:
        midnight = datetime.combine(date.fromisoformat(day), time()) if day else None
    except ValueError:
        raise InputError(f"--date: {day!r}: give such as 2026-03-07") from None
    first = _given(begin or ("00:00" if day else ""), "--from", midnight)
    last = _given(end or ("24:00" if day else ""), "--to", midnight)
    if first and last and first >= last:
        raise InputError(f"--to: {end!r}: give a moment after --from {first:%Y-%m-%d %H:%M}")
    return first, last


def _given(text: str, option: str, midnight: datetime | None) -> datetime | None:
    if not text:
        return None
    try:
        if midnight and text == "24:00":
            return midnight + timedelta(days=1)
        if midnight and len(text) < 9:
            return datetime.combine(midnight.date(), time.fromisoformat(text.zfill(5)))
        return datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError:
        like = "08:00" if midnight else "'2026-03-07 08:00', or a clock time such as 08:00 with --date"
        raise InputError(f"{option}: {text!r}: give such as {like}") from None


def _hour(moment: datetime, log: GateLog) -> float:
    return (moment - datetime.combine(log.first_day, time())) / timedelta(hours=1)
