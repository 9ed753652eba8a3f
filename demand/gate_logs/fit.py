"""The profile that fits a gate log."""

from __future__ import annotations

import numpy as np

from demand.gate_logs.coverage import Stretch
from demand.gate_logs.log import GateLog
from demand.profiles import Floats, Profile
from sumo_nets.errors import InputError

_DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
#: Days of the week that a profile can be fitted to, by name.
DAYS = {
    "all": frozenset(range(7)),
    "weekdays": frozenset(range(5)),
    **{name: frozenset({number}) for number, name in enumerate(_DAYS)},
}
_CLASSES = {"Mondays to Fridays": range(5), "Saturdays": range(5, 6), "Sundays": range(6, 7)}
#: With fewer days of a class, one unusual day weighs much.
_ENOUGH_DAYS = 4


def fit_profile(log: GateLog, slots: int, source: str, days: str = "all", initial: int | None = None) -> Profile:
    """The profile whose hourly rates are most likely to have made a log.

    Arrivals in an hour of the day are counted and divided by the hours that the log covers of it; the leaving rate is
    the cars that left divided by the hours that all cars together were there, which is its maximum-likelihood estimate.

    Args:
        log: the movements.
        slots: slots of the garage that was logged.
        source: where the log comes from, for the profile's provenance.
        days: one of ``DAYS``.
        initial: cars in the garage when the log begins; default: as few as the log allows.

    Returns:
        A profile of 24 hours.

    Raises:
        InputError: the log has none of these days, more cars leave than were there, or more stay than there are slots.
    """
    least = log.least_inside()
    if initial is not None and initial < least:
        raise InputError(f"--initial: {initial}: at least {least} cars were there before the first movement")
    covered = _chosen(log, days)
    order = np.lexsort((-log.steps, log.hours))  # of the same moment: in before out
    hours, steps = log.hours[order], log.steps[order]
    there = (least if initial is None else initial) + np.concatenate(([0.0], np.cumsum(steps)))
    if there.max() > slots:
        raise InputError(
            f"--slots: {slots}: up to {int(there.max())} cars were there at once; if exits were missed, plates in the"
            " log let them be mended"
        )
    came, left = (_counts(log, hours[steps == step], covered) for step in (1, -1))
    present = _car_hours(log, hours, there, covered)
    open_h = covered.sum(axis=0)
    known = np.maximum(open_h, 1e-9)
    touched = int((covered.sum(axis=1) > 0).sum())
    return Profile(
        words=f"fitted to {open_h.sum():.0f} h on {touched} days of a gate log ({days})",
        source=source,
        licence="",
        hours=tuple(range(25)),
        arrivals=tuple((came / known / slots).tolist()),
        leaving=tuple((left / np.maximum(present, 1e-9)).tolist()),
        occupancy=_at_midnight(hours, there, covered) / slots,
        observed={hour + 0.5: float(present[hour] / known[hour] / slots) for hour in np.flatnonzero(open_h).tolist()},
    )


def basis(log: GateLog, days: str) -> list[str]:
    """What a fit rests on, in words, with a warning where it is little.

    Args:
        log: the movements.
        days: one of ``DAYS``.

    Returns:
        Lines.
    """
    covered = _chosen(log, days)
    open_h = covered.sum(axis=1)
    weekday = (log.first_day.weekday() + np.arange(log.days)) % 7
    counts = {
        name: float(open_h[np.isin(weekday, numbers)].sum() / 24)
        for name, numbers in _CLASSES.items()
        if DAYS[days] & set(numbers)
    }
    lines = ["days covered: " + ", ".join(f"{count:.1f} {name}" for name, count in counts.items())]
    few = [name for name, count in counts.items() if count < _ENOUGH_DAYS - 0.5]
    if few:
        lines.append(
            f"warning: the log has fewer than {_ENOUGH_DAYS} {', '.join(few)}: one odd day weighs much in the profile"
        )
    silent = np.flatnonzero(covered.sum(axis=0) < 1e-9)
    if len(silent):
        lines.append(f"warning: no log of the hours {', '.join(map(str, silent))}: taken to be without traffic")
    return lines


def _chosen(log: GateLog, days: str) -> Floats:
    """Covered part of each hour, a row a day; 0 on days that are not chosen."""
    if days not in DAYS:
        raise InputError(f"--days: {days!r}: give one of {', '.join(DAYS)}")
    weekday = (log.first_day.weekday() + np.arange(log.days)) % 7
    covered = log.covered_hours() * np.isin(weekday, list(DAYS[days]))[:, None]
    if not covered.any():
        raise InputError(f"--days: {days}: the log has no such day")
    return covered


def _counts(log: GateLog, hours: Floats, covered: Floats) -> Floats:
    """Movements in covered time of the chosen days, by hour of the day."""
    read = np.any([(hours >= a) & (hours <= b) for a, b in log.covered], axis=0)
    counts = np.histogram(hours[read], np.arange(covered.size + 1.0))[0].reshape(covered.shape)
    return np.asarray((counts * (covered > 0)).sum(axis=0), dtype=np.float64)


def _car_hours(log: GateLog, hours: Floats, there: Floats, covered: Floats) -> Floats:
    """Hours that all cars together were there in covered time of the chosen days, by hour of the day."""
    times = np.concatenate(([min(0.0, hours[0])], hours, [max(float(covered.size), hours[-1])]))
    area = np.concatenate(([0.0], np.cumsum(np.diff(times) * there)))

    def within(stretch: Stretch) -> Floats:
        return np.diff(np.interp(np.clip(np.arange(covered.size + 1.0), *stretch), times, area))

    total = np.sum([within(stretch) for stretch in log.covered], axis=0).reshape(covered.shape)
    return np.asarray((total * (covered > 0)).sum(axis=0))


def _at_midnight(hours: Floats, there: Floats, covered: Floats) -> float:
    """Mean number of cars at the begin of the chosen days; at their first covered hours if no midnight is covered."""
    chosen = np.flatnonzero(covered.sum(axis=1) > 0)
    whole = chosen[covered[chosen, 0] > 0.5]
    firsts = 24.0 * whole if len(whole) else 24.0 * chosen + np.argmax(covered[chosen] > 0, axis=1)
    return float(np.mean(there[np.searchsorted(hours, firsts)]))
