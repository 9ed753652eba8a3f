"""One deadlock, and a plan that resolves it, as the ladder of resolution stages sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from controller.types import NO_AGV, AgvNumber, Path, PlanningProblem
from sumo_nets.numbering import NO_VERTEX, Vertex

DeadlockKind = Literal["deadlock", "obstruction"]
#: How it was found: AGVs wait for each other in a ring, for one without work, or one comes no nearer to its goal.
DeadlockCause = Literal["ring", "idle", "stuck"]
#: Stages of the ladder, besides "replanned": it dissolved by itself, and "": none.
Stage = Literal["", "replanned", "partial_cbs", "leader", "pull_over", "widen", "homes", "lacam"]

#: Places and goals of all AGVs that can move, and what is closed to them.
Situation = tuple[tuple[tuple[AgvNumber, Vertex, Vertex], ...], bytes, tuple[tuple[Vertex, ...], ...]]


@dataclass(slots=True)
class Deadlock:
    """A deadlock that is not over yet.

    Attributes:
        kind: "deadlock" or "obstruction".
        number: count of its kind in the run.
        members: AGVs found in it.
        cause: "ring", "idle" or "stuck".
        since: step at which the waiting began.
        reached: goals of the members, and how near to them they had come when it was found.
        stage: the stage whose plan is being carried out, "" while there is none.
        leader, goal, arrived: the AGV whose arrival is the progress, where it goes, and whether it is there.
        locked: AGVs that are still carrying out the plan.
        aside: AGVs that stand aside, with the vertices of their way there: nobody else of the group may want one of
            them before they may leave.
        best: sum of the costs to their goals that the AGVs of the plan had come to before it.
        carried: stage and group of the plan that is, or was last, carried out.
        in_vain: stages, with the group, whose plan was carried out without progress.
        moved: last step at which one of them made headway, or at which the ladder was climbed in vain.
        granted: vertices granted to the members when last looked at.
        failures: how often the ladder was climbed in vain; each time another leader is tried first, and LaCAM* with
            more effort.
        hopeless: the situation in which it is proven that there is no resolution: no climb until it changes.
    """

    kind: DeadlockKind
    number: int
    members: tuple[AgvNumber, ...]
    cause: DeadlockCause
    since: int
    reached: tuple[tuple[Vertex, int], ...]
    stage: Stage = ""
    leader: AgvNumber = NO_AGV
    goal: Vertex = NO_VERTEX
    arrived: bool = False
    locked: set[AgvNumber] = field(default_factory=set)
    aside: dict[AgvNumber, frozenset[Vertex]] = field(default_factory=dict)
    best: int = 0
    carried: tuple[Stage, frozenset[AgvNumber]] = ("", frozenset())
    in_vain: set[tuple[Stage, frozenset[AgvNumber]]] = field(default_factory=set)
    moved: int = 0
    granted: int = 0
    failures: int = 0
    hopeless: Situation | None = None


@dataclass(frozen=True, slots=True)
class Resolution:
    """A plan for a group, and the stage that found it.

    Attributes:
        stage: the stage.
        leader: the AGV whose arrival is the progress.
        paths: a path for each AGV of the group.
        homes: the new homes of AGVs that exchange theirs.
    """

    stage: Stage
    leader: AgvNumber
    paths: Mapping[AgvNumber, Path]
    homes: Mapping[AgvNumber, Vertex] = field(default_factory=dict)

    @property
    def key(self) -> tuple[Stage, frozenset[AgvNumber]]:
        """Stage and group."""
        return self.stage, frozenset(self.paths)


def situation_of(problem: PlanningProblem) -> Situation:
    """The situation in which a problem for the ladder is."""
    places = tuple((a.agv, a.vertex, a.goal) for a in problem.agents)
    return places, problem.blocked.tobytes(), tuple(path.vertices for path in problem.fixed)
