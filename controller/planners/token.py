"""Token passing with rest at the end (Ma, Li, Kumar and Koenig 2017), over safe intervals.

An agent is an AGV as the planner sees it. An agent rests at the vertex where its path ends: it may stay there for ever.
The token is the set of all agents' paths, rests included; here it is a reservation table, which gives each vertex to at
most one agent at a time.

Every agent always has a complete path to a vertex where it may rest. An agent with a new goal gets the quickest path
that conflicts with no path in the table, and this path replaces its old one. If there is no such path yet, the agent
fails: it keeps its old path and is asked for again in a later call. Agents that fail are tried once more after the
others, since another agent's new path may have made room. An agent cut off by resting agents is not retried until one
of these rests elsewhere. At the end of the call the paths of all agents can be improved, see ``lns``.

Guarantee: no deadlock can arise in a well-formed garage, since every accepted set of paths can be carried out to its
end. A garage is well-formed if from every end point (slot, bay, home or charger) there is a way to every other one that
passes no third.
Limits: not optimal; an agent's new path never makes another agent give way.

Departures from the paper:
- AGVs have priorities, and are planned in that order.
- Only in small fleets may paths lead through empty slots. Such paths save a few turns. But then each parked car changes
  the distances, so that searches grow with the garage; and parked cars soon close most of these paths.
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
        improvements: how many groups of agents around a late one are planned again in one call, at most; see ``lns``.
        late_moves: an agent is late if it waits on its way for longer than this many moves take.
        detours: also treat agents on long detours as late. Plans are better, and searches take longer.
        slack_moves: an exact distance is searched for only where it may save more than this many moves; see
            ``search.sipp``.
        through_slots_agvs: in fleets of up to this many AGVs paths may lead through a slot, unless it holds a car
            or an agent rests in it or heads for it.
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
        vertex, goal: where the path should have begun and ended.
        blocker: the agent in the way, -1 if unknown.
        around: there is no way while all these vertices are closed. Empty if closed vertices were not the reason.
    """

    vertex: Vertex
    goal: Vertex
    blocker: AgvNumber
    around: IntArray

    def holds(self, agent: PlanAgent, closed: NDArray[np.uint8]) -> bool:
        """Whether another search would fail for the same reason."""
        same = (self.vertex, self.goal) == (agent.vertex, agent.goal)
        return same and len(self.around) > 0 and bool(closed[self.around].all())


class Token:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        complete: True: paths lead to the goal. Only agents without a path to their goal are given; ``fixed`` holds the
            present path of every agent.
        rests: True: every agent always has a path to a vertex where it can rest for ever.
        improves: whether the planner is also given the agents that have a path, in ``PlanningProblem.carrying``.
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
        """The distances that the last call used."""
        return self._search.distances

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for the agents of a problem.

        Returns:
            SOLVED with a path for each agent; PARTIAL when some agents fail. ``failed`` maps
            each of them to the agent in its way.
        """
        if _fleet(problem) <= self.options.through_slots_agvs:
            self._search = self._through_slots
        else:
            self._search = self._around_slots
            problem = replace(problem, blocked=problem.blocked | self._slots)
        self._search.distances.counters[:] = 0
        self._search.begin(problem)
        self.table.reset(problem.fixed)
        # Each pass tries the agents that failed in the pass before.
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
        """Replace an agent's path by a new one to its goal; if there is none, the old path stays.

        Returns:
            None if the agent has a new path, else the agent in the way (-1 if unknown).
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
        """Vertices that an agent can never drive through, shape (n,): where others rest, and blocked ones."""
        closed = problem.blocked.copy()
        closed[agent.goal] = 0
        closed[self.table.rests(but=agent.agv)] = 1
        return closed

    def _cut(self, agent: PlanAgent, closed: NDArray[np.uint8]) -> _Cut:
        space, counters = self._search.distances.space, self._search.distances.counters
        around = closed_around(agent.vertex, agent.goal, closed, space.lanes, counters)
        return _Cut(agent.vertex, agent.goal, self._search.blocker, around)

    def _improve(self, problem: PlanningProblem, planned: dict[AgvNumber, PlanAgent]) -> set[AgvNumber]:
        """Improve the paths of all agents that have one to their goal; returns the agents whose path has changed."""
        ends = {path.agv: path.vertices[-1] for path in problem.fixed}
        agents = {a.agv: a for a in problem.carrying if ends.get(a.agv) == a.goal} | planned
        self._looked.update({agent.agv: 0 for agent in problem.agents})
        make = Detours if self.options.detours else Improvement
        improvement = make(problem, agents, self.table, self._search, self._looked)
        improvement.run(self.options.improvements, self._threshold)
        return improvement.changed


def _fleet(problem: PlanningProblem) -> int:
    """Number of AGVs: those with a path to a vertex where they rest, and those to be planned."""
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
