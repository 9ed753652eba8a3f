"""The requests that replay a gate log, as a file for the workload ``csv``."""

from __future__ import annotations

import re
from collections import deque

import numpy as np

from controller.types import RequestKind
from demand.csv_file import INSIDE
from demand.gate_logs.log import GateLog
from demand.types import car_names
from parking_sim.errors import InputError

COLUMNS = ("time_s", "kind", "car")


def requests_of(log: GateLog, initial: int | None = None) -> list[tuple[str, str, str]]:
    """Each movement as a request, in seconds from the log's begin.

    A car that leaves is taken to be asked for when it left: the log doesn't say how long its customer waited. Cars
    whose plates were not read leave in the order in which they came.

    Args:
        log: the part to replay.
        initial: cars inside when it begins; default: as few as the log allows.

    Returns:
        Rows of ``COLUMNS``: first the cars inside, then the requests in order.

    Raises:
        InputError: more cars leave than can have been there.
    """
    least = log.least_inside()
    if initial is not None and initial < least:
        raise InputError(f"--initial: {initial}: at least {least} cars were there before the first movement")
    begin = log.covered[0][0]
    names = _Names()
    unread = (least if initial is None else initial) - len(log.inside)
    nameless = deque(names.of(name) for name in car_names("inside", unread))
    rows = [("0", INSIDE, name) for name in (*map(names.of, log.inside), *nameless)]
    order = np.lexsort((-log.steps * np.array([not car for car in log.cars]), log.hours))
    for place in order.tolist():
        came, car = log.steps[place] > 0, log.cars[place]
        if car:
            name = names.of(car)
        elif came:
            nameless.append(name := names.of(f"unread{place + 1}"))
        else:
            name = nameless.popleft()
        kind = RequestKind.PARK if came else RequestKind.RETRIEVE
        rows.append((f"{3600 * (log.hours[place] - begin):.0f}", kind.value, name))
    return rows


class _Names:
    """Names of cars for a request file: letters, digits and any of _ . + -, each for one car."""

    def __init__(self) -> None:
        self._of: dict[str, str] = {}
        self._taken: set[str] = set()

    def of(self, car: str) -> str:
        if car not in self._of:
            plain = re.sub(r"[^\w.+-]+", "-", car).strip("-")
            name = next(n for n in (plain, *(f"{plain}.{k}" for k in range(2, 10**6))) if n not in self._taken)
            self._taken.add(name)
            self._of[car] = name
        return self._of[car]
