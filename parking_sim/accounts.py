"""What a run adds up while it lasts: what each AGV does, the energy it draws, and where wall-clock time goes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Literal

from analysis.record import ACTIVITIES, Activity
from controller.acs import Acs
from controller.fleet import Agv
from controller.types import Action, AgvMode, AgvNumber, Motion
from sumo_nets.numbering import Numbered, NumberedList, numbered

#: What takes wall-clock time; planning is a part of control.
Part = Literal["plant", "control", "planning", "check", "record"]

_ACTIVITY_OF: Mapping[Action, Activity] = {
    Action.TURN: "turning",
    Action.LIFT: "lifting",
    Action.LOWER: "lowering",
    Action.CHARGE: "charging",
}


class Accounts:
    """The sums of one run.

    Args:
        agvs: number of AGVs.
        motion: says how long a step lasts.
    """

    def __init__(self, agvs: int, motion: Motion) -> None:
        self._motion = motion
        self._steps: Numbered[AgvNumber, dict[Activity, int]] = [dict.fromkeys(ACTIVITIES, 0) for _ in range(agvs)]
        self._soc: NumberedList[AgvNumber, float] = [1.0] * agvs
        self._drawn: NumberedList[AgvNumber, float] = [0.0] * agvs
        self._wall_s: dict[Part, float] = {"plant": 0.0, "control": 0.0, "planning": 0.0, "check": 0.0, "record": 0.0}
        self._start = perf_counter()

    def begin(self) -> None:
        """Count the run's wall-clock time from now on."""
        self._start = perf_counter()

    @property
    def total_s(self) -> float:
        """Wall-clock seconds since the run began."""
        return perf_counter() - self._start

    @contextmanager
    def timed(self, part: Part) -> Iterator[None]:
        """Add the wall-clock time of a ``with`` block to a part."""
        start = perf_counter()
        yield
        self._wall_s[part] += perf_counter() - start

    def planned(self, wall_s: float) -> None:
        """Add the wall-clock seconds of one planning call."""
        self._wall_s["planning"] += wall_s

    def count(self, acs: Acs) -> None:
        """Count what each AGV does in this step."""
        for agv, a, steps in zip(acs.agvs, acs.executor.agvs, self._steps, strict=True):
            if a.acting is not None:
                steps[_ACTIVITY_OF[a.acting]] += 1
            elif not a.standing:
                steps["loaded" if a.loaded else "empty"] += 1
            else:
                steps["idle" if agv.mode is AgvMode.IDLE else "waiting"] += 1

    def draw(self, agvs: Numbered[AgvNumber, Agv] | Sequence[Agv]) -> None:
        """Add by how much the state of charge of each AGV has fallen since the last call."""
        for i, agv in numbered(agvs):
            self._drawn[i] += max(0.0, self._soc[i] - agv.soc)
            self._soc[i] = agv.soc

    def drawn(self, agv: AgvNumber) -> float:
        """Energy an AGV has drawn, as a share of its battery's capacity."""
        return self._drawn[agv]

    def seconds(self, agv: AgvNumber) -> Mapping[str, float]:
        """Simulated seconds of each activity of an AGV, by the column of the record: ``empty_s`` and so on."""
        return {f"{activity}_s": self._motion.seconds(steps) for activity, steps in self._steps[agv].items()}

    def wall_split(self, sumo_s: float) -> dict[str, float]:
        """Wall-clock seconds: all, SUMO's own steps, the rest of the plant, planning, the rest of the controller, ...

        Args:
            sumo_s: wall-clock seconds of SUMO's own steps.
        """
        wall = self._wall_s
        return {
            "total": self.total_s,
            "sumo": sumo_s,
            "plant": wall["plant"] - sumo_s,
            "planning": wall["planning"],
            "execution": wall["control"] - wall["planning"],
            "record": wall["record"],
            "check": wall["check"],
        }
