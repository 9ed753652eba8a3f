"""Which hours a log covers: from its begin to its end, without the stretches in which it was silent by a fault.

A silence is taken for an outage if the other days make it incredible. Let an hour of the day have had ``n`` movements
in ``E`` hours of the other days of its class (Monday to Friday, Saturdays, Sundays), and let the silence take ``e``
hours of it. If the traffic was the same, none of the ``n`` fell in the silence with probability
``(E / (E + e)) ** n``; the product over the hours of the day is the probability of the whole silence (the conditional
test of two Poisson counts). It is an outage if that is less than one in a thousand for the whole log, which is one in
a thousand times the number of silences. A day that is always quiet, such as a closed Sunday, is none, and a log of one
day of a class has nothing to compare with.
"""

from __future__ import annotations

from datetime import date, timedelta
from itertools import pairwise

import numpy as np

from demand.profiles import Floats

#: Stretch of time, hours since the log's first midnight.
Stretch = tuple[float, float]

_CHANCE = 1e-3
#: Shorter silences are not looked at.
_SHORTEST_H = 0.5
#: Hours of the day of which the other days have less tell nothing.
_KNOWN_H = 0.5


def ends(hours: Floats) -> Stretch:
    """When a log begins and ends, as far as its movements tell.

    It is open as long before the first movement as the second comes after it, and likewise at the end, but not beyond
    the midnights next to them. Counting from the first movement to the last would find too many in too little time.

    Args:
        hours: when the movements were, in order.

    Returns:
        Begin and end.
    """
    first, last = float(hours[0]), float(hours[-1])
    if first == last:
        return first // 24 * 24, first // 24 * 24 + 24
    before, after = float(hours[1] - hours[0]), float(hours[-1] - hours[-2])
    return max(first - before, first // 24 * 24), min(last + after, last // 24 * 24 + 24)


def outages(hours: Floats, first_day: date, within: Stretch) -> list[Stretch]:
    """Silences that are outages, see the module's text.

    Args:
        hours: when the movements were read, in order.
        first_day: the day at whose midnight the hours begin.
        within: the log's begin and end.

    Returns:
        The outages in order.
    """
    days = int(within[1] // 24) + 1
    counts = _rows(np.histogram(hours, np.arange(24 * days + 1.0))[0], days)
    limit = np.log(_CHANCE / max(1, len(hours) - 1))
    silences = [(float(a), float(b)) for a, b in pairwise(hours) if b - a >= _SHORTEST_H]
    spans = {silence: _rows(cover([silence], days), days) for silence in silences}
    kind = np.maximum(0, (first_day.weekday() + np.arange(days)) % 7 - 4)
    found: list[Stretch] = []
    open_h = _rows(cover([within], days), days)
    while new := [s for s in silences if s not in found and _chance(counts, open_h, spans[s], kind) < limit]:
        found += new
        open_h = open_h - sum(spans[silence] for silence in new)
    return sorted(found)


def without(whole: Stretch, holes: list[Stretch]) -> list[Stretch]:
    """A stretch of time without some parts of it, which come in order."""
    edges = [whole[0], *(edge for hole in holes for edge in hole), whole[1]]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]


def cover(stretches: list[Stretch], days: int) -> Floats:
    """How much of each hour since the first midnight some stretches cover, hours."""
    edges = np.arange(24 * days + 1.0)
    return np.asarray(np.sum([np.diff(np.clip(edges, a, b)) for a, b in stretches], axis=0), dtype=np.float64)


def in_words(stretch: Stretch, first_day: date) -> str:
    """Such as ``2024-05-06 14:10 to 18:20``."""
    begin, end = (_moment(hour, first_day) for hour in stretch)
    return f"{begin} to {end.removeprefix(begin[:11])}"


def _moment(hour: float, first_day: date) -> str:
    minutes = round(60 * hour)
    return f"{first_day + timedelta(minutes // 1440)} {minutes // 60 % 24:02}:{minutes % 60:02}"


def _rows(values: Floats, days: int) -> Floats:
    return np.asarray(values, dtype=np.float64).reshape(days, 24)


def _chance(counts: Floats, open_h: Floats, span: Floats, kind: Floats) -> float:
    """Logarithm of the probability of a silence by the other days: a row a day, a column for each hour of the day."""
    touched = span.any(axis=1)
    total = 0.0
    for number in np.unique(kind[touched]):
        others = (kind == number) & ~touched
        there = open_h[others].sum(axis=0)
        known = there > _KNOWN_H
        silent = span[touched & (kind == number)].sum(axis=0)[known]
        total -= float(np.sum(counts[others].sum(axis=0)[known] * np.log1p(silent / there[known])))
    return total
