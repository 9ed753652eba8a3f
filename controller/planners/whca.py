"""WHCA*: windowed hierarchical cooperative A* (Silver 2005), one agent after the other over a reservation table.

Agents are planned in order of priority, each with the quickest path inside the window that keeps clear of everything
reserved before it; the exact distance to the goal judges what lies beyond the window.

Departures from the paper: time is in safe intervals instead of single steps (``search.sipp``). Every agent's start is
reserved for the time it needs to leave. An agent that finds no path takes back the path of the agent that cut it off
and goes first, up to ``raises`` times a call; after that it holds its place, whoever planned to pass there plans again,
and the result is PARTIAL.
Guarantee: paths, and the places of those that hold, are free of conflicts with each other and with ``fixed`` up to the
window, unless a fixed path crosses the place of one that can't leave it in time.
Limits: neither complete nor optimal; agents may give way to each other for ever from window to window, which is for
deadlock handling to see.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import AgvNumber, Counters, Motion, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import Graph


@dataclass(frozen=True, slots=True)
class WhcaOptions:
    """Options of WHCA*.

    Attributes:
        raises: how often per call an agent without a path may go before the one that cut it off.
    """

    raises: int = 10


class Whca:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        distances: exact distances, also of use for dispatch.
        table: the reservations of the last call.
    """

    def __init__(self, space: Space, options: WhcaOptions) -> None:
        self.options = options
        self.distances = Distances(space)
        self.table = ReservationTable(len(space.graph.names), space.motion.following)
        self._search = PathSearch(self.distances)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem.

        Returns:
            SOLVED with a path for each agent, or PARTIAL with the agents that hold their place and who is in their
            way. Counters are those of this call, distance searches included.
        """
        self.distances.counters[:] = 0
        self._search.begin(problem)
        self.table.reset(problem.fixed)
        round_ = Round(problem, self.table, self._search, self.options.raises)
        round_.run()
        counters = Counters(*self.distances.counters.tolist())
        return PlanResult(round_.status, round_.paths, round_.failed, counters)


class SingleAgentSearch(Protocol):
    """What finds one agent's path: ``PathSearch`` anywhere on the floor, or a planner's own along a fixed route."""

    blocker: AgvNumber

    def find_path(self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable) -> Path | None:
        """A path that keeps clear of the table, or None; then ``blocker`` is who is in the way, or -1."""


class Round:
    """One planning call, agent after agent: who has a path, who holds, who is still to be planned.

    Args:
        problem: what to plan.
        table: the reservations of ``problem.fixed``; those of the paths found are added.
        search: finds each agent's path.
        raises: see ``WhcaOptions``.

    Attributes:
        paths, failed: as in ``PlanResult``.
    """

    def __init__(
        self, problem: PlanningProblem, table: ReservationTable, search: SingleAgentSearch, raises: int
    ) -> None:
        self.problem = problem
        self.table = table
        self.search = search
        self.raises = raises
        self.agents = {agent.agv: agent for agent in problem.agents}
        self.paths: dict[AgvNumber, Path] = {}
        self.failed: dict[AgvNumber, AgvNumber] = {}
        self.queue = deque(sorted(problem.agents, key=lambda agent: (-agent.priority, agent.agv)))

    @property
    def status(self) -> Status:
        """SOLVED, or PARTIAL when some agent holds."""
        return Status.PARTIAL if self.failed else Status.SOLVED

    def run(self) -> None:
        """Plan until each agent has a path or holds. Ends: raises are bounded, and a holder never moves again."""
        for agent in self.queue:
            self._reserve_start(agent)
        while self.queue:
            agent = self.queue.popleft()
            self.table.remove(agent.agv)
            path = self.search.find_path(self.problem, agent, self.table)
            if path is not None:
                self.paths[agent.agv] = path
                self.table.add(path)
                continue
            blocker = self.search.blocker
            if self.raises > 0 and blocker in self.paths:
                self.raises -= 1
                self._reserve_start(agent)
                self._take_back(blocker)
                self.queue.appendleft(agent)
            else:
                self._hold(agent, blocker)

    def _reserve_start(self, agent: PlanAgent) -> None:
        """Reserve an agent's start for the time it needs to leave it."""
        graph, motion = self.problem.graph, self.problem.motion
        leaving = [
            motion.turn(graph, agent.in_edge, e, agent.loaded) + int(motion.edge_steps[int(agent.loaded), e])
            for e in graph.out_edges(agent.vertex)
        ]
        self.table.hold(agent.vertex, 0, agent.ready_step + min(leaving, default=1), agent.agv)

    def _take_back(self, agv: AgvNumber) -> None:
        """Take back an agent's path; it is planned again, before those that have not been planned yet."""
        del self.paths[agv]
        self.table.remove(agv)
        self._reserve_start(self.agents[agv])
        self.queue.appendleft(self.agents[agv])

    def _hold(self, agent: PlanAgent, blocker: AgvNumber) -> None:
        """Let an agent keep its place for the whole window, and plan again for all that meant to pass there."""
        for agv in {owner for _, _, owner in self.table.intervals(agent.vertex)} & self.paths.keys():
            self._take_back(agv)
        self.table.hold(agent.vertex, 0, self.problem.window_steps, agent.agv)
        self.failed[agent.agv] = blocker


def make_whca(graph: Graph, motion: Motion, options: WhcaOptions | None = None) -> Whca:
    """A WHCA* planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``WhcaOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Whca(Space(graph, motion), options or WhcaOptions())
