"""The record beside SUMO's own account: each fact that both tell must be the same.

Each witness compares one kind of fact and says how many it compared and what contradicts. What no witness sees is
listed in docs/witnesses.md.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.sumo_outputs import Stop, SumoOutputs, read_sumo_outputs

if TYPE_CHECKING:
    import pandas as pd

    from analysis.tables import Run

#: Contradictions that are kept in words; all are counted.
TOLD = 20
#: Seconds in which SUMO shows a car that was handed over: it waits until no other car drives past the bay.
SHOWN_WITHIN_S = 30.0
#: Metres between the front of an AGV and the end of its lane that still count as "at the vertex".
AT_VERTEX_M = 1.0


@dataclass(slots=True)
class Testimony:
    """What one witness saw.

    Attributes:
        facts: facts of the record that it compared.
        wrong: those that SUMO contradicts, and what SUMO saw that the record lacks.
        words: the first ``TOLD`` of these, one line each.
    """

    facts: int = 0
    wrong: int = 0
    words: list[str] = field(default_factory=list)

    def fact(self, contradiction: str = "") -> None:
        """Count a fact; empty if SUMO says the same."""
        self.facts += 1
        self.wrong += bool(contradiction)
        if contradiction and len(self.words) < TOLD:
            self.words.append(contradiction)


@dataclass(frozen=True, slots=True)
class _Case:
    """A run and SUMO's account of it.

    ``start_s`` is SUMO's clock when the run's clock began; ``step_s`` is as long as either may be early or late.
    """

    run: Run
    seen: SumoOutputs
    start_s: float
    step_s: float
    end_s: float

    def near(self, recorded_s: float, seen_s: float) -> bool:
        """Whether a time of the run is a time of SUMO's. What lasted to the end has no time of its own."""
        recorded = self.end_s if math.isnan(recorded_s) else recorded_s
        seen = self.end_s if math.isinf(seen_s) else seen_s - self.start_s
        return abs(recorded - seen) <= self.step_s + 1e-6


def witnesses(run: Run, folder: Path) -> dict[str, dict[str, Any]]:
    """Compare a run with what SUMO wrote about it.

    Args:
        run: the record.
        folder: where SUMO's outputs are.

    Returns:
        By witness (a key of ``WITNESSES``) the fields of its ``Testimony``; empty if SUMO wrote nothing.
    """
    seen = read_sumo_outputs(folder)
    if seen is None:
        return {}
    meta = run.meta
    case = _Case(run, seen, meta["sumo_start_s"], meta["step_s"], meta["simulated_s"])
    found = {name: witness(case) for name, witness in WITNESSES.items()}
    return {name: {"facts": t.facts, "wrong": t.wrong, "words": t.words} for name, t in found.items()}


# --- customers ----------------------------------------------------------------------------------------------------


def _customers(case: _Case) -> Testimony:
    """Each customer's car stood at the parkingArea of the bay that ``tasks`` names, from when to when it says."""
    told = Testimony()
    stays = {
        vehicle: [stop for stop in stops if stop.area]
        for vehicle, stops in case.seen.stops.items()
        if any(stop.area for stop in stops)
    }
    if not case.seen.areas:
        return told
    for row in case.run.tasks.to_dict("records"):
        expected = _expected_stay(row)
        seen = stays.pop(f"customer{row['request']}", [])
        if expected is not None:
            told.fact(_stay_contradiction(case, row, *expected, seen))
        elif seen and not case.near(math.nan, seen[0].start_s):
            told.fact(f"request {row['request']}: SUMO saw its car at {seen[0].area}, tasks name no stay at a bay")
    for vehicle, stops in stays.items():
        told.fact(f"SUMO saw {vehicle} at {stops[0].area}; no task is its own")
    return told


def _expected_stay(row: Mapping[Any, Any]) -> tuple[str, str, float, float] | None:
    """Bay, use, from when, to when; None if the car stood at no bay."""
    if row["kind"] == "park":
        stay = (row["origin"], "in", row["at_bay_s"], row["lifted_s"])
    else:
        stay = (row["destination"], "out", row["delivered_s"], row["done_s"])
    return None if math.isnan(stay[2]) else stay


def _stay_contradiction(
    case: _Case, row: Mapping[Any, Any], bay: str, use: str, from_s: float, to_s: float, seen: list[Stop]
) -> str:
    claim = f"request {row['request']}, {row['car']!r}: tasks say {bay} ({use}) from {from_s:.1f} s to {to_s:.1f} s"
    if not seen and use == "out" and from_s + SHOWN_WITHIN_S > case.end_s and math.isnan(to_s):
        return ""
    if len(seen) != 1:
        return f"{claim}, SUMO saw {len(seen)} stays"
    stop = seen[0]
    there = case.seen.areas.get(stop.area) == (bay, use)
    late_s = stop.start_s - case.start_s - from_s
    came = case.near(from_s, stop.start_s) or (use == "out" and 0 <= late_s <= SHOWN_WITHIN_S)
    if there and came and case.near(to_s, stop.end_s):
        return ""
    seen_s = [stop.start_s - case.start_s, stop.end_s - case.start_s]
    return f"{claim}, SUMO says {stop.area} from {seen_s[0]:.1f} s to {seen_s[1]:.1f} s"


# --- AGVs ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Action:
    """A car is lifted (or else lowered), which ends at ``end_s`` of the run."""

    request: int
    vertex: str
    lift: bool
    end_s: float


def _agvs(case: _Case) -> Testimony:
    """Each car was lifted and lowered while the AGV stood at the vertex that ``tasks`` names, as long as that takes.

    The load is told by the AGV's vehicle type, which also has to be right at the end of every other stop.
    """
    told = Testimony()
    agv = (case.run.meta.get("scenario") or {}).get("agv") or {}
    takes_s = {True: float(agv.get("lift_s", 0.0)), False: float(agv.get("lower_s", 0.0))}
    actions = _actions(case.run.tasks)
    for vehicle, stops in case.seen.stops.items():
        if not vehicle.startswith("agv"):
            continue
        due = actions.pop(vehicle, [])
        loaded = False
        for stop in stops:
            until_s = stop.end_s - case.start_s + case.step_s / 2
            while due and due[0].end_s <= until_s:
                action = due.pop(0)
                loaded = action.lift
                told.fact(_action_contradiction(case, vehicle, action, stop, takes_s[action.lift]))
            # what ended in the run's last step is not in its record
            if math.isfinite(stop.end_s) and (stop.vehicle_type == "agv_loaded") != loaded:
                told.fact(
                    f"{vehicle}: SUMO says {stop.vehicle_type} at {until_s:.1f} s on {stop.lane}, "
                    f"by tasks it was {'loaded' if loaded else 'empty'}"
                )
        for action in due:
            told.fact(f"{vehicle}: {_words(action)}, SUMO saw no stop then")
    for vehicle, due in actions.items():
        told.fact(f"{vehicle}: {_words(due[0])}, SUMO saw no such AGV")
    return told


def _actions(tasks: pd.DataFrame) -> dict[str, list[_Action]]:
    """What each AGV did with cars, by time."""
    found: dict[str, list[_Action]] = defaultdict(list)
    for row in tasks.to_dict("records"):
        for lift, vertex, end_s in (
            (True, row["origin"], row["lifted_s"]),
            (False, row["destination"], row["delivered_s"]),
        ):
            if not math.isnan(end_s):
                found[f"agv{row['agv']}"].append(_Action(row["request"], vertex, lift, end_s))
    for actions in found.values():
        actions.sort(key=lambda action: action.end_s)
    return found


def _action_contradiction(case: _Case, vehicle: str, action: _Action, stop: Stop, takes_s: float) -> str:
    vertex, length_m = case.seen.lane_ends.get(stop.lane, ("", math.inf))
    came_s = stop.start_s - case.start_s
    there = vertex == action.vertex and stop.pos_m >= length_m - AT_VERTEX_M
    if there and came_s + takes_s <= action.end_s + case.step_s + 1e-6:
        return ""
    return f"{vehicle}: {_words(action)}, SUMO says it stood at {vertex or stop.lane} from {came_s:.1f} s"


def _words(action: _Action) -> str:
    done = "lifted" if action.lift else "lowered"
    return f"tasks say the car of request {action.request} was {done} at {action.vertex} until {action.end_s:.1f} s"


#: Name -> witness, in the order of a report.
WITNESSES: Mapping[str, Callable[[_Case], Testimony]] = {"customers": _customers, "agvs": _agvs}
