"""What held AGVs and requests, in words: the events ``held`` of a record, and what was open when a run ended."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from analysis.faults import FaultSpan, fault_spans
from analysis.words import counted, listed

if TYPE_CHECKING:
    from analysis.tables import Run

#: Cause (see ``controller.holds.Cause``) -> words; {agv}: the AGV at the root, {place}: the place concerned.
_WORDS: Mapping[str, str] = {
    "fault": "AGV {agv} cannot move",
    "closed": "{place} is closed",
    "cut_off": "no way leads round {place}",
    "not_moving": "AGV {agv} may drive on from {place} and does not",
    "customer": "the customer at {place} has not finished",
    "not_come": "the customer's car has been called to {place} and has not come",
    "bay_taken": "the last car has not left the place beside {place}",
    "no_bay": "no bay is free",
    "no_slot": "no slot is free",
    "no_charger": "no charger is free",
    "no_agv": "no AGV is free",
    "idle_agv": "AGV {agv} stands idle at {place}, in the way",
    "traffic": "AGV {agv} is at work or on its way at {place}",
    "ring": "AGVs wait for one another in a ring",
    "no_plan": "the planner has found no way to {place} yet",
}
#: Causes that every busy garage has.
ORDINARY = frozenset(
    {"not_moving", "customer", "not_come", "bay_taken", "no_bay", "no_charger", "no_agv", "traffic", "no_plan"}
)


@dataclass(frozen=True)
class Held:
    """What holds an AGV, or a request that no AGV works on.

    Attributes:
        agv, request: numbers, -1 for none.
        car: name of the car concerned, "" for none.
        cause: one of ``controller.holds.Cause``.
        chain: AGVs it waits for: each waits for the next one, the last one is at the root.
        faults: numbers of the faults at the root.
        place: name of the place concerned.
    """

    agv: int
    request: int
    car: str
    cause: str
    chain: tuple[int, ...]
    faults: tuple[int, ...]
    place: str

    @property
    def is_ordinary(self) -> bool:
        """Nothing is wrong: others go first, or a customer takes some time."""
        return self.cause in ORDINARY and not self.faults

    @property
    def root(self) -> _Root:
        """What holds it in the end."""
        last = self.chain[-1] if self.chain and self.cause != "cut_off" else self.agv
        itself = self.cause == "fault" and last == self.agv
        return _Root(self.cause, "" if itself else self.place, -1 if itself else last, self.faults)


class _Root(NamedTuple):
    """What holds an AGV or a request in the end; ``agv`` is -1 where it is the AGV itself."""

    cause: str
    place: str
    agv: int
    faults: tuple[int, ...]

    def words(self) -> str:
        """The root without its faults."""
        if self.agv < 0 and self.cause == "fault":
            return "cannot move"
        return _WORDS[self.cause].format(agv=self.agv, place=self.place)

    def behind(self, faults: Mapping[int, FaultSpan], time_s: float) -> tuple[FaultSpan, ...]:
        """The faults behind it. The controller is not told why an AGV does not drive on, but the record knows."""
        if self.cause == "not_moving":
            return tuple(f for f in faults.values() if self.agv in f.agvs and f.start_s <= time_s < f.end_s)
        return tuple(faults[n] for n in self.faults if n in faults)


@dataclass(frozen=True)
class LongWait:
    """A wait of an AGV that was long enough to be written down.

    Attributes:
        agv: number of the AGV.
        car: car of its task when the wait was written down, "" for none.
        start_s, end_s: simulated seconds from begin to end; an infinite end: it lasted when the run ended.
        reasons: what held the AGV, in the order in which the causes changed.
    """

    agv: int
    car: str
    start_s: float
    end_s: float
    reasons: tuple[str, ...]


def reason(held: Held, faults: Mapping[int, FaultSpan], time_s: float) -> str:
    """What holds an AGV or request, in words.

    Args:
        held: the hold.
        faults: the faults of the run by number.
        time_s: when.
    """
    root = held.root
    through = f"waits for {listed(held.chain)}: " if held.chain and held.cause != "cut_off" else ""
    behind = "; ".join(fault.text for fault in root.behind(faults, time_s))
    return f"{through}{root.words()}{': ' if behind else ''}{behind}"


def ending(holds: Iterable[Held], faults: Mapping[int, FaultSpan], time_s: float) -> list[str]:
    """What held the work that was open at the end of a run, one sentence for each set of faults, and for no fault.

    Args:
        holds: of all AGVs and requests.
        faults: the faults of the run by number.
        time_s: the end of the run, simulated seconds.
    """
    groups: dict[tuple[FaultSpan, ...], dict[str, list[Held]]] = {}
    for held in holds:
        same = groups.setdefault(held.root.behind(faults, time_s), {})
        same.setdefault(held.root.words(), []).append(held)
    lines = []
    for behind, causes in groups.items():
        told = "; ".join(f"{_who(group)}: {words}" for words, group in causes.items())
        reasons = "; ".join(fault.text + _end(fault) for fault in behind)
        lines.append(f"{reasons}. {told}" if reasons else told)
    return lines


def _end(fault: FaultSpan) -> str:
    return ", and has not ended" if math.isinf(fault.end_s) else ""


def _who(group: Sequence[Held]) -> str:
    agvs = [held.agv for held in group if held.agv >= 0]
    requests = len(group) - len(agvs)
    return " and ".join([*([listed(agvs)] if agvs else []), *([counted(requests, "request")] if requests else [])])


def long_waits(run: Run) -> list[LongWait]:
    """The long waits of a run's AGVs, in the order in which they became long.

    Args:
        run: a record.
    """
    faults = fault_spans(run)
    found: list[LongWait] = []
    last: dict[int, int] = {}  # AGV -> place in ``found`` of its wait that is not over
    for row in run.events[run.events["kind"].isin(["held", "held_end"])].to_dict("records"):
        agv, time_s, detail = int(row["agv"]), float(row["time_s"]), json.loads(row["detail"])
        if row["kind"] == "held_end":
            place = last.pop(agv)
            found[place] = replace(found[place], end_s=time_s)
            continue
        if agv not in last:
            last[agv] = len(found)
            found.append(LongWait(agv, str(row["car"]), float(detail["since_s"]), math.inf, ()))
        held = Held(
            agv, detail["request"], str(row["car"]), detail["cause"], tuple(detail["chain"]), tuple(detail["faults"]),
            str(row["vertex"]),
        )  # fmt: skip
        wait = found[last[agv]]
        found[last[agv]] = replace(wait, reasons=(*wait.reasons, reason(held, faults, time_s)))
    return found
