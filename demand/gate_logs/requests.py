"""The requests that replay a gate log, as a file for the workload ``csv``."""

from __future__ import annotations

from collections import deque
from itertools import count

import numpy as np

from controller.types import RequestKind
from demand.csv_file import INSIDE
from demand.gate_logs.log import GateLog
from sumo_nets.errors import InputError

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
    begin, known = log.covered[0][0], {*log.inside, *log.cars}
    names = (name for number in count(1) if (name := f"no plate {number}") not in known)
    nameless = deque(next(names) for _ in range((least if initial is None else initial) - len(log.inside)))
    rows = [("0", INSIDE, car) for car in (*log.inside, *nameless)]
    order = np.lexsort((-log.steps * np.array([not car for car in log.cars]), log.hours))  # no plate: in before out
    for place in order.tolist():
        came, car = log.steps[place] > 0, log.cars[place]
        if not car and came:
            nameless.append(car := next(names))
        elif not car:
            car = nameless.popleft()
        kind = RequestKind.PARK if came else RequestKind.RETRIEVE
        rows.append((f"{3600 * (log.hours[place] - begin):.0f}", kind.value, car))
    return rows
