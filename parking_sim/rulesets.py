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
        empty_avoid_slots_of: planners under which AGVs on their way home do not pass through empty slots.
        unaided: planners whose deadlocks are not resolved by the controller.
        dispatch: dispatch rule that goes with the set, "" for the scenario's.
        charge_anywhere, charge_unasked, by_charge, around_cars, keep_for_returning: see ``controller.rules.Rules``.
        run_on: ticks that the run goes on after the last task, at most; it ends when all AGVs are idle.
    """

    turn: int = 1
    turn_of: Mapping[str, int] = field(default_factory=dict)
    lift: int = 10
    lower: int = 10
    charge: int = 20
    charge_after_cells: int = 300
    assign_on_return: bool = False
    empty_avoid_slots_of: frozenset[str] = frozenset()
    unaided: frozenset[str] = frozenset()
    dispatch: str = ""
    charge_anywhere: bool = True
    charge_unasked: bool = True
    by_charge: bool = True
    around_cars: bool = False
    keep_for_returning: bool = False
    run_on: int = 0

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

    def rules(self, planner: str = "") -> Rules:
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
            charge_anywhere=self.charge_anywhere,
            charge_unasked=self.charge_unasked,
            by_charge=self.by_charge,
            around_cars=self.around_cars,
            resolve_deadlocks=planner not in self.unaided,
            empty_avoid_slots=planner in self.empty_avoid_slots_of,
            keep_for_returning=self.keep_for_returning,
            run_on_steps=self.run_on,
        )


#: State of charge at which charging is due in the discrete plant. The thesis names the cells between charges, not the
#: size of the battery. With one for twice as many cells, an AGV that is not due yet has the charge for the longest task
#: of the thesis's grids.
CHARGE_BELOW = 0.5

#: ``thesis``: what the thesis's program does (2025; see docs/thesis.md). A right-angled turn takes 1 tick under A* and
#: D* Lite, but 2 under its pipeline; charging is set to 20 ticks, but the tick that sets it is the first of them. AGVs
#: take tasks in order of their numbers, to the slot or from the car that is nearest as the cars stand; on their way
#: home they avoid empty slots, but not under A*; nobody resolves deadlocks of A* and D* Lite; the run is stopped on the
#: 11th tick after the last task. ``fair``: one turn for all, each car fetched by name, deadlocks are resolved under
#: every planner, and the run ends with the last task.
RULE_SETS: dict[str, TickRules] = {
    "thesis": TickRules(
        turn=2,
        turn_of={"astar": 1, "dstar_lite": 1},
        charge=19,
        charge_anywhere=False,
        charge_unasked=False,
        by_charge=False,
        empty_avoid_slots_of=frozenset({"dstar_lite", "pipeline"}),
        unaided=frozenset({"astar", "dstar_lite", "pipeline"}),
        dispatch="first-come",
        around_cars=True,
        keep_for_returning=True,
        run_on=11,
    ),
    "fair": TickRules(turn=1),
}
