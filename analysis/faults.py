"""The faults of a run, from its record: what was out of order, where, and from when to when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.words import listed, words

if TYPE_CHECKING:
    from analysis.tables import Run

#: A fault names so many places, then counts the others.
_PLACES = 6


@dataclass(frozen=True)
class FaultSpan:
    """One fault.

    Attributes:
        number: its number in the run.
        cause: its kind, see ``parking_sim.fault_config``; also tow, repair, late and lost.
        agvs: AGVs concerned.
        places: names of the places concerned; of a zone stop the zone's centre comes first.
        start_s, end_s: simulated seconds from begin to end; infinite if it did not end in the run.
    """

    number: int
    cause: str
    agvs: tuple[int, ...]
    places: tuple[str, ...]
    start_s: float
    end_s: float

    @property
    def text(self) -> str:
        """The fault in a few words, with its number."""
        if self.cause == "zone_stop":
            rest = len(self.places) - _PLACES
            more = f" and {rest} more" if rest > 0 else ""
            return f"zone stop {self.number} round {self.places[0]} closes {', '.join(self.places[:_PLACES])}{more}"
        if self.places:
            what = "is blocked" if self.cause == "blocked" else f"({self.cause}) is out of order"
            return f"{', '.join(self.places)} {what} (fault {self.number})"
        return f"{words(self.cause)} of {listed(self.agvs)} (fault {self.number})"


def fault_spans(run: Run) -> Mapping[int, FaultSpan]:
    """The faults of a run by their numbers, in the order in which they began.

    Args:
        run: a record.
    """
    ends = {int(row["fault"]): float(row["time_s"]) for row in run.details("fault_end").to_dict("records")}
    names = run.vertices["vertex"].tolist()
    spans = {}
    for row in run.details("fault_start").to_dict("records"):
        number = int(row["fault"])
        spans[number] = FaultSpan(
            number,
            str(row["cause"]),
            tuple(int(n) for n in row["agvs"]),
            tuple(names[v] for v in row["vertices"]),
            float(row["time_s"]),
            ends.get(number, math.inf),
        )
    return spans
