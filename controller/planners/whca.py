"""WHCA*: windowed hierarchical cooperative A* (Silver 2005), one agent after the other over a reservation table.

Agents are planned in order of priority, each with the quickest path inside the window that keeps clear of everything
reserved before it; the exact distance to the goal judges what lies beyond the window.

A plan is kept from call to call where it still holds: the goal is the same, nothing on the way is blocked, and it keeps
clear of all that is reserved before it. Once it looks less than half a window ahead a search adds a new end to it.

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
        raises: how often per call an agent without a path may go before the one that cut it off.
        slack_moves: a distance is searched for only where that may save more than so many moves; see ``search.sipp``.
    """

    raises: int = 10
    slack_moves: int = 2


class Whca:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        window: its range. Paths that look far ahead cost it no more, as it keeps them.
        keeps: it wants to know what the agents carry out, ``PlanningProblem.carried``.
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
            SOLVED with a path for each agent, or PARTIAL with the agents that hold their place and who is in their
            way. Counters are those of this call, distance searches included.
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
        """What gives an agent's present path if its goal is the same and nothing on the way is blocked."""
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
        """A path if nothing reserved is in its way, with a new end if it looks less than half a window ahead."""
        window, ahead, there = problem.window_steps, path.arrive[-1], path.vertices[-1] == agent.goal
        if there or 2 * ahead >= window:
            path = replace(path, until=max(window, (ahead or agent.ready_step) + agent.dwell_steps * there))
            return path if self.table.admits(path) else None
        if not ahead or not self.table.admits(replace(path, until=ahead + 1)):
            return None
        edge = problem.graph.edge_index[path.vertices[-2], path.vertices[-1]]
        then = replace(agent, vertex=path.vertices[-1], in_edge=edge, ready_step=ahead, turned_to=NO_VERTEX)
        end = self._search.find_path(problem, then, self.table, since=ahead)
        return end and _joined(path, end)


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
        """Plan until each agent has a path or holds. Ends: raises are bounded, and a holder never moves again."""
        for agent in self.queue:
            self._reserve_start(agent)
        while self.queue:
            agent = self.queue.popleft()
            self.table.remove(agent.agv)
            path = self.keep(agent) or self.search.find_path(self.problem, agent, self.table)
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


def _joined(path: Path, end: Path) -> Path:
    """A path that goes on with another one where it ends."""
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
