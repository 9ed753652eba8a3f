"""Rules of the AGVs' work besides driving: lifting, charging and assignment. This module holds data only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rules:
    """Durations in planning steps and rules of assignment.

    Attributes:
        lift_slot, lower_slot: lifting and lowering a car at a slot.
        lift_bay, lower_bay: the same where a customer hands over (a bay, or a home in the thesis).
        charge_below: state of charge (0 to 1) at or below which an AGV without a task goes charging.
        charge_to: state of charge at which charging stops.
        charge_steps: steps of a charge from 0 to 1.
        charge_least_steps: least steps of a charge.
        assign_on_return: an AGV may get a task on its way home, before it arrives.
        cell_steps: steps of one ordinary move; the thesis counts stuck ticks and windows in moves.
        charge_anywhere: an AGV on its way home may turn off to charge anywhere, not only in the slot it starts from.
        charge_unasked: AGVs go charging even when all requests are finished.
        by_charge: the emptiest AGV charges first, and tasks go to AGVs with charge enough, see
            ``controller.charging``; else AGVs charge in order of their numbers and take any task.
        around_cars: slots are chosen by the way around parked cars as they stand now.
        resolve_deadlocks: detect and resolve deadlocks.
        empty_avoid_slots: AGVs on their way home without a car do not pass through empty slots.
        keep_for_returning: each AGV on its way home keeps one open task from being taken by others (the thesis starts
            tasks while completed + active < wanted, and counts those on their way home as active).
        run_on_steps: steps the run continues after the last task; it ends earlier when all AGVs are idle.
    """

    lift_slot: int
    lower_slot: int
    lift_bay: int
    lower_bay: int
    charge_below: float
    charge_to: float
    charge_steps: int
    charge_least_steps: int
    assign_on_return: bool
    cell_steps: int
    charge_anywhere: bool = True
    charge_unasked: bool = True
    by_charge: bool = True
    around_cars: bool = False
    resolve_deadlocks: bool = True
    empty_avoid_slots: bool = False
    keep_for_returning: bool = False
    run_on_steps: int = 0

    def charging_steps(self, soc: float) -> int:
        """Steps to charge from a state of charge to ``charge_to``."""
        return max(self.charge_least_steps, round((self.charge_to - soc) * self.charge_steps))
