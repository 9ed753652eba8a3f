"""CBS: conflict-based search (Sharon et al. 2015), optimal on the sum of arrival steps, or bounded for a few agents.

The constraint tree is searched best first by (cost, makespan, number of conflicts, order of creation). A node replans
one agent under its constraints with the same single-agent search as WHCA*, which keeps clear of ``problem.fixed``.

Two ways to split a conflict at a vertex:
- by the step (default): the vertex is forbidden at the first step at which both own it, to one agent in each child.
  Complete in the sense of the paper, and optimal; of a swap one child forbids either agent its move.
- by the whole stay (``CbsLimits.ranges``): each child forbids one agent the vertex while the other one is there. With
  moves of ten steps a conflict takes one split instead of ten; neither optimal nor complete.

Guarantee: without limits and ranges SOLVED is optimal. Limits: if there is no solution the tree may grow for ever, so
give limits; all paths run to the goal and rest there, whatever the window of the problem.

As the planner ``cbs`` (``CbsPlanner``) it is the yardstick for small cases: every call plans every AGV to its goal, and
one that the limit ends is planned as by WHCA* instead.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count

from controller.conflicts import find_conflicts
from controller.planners.whca import Round
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import (
    FOREVER,
    AgvNumber,
    Conflict,
    Counters,
    Motion,
    Path,
    PlanAgent,
    PlanningProblem,
    PlanResult,
    Status,
)
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Vertex


@dataclass(frozen=True, slots=True)
class CbsLimits:
    """How far to look, and how to split. The defaults are full CBS; ``PARTIAL`` has the thesis' values.

    Attributes:
        expansions: nodes of the constraint tree taken from OPEN at most.
        nodes: nodes of the constraint tree generated at most.
        constraints: constraints of one node at most; nodes with more are dropped.
        ranges: forbid whole stays instead of single steps.
    """

    expansions: int | None = None
    nodes: int | None = None
    constraints: int | None = None
    ranges: bool = False

    def raised(self, times: float) -> CbsLimits:
        """So many times the effort."""

        def more(limit: int | None) -> int | None:
            return None if limit is None else round(times * limit)

        return CbsLimits(more(self.expansions), more(self.nodes), more(self.constraints), self.ranges)


#: Partial CBS on a deadlocked group (thesis 2025), with whole stays since our moves last many steps.
PARTIAL = CbsLimits(expansions=64, nodes=128, constraints=64, ranges=True)


@dataclass(frozen=True, slots=True)
class Constraint:
    """What an agent may not do: own ``vertex`` in the steps ``start`` to ``end`` (exclusive), or, where ``edge`` is not
    -1, arrive by this edge at step ``start``.
    """

    agv: AgvNumber
    vertex: Vertex
    start: int
    end: int
    edge: EdgeIndex = NO_EDGE


@dataclass(frozen=True, slots=True)
class _Node:
    constraints: tuple[Constraint, ...]
    paths: dict[AgvNumber, Path]
    conflicts: list[Conflict]

    @property
    def key(self) -> tuple[int, int, int]:
        ends = [path.arrive[-1] for path in self.paths.values()]
        return sum(ends), max(ends, default=0), len(self.conflicts)


class Cbs:
    """The planner, with the search memory it keeps between calls.

    Args:
        distances: exact distances of the garage, to share with another planner; their counters count the work.
        limits: see ``CbsLimits``.
    """

    def __init__(self, distances: Distances, limits: CbsLimits | None = None) -> None:
        space = distances.space
        self.limits = limits or CbsLimits()
        self.distances = distances
        self._table = ReservationTable(len(space.graph.names), space.motion.following)
        self._search = PathSearch(distances)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem to their goals.

        Returns:
            SOLVED; INFEASIBLE if the tree is exhausted (some agent can't reach its goal at all, or, with limits on
            constraints or with ranges, nothing was found); TIMEOUT if a limit ended the search. Paths only if SOLVED.
        """
        before = self.distances.counters.copy()
        problem = replace(problem, window_steps=FOREVER)
        self._search.begin(problem)
        self._table.reset(problem.fixed)
        status, paths = self._run(problem)
        work = Counters(*(self.distances.counters - before).tolist())
        return PlanResult(status, paths, {}, work)

    def _run(self, problem: PlanningProblem) -> tuple[Status, dict[AgvNumber, Path]]:
        agents = {agent.agv: agent for agent in problem.agents}
        root = _Node((), {}, [])
        for agent in problem.agents:
            path = self._low_level(problem, agent, ())
            if path is None:
                return Status.INFEASIBLE, {}
            root.paths[agent.agv] = path
        tie = count(1)
        root = replace(root, conflicts=find_conflicts(root.paths.values(), problem.motion))
        OPEN = [(root.key, 0, root)]
        limits = self.limits
        expanded, made = 0, 1
        while OPEN:
            _, _, node = heapq.heappop(OPEN)
            if not node.conflicts:
                return Status.SOLVED, node.paths
            if limits.expansions is not None and expanded >= limits.expansions:
                return Status.TIMEOUT, {}
            expanded += 1
            if limits.constraints is not None and len(node.constraints) >= limits.constraints:
                continue
            for constraint in _split(problem, node, limits.ranges):
                if limits.nodes is not None and made >= limits.nodes:
                    return Status.TIMEOUT, {}
                made += 1
                child = self._child(problem, node, agents[constraint.agv], constraint)
                if child is not None:
                    heapq.heappush(OPEN, (child.key, next(tie), child))
        return Status.INFEASIBLE, {}

    def _child(self, problem: PlanningProblem, node: _Node, agent: PlanAgent, constraint: Constraint) -> _Node | None:
        constraints = (*node.constraints, constraint)
        path = self._low_level(problem, agent, constraints)
        if path is None:
            return None
        paths = {**node.paths, agent.agv: path}
        return _Node(constraints, paths, find_conflicts(paths.values(), problem.motion))

    def _low_level(
        self, problem: PlanningProblem, agent: PlanAgent, constraints: tuple[Constraint, ...]
    ) -> Path | None:
        """The agent's quickest path under its constraints, which are reservations while the search lasts."""
        nobody = AgvNumber(-2)
        own = [c for c in constraints if c.agv == agent.agv]
        for c in own:
            if c.edge < 0:
                self._table.hold(c.vertex, c.start, c.end, nobody)
        bans = {(c.edge, c.start) for c in own if c.edge >= 0}
        path = self._search.find_path(problem, agent, self._table, forbidden=bans)
        self._table.remove(nobody)
        return path


def cbs(problem: PlanningProblem, limits: CbsLimits | None = None) -> PlanResult:
    """Solve one problem with fresh search memory; see ``Cbs``."""
    return Cbs(Distances(Space(problem.graph, problem.motion)), limits)(problem)


@dataclass(frozen=True, slots=True)
class CbsOptions:
    """Options of CBS as a planner.

    Attributes:
        expansions: see ``CbsLimits``.
        raises: see ``WhcaOptions``; for problems that CBS does not solve.
    """

    expansions: int = field(default=500, metadata={"least": 1})
    raises: int = 10


class CbsPlanner:
    """CBS for all agents of a problem, and WHCA* where that takes too long.

    Attributes:
        solved, calls: how many calls CBS itself answered, of how many.
    """

    def __init__(self, space: Space, options: CbsOptions) -> None:
        self.options = options
        self.distances = Distances(space)
        self.solved, self.calls = 0, 0
        self._cbs = Cbs(self.distances, CbsLimits(expansions=options.expansions))
        self._search = PathSearch(self.distances)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem.

        Returns:
            SOLVED, and optimal if CBS answered; else as from WHCA*, or without a window as from ``Cbs``.
        """
        before = self.distances.counters.copy()
        result = self._cbs(problem)
        self.calls += 1
        self.solved += result.status is Status.SOLVED
        if result.status is Status.SOLVED or problem.window_steps >= FOREVER:
            return result
        self._search.begin(problem)
        table = ReservationTable(len(problem.graph.names), problem.motion.following)
        for path in problem.fixed:
            table.add(path)
        round_ = Round(problem, table, self._search, self.options.raises)
        round_.run()
        work = Counters(*(self.distances.counters - before).tolist())
        return PlanResult(round_.status, round_.paths, round_.failed, work)


def make_cbs(graph: Graph, motion: Motion, options: CbsOptions | None = None) -> CbsPlanner:
    """A CBS planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``CbsOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return CbsPlanner(Space(graph, motion), options or CbsOptions())


def _split(problem: PlanningProblem, node: _Node, ranges: bool) -> Iterator[Constraint]:
    """The constraints of a node's children, one each, from its earliest conflict."""
    conflict = node.conflicts[0]
    stays = [_stay(node.paths[agv], conflict, problem.motion.following) for agv in conflict.agents]
    if conflict.kind == "swap" and problem.motion.following and None in stays:
        for agv in conflict.agents:
            path = node.paths[agv]
            k = path.arrive.index(conflict.step)
            tail, head = path.vertices[k - 1 : k + 1]
            edge = problem.graph.edge_index[tail, head]
            yield Constraint(agv, head, conflict.step, conflict.step + 1, edge)
        return
    for agv, other in zip(conflict.agents, reversed(stays), strict=True):
        start, end = other if ranges and other else (conflict.step, conflict.step + 1)
        yield Constraint(agv, conflict.vertex, start, end)


def _stay(path: Path, conflict: Conflict, following: bool) -> tuple[int, int] | None:
    """When a path owns the conflict's vertex around its step; None if it doesn't."""
    last = len(path.vertices) - 1
    for i, v in enumerate(path.vertices):
        start = 0 if i == 0 else (path.arrive[i] if following else path.depart[i - 1])
        end = path.until if i == last else path.arrive[i + 1]
        if v == conflict.vertex and start <= conflict.step < end:
            return start, end
    return None
