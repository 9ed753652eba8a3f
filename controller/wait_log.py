"""Long waits of AGVs, written down with their causes while they last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from controller.events import Event, Log
from controller.executor import Executor
from controller.fleet import Agv
from controller.holds import Hold, Holds
from controller.types import AgvNumber
from sumo_nets.numbering import Numbered, NumberedList, numbered

#: A long wait is looked at anew so often while it lasts: its least length divided by this.
LOOKS = 12


@dataclass(slots=True)
class _Wait:
    """A wait that has become long: since which step, and what holds the AGV as it was last written down."""

    since: int
    hold: Hold


class WaitLog:
    """Writes an event ``held`` when an AGV has waited for long and when the cause changes, and ``held_end`` at the end.

    Args:
        holds: finds the causes.
        executor, agvs: read only.
        long_steps: a wait is long from here on.
        log: takes events.
    """

    def __init__(
        self, holds: Holds, executor: Executor, agvs: Numbered[AgvNumber, Agv], long_steps: int, log: Log
    ) -> None:
        self._holds = holds
        self._executor = executor
        self._agvs = agvs
        self._long = long_steps
        self._every = max(1, long_steps // LOOKS)
        self._log = log
        self._since: NumberedList[AgvNumber, int] = [0] * len(agvs)
        self._marks: NumberedList[AgvNumber, tuple[int, int, int]] = [(0, 0, 0)] * len(agvs)
        self._waits: dict[AgvNumber, _Wait] = {}

    def step(self, step: int) -> None:
        """Look at the AGVs.

        Args:
            step: now.
        """
        for agv, a in zip(self._agvs, self._executor.agvs, strict=True):
            n, mark = agv.number, (a.granted, a.reached, a.acted)
            works = a.acting_until >= 0 or not self._holds.has_work(agv)
            if mark != self._marks[n] or (works and not agv.immobile):
                self._marks[n], self._since[n] = mark, step
            if n in self._waits and self._since[n] != self._waits[n].since:
                self._end(self._waits.pop(n), agv, step)
        if step % self._every == 0:
            long = [n for n, since in numbered(self._since) if step - since >= self._long]
            for hold in self._holds.of_agvs(long) if long else ():
                self._note(hold)

    def _note(self, hold: Hold) -> None:
        wait = self._waits.get(hold.agv)
        if wait is not None and wait.hold == hold:
            return
        since = self._since[hold.agv]
        self._waits[hold.agv] = _Wait(since, hold)
        task = self._agvs[hold.agv].task
        since_s = since * self._executor.motion.step_s
        detail = {**hold_detail(hold), "since_s": since_s}
        self._log(Event("held", hold.agv, task.car if task else "", hold.vertex, detail))

    def _end(self, wait: _Wait, agv: Agv, step: int) -> None:
        waited_s = (step - wait.since) * self._executor.motion.step_s
        detail = {"cause": wait.hold.cause.value, "waited_s": waited_s}
        self._log(Event("held_end", agv.number, detail=detail))


def hold_detail(hold: Hold) -> Mapping[str, object]:
    """A hold as the detail of an event."""
    return {
        "cause": hold.cause.value,
        "chain": hold.chain,
        "faults": hold.faults,
        "request": hold.request,
    }
