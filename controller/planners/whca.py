"""WHCA*: windowed hierarchical cooperative A* (Silver 2005), one agent after the other over a reservation table.

An agent is an AGV as the planner sees it. Time is counted in steps, from the start of the call. A reservation gives a
vertex to one agent from one step to another; the reservation table holds all of them. The window is the number of steps
for which paths must be free of conflicts.

Agents are planned in order of priority. Each gets the quickest path inside the window that meets no reservation, and
this path is then reserved. Beyond the window an agent ignores the others: the distance to its goal on the empty floor
says how long the rest of the way takes.

An agent keeps its path from the last call if the path still holds. A path holds if the goal is the same, no vertex on
the way is blocked, and the path meets no reservation made before it in this call. If a path that holds ends less than
half a window ahead, a search adds a new end to it.

Departures from the paper:
- Time is in safe intervals instead of single steps. A safe interval is a span of steps in which no other agent has
  reserved the vertex (``search.sipp``).
- The start of each agent is reserved for the time that the agent needs to leave it.
- An agent that finds no path is raised: the path of the agent that cuts it off is taken back, and the raised agent is
  planned first. ``raises`` limits how often this happens in a call. After that, an agent without a path holds: it stays
  at its vertex for the whole window. All agents with a path through that vertex are planned again. The result is
  PARTIAL.

Guarantee: up to the window, no path conflicts with another path, with a fixed path or with an agent that holds. There
is one exception: a fixed path may cross the vertex of an agent that can't leave in time.
Limits: the planner is neither complete nor optimal. Agents may give way to each other for ever, window after window;
deadlock handling has to notice that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import AgvNumber, Counters, Motion, Path, PlanAgent, PlanningProblem, PlanResult, Status
from controller.window import WindowRange
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Vertex


@dataclass(frozen=True, slots=True)
class WhcaOptions:
    """Options of WHCA*.

    Attributes:
        raises: how often in one call an agent without a path may be planned before the agent that cuts it off.
        slack_moves: an exact distance is searched for only where it may save more than this many moves; see
            ``search.sipp``.
    """

    raises: int = 10
    slack_moves: int = 2


class Whca:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        window: the range of the window, in moves. Long windows cost little here, because paths are kept.
        keeps: True: the planner is given the paths that the agents carry out, in ``PlanningProblem.carried``.
        distances: exact distances, also of use for dispatch.
        table: the reservations of the last call.
    """

    window = WindowRange(start=11, least=11, most=21)
    keeps = True

    def __init__(self, space: Space, options: WhcaOptions) -> None:
        self.options = options
        self.distances = Distances(space, windowed=True)
        self.table = ReservationTable(len(space.graph.names), space.motion.following)
        self._search = PathSearch(self.distances, options.slack_moves * int(np.median(space.lanes.edge_steps)))
        self._goals: dict[AgvNumber, Vertex] = {}

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem.

        Returns:
            SOLVED with a path for each agent, or PARTIAL. ``failed`` then maps each agent that holds to the agent in
            its way, -1 if unknown. Counters are those of this call, distance searches included.
        """
        self.distances.counters[:] = 0
        self._search.begin(problem)
        self.table.reset(problem.fixed)
        round_ = Round(problem, self.table, self._search, self.options.raises, self._keep(problem))
        round_.run()
        self._goals = {agent.agv: agent.goal for agent in problem.agents}
        counters = Counters(*self.distances.counters.tolist())
        return PlanResult(round_.status, round_.paths, round_.failed, counters)

    def _keep(self, problem: PlanningProblem) -> Callable[[PlanAgent], Path | None]:
        """A function from an agent to the path that it can keep, or to None if it has to be planned anew."""
        carried = {path.agv: path for path in problem.carried}

        def keep(agent: PlanAgent) -> Path | None:
            path = carried.get(agent.agv)
            if path is None or self._goals.get(agent.agv) != agent.goal:
                return None
            if any(problem.blocked[v] for v in path.vertices[1:] if v != agent.goal):
                return None
            return self._as_reserved(path, agent, problem)

        return keep

    def _as_reserved(self, path: Path, agent: PlanAgent, problem: PlanningProblem) -> Path | None:
        """The path if it meets no reservation, with a new end if it ends less than half a window ahead; else None."""
        window, ahead, there = problem.window_steps, path.arrive[-1], path.vertices[-1] == agent.goal
        # Long enough: the agent stays at the path's last vertex until the window ends, and at its goal for its work.
        if there or 2 * ahead >= window:
            path = replace(path, until=max(window, (ahead or agent.ready_step) + agent.dwell_steps * there))
            return path if self.table.admits(path) else None
        if not ahead or not self.table.admits(replace(path, until=ahead + 1)):
            return None
        # Too short: search on from the last vertex, as if the agent stood there when the path ends.
        edge = problem.graph.edge_index[path.vertices[-2], path.vertices[-1]]
        then = replace(agent, vertex=path.vertices[-1], in_edge=edge, ready_step=ahead, turned_to=NO_VERTEX)
        end = self._search.find_path(problem, then, self.table, since=ahead)
        return end and _joined(path, end)


class SingleAgentSearch(Protocol):
    """A search for the path of one agent: ``PathSearch`` on the whole floor, or a planner's own along a fixed route."""

    blocker: AgvNumber

    def find_path(self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable) -> Path | None:
        """A path that meets no reservation, or None; then ``blocker`` is the agent in the way, -1 if unknown."""


class Round:
    """One planning call, agent after agent. Each agent has a path, holds, or is still in the queue.

    Args:
        problem: what to plan.
        table: the reservations of ``problem.fixed``; those of the paths found are added.
        search: finds each agent's path.
        raises: see ``WhcaOptions``.
        keep: gives an agent's old path if that still holds, so that it needs no search.

    Attributes:
        paths, failed: as in ``PlanResult``.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        table: ReservationTable,
        search: SingleAgentSearch,
        raises: int,
        keep: Callable[[PlanAgent], Path | None] = lambda _: None,
    ) -> None:
        self.problem = problem
        self.table = table
        self.search = search
        self.raises = raises
        self.keep = keep
        self.agents = {agent.agv: agent for agent in problem.agents}
        self.paths: dict[AgvNumber, Path] = {}
        self.failed: dict[AgvNumber, AgvNumber] = {}
        self.queue = deque(sorted(problem.agents, key=lambda agent: (-agent.priority, agent.agv)))

    @property
    def status(self) -> Status:
        """SOLVED, or PARTIAL when some agent holds."""
        return Status.PARTIAL if self.failed else Status.SOLVED

    def run(self) -> None:
        """Plan until each agent has a path or holds.

        This ends: the number of raises is limited, and an agent that holds is not planned again.
        """
        for agent in self.queue:
            self._reserve_start(agent)
        while self.queue:
            agent = self.queue.popleft()
            self.table.remove(agent.agv)  # its own start must not be in its way
            path = self.keep(agent) or self.search.find_path(self.problem, agent, self.table)
            if path is not None:
                self.paths[agent.agv] = path
                self.table.add(path)
                continue
            blocker = self.search.blocker
            if self.raises > 0 and blocker in self.paths:
                self.raises -= 1
                self._reserve_start(agent)
                # The agent goes to the front of the queue last, so that it is planned before its blocker.
                self._take_back(blocker)
                self.queue.appendleft(agent)
            else:
                self._hold(agent, blocker)

    def _reserve_start(self, agent: PlanAgent) -> None:
        """Reserve an agent's start until the agent can have left it: turned, and driven its quickest edge."""
        graph, motion = self.problem.graph, self.problem.motion
        leaving = [
            motion.turn(graph, agent.in_edge, e, agent.loaded) + int(motion.edge_steps[int(agent.loaded), e])
            for e in graph.out_edges(agent.vertex)
        ]
        self.table.hold(agent.vertex, 0, agent.ready_step + min(leaving, default=1), agent.agv)

    def _take_back(self, agv: AgvNumber) -> None:
        """Take back an agent's path, and put the agent at the front of the queue."""
        del self.paths[agv]
        self.table.remove(agv)
        self._reserve_start(self.agents[agv])
        self.queue.appendleft(self.agents[agv])

    def _hold(self, agent: PlanAgent, blocker: AgvNumber) -> None:
        """Let an agent hold: it keeps its vertex for the whole window, and paths through that vertex are taken back."""
        for agv in {owner for _, _, owner in self.table.intervals(agent.vertex)} & self.paths.keys():
            self._take_back(agv)
        self.table.hold(agent.vertex, 0, self.problem.window_steps, agent.agv)
        self.failed[agent.agv] = blocker


def _joined(path: Path, end: Path) -> Path:
    """A path followed by another one, which starts at the vertex where the first one ends."""
    return Path(
        path.agv,
        path.vertices + end.vertices[1:],
        path.arrive + end.arrive[1:],
        path.depart + end.depart,
        end.until,
    )


def make_whca(graph: Graph, motion: Motion, options: WhcaOptions | None = None) -> Whca:
    """A WHCA* planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``WhcaOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Whca(Space(graph, motion), options or WhcaOptions())
