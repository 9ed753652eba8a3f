"""What the ACS keeps about each AGV, and the thesis's priority formula."""

from __future__ import annotations

from dataclasses import dataclass

from controller.garage import Job
from controller.types import Action, AgvMode, AgvNumber
from sumo_nets.numbering import NO_VERTEX, Vertex

#: Base priority by state (thesis 2025, III-2): a car on its way out first, then charging, then work on cars.
BASE_PRIORITY = {
    AgvMode.RETURNING_WITH_CAR: 3,
    AgvMode.GOING_TO_CHARGE: 2,
    AgvMode.GOING_TO_PARK: 1,
    AgvMode.GOING_TO_COLLECT: 1,
}

#: States in which an AGV may get a task or be sent to charge.
FREE_MODES = frozenset({AgvMode.IDLE, AgvMode.RETURNING_HOME_EMPTY})


@dataclass(slots=True, eq=False)
class Agv:
    """One AGV as the ACS sees it.

    Attributes:
        number: number of the AGV.
        home: vertex where it rests.
        goal: vertex it has to reach now.
        mode: one of the eight states.
        job: what it works on.
        action: action under way at the goal.
        then: where it goes when that action has ended, -1 while its way there is not to be planned yet.
        soc: state of charge, 0 to 1.
        tasks: tasks done.
        immobile: it has reported a fault and cannot move.
        off_duty: it gets no task until its fault is repaired.
    """

    number: AgvNumber
    home: Vertex
    goal: Vertex
    mode: AgvMode = AgvMode.IDLE
    job: Job | None = None
    action: Action | None = None
    then: Vertex = NO_VERTEX
    soc: float = 1.0
    tasks: int = 0
    immobile: bool = False
    off_duty: bool = False

    @property
    def heads_for(self) -> Vertex:
        """Where its plan has to end."""
        return self.goal if self.then < 0 else self.then


def priority(agv: Agv, stuck: int) -> int:
    """Priority of an AGV in planning, higher first (thesis 2025, III-2).

    Args:
        agv: the AGV.
        stuck: how many moves it could have made while it stood waiting.

    Returns:
        ``Base * 100 + StuckBoost - id``; from 5 stuck ticks on the boost is 1000, before that 10 for each.
    """
    boost = 1000 if stuck >= 5 else 10 * stuck
    return BASE_PRIORITY.get(agv.mode, 0) * 100 + boost - agv.number
