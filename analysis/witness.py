"""The record beside SUMO's own account: each fact that both tell must be the same.

Each witness compares one kind of fact and says how many it compared and what contradicts. What no witness sees is
listed in docs/witnesses.md.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.sumo_outputs import Stop, SumoOutputs, read_sumo_outputs

if TYPE_CHECKING:
    import pandas as pd

    from analysis.tables import Run

#: Contradictions that are kept in words; all are counted.
TOLD = 20
#: Seconds for which traffic on the street may keep a leaving car from appearing at its bay, and from driving off.
TRAFFIC_S = 30.0
#: Steps after which the record's state of charge is read anew at the latest, and watts that an AGV needs to drive.
BATTERY_STEPS, DRIVING_W = 120, 1000.0
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

    def clock(self, seen_s: float) -> float:
        """A time of SUMO's on the run's clock; the run's end if it never came."""
        return self.end_s if math.isinf(seen_s) else seen_s - self.start_s

    def within(self, late_s: float, most_s: float = 0.0) -> bool:
        """Whether something came in its step, or at most so much later."""
        return -self.step_s - 1e-6 <= late_s <= most_s + self.step_s + 1e-6

    def in_last_step(self, seen_s: float) -> bool:
        """Whether something happened so late that the run had no step left to write it down."""
        return self.within(self.end_s - self.clock(seen_s))


def witnesses(run: Run, folder: Path) -> dict[str, dict[str, Any]]:
    """Compare a run with what SUMO wrote about it.

    Args:
        run: the record.
        folder: where SUMO's outputs are.

    Returns:
        By witness (a key of ``WITNESSES``) the fields of its ``Testimony``; empty if the run was not in SUMO. Outputs
        that can't be read are a contradiction.
    """
    meta = run.meta
    if meta.get("sumo_start_s") is None:
        return {}
    try:
        seen = read_sumo_outputs(folder)
    except (OSError, xml.parsers.expat.ExpatError) as error:
        found = {"totals": Testimony()}
        found["totals"].fact(f"SUMO's outputs can't be read: {error}")
    else:
        case = _Case(run, seen, meta["sumo_start_s"], meta["step_s"], meta["simulated_s"])
        found = {name: witness(case) for name, witness in WITNESSES.items()}
    return {name: {"facts": t.facts, "wrong": t.wrong, "words": t.words} for name, t in found.items()}


# --- customers ----------------------------------------------------------------------------------------------------


def _customers(case: _Case) -> Testimony:
    """Each customer's car stood at the parkingArea of the bay that ``tasks`` names, from when to when it says."""
    told = Testimony()
    if not case.seen.areas:
        return told
    parked = {vehicle: [stop for stop in stops if stop.area] for vehicle, stops in case.seen.stops.items()}
    stays = {vehicle: stops for vehicle, stops in parked.items() if stops}
    for row in case.run.tasks.to_dict("records"):
        expected = _expected_stay(row, case.end_s)
        seen = stays.pop(f"customer{row['request']}", [])
        if expected is not None:
            told.fact(_stay_contradiction(case, expected, seen))
        elif seen and not case.in_last_step(seen[0].start_s):
            told.fact(f"request {row['request']}: SUMO saw its car at {seen[0].area}, tasks name no stay at a bay")
    for vehicle, stops in stays.items():
        told.fact(f"SUMO saw {vehicle} at {stops[0].area}; no task is its own")
    return told


@dataclass(frozen=True, slots=True)
class _Stay:
    """A car stood at a bay's place: that of cars that come (``in``) or that of cars that leave (``out``)."""

    request: int
    bay: str
    use: str
    from_s: float
    to_s: float

    @property
    def slack_s(self) -> float:
        """Seconds that SUMO's stay may begin later and end earlier."""
        return TRAFFIC_S if self.use == "out" else 0.0


def _expected_stay(row: Mapping[Any, Any], end_s: float) -> _Stay | None:
    """What ``tasks`` says of a request; None if the car stood at no bay."""
    if row["kind"] == "park":
        bay, use, from_s, to_s = row["origin"], "in", row["at_bay_s"], row["lifted_s"]
    else:
        bay, use, from_s, to_s = row["destination"], "out", row["delivered_s"], row["done_s"]
    if math.isnan(from_s):
        return None
    return _Stay(row["request"], bay, use, from_s, end_s if math.isnan(to_s) else to_s)


def _stay_contradiction(case: _Case, stay: _Stay, seen: list[Stop]) -> str:
    claim = f"request {stay.request}: tasks say {stay.bay} ({stay.use}) from {stay.from_s:.1f} to {stay.to_s:.1f} s"
    if not seen and case.within(case.end_s - stay.from_s, stay.slack_s):
        return ""
    if len(seen) != 1:
        return f"{claim}, SUMO saw {len(seen)} stays"
    area, came_s, left_s = seen[0].area, case.clock(seen[0].start_s), case.clock(seen[0].end_s)
    there = case.seen.areas.get(area) == (stay.bay, stay.use)
    if there and case.within(came_s - stay.from_s, stay.slack_s) and case.within(stay.to_s - left_s, stay.slack_s):
        return ""
    return f"{claim}, SUMO says {area} from {came_s:.1f} to {left_s:.1f} s"


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
            until_s = case.clock(stop.end_s) + case.step_s / 2
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
    came_s = case.clock(stop.start_s)
    there = vertex == action.vertex and stop.pos_m >= length_m - AT_VERTEX_M
    if there and case.within(action.end_s - came_s - takes_s, math.inf):
        return ""
    return f"{vehicle}: {_words(action)}, SUMO says it stood at {vertex or stop.lane} from {came_s:.1f} s"


def _words(action: _Action) -> str:
    done = "lifted" if action.lift else "lowered"
    return f"tasks say the car of request {action.request} was {done} at {action.vertex} until {action.end_s:.1f} s"


# --- sums ---------------------------------------------------------------------------------------------------------


def _distance(case: _Case) -> Testimony:
    """Each AGV drove as far as its SUMO trip is long.

    The record adds the lanes up that an AGV drove, SUMO's trip the crossings between them, too, and the parts of lanes
    at its beginning and end.
    """
    told = Testimony()
    for row in case.run.agvs.to_dict("records"):
        trip, stops = case.seen.trips.get(f"agv{row['agv']}", {}), case.seen.stops.get(f"agv{row['agv']}", ())
        ends_m = 2 * max((case.seen.lane_ends[stop.lane][1] for stop in stops), default=0.0)
        seen_m, driven_m = float(trip.get("routeLength", math.nan)), row["distance_m"]
        most_m = driven_m + row["moves"] * case.seen.longest_crossing_m
        right = driven_m - ends_m <= seen_m <= most_m + ends_m
        told.fact("" if right else f"agv{row['agv']}: the record says {driven_m:.0f} m, SUMO's trip {seen_m:.0f} m")
    return told


def _battery(case: _Case) -> Testimony:
    """Each battery is as full at the end as SUMO says, and what was drawn from it is what SUMO's AGV consumed.

    What is drawn while the battery is charged does not show in the record, so it may fall short by what was charged.
    What was drawn from a battery that a fault emptied is not compared: a fault draws nothing that SUMO sees.
    """
    told = Testimony()
    agv_type = (case.run.meta.get("scenario") or {}).get("agv") or {}
    capacity_wh, charge_w = (float(agv_type.get(key, math.nan)) for key in ("battery_wh", "charge_w"))
    stale_h = BATTERY_STEPS * case.step_s / 3600.0
    faults = case.run.details("fault_start").to_dict("records")
    emptied = {agv for fault in faults if fault["cause"] == "battery" for agv in fault["agvs"]}
    last = case.run.trajectory.groupby("agv")["soc"].last()
    for row in case.run.agvs.to_dict("records"):
        trip = case.seen.trips.get(f"agv{row['agv']}", {})
        left_wh = float(trip.get("actualBatteryCapacity", math.nan))
        used_wh = float(trip.get("totalEnergyConsumed", math.nan)) - float(trip.get("totalEnergyRegenerated", math.nan))
        charged_wh = left_wh + used_wh - capacity_wh
        stale_wh = max(charge_w, DRIVING_W) * stale_h + 1.0
        recorded_wh = float(last.get(row["agv"], math.nan)) * capacity_wh
        right = abs(recorded_wh - left_wh) <= stale_wh
        told.fact("" if right else f"agv{row['agv']}: {recorded_wh:.0f} Wh left by the record, {left_wh:.0f} by SUMO")
        if row["agv"] in emptied:
            continue
        slack_wh = DRIVING_W * stale_h + 1.0
        right = used_wh - charged_wh - slack_wh <= row["energy_wh"] <= used_wh + slack_wh
        told.fact("" if right else f"agv{row['agv']}: {row['energy_wh']:.0f} Wh drawn, SUMO's AGV used {used_wh:.0f}")
    return told


def _street(case: _Case) -> Testimony:
    """Cars waited in the street, all together, as long as SUMO saw them stand there or had no room for them.

    The record looks now and then (``record.sample_s``), which may be wrong by one look for each wait.
    """
    told = Testimony()
    line = case.run.timeline
    times = line["time_s"].tolist()
    if not case.seen.areas or len(times) < 2:
        return told
    held = [after - before for before, after in pairwise([*times, max(times[-1], case.end_s)])]
    recorded_s = sum(cars * seconds for cars, seconds in zip(line["queue"].tolist(), held, strict=True))
    seen_s, waits = 0.0, 0
    for row in case.run.tasks.to_dict("records"):
        if row["kind"] == "park" and row["state"] in ("served", "waiting"):
            car_s, times_waited = _wait_in_street(case, f"customer{row['request']}", row["requested_s"])
            seen_s, waits = seen_s + car_s, waits + times_waited
    right = abs(recorded_s - seen_s) <= waits * (times[1] - times[0]) + 1e-6
    told.fact("" if right else f"cars waited {recorded_s:.0f} s in the street by the record, {seen_s:.0f} s by SUMO")
    return told


def _wait_in_street(case: _Case, vehicle: str, from_s: float) -> tuple[float, int]:
    """Seconds that a customer waited before the bay, and how often."""
    trip = case.seen.trips.get(vehicle)
    if trip is None:
        return case.end_s - from_s, 1
    stops = [stop for stop in case.seen.stops.get(vehicle, ()) if not stop.area]
    stood_s = sum(case.clock(stop.end_s) - case.clock(stop.start_s) for stop in stops)
    outside_s = case.clock(float(trip["depart"])) - from_s
    return outside_s + stood_s + float(trip["waitingTime"]), 1 + len(stops) + int(trip["waitingCount"])


def _totals(case: _Case) -> Testimony:
    """SUMO ran as long, saw collisions or none, and moved nobody by magic."""
    told = Testimony()
    counts, meta = case.seen.counts, case.run.meta
    ran_s = case.clock(counts["performance", "end"])
    told.fact("" if case.within(ran_s - case.end_s) else f"SUMO ran {ran_s:.1f} s, the record says {case.end_s:.1f} s")
    collisions = counts["safety", "collisions"]
    right = bool(collisions) == bool(meta["sumo_collisions"])
    told.fact("" if right else f"SUMO counted {collisions:.0f} collisions, the record {meta['sumo_collisions']}")
    teleports = counts["teleports", "total"]
    told.fact(f"SUMO teleported {teleports:.0f} vehicles" if teleports else "")
    return told


#: Name -> witness, in the order of a report.
WITNESSES: Mapping[str, Callable[[_Case], Testimony]] = {
    "customers": _customers,
    "agvs": _agvs,
    "distance": _distance,
    "battery": _battery,
    "street": _street,
    "totals": _totals,
}
