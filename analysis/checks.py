"""What must hold in every run: one definition for the command line, the demonstration, the report and sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analysis.witness import WITNESSES

if TYPE_CHECKING:
    from analysis.metrics import Metrics

#: What must hold -> the metric that tells, and the only value that is right. A metric that is not known fails nothing.
RULES: Mapping[str, tuple[str, int]] = {
    "No collision in SUMO": ("sumo_collisions", 0),
    "No overlap seen by the independent check": ("footprint_overlaps", 0),
    "Every deadlock was resolved": ("deadlocks_unresolved", 0),
    "Every request is accounted for": ("requests_conserved", 1),
    "Every car is accounted for": ("cars_conserved", 1),
    "SUMO saw customers at bays where and when the record says": ("customers_witnessed_share", 1),
    "SUMO saw AGVs lift and lower cars where and when the record says": ("agvs_witnessed_share", 1),
    "SUMO saw AGVs drive as far as the record says": ("distance_witnessed_share", 1),
    "SUMO saw batteries as the record says": ("battery_witnessed_share", 1),
    "SUMO saw cars wait in the street as long as the record says": ("street_witnessed_share", 1),
    "SUMO counted time, collisions and teleports as the record says": ("totals_witnessed_share", 1),
}
_CARS = ("arrived", "parked", "left", "in_transit")


@dataclass(frozen=True)
class Check:
    """Something that must hold in a run: what, whether it does (None: not known), and the figures behind it."""

    text: str
    passed: bool | None
    figures: str


def run_checks(meta: Mapping[str, Any], metrics: Metrics) -> list[Check]:
    """What must hold in every run.

    Args:
        meta: keys as in ``analysis.record.META``.
        metrics: the run's metrics.

    Returns:
        The checks. That every customer was served is not asked of a run whose scenario gives a duration: some tasks are
        under way when it ends. Customers who are turned away are an outcome, which fails no check.
    """
    figures = _figures(meta, metrics)
    found = [Check(text, _holds(metrics[key], right), figures[key]) for text, (key, right) in RULES.items()]
    if (meta.get("scenario") or {}).get("duration_s") is not None:
        return found
    wanted, done = metrics["tasks_wanted"], metrics["tasks_done"]
    away, void = metrics["customers_turned_away"], metrics["requests_void"]
    told = f"{done} of {_shown(wanted)} tasks, {metrics['requests_waiting']} waiting, {away} turned away, {void} void"
    served = done + away + void >= wanted if math.isfinite(wanted) else None
    return [*found, Check("Every customer let in was served", served, told)]


def failed_checks(checks: Sequence[Check]) -> tuple[str, ...]:
    """The checks that failed, one line each; empty if nothing is wrong."""
    return tuple(f"{check.text}: no ({check.figures})" for check in checks if check.passed is False)


def _holds(value: float, right: int) -> bool | None:
    return value == right if math.isfinite(value) else None


def _figures(meta: Mapping[str, Any], metrics: Metrics) -> dict[str, str]:
    """What is shown beside each check, by its metric."""
    clearance = metrics["least_clearance_m"]
    near = f", the nearest two bodies kept {clearance:.2f} m" if math.isfinite(clearance) else ""
    under = metrics["turns_under_cars"]
    turns = f", {_shown(under)} turns under cars in slots too short to drive straight out of" if under > 0 else ""
    cars = ", ".join(f"{name.replace('_', ' ')} {_shown(metrics[f'cars_{name}'])}" for name in _CARS)
    return {
        "sumo_collisions": f"{_shown(metrics['sumo_collisions'])} collisions",
        "footprint_overlaps": f"{_shown(metrics['footprint_overlaps'])} overlaps{near}{turns}",
        "deadlocks_unresolved": f"{metrics['deadlocks_found']} found, {metrics['deadlocks_unresolved']} unresolved",
        "requests_conserved": f"{metrics['requests']} requests",
        "cars_conserved": "; ".join(map(str, meta.get("audit") or ())) or cars,
        **{f"{name}_witnessed_share": _testimony((meta.get("witnesses") or {}).get(name)) for name in WITNESSES},
    }


def _testimony(testimony: Mapping[str, Any] | None) -> str:
    """What a witness saw, and the first contradiction."""
    if not testimony or not testimony["facts"]:
        return "not witnessed: SUMO wrote nothing of it"
    confirmed = f"{testimony['facts'] - testimony['wrong']:,} of {testimony['facts']:,}"
    return f"{confirmed}; {testimony['words'][0]}" if testimony["words"] else confirmed


def _shown(value: float) -> str:
    return f"{value:,.0f}" if math.isfinite(value) else "–"
