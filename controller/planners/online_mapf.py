"""Online MAPF of a fleet manager for narrow aisles (Shin et al. 2022, section 3.1): plan at events, for new goals.

An *agent* is an AGV with a new goal. Every other AGV, standing or driving along an earlier path, is an *obstacle*
(here: the ``fixed`` paths of the problem). Agents are planned one after another, round obstacles and each other:
agents in dead ends first, then the agents nearest to their goals. If an agent finds no path, other orders are tried
until all agents have a path or the permutations are used up. Paths are cut at their first wait, because the paper's
robots cannot wait in the middle of a plan. The rest is planned at the next event. Very short paths are not sent.

Departures: time is in safe intervals (``search.sipp``). The agent that failed goes first in the next order; the orders
that are left follow lexicographically. If no order serves all, the one that served most is taken. The paper's planning
time-out is a number of permutations, so that runs repeat.
Guarantee: paths are free of conflicts with each other and with the obstacles up to where they are cut.
Limits: neither complete nor optimal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, permutations

from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import NO_AGV, AgvNumber, Counters, Motion, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Vertex, numbered


@dataclass(frozen=True, slots=True)
class OnlineMapfOptions:
    """Options of online MAPF.

    Attributes:
        permutations: orders of priority tried in one call, at most.
        short_moves: paths of so many moves or fewer that end before the goal, at a wait, are not sent; 0 sends all.
    """

    permutations: int = field(default=50, metadata={"least": 1})
    short_moves: int = 0


class OnlineMapf:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        complete: only agents whose path does not end at their goal have to be given.
        tried: orders of priority that the last call tried.
    """

    complete = True

    def __init__(self, space: Space, options: OnlineMapfOptions) -> None:
        self.options = options
        self.distances = Distances(space)
        self.table = ReservationTable(len(space.graph.names), space.motion.following)
        self.tried = 0
        self._dead_ends = dead_ends(space.graph)
        self._search = PathSearch(self.distances)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for the agents of a problem.

        Returns:
            SOLVED with a path for each agent, one of a single vertex for those that wait; PARTIAL when some found none,
            with the agents in their way.
        """
        self.distances.counters[:] = 0
        self._search.begin(problem)
        best: tuple[dict[AgvNumber, Path], dict[AgvNumber, AgvNumber]] | None = None
        self.tried = 0
        for order in _Orders(self._by_priority(problem), self.options.permutations):
            self.tried += 1
            paths, failed = self._plan(order.agents, problem)
            if best is None or len(failed) < len(best[1]):
                best = paths, failed
            if not failed:
                break
            order.failed = next(iter(failed))
        paths, failed = best or ({}, {})
        cut = {agv: self._shorten(path, problem) for agv, path in paths.items()}
        counters = Counters(*self.distances.counters.tolist())
        return PlanResult(Status.PARTIAL if failed else Status.SOLVED, cut, failed, counters)

    def _by_priority(self, problem: PlanningProblem) -> list[PlanAgent]:
        """Order of planning: agents in dead ends first, then the agents nearest to their goals."""

        def rank(a: PlanAgent) -> tuple[bool, int, int]:
            leaves_dead_end = a.goal != a.vertex and a.vertex in self._dead_ends
            return not leaves_dead_end, self.distances.distance(a.vertex, a.in_edge, a.goal, a.loaded), a.agv

        return sorted(problem.agents, key=rank)

    def _plan(
        self, order: Sequence[PlanAgent], problem: PlanningProblem
    ) -> tuple[dict[AgvNumber, Path], dict[AgvNumber, AgvNumber]]:
        """Paths in this order, and the agent in the way of each agent without a path, which keeps its place."""
        agents = {agent.agv for agent in order}
        self.table.reset([path for path in problem.fixed if path.agv not in agents])
        for agent in order:
            self.table.hold(agent.vertex, 0, agent.ready_step + self._leaving(agent, problem), agent.agv)
        paths: dict[AgvNumber, Path] = {}
        failed: dict[AgvNumber, AgvNumber] = {}
        for agent in order:
            self.table.remove(agent.agv)
            found = self._search.find_path(problem, agent, self.table)
            if found is None:
                failed[agent.agv] = self._search.blocker
                self.table.hold(agent.vertex, 0, problem.window_steps, agent.agv)
            else:
                paths[agent.agv] = found
                self.table.add(found)
        return paths, failed

    def _leaving(self, agent: PlanAgent, problem: PlanningProblem) -> int:
        """Steps an agent needs at least to leave its start."""
        graph, motion = problem.graph, problem.motion
        out = graph.out_edges(agent.vertex)
        driving = motion.edge_steps[int(agent.loaded)]
        return min((motion.turn(graph, agent.in_edge, e, agent.loaded) + int(driving[e]) for e in out), default=1)

    def _shorten(self, path: Path, problem: PlanningProblem) -> Path:
        short = cut_at_wait(path, problem)
        if len(short.vertices) < len(path.vertices) and len(short.vertices) - 1 <= self.options.short_moves:
            return cut(path, 0)
        return short


class _Order:
    """One order of priority; the agents that failed in it are noted."""

    def __init__(self, agents: tuple[PlanAgent, ...]) -> None:
        self.agents = agents
        self.failed = NO_AGV


class _Orders:
    """Orders of priority, each once: the given one, then those in which a failed agent goes first, then the rest."""

    def __init__(self, agents: Sequence[PlanAgent], most: int) -> None:
        self._agents = tuple(agents)
        self._most = most

    def __iter__(self) -> Iterator[_Order]:
        seen: set[tuple[PlanAgent, ...]] = set()
        rest = permutations(self._agents)
        following: tuple[PlanAgent, ...] | None = self._agents
        while following is not None and len(seen) < self._most:
            seen.add(following)
            order = _Order(following)
            yield order
            raised = sorted(following, key=lambda agent: agent.agv != order.failed)
            following = tuple(raised)
            if following in seen:
                following = next((o for o in islice(rest, self._most) if o not in seen), None)


def dead_ends(graph: Graph) -> frozenset[Vertex]:
    """Vertices of dead ends: from a place with one neighbour back to where there is another way to go."""
    found: set[Vertex] = set()
    for end, ways in numbered(graph.successors):
        v, came_from = end, NO_VERTEX
        while len(ways) == 1 or (came_from >= 0 and len(ways) == 2 and came_from in ways):
            found.add(v)
            onward = [w for w in ways if w != came_from]
            if not onward or onward[0] in found:
                break
            v, came_from = onward[0], v
            ways = graph.successors[v]
    return frozenset(found)


def cut(path: Path, last: int) -> Path:
    """A path as far as its vertex number ``last``, which it holds until it would have left it."""
    if last == len(path.vertices) - 1:
        return path
    ends = last + 1
    return replace(path, vertices=path.vertices[:ends], arrive=path.arrive[:ends], depart=path.depart[:last],
                   until=path.arrive[ends])  # fmt: skip


def cut_at_wait(path: Path, problem: PlanningProblem) -> Path:
    """A path as far as the first vertex where it stands longer than it needs to turn (paper, section 3.1.5)."""
    agent = next(a for a in problem.agents if a.agv == path.agv)
    graph, motion = problem.graph, problem.motion
    in_edge = agent.in_edge
    ready = agent.ready_step
    for i, (u, v) in enumerate(zip(path.vertices, path.vertices[1:], strict=False)):
        edge = graph.edge_index[u, v]
        if path.depart[i] > ready + motion.turn(graph, in_edge, edge, agent.loaded):
            return cut(path, i)
        in_edge, ready = edge, path.arrive[i + 1]
    return path


def current_goals(
    final: Mapping[AgvNumber, Vertex],
    distance: Mapping[AgvNumber, float],
    way_points: Mapping[Vertex, Sequence[Vertex]],
    standing: Mapping[Vertex, AgvNumber] | None = None,
) -> dict[AgvNumber, Vertex]:
    """Where each robot has to go now, if several want one place (paper, section 3.1.1).

    The robot with the shorter way gets the place, the others the way points before it in their order; calling this
    again moves them up as places become free.

    Args:
        final: final goal of each robot.
        distance: how far each robot is from its final goal.
        way_points: for each place that several may want, where to wait for it, nearest to it first. Nobody's final
            goal is a way point of another.
        standing: places where robots stand, by vertex: no other robot is sent there.

    Returns:
        The current goal of each robot; a robot for which no way point is left keeps its final goal.
    """
    taken = dict(standing or {})
    goals: dict[AgvNumber, Vertex] = {}
    finals = set(final.values())
    for n in sorted(final, key=lambda n: (final[n], distance[n], n)):
        ways = [v for v in way_points.get(final[n], ()) if v not in finals]
        free = (v for v in (final[n], *ways) if taken.get(v, n) == n)
        goals[n] = next(free, final[n])
        taken[goals[n]] = n
    return goals


def make_online_mapf(graph: Graph, motion: Motion, options: OnlineMapfOptions | None = None) -> OnlineMapf:
    """An online MAPF planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``OnlineMapfOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return OnlineMapf(Space(graph, motion), options or OnlineMapfOptions())
