"""Times of a run as its pages and texts show them: the time of day if the demand has one, else the simulated time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sumo_nets.errors import InputError

_DAY_S = 86_400


@dataclass(frozen=True)
class Clock:
    """Shows simulated seconds.

    Attributes:
        day_start_h: hour of the day at which the run starts; None if the demand has no time of day.
    """

    day_start_h: float | None = None

    @classmethod
    def of(cls, meta: Mapping[str, Any]) -> Clock:
        """The clock of a run.

        Args:
            meta: keys as in ``analysis.record.META``.
        """
        return cls(meta.get("day_start_h"))

    @property
    def name(self) -> str:
        """What the clock shows."""
        return "simulated time" if self.day_start_h is None else "time of day"

    @property
    def offset_s(self) -> int:
        """Seconds of the clock at the start of the run."""
        return round(3600 * (self.day_start_h or 0.0))

    def at(self, time_s: float) -> str:
        """A moment: "h:mm:ss" in whole seconds that have passed, from the second day on with the day before it.

        Args:
            time_s: simulated seconds.
        """
        seconds = math.floor(time_s + 1e-6) + self.offset_s
        if self.day_start_h is None or seconds < _DAY_S:
            return _hms(seconds)
        return f"day {seconds // _DAY_S + 1}, {_hms(seconds % _DAY_S)}"

    def seconds(self, text: str) -> float:
        """The simulated seconds of a moment.

        Args:
            text: a number of simulated seconds, or m:ss or h:mm:ss as the clock shows it.

        Raises:
            InputError: it is neither, or before the start of the run.
        """
        parts = text.split(":")
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        if not 1 <= len(values) <= 3 or not all(math.isfinite(value) and value >= 0 for value in values):
            raise InputError(f"{text!r}: give seconds or h:mm:ss")
        shown = sum(value * 60.0**k for k, value in enumerate(reversed(values)))
        if len(values) < 3:
            return shown
        if shown < self.offset_s:
            raise InputError(f"{text!r}: the run starts at {self.at(0.0)}")
        return shown - self.offset_s


def hour_text(hour: float) -> str:
    """An hour of the day as h:mm, to the minute."""
    minutes = round(60 * hour)
    return f"{minutes // 60}:{minutes % 60:02}"


def _hms(seconds: int) -> str:
    return f"{seconds // 3600}:{seconds % 3600 // 60:02}:{seconds % 60:02}"
