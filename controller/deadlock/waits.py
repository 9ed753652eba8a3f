"""The wait-for graph: which AGV waits for which other AGV, over the whole way ahead.

An AGV is *held up* when the plan that was just made takes it no nearer to its goal: it stands without a plan, or it is
driven back. It waits for the first AGV that will stand on its way when all plans have been carried out, else for
the first one that holds a vertex of its way now. An AGV that stands and has a plan waits for the AGV that holds the
next vertex of its plan, or has been promised that vertex first. An AGV that cannot move waits for the end of its fault,
and for no AGV. Three patterns stop the garage, and all are found here:

- a *ring*: a strongly connected component of two or more (Tarjan, as networkx implements it) with one held up. An AGV
  that drives on closes a ring when the very next vertex after its plan is where another member will stand: of two that
  meet head-on the one drives the other back, and no timer is needed to see it;
- a *chain that ends at an idle AGV*: the idle AGV will not move by itself, and no way leads round it;
- a *livelock*: an AGV waits for no other AGV but has come no nearer to its goal for a long time, see ``Progress``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import dataclass

import networkx as nx

from controller.costs import Costs
from controller.executor import Executor
from controller.fleet import Agv
from controller.types import FOREVER, NO_AGV, AgvNumber
from sumo_nets.numbering import Numbered, Vertex, numbers


@dataclass(frozen=True, slots=True)
class WaitGraph:
    """A wait-for graph at one step.

    Attributes:
        edges: for each waiting AGV the one it waits for; AGVs that drive on are in it only where they close a ring.
        vertices: for each of them the vertex concerned.
        rings: strongly connected components of two or more, members in ascending order.
        blocked_by_idle: chains (first the AGV without anything to do) that end at an AGV which will not move.
    """

    edges: Mapping[AgvNumber, AgvNumber]
    vertices: Mapping[AgvNumber, Vertex]
    rings: tuple[tuple[AgvNumber, ...], ...]
    blocked_by_idle: tuple[tuple[AgvNumber, ...], ...]


#: The AGV that another AGV waits for, and the vertex concerned.
_Wait = tuple[AgvNumber, Vertex]


def wait_graph(
    executor: Executor, agvs: Numbered[AgvNumber, Agv], costs: Costs, resolving: Container[AgvNumber] = ()
) -> WaitGraph:
    """The wait-for graph now.

    Args:
        executor: owners and orders of the vertices.
        agvs: the fleet.
        costs: finds the ways ahead, round parked cars.
        resolving: AGVs that carry out the resolution of a deadlock; they wait for no AGV.

    Returns:
        Each AGV waits for at most one other.
    """
    find = _Waits(executor, agvs, costs)
    going = [agv for agv in agvs if agv.number not in resolving and find.goes(agv)]
    held_up = {agv.number for agv in going if find.held_up(agv)}
    lasting = {agv.number: find.at_the_end(agv, agv.number in held_up) for agv in going} if held_up else {}
    last = {n: wait for n, wait in lasting.items() if wait}
    found = tuple(ring for ring in rings({n: other for n, (other, _) in last.items()}) if held_up.intersection(ring))
    shown = {n: last[n] for ring in found for n in ring}
    for agv in going:
        n = agv.number
        wait = find.before_next(agv) or (last.get(n) or find.now(agv) if n in held_up else None)
        if wait:
            shown.setdefault(n, wait)
    edges = {n: other for n, (other, _) in shown.items()}
    vertices = {n: v for n, (_, v) in shown.items()}
    return WaitGraph(edges, vertices, found, _behind_idle(edges, held_up, find.idle))


class _Waits:
    """Finds the AGV that each one waits for.

    Attributes:
        ends: where each AGV will be when its plan has been carried out.
        rests: the AGV at each of these places.
        idle: AGVs without anything to do that stay where they are.
    """

    def __init__(self, executor: Executor, agvs: Numbered[AgvNumber, Agv], costs: Costs) -> None:
        self._executor = executor
        self._costs = costs
        self.ends: Numbered[AgvNumber, Vertex] = [a.pending[-1] if a.pending else a.last for a in executor.agvs]
        self.rests: dict[Vertex, AgvNumber] = dict(zip(self.ends, numbers(self.ends), strict=True))
        self.idle = {agv.number for agv in agvs if self._is_idle(agv)}
        self._idle_at = {self.ends[n] for n in self.idle}
        broken = [v for agv in agvs if agv.immobile for v in executor.agvs[agv.number].trail]
        self._walls = costs.blocked
        if executor.closed or broken:
            self._walls = costs.blocked.copy()
            self._walls[[*executor.closed, *broken]] = 1

    def _is_idle(self, agv: Agv) -> bool:
        a = self._executor.agvs[agv.number]
        return a.standing and a.acting_until < 0 and not a.pending and agv.goal == a.last and not agv.immobile

    def goes(self, agv: Agv) -> bool:
        """Whether the AGV has a goal to reach and no action under way."""
        a = self._executor.agvs[agv.number]
        return not (agv.immobile or a.acting_until >= 0 or agv.action is not None or agv.goal == a.last)

    def held_up(self, agv: Agv) -> bool:
        """Whether the AGV's plan takes it no nearer to its goal."""
        a = self._executor.agvs[agv.number]
        if not a.pending:
            return a.standing
        to = self._costs.to(agv.goal)
        return bool(to[a.pending[-1]] >= to[a.last])

    def before_next(self, agv: Agv) -> _Wait | None:
        """The AGV that keeps this AGV from the next vertex of its plan."""
        a, ex = self._executor.agvs[agv.number], self._executor
        if not (a.pending and a.standing):
            return None
        w = a.pending[0]
        other = ex.order[w][0] if ex.owner[w] in (NO_AGV, agv.number) else ex.owner[w]
        return None if other == agv.number else (other, w)

    def at_the_end(self, agv: Agv, held_up: bool) -> _Wait | None:
        """The first AGV on its way on when all plans have been carried out; only next door if it drives on."""
        way = self._way(agv)
        return self._first(agv, way if held_up else way[:1], self._resting)

    def now(self, agv: Agv) -> _Wait | None:
        """The first AGV that holds a vertex of its way on."""
        return self._first(agv, self._way(agv), lambda v: self._executor.owner[v])

    def _way(self, agv: Agv) -> list[Vertex]:
        """Vertices from the end of the plan to the goal, round idle AGVs if such a way exists."""
        end = self.ends[agv.number]
        way = self._costs.way(end, agv.goal, self._walls)
        if self._idle_at.isdisjoint(way):
            return way
        walls = self._walls.copy()
        walls[list(self._idle_at)] = 1
        return self._costs.way(end, agv.goal, walls) or way

    def _resting(self, vertex: Vertex) -> AgvNumber:
        return self.rests.get(vertex, NO_AGV)

    @staticmethod
    def _first(agv: Agv, way: Iterable[Vertex], holder: Callable[[Vertex], AgvNumber]) -> _Wait | None:
        for v in way:
            other = holder(v)
            if other not in (NO_AGV, agv.number):
                return other, v
        return None


def rings(edges: Mapping[AgvNumber, AgvNumber]) -> tuple[tuple[AgvNumber, ...], ...]:
    """Strongly connected components of two or more agents in a wait-for graph."""
    if len(edges) < 2:
        return ()
    g: nx.DiGraph[AgvNumber] = nx.DiGraph(edges.items())
    return tuple(sorted(tuple(sorted(c)) for c in nx.strongly_connected_components(g) if len(c) > 1))


def _behind_idle(
    edges: Mapping[AgvNumber, AgvNumber], held_up: set[AgvNumber], idle: Collection[AgvNumber]
) -> tuple[tuple[AgvNumber, ...], ...]:
    chains: dict[AgvNumber, list[AgvNumber]] = {}
    for first in edges:
        seen, end = {first}, first
        while end in edges and edges[end] not in seen:
            end = edges[end]
            seen.add(end)
        if end in idle and held_up.intersection(seen):
            chains.setdefault(end, [end]).append(first)
    return tuple(tuple(chain) for _, chain in sorted(chains.items()))


@dataclass(slots=True)
class _Best:
    goal: Vertex
    cost: int
    since: int


class Headway:
    """Since when each AGV has come no nearer to its goal.

    Driving to and fro is no progress: the least cost reached since the goal was set counts.

    Args:
        executor: where the AGVs are.
        agvs: the fleet.
        costs: how far it is to their goals.
        complete: plans are complete: who has one to its goal is on its way, however long the way or a queue is.
    """

    def __init__(self, executor: Executor, agvs: Numbered[AgvNumber, Agv], costs: Costs, complete: bool) -> None:
        self._executor = executor
        self._agvs = agvs
        self._costs = costs
        self._complete = complete
        self._best = {agv.number: _Best(agv.goal, FOREVER, 0) for agv in agvs}

    def update(self, step: int, excused: Container[AgvNumber] = ()) -> None:
        """Take note of where the AGVs are.

        Args:
            step: now.
            excused: AGVs that are not stuck now: cut off by a fault, or concerned by a deadlock that is not over yet.
        """
        for agv in self._agvs:
            best, a = self._best[agv.number], self._executor.agvs[agv.number]
            cost = int(self._costs.to(agv.goal)[a.last])
            acting = a.acting_until >= 0 or agv.action is not None or agv.goal == a.last
            planned = self._complete and bool(a.pending) and a.pending[-1] == agv.goal
            excuse = agv.immobile or agv.off_duty or agv.number in excused
            if acting or planned or excuse or agv.goal != best.goal or cost < best.cost:
                best.since = step
            if agv.goal != best.goal or cost < best.cost:
                best.goal, best.cost = agv.goal, cost

    def best(self, group: Iterable[AgvNumber]) -> int:
        """Sum of the least costs to their goals that AGVs have come to since their goals were set."""
        return sum(self._best[n].cost for n in group)

    def reached(self, group: Iterable[AgvNumber]) -> tuple[tuple[Vertex, int], ...]:
        """For each AGV its goal, and the least cost to it that it has come to since."""
        return tuple((self._best[n].goal, self._best[n].cost) for n in group)

    def now(self, group: Iterable[AgvNumber]) -> int:
        """Sum of the costs to their goals from where AGVs are now."""
        return sum(int(self._costs.to(self._agvs[n].goal)[self._executor.agvs[n].last]) for n in group)

    def has_arrived(self, n: AgvNumber) -> bool:
        """Whether the AGV has been at its goal since the goal was set; it may have had to leave again."""
        return self._best[n].cost == 0

    def stuck(self, step: int, steps: int) -> list[AgvNumber]:
        """AGVs that have come no nearer to their goal for this many steps."""
        return [n for n, best in self._best.items() if step - best.since >= steps]
