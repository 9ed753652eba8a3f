"""The requests that replay a gate log, as a file for the workload ``csv``."""

from __future__ import annotations

import csv
import io
import re
from collections import deque

from controller.types import RequestKind
from demand.csv_file import INSIDE
from demand.gate_logs.log import GateLog
from demand.types import car_names


def requests_csv(log: GateLog, initial: int | None = None) -> str:
    """Each movement as a request, in seconds from the log's begin.

    A car that leaves is taken to be asked for when it left: the log doesn't say how long its customer waited. Cars
    whose plates were not read leave in the order in which they came.

    Args:
        log: the part to replay.
        initial: cars inside when it begins; default: as few as the log allows.

    Returns:
        The file's text: first the cars inside, then the requests in order.
    """
    begin = log.covered[0][0]
    names = _Names()
    unread = max(0, (log.least_inside() if initial is None else initial) - len(log.inside))
    nameless = deque(names.of(name) for name in car_names("inside", unread))
    rows = [("0", INSIDE, name) for name in (*(names.of(car) for car in log.inside), *nameless)]
    for number, (hour, step, car) in enumerate(zip(log.hours, log.steps, log.cars, strict=True), 1):
        kind = RequestKind.PARK if step > 0 else RequestKind.RETRIEVE
        if car:
            name = names.of(car)
        elif step > 0:
            nameless.append(name := names.of(f"unread{number}"))
        else:
            name = nameless.popleft()
        rows.append((f"{3600 * (hour - begin):.0f}", kind.value, name))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([("time_s", "kind", "car"), *rows])
    return text.getvalue()


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
