"""What an AGV needs for its work besides driving: lifts, charging, when it may be sent again. Data, no behaviour."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rules:
    """Durations in planning steps and rules of assignment.

    Attributes:
        lift_slot, lower_slot: lifting and lowering a car at a slot.
        lift_bay, lower_bay: the same where a customer hands over (a bay, or a home in the thesis).
        charge_below: state of charge (0 to 1) at or below which an AGV without a task goes charging.
        charge_to: state of charge at which it stops.
        charge_steps: steps a charge takes from 0 to 1.
        charge_least_steps: a charge takes at least so long.
        assign_on_return: an AGV on its way home may get a task before it is there.
        cell_steps: steps of one ordinary move; the thesis counts stuck ticks and windows in moves.
        charge_anywhere: an AGV on its way home may turn off to charge anywhere, not only in the slot it starts from.
        charge_unasked: AGVs go to charge though all requests are finished.
        by_charge: the emptiest AGV charges first, and tasks go to AGVs with charge enough, see
            ``controller.charging``; else AGVs charge in order of their numbers and take any task.
        around_cars: slots are chosen by the way around parked cars as they stand now.
        resolve_deadlocks: deadlocks are looked for and resolved.
        empty_avoid_slots: AGVs on their way home without a car do not pass through empty slots.
        keep_for_returning: each AGV on its way home keeps one open task from being taken by others (the thesis starts
            tasks while completed + active < wanted, and counts those on their way home as active).
        run_on_steps: the run goes on so long after the last task, or until all AGVs are idle.
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
