"""Who really waits for whom.

An AGV waits when it stands, has somewhere to go, and the next vertex of its way belongs to another AGV or has been
promised to another one first. That gives a wait-for graph of what happens, not of what was planned. An AGV that cannot
move waits for the end of its fault, and for no AGV. Three patterns stop the garage, and all are found here:

- a *ring*: a strongly connected component of two or more (Tarjan, as networkx implements it);
- a *chain that ends at an AGV without anything to do*: it will not move by itself;
- an AGV that is not kept waiting but has come no nearer to its goal for long (*livelock*): see ``Progress``.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass

import networkx as nx

from controller.costs import Costs
from controller.executor import Executor
from controller.fleet import Agv
from controller.types import NO_AGV, AgvNumber
from sumo_nets.numbering import NO_VERTEX, Numbered, Vertex


@dataclass(frozen=True, slots=True)
class WaitGraph:
    """A wait-for graph at one step.

    Attributes:
        edges: for each waiting AGV the one it waits for.
        vertices: for each waiting AGV the vertex it wants.
        rings: strongly connected components of two or more, members in ascending order.
        blocked_by_idle: chains (first the AGV without anything to do) that end at an AGV which will not move.
    """

    edges: Mapping[AgvNumber, AgvNumber]
    vertices: Mapping[AgvNumber, Vertex]
    rings: tuple[tuple[AgvNumber, ...], ...]
    blocked_by_idle: tuple[tuple[AgvNumber, ...], ...]


def wanted_vertex(executor: Executor, agv: Agv, costs: Costs) -> Vertex:
    """The next vertex of an AGV's way: as planned, or else on the shortest way to its goal; -1 if it wants none."""
    a = executor.agvs[agv.number]
    if a.pending:
        return a.pending[0]
    if agv.goal == a.last:
        return NO_VERTEX
    to = costs.to(agv.goal)
    graph, steps = executor.graph, executor.motion.edge_steps[0]
    options = [(int(steps[graph.edge_index[a.last, v]] + to[v]), v) for v in graph.successors[a.last]]
    return min(options)[1] if options else NO_VERTEX


def wait_graph(executor: Executor, agvs: Numbered[AgvNumber, Agv], costs: Costs) -> WaitGraph:
    """The wait-for graph now.

    Args:
        executor: owners and orders of the vertices.
        agvs: the fleet.
        costs: tells where an AGV without a plan wants to go.

    Returns:
        Each AGV waits for at most one other, as it wants one vertex at a time.
    """
    edges: dict[AgvNumber, AgvNumber] = {}
    vertices: dict[AgvNumber, Vertex] = {}
    for agv in agvs:
        a = executor.agvs[agv.number]
        if agv.immobile or not a.standing or a.acting_until >= 0 or agv.action is not None:
            continue
        w = wanted_vertex(executor, agv, costs)
        if w < 0:
            continue
        other = executor.owner[w]
        if other in (-1, agv.number):
            queue = executor.order.get(w)
            other = queue[0] if queue and agv.number in queue else NO_AGV
        if other not in (-1, agv.number):
            edges[agv.number] = other
            vertices[agv.number] = w
    return WaitGraph(edges, vertices, rings(edges), _behind_idle(edges, executor, agvs))


def rings(edges: Mapping[AgvNumber, AgvNumber]) -> tuple[tuple[AgvNumber, ...], ...]:
    """Strongly connected components of two or more agents in a wait-for graph."""
    if len(edges) < 2:
        return ()
    g: nx.DiGraph[AgvNumber] = nx.DiGraph(edges.items())
    return tuple(sorted(tuple(sorted(c)) for c in nx.strongly_connected_components(g) if len(c) > 1))


def _behind_idle(
    edges: Mapping[AgvNumber, AgvNumber], executor: Executor, agvs: Numbered[AgvNumber, Agv]
) -> tuple[tuple[AgvNumber, ...], ...]:
    chains: dict[AgvNumber, list[AgvNumber]] = {}
    for first in edges:
        seen, end = {first}, first
        while end in edges and edges[end] not in seen:
            end = edges[end]
            seen.add(end)
        a = executor.agvs[end]
        has_nothing_to_do = a.standing and a.acting_until < 0 and not a.pending and agvs[end].goal == a.last
        if end not in edges and has_nothing_to_do and not agvs[end].immobile:
            chains.setdefault(end, [end]).append(first)
    return tuple(tuple(chain) for _, chain in sorted(chains.items()))


@dataclass(slots=True)
class _Best:
    goal: Vertex
    cost: int
    since: int


class Progress:
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
        self._best = {agv.number: _Best(agv.goal, 0, 0) for agv in agvs}

    def update(self, step: int, cut_off: Container[AgvNumber] = ()) -> None:
        """Take note of where the AGVs are; those ``cut_off`` by a fault wait for its end, which is no deadlock."""
        for agv in self._agvs:
            best, a = self._best[agv.number], self._executor.agvs[agv.number]
            cost = int(self._costs.to(agv.goal)[a.last])
            acting = a.acting_until >= 0 or agv.action is not None or agv.goal == a.last
            planned = self._complete and bool(a.pending) and a.pending[-1] == agv.goal
            faulty = agv.immobile or agv.off_duty or agv.number in cut_off
            if acting or planned or faulty or agv.goal != best.goal or cost < best.cost:
                best.goal, best.cost, best.since = agv.goal, cost, step

    def stuck(self, step: int, steps: int) -> list[AgvNumber]:
        """AGVs that came no nearer to their goal in so many steps."""
        return [n for n, best in self._best.items() if step - best.since >= steps]
