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

    def charging_steps(self, soc: float) -> int:
        """Steps to charge from a state of charge to ``charge_to``."""
        return max(self.charge_least_steps, round((self.charge_to - soc) * self.charge_steps))
