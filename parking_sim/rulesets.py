"""Rule sets of the discrete plant: how many ticks things take. Data only; ``RULE_SETS`` is the table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from controller.rules import Rules
from controller.types import Motion, make_motion
from sumo_nets.graph import Graph


@dataclass(frozen=True, slots=True)
class TickRules:
    """Durations in ticks; a move to the next cell takes one.

    Attributes:
        turn: a turn of 90 degrees; a reversal and the first move of a run are free.
        turn_of: exceptions from ``turn`` by planner.
        lift, lower: at a slot; nothing at a home.
        charge: charging.
        charge_after_cells: cells driven after which charging is due.
        assign_on_return: an AGV on its way home may get a task.
    """

    turn: int = 1
    turn_of: Mapping[str, int] = field(default_factory=dict)
    lift: int = 10
    lower: int = 10
    charge: int = 20
    charge_after_cells: int = 300
    assign_on_return: bool = False

    def motion(self, graph: Graph, planner: str) -> Motion:
        """Durations on a graph whose edges all are one cell."""
        turn = self.turn_of.get(planner, self.turn)
        return make_motion(
            graph,
            step_s=1.0,
            edge_steps=lambda length_m, loaded: 1,
            turn_steps=lambda angle_deg, loaded: turn if 45.0 < angle_deg <= 90.0 else 0,
            following=True,
        )

    def rules(self) -> Rules:
        """The same for the ACS. The state of charge falls to ``charge_below`` over ``charge_after_cells``."""
        return Rules(
            lift_slot=self.lift,
            lower_slot=self.lower,
            lift_bay=0,
            lower_bay=0,
            charge_below=CHARGE_BELOW,
            charge_to=1.0,
            charge_steps=0,
            charge_least_steps=self.charge,
            assign_on_return=self.assign_on_return,
            cell_steps=1,
        )


#: State of charge at which charging is due in the discrete plant.
CHARGE_BELOW = 0.3

#: ``thesis``: the thesis's program counts 1 tick for a right-angled turn under A* and D* Lite and 2 under its
#: pipeline (see docs). ``fair``: the same turn for all.
RULE_SETS: dict[str, TickRules] = {
    "thesis": TickRules(turn=1, turn_of={"whca": 2}),
    "fair": TickRules(turn=1),
}
