"""Events for long waits of AGVs, with the cause of each wait."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from controller.events import Event, Log
from controller.executor import Executor
from controller.fleet import Agv
from controller.holds import Hold, Holds
from controller.types import AgvNumber
from sumo_nets.numbering import Numbered, NumberedList, numbered

#: A long wait is checked again after its least length divided by this number.
LOOKS = 12


@dataclass(slots=True)
class _Wait:
    """A long wait: the step at which it began, and the cause last recorded."""

    since: int
    hold: Hold


class WaitLog:
    """Writes ``held`` events when an AGV's wait becomes long or changes its cause, and ``held_end`` when it ends.

    Args:
        holds: finds the causes.
        executor, agvs: read only.
        long_steps: least length of a long wait, steps.
        log: receives events.
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
        """Check the waits of all AGVs.

        Args:
            step: current step.
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
    """The details of an event, made from a hold."""
    return {
        "cause": hold.cause.value,
        "chain": hold.chain,
        "faults": hold.faults,
        "request": hold.request,
    }
