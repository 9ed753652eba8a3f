"""Token passing with rest at the end (Ma, Li, Kumar and Koenig 2017), over safe intervals.

Every agent always has a complete path to a place where it may rest for ever. An agent with a new goal gets the quickest
path that keeps clear of all other paths, rests included; if there is none yet it keeps the path it has and is asked
again. Agents that fail are tried once more after the others, since a new path of another agent may have made room; but
whom others cut off by resting in the way is not tried before one of them rests elsewhere. After that the plan of all
can be improved, see ``lns``.

Guarantee: in a well-formed garage (slots, bays, homes and chargers are end points, and between any two of them there
is a way that passes no other) no deadlock can arise, since every accepted set of paths can be carried out to its end.
Limits: not optimal; an agent's path never makes another one give way.

Departures from the paper: AGVs have priorities and are planned in that order. Only in small fleets paths lead through
slots that are empty. That saves a few turns, but distances change with every car that is parked, so that searches grow
with the garage, and cars parked in the way soon leave little of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from controller.planners.lns import Detours, Improvement
from controller.search.cut import closed_around
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import FOREVER, AgvNumber, Counters, Motion, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import Vertex


@dataclass(frozen=True, slots=True)
class TokenOptions:
    """Options of token passing.

    Attributes:
        passes: how often agents without a path are tried in one call.
        improvements: neighbourhoods of late agents planned again in one call, at most; see ``lns``.
        late_moves: who waits on its way for longer than so many moves take is late.
        detours: who goes a long way round because of others is late, too: better plans for more search.
        through_slots_agvs: in fleets of up to so many AGVs paths may lead through slots that nobody rests in, has
            parked in or heads for.
    """

    passes: int = field(default=2, metadata={"least": 1})
    improvements: int = 3
    late_moves: int = 4
    detours: bool = False
    slack_moves: int = 2
    through_slots_agvs: int = 3


@dataclass(frozen=True, slots=True)
class _Cut:
    """Why an agent found no path.

    Attributes:
        vertex, goal: from where to where.
        blocker: who was in the way.
        around: while all these vertices are closed there is no way; empty if it is not that.
    """

    vertex: Vertex
    goal: Vertex
    blocker: AgvNumber
    around: IntArray

    def holds(self, agent: PlanAgent, closed: NDArray[np.uint8]) -> bool:
        """Another search would be in vain."""
        same = (self.vertex, self.goal) == (agent.vertex, agent.goal)
        return same and len(self.around) > 0 and bool(closed[self.around].all())


class Token:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        complete: it plans complete paths; only agents whose goal is new have to be given, and ``fixed`` may hold the
            path that such an agent carries out so far.
        rests: every agent always has a path to where it can rest for ever.
        improves: it wants to know the agents that have a path, ``PlanningProblem.carrying``.
    """

    complete = True
    rests = True

    def __init__(self, space: Space, options: TokenOptions) -> None:
        self.options = options
        self.improves = options.improvements > 0
        move = int(np.median(space.lanes.edge_steps))
        self._threshold = options.late_moves * move
        self._slots = np.zeros(len(space.graph.names), dtype=np.uint8)
        self._slots[list(space.graph.slots)] = 1
        self.table = ReservationTable(len(space.graph.names), space.motion.following)
        self._around_slots = PathSearch(Distances(space, ends=self._slots), options.slack_moves * move)
        self._through_slots = PathSearch(Distances(space, whole=True), options.slack_moves * move)
        self._search = self._around_slots
        self._looked: dict[AgvNumber, int] = {}
        self._cuts: dict[AgvNumber, _Cut] = {}

    @property
    def distances(self) -> Distances:
        """The distances that the last call went by."""
        return self._search.distances

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for the agents of a problem.

        Returns:
            SOLVED with a path for each agent; PARTIAL when some of them keep what they have, with who is in their way.
        """
        if _fleet(problem) <= self.options.through_slots_agvs:
            self._search = self._through_slots
        else:
            self._search = self._around_slots
            problem = replace(problem, blocked=problem.blocked | self._slots)
        self._search.distances.counters[:] = 0
        self._search.begin(problem)
        self.table.reset(problem.fixed)
        waiting = sorted(problem.agents, key=lambda agent: (-agent.priority, agent.agv))
        planned: dict[AgvNumber, PlanAgent] = {}
        failed: dict[AgvNumber, AgvNumber] = {}
        for _ in range(self.options.passes):
            failed = {}
            for agent in waiting:
                blocker = self._plan(agent, problem)
                if blocker is None:
                    planned[agent.agv] = agent
                else:
                    failed[agent.agv] = blocker
            waiting = [agent for agent in waiting if agent.agv in failed]
            if not waiting:
                break
        changed = self._improve(problem, planned) if self.improves else ()
        paths = {agv: self.table.path(agv) for agv in (*planned, *changed)}
        counters = Counters(*self._search.distances.counters.tolist())
        return PlanResult(Status.PARTIAL if failed else Status.SOLVED, paths, failed, counters)

    def _plan(self, agent: PlanAgent, problem: PlanningProblem) -> AgvNumber | None:
        """Reserve a new path instead of the one carried out so far; if there is none, that one stays.

        Returns:
            None, or who is in the way.
        """
        cut = self._cuts.get(agent.agv)
        if cut is not None and cut.holds(agent, self._closed_for(agent, problem)):
            return cut.blocker
        carried = self.table.take((agent.agv,))
        if self._search.reserve_path(problem, agent, self.table) >= 0:
            return None
        self.table.put(carried, 1)
        self._cuts[agent.agv] = self._cut(agent, self._closed_for(agent, problem))
        return self._search.blocker

    def _closed_for(self, agent: PlanAgent, problem: PlanningProblem) -> NDArray[np.uint8]:
        """Vertices that an agent can never drive through, shape (n,): where others rest, and what is blocked."""
        closed = problem.blocked.copy()
        closed[agent.goal] = 0
        closed[self.table.rests(but=agent.agv)] = 1
        return closed

    def _cut(self, agent: PlanAgent, closed: NDArray[np.uint8]) -> _Cut:
        space, counters = self._search.distances.space, self._search.distances.counters
        around = closed_around(agent.vertex, agent.goal, closed, space.lanes, counters)
        return _Cut(agent.vertex, agent.goal, self._search.blocker, around)

    def _improve(self, problem: PlanningProblem, planned: dict[AgvNumber, PlanAgent]) -> set[AgvNumber]:
        """Improve the plan of all that have a path to their goal; those whose path has changed."""
        ends = {path.agv: path.vertices[-1] for path in problem.fixed}
        agents = {a.agv: a for a in problem.carrying if ends.get(a.agv) == a.goal} | planned
        self._looked.update({agent.agv: 0 for agent in problem.agents})
        make = Detours if self.options.detours else Improvement
        improvement = make(problem, agents, self.table, self._search, self._looked)
        improvement.run(self.options.improvements, self._threshold)
        return improvement.changed


def _fleet(problem: PlanningProblem) -> int:
    """Number of AGVs: each has a path to a place where it rests, or is to be planned."""
    resting = {path.agv for path in problem.fixed if path.until >= FOREVER}
    return len(resting | {agent.agv for agent in problem.agents})


def make_token(graph: Graph, motion: Motion, options: TokenOptions | None = None) -> Token:
    """A token-passing planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``TokenOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Token(Space(graph, motion), options or TokenOptions())
