"""Binary-tree routing: each AGV keeps to the route of the modified binary tree, and waits on it for the others.

Routes come from ``controller.routing.binary_tree`` (Do et al. 2010), one for each new goal. The paper plans for one AGV
and leaves traffic to future work; here agents are timed one after the other, in order of priority, over the same
reservation table as in WHCA*: along a fixed route only the waits are free. An agent that can't go on even waiting holds
its place; those that wait for each other in a ring are for deadlock handling, which may lead them off their routes.

Guarantee: as for WHCA*, of which this is the round with another search.
Limits: an idle AGV never makes room by itself. A detour past others is never taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from controller.planners.whca import Round
from controller.routing.binary_tree import BinaryTree, compile_tree, find_route
from controller.search.reservations import ReservationTable
from controller.types import (
    FOREVER,
    NEVER,
    NO_AGV,
    AgvNumber,
    Counters,
    Motion,
    Path,
    PlanAgent,
    PlanningProblem,
    PlanResult,
)
from sumo_nets.graph import Graph
from sumo_nets.numbering import Vertex


@dataclass(frozen=True, slots=True)
class BinaryTreeOptions:
    """Options of binary-tree routing.

    Attributes:
        raises: how often per call an agent that can't go on may go before the one that cut it off.
    """

    raises: int = 10


class _Stop(NamedTuple):
    """Standing at a vertex of the route within one safe interval of it.

    Attributes:
        arrive: earliest arrival.
        depart: departure from the vertex before.
        last: end of the safe interval, ``FOREVER`` if only the window's end cuts it.
        before: number of the stop at the vertex before.
    """

    arrive: int
    depart: int
    last: int
    before: int


class RouteSearch:
    """Times agents along their routes; a ``SingleAgentSearch``.

    Attributes:
        blocker: after a search without a path the agent in the way, or -1.
        counters: search work; a state is a stop.
    """

    def __init__(self, tree: BinaryTree) -> None:
        self.blocker = NO_AGV
        self.counters = Counters()
        self._tree = tree
        self._routes: dict[AgvNumber, tuple[Vertex, ...]] = {}

    def find_path(self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable) -> Path | None:
        """The agent's quickest path along its route, as far as it gets inside the window."""
        self.blocker = NO_AGV
        route = self._route(problem, agent)
        if route is None:
            return None
        layers = self._layers(problem, agent, table, route)
        complete = problem.window_steps >= FOREVER
        for i in range(len(layers) - 1, -1, -1):
            ends = [k for k, stop in enumerate(layers[i]) if stop.last >= FOREVER]
            if ends and (i + 1 == len(route) or not complete):
                best = min(ends, key=lambda k: layers[i][k].arrive)
                return _path(problem, agent, route[: i + 1], layers, best)
        self.blocker = _blocker(table, route, layers)
        return None

    def _route(self, problem: PlanningProblem, agent: PlanAgent) -> tuple[Vertex, ...] | None:
        """What is left of the agent's route; a new one for a new goal, after a detour, or around a fault."""
        route = self._routes.get(agent.agv, ())
        if agent.vertex in route and route[-1] == agent.goal:
            rest = route[route.index(agent.vertex) :]
            if not problem.blocked[list(rest[1:-1])].any():
                self._routes[agent.agv] = rest
                return rest
        found = find_route(self._tree, agent.vertex, agent.goal, agent.in_edge, problem.blocked)
        if found is None:
            return None
        self._routes[agent.agv] = found.vertices
        return found.vertices

    def _layers(
        self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable, route: Sequence[Vertex]
    ) -> list[list[_Stop]]:
        """The stops that can be reached at each vertex of the route, as far as there are any."""
        begin, last = next(_gaps(table, route[0], problem.window_steps))
        layers = [[_Stop(agent.ready_step, 0, last, -1)] if begin == 0 else []]
        edge = agent.in_edge
        for u, w in pairwise(route):
            edge_out = problem.graph.edge_index[u, w]
            turn = problem.motion.turn(problem.graph, edge, edge_out, agent.loaded)
            steps = int(problem.motion.edge_steps[int(agent.loaded), edge_out])
            edge = edge_out
            if turn >= NEVER:
                break
            stops: dict[int, _Stop] = {}
            gaps = list(_gaps(table, w, problem.window_steps))
            for before, stop in enumerate(layers[-1]):
                self.counters.expanded += 1
                self.counters.valid += 1
                for k, entered in _entries(stop, turn, steps, gaps, problem):
                    if k not in stops or entered.arrive < stops[k].arrive:
                        stops[k] = entered._replace(before=before)
            if not stops:
                break
            self.counters.generated += len(stops)
            layers.append([stops[k] for k in sorted(stops)])
        return layers


class BinaryTreePlanner:
    """The planner, with the routes it keeps between calls.

    Attributes:
        table: the reservations of the last call.
    """

    def __init__(self, tree: BinaryTree, motion: Motion, options: BinaryTreeOptions) -> None:
        self.options = options
        self.table = ReservationTable(len(tree.graph.names), motion.following)
        self._search = RouteSearch(tree)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem.

        Returns:
            SOLVED, or PARTIAL with the agents that hold their place and the agents in their way (-1: no route).
        """
        self._search.counters = Counters()
        self.table.reset(problem.fixed)
        round_ = Round(problem, self.table, self._search, self.options.raises)
        round_.run()
        return PlanResult(round_.status, round_.paths, round_.failed, self._search.counters)


def make_binary_tree(graph: Graph, motion: Motion, options: BinaryTreeOptions | None = None) -> BinaryTreePlanner:
    """A binary-tree planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``BinaryTreeOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return BinaryTreePlanner(compile_tree(graph), motion, options or BinaryTreeOptions())


def _gaps(table: ReservationTable, vertex: Vertex, window: int) -> Iterator[tuple[int, int]]:
    """Begin and end of the times at which a vertex is free; what is reserved beyond the window doesn't count."""
    begin = 0
    for start, end, _ in table.intervals(vertex):
        if start >= window:
            break
        if start > begin:
            yield begin, start
        begin = end
    yield begin, FOREVER


def _entries(
    stop: _Stop, turn: int, steps: int, gaps: Sequence[tuple[int, int]], problem: PlanningProblem
) -> Iterator[tuple[int, _Stop]]:
    """Stops at the next vertex that can be reached from one here, by number of its gap."""
    following = problem.motion.following
    for k, (begin, end) in enumerate(gaps):
        arrive = max(stop.arrive + turn + steps, begin if following else begin + steps)
        if arrive > stop.last or (arrive if following else arrive - steps) >= problem.window_steps:
            return
        # an agent that enters a vertex and leaves the one before at the last moment might close a ring
        in_between = following and arrive == stop.last and arrive == begin
        if arrive < end and not in_between:
            yield k, _Stop(arrive, arrive - steps, end, -1)


def _path(
    problem: PlanningProblem, agent: PlanAgent, route: tuple[Vertex, ...], layers: list[list[_Stop]], last: int
) -> Path:
    stops = []
    for layer in reversed(layers[: len(route)]):
        stops.append(layer[last])
        last = layer[last].before
    stops.reverse()
    arrive = (0, *(stop.arrive for stop in stops[1:]))
    until = min(problem.window_steps, FOREVER)
    if until < FOREVER:
        until = max(until, arrive[-1] + (agent.dwell_steps if route[-1] == agent.goal else 0))
    return Path(agent.agv, route, arrive, tuple(stop.depart for stop in stops[1:]), until)


def _blocker(table: ReservationTable, route: Sequence[Vertex], layers: Sequence[Sequence[_Stop]]) -> AgvNumber:
    """Who ends the last stop's safe interval, or else stands on the vertex behind it."""
    i = len(layers) - 1
    last = max((stop.last for stop in layers[i]), default=0)
    if last < FOREVER:
        return table.owner(route[i], last)
    return table.owner(route[i + 1], FOREVER - 1) if i + 1 < len(route) else NO_AGV
