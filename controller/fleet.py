"""What the ACS stores about each AGV, and the thesis's priority formula."""

from __future__ import annotations

from dataclasses import dataclass

from controller.garage import Task
from controller.types import Action, AgvMode, AgvNumber
from sumo_nets.numbering import NO_VERTEX, Vertex

#: Base priority by state (thesis 2025, III-2): first AGVs bringing cars out, then charging, then other work on cars.
BASE_PRIORITY = {
    AgvMode.RETURNING_WITH_CAR: 3,
    AgvMode.GOING_TO_CHARGE: 2,
    AgvMode.GOING_TO_PARK: 1,
    AgvMode.GOING_TO_COLLECT: 1,
}

#: States in which an AGV may get a task or go charging.
FREE_MODES = frozenset({AgvMode.IDLE, AgvMode.RETURNING_HOME_EMPTY})


@dataclass(frozen=True, slots=True)
class StuckBoost:
    """How far waiting raises an AGV's priority. Defaults are those of the thesis's program.

    Attributes:
        step: boost for each tick an AGV has been stuck.
        after: number of stuck ticks from which the boost is ``most``.
        most: the boost of an AGV that has been stuck for long.
    """

    step: int = 10
    after: int = 5
    most: int = 1000

    def of(self, stuck: int) -> int:
        """The boost after this many stuck ticks."""
        return self.most if stuck >= self.after else self.step * stuck

    def raised(self, times: float) -> StuckBoost:
        """A boost that grows ``times`` times faster and reaches its maximum ``times`` times sooner."""
        return StuckBoost(round(times * self.step), max(1, round(self.after / times)), self.most)


@dataclass(slots=True, eq=False)
class Agv:
    """One AGV as the ACS sees it.

    Attributes:
        number: number of the AGV.
        home: vertex where it rests.
        goal: vertex the AGV has to reach now.
        mode: one of the eight states.
        task: the task the AGV works on.
        action: action under way at the goal.
        then: destination after this action, for planning the departure early; -1 while it is not to be planned.
        soc: state of charge, 0 to 1.
        due_at: state of charge at or below which the AGV has to charge; -1 if it need not charge or has a charger.
        tasks_done: number of completed tasks.
        immobile: the AGV has reported a fault and cannot move.
        off_duty: the AGV gets no task until its fault is repaired.
    """

    number: AgvNumber
    home: Vertex
    goal: Vertex
    mode: AgvMode = AgvMode.IDLE
    task: Task | None = None
    action: Action | None = None
    then: Vertex = NO_VERTEX
    soc: float = 1.0
    due_at: float = -1.0
    tasks_done: int = 0
    immobile: bool = False
    off_duty: bool = False

    @property
    def due(self) -> bool:
        """Whether the AGV has to charge and has no charger yet."""
        return self.soc <= self.due_at

    @property
    def heads_for(self) -> Vertex:
        """Vertex where the AGV's plan has to end."""
        return self.goal if self.then < 0 else self.then


def priority(agv: Agv, stuck: int, boost: StuckBoost) -> int:
    """Priority of an AGV in planning, higher first (thesis 2025, III-2).

    Args:
        agv: the AGV.
        stuck: time the AGV has stood waiting, in moves.
        boost: effect of this time on the priority.

    Returns:
        ``Base * 100 + StuckBoost - id``.
    """
    return BASE_PRIORITY.get(agv.mode, 0) * 100 + boost.of(stuck) - agv.number
