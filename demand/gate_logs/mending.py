"""Entries and exits paired by plate, and what the gates missed put back.

Cameras and coils miss cars, read them twice, and disagree about the time. Each car's movements must alternate: in, out,
in, out. Where they don't, the least is changed that makes them:

* the same movement again within two minutes is one movement, read twice;
* an exit right before an entry that both lack their other half is a pair the wrong way round;
* an entry without an exit is given one a typical stay later, and an exit without an entry one a typical stay earlier,
  but no further than half the way to the car's neighbouring movement. If a movement without a plate may be the missing
  one, the one next to that moment is taken;
* where most movements have a plate, each other movement without one is a car's of its own, an entry with the next exit
  if there is one within the longest stay.

The typical stay is the median of the stays read in full. At the log's ends a car may have been there before or stay
beyond; it is taken to, unless that would make its stay longer than the longest one read in full.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from math import inf
from statistics import median

#: Hour and step (+1 in, -1 out) of one car's movements.
Move = tuple[float, int]

_TWICE_H = 2 / 60


@dataclass(frozen=True)
class Mended:
    """Movements that alternate, car by car.

    Attributes:
        moves: car -> its movements in order.
        unread: movements without a plate, in order, if most have none.
        notes: what was changed, in words.
    """

    moves: Mapping[str, Sequence[Move]]
    unread: Sequence[Move]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Stays:
    """What stays read in full tell, hours, and when the log begins and ends."""

    typical: float
    longest: float
    begin: float
    end: float


def mend(cars: Mapping[str, Sequence[Move]], unread: Sequence[Move], begin: float, end: float) -> Mended:
    """Make each car's movements alternate.

    Args:
        cars: car -> its movements as read.
        unread: movements without a plate, in order.
        begin: hour at which the log begins.
        end: hour at which it ends.

    Returns:
        The mended movements.
    """
    once = {car: _read_once(sorted(moves, key=lambda move: move[0])) for car, moves in cars.items()}
    full = [b - a for moves in once.values() for (a, step), (b, after) in pairwise(moves) if step > after]
    stays = _Stays(median(full) if full else 0.0, max(full, default=inf), begin, end)
    turned = {car: _turned(moves, stays) for car, moves in once.items()}
    pool = {step: [hour for hour, s in unread if s == step] for step in (1, -1)}
    mended = {car: _filled(moves, stays, pool) for car, moves in turned.items()}
    left = sorted((hour, step) for step, hours in pool.items() for hour in hours)
    nameless: dict[str, list[Move]] = {}
    if len(unread) < sum(map(len, once.values())):
        names = (name for number in count(1) if (name := f"no plate {number}") not in cars)
        nameless = dict(zip(names, _visits(left, stays), strict=False))
        mended |= {car: _filled(moves, stays, {1: [], -1: []}) for car, moves in nameless.items()}
    known = {**turned, **nameless}
    added = {step: _count(mended, step) - _count(known, step) for step in (-1, 1)}
    for step, hours in pool.items():
        added[step] -= _count({"": unread}, step) - len(hours)  # not added: there, without a plate
    counts = {
        "movements read twice: counted once": sum(map(len, cars.values())) - sum(map(len, once.values())),
        "pairs the wrong way round (out before in): turned": _turns(once, turned),
        "movements without a plate: matched to a car that lacks one": len(unread) - len(left),
        "entries without an exit: an exit added after a typical stay": added[-1],
        "exits without an entry: an entry added a typical stay before": added[1],
    }
    notes = tuple(f"mended: {number} {words}" for words, number in counts.items() if number)
    return Mended(mended, [] if nameless else left, notes)


def _read_once(moves: Sequence[Move]) -> list[Move]:
    """Moves without repeats. Of an entry and an exit at one moment, the one that fits the move before comes first."""
    kept: list[Move] = []
    for move in _in_step(moves):
        if not kept or move[1] != kept[-1][1] or move[0] - kept[-1][0] > _TWICE_H:
            kept.append(move)
    return kept


def _in_step(moves: Sequence[Move]) -> list[Move]:
    ordered = list(moves)
    for place in range(len(ordered) - 1):
        a, b = ordered[place : place + 2]
        inside = place > 0 and ordered[place - 1][1] == 1
        if a[0] == b[0] and a[1] != b[1] and (a[1] == 1) == inside:
            ordered[place], ordered[place + 1] = b, a
    return ordered


def _turned(moves: Sequence[Move], stays: _Stays) -> list[Move]:
    steps = [step for _, step in moves]
    for place, ((out, step), (into, after)) in enumerate(pairwise(moves)):
        if (steps[place], steps[place + 1]) != (-1, 1) or (step, after) != (-1, 1) or into - out > stays.longest:
            continue
        before, behind = steps[place - 1] if place else 0, steps[place + 2] if place + 2 < len(steps) else 0
        lacks_entry = before == -1 or (not before and out - stays.begin > stays.longest)
        lacks_exit = behind == 1 or (not behind and stays.end - into > stays.longest)
        if before != 1 and behind != -1 and (lacks_entry or lacks_exit):
            steps[place], steps[place + 1] = 1, -1
    return [(hour, step) for (hour, _), step in zip(moves, steps, strict=True)]


def _filled(moves: Sequence[Move], stays: _Stays, pool: Mapping[int, list[float]]) -> list[Move]:
    filled: list[Move] = []
    for place, (hour, step) in enumerate(moves):
        before = moves[place - 1] if place else None
        behind = moves[place + 1] if place + 1 < len(moves) else None
        if step == -1 and (before[1] == -1 if before else hour - stays.begin > stays.longest):
            filled.append((_missing(hour, step, before, stays, pool), 1))
        filled.append((hour, step))
        if step == 1 and (behind[1] == 1 if behind else stays.end - hour > stays.longest):
            filled.append((_missing(hour, step, behind, stays, pool), -1))
    return filled


def _visits(moves: Sequence[Move], stays: _Stays) -> list[list[Move]]:
    """Movements without a plate as visits: first in, first out."""
    visits: list[list[Move]] = []
    waiting: deque[list[Move]] = deque()
    for hour, step in moves:
        while waiting and hour - waiting[0][0][0] > stays.longest:
            waiting.popleft()
        if step == -1 and waiting:
            waiting.popleft().append((hour, step))
        else:
            visits.append([(hour, step)])
            if step == 1:
                waiting.append(visits[-1])
    return visits


def _missing(hour: float, step: int, neighbour: Move | None, stays: _Stays, pool: Mapping[int, list[float]]) -> float:
    """When the other half of a movement was: an entry's exit after it, an exit's entry before it."""
    room = abs(neighbour[0] - hour) if neighbour else inf
    wanted = hour + step * min(stays.typical, room / 2)
    hours = pool[-step]
    place = bisect_left(hours, wanted)
    near = [
        k for k in (place - 1, place) if 0 <= k < len(hours) and 0 < step * (hours[k] - hour) < min(room, stays.longest)
    ]
    return hours.pop(min(near, key=lambda k: abs(hours[k] - wanted))) if near else wanted


def _turns(before: Mapping[str, Sequence[Move]], after: Mapping[str, Sequence[Move]]) -> int:
    return sum(a != b for car in before for a, b in zip(before[car], after[car], strict=True)) // 2


def _count(cars: Mapping[str, Sequence[Move]], step: int) -> int:
    return sum(s == step for moves in cars.values() for _, s in moves)
