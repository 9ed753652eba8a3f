"""The thesis's pipeline: D* Lite, reservation table, wait-for graph, partial CBS, leader, pull-over (2025, III-3.3).

Pseudo-code 3, once a move. The reservation table is empty but for where every AGV is now. AGVs are planned by priority:
each asks a D* Lite of its own, kept and repaired but told of no other AGV, for its next h cells. Where they conflict
with what is reserved, an edge of the wait-for graph leads to the holder; two AGVs whose next moves conflict wait for
each other. A strongly connected component of two or more is a deadlock: partial CBS plans its AGVs over the table and
overwrites their moves; if it fails the leader, the member of highest priority, moves; if a member stands in the
leader's way, the others pull over to the first cell that is free after the move: where they stand, right, left, down,
up. If all AGVs wait without a deadlock, those of highest priority are planned as one. Conflicts that are left are
resolved in pairs. Neighbours are ranked as under ``astar`` and ``dstar_lite``.

Guarantee: the moves of one call are free of conflicts. Limits: nothing is remembered between calls but the searches, so
that AGVs may undo one call's moves in the next one, for ever. Neither complete nor optimal.

Departures from pseudo-code 3:

- An AGV whose next cell is reserved goes to the best neighbour that is free, however far round, instead of staying.
  Only so do moves and steps come near the printed ones. ``sidestep: false`` has the pseudo-code to the letter. Each
  reserved neighbour, and a reserved place of its own, is an edge.
- AGVs without anything to do are reserved for the whole window, and closed to the searches like parked cars. The
  authors' program forgets them after t = 0, and lets others drive through them.
- An AGV that can't set out yet (it turns, lifts, charges) is reserved where it stands until it can.
- CBS has to move an AGV, or it has failed; the program's CBS succeeds without progress. See ``partial_cbs``.
- Each strongly connected component is a group of its own, of its members of highest priority.
- The others pull over only if one of them stands in the leader's way, and not to where another one still stands.
- Of two that meet in the end the one of lower priority stays. Nobody moves to a place that is not left in the same
  step.
- Fixed paths are reserved as a whole, since they are no plans of this planner. Where bodies need both places while they
  drive (``Motion.following`` False) a place that is being left is not entered.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import networkx as nx

from controller.planners.dstar_lite import DStarLite
from controller.planners.one_step import STAY, blocked_for, one_move_path
from controller.planners.partial_cbs import CbsBounds, Floor, Member, MoveTable, PartialCbs
from controller.search.space import Space
from controller.types import (
    FOREVER,
    NO_AGV,
    TRAIL,
    AgvNumber,
    Counters,
    Motion,
    Path,
    PlanAgent,
    PlanningProblem,
    PlanResult,
    Status,
)
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, EdgeIndex, Vertex

#: Pull-over tries the neighbours in this order, by heading in degrees.
RIGHT_LEFT_DOWN_UP = (0, 180, 270, 90)


@dataclass(frozen=True, slots=True)
class PipelineOptions(CbsBounds):
    """Limits and weights. The defaults are those of the thesis's program; those of partial CBS are inherited.

    Attributes:
        sidestep: an AGV whose next cell is reserved goes to the best free neighbour; else it stays, as in
            pseudo-code 3.
        wait_edges: edges of the wait-for graph at most.
        group: AGVs of a deadlock that are planned together at most.
    """

    sidestep: bool = True
    wait_edges: int = 64
    group: int = field(default=5, metadata={"least": 2})


class Pipeline:
    """The planner.

    Attributes:
        one_move: its paths end with the move, before the window does.
        options: see ``PipelineOptions``.
        floor: the garage.
        search: each AGV's own D* Lite.
        cbs: plans groups.
        aside: neighbours of each vertex in the order in which pull-over tries them.
        meets_conflicts: the window goes by the edges in ``PlanResult.waits``.
        stages: how often each stage has moved a group on: "partial_cbs", "leader", "pull_over".
    """

    one_move = True
    meets_conflicts = True

    def __init__(self, space: Space, options: PipelineOptions) -> None:
        self.options = options
        self.floor = Floor(space)
        self.search = DStarLite(space)
        self.cbs = PartialCbs(self.floor, options, self.search.counters)
        self.aside = self.floor.ways(space, RIGHT_LEFT_DOWN_UP)
        self.stages: Counter[str] = Counter()

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan one move for all agents of a problem.

        Returns:
            SOLVED with paths of at most one move; those that wait have a path that stays. ``waits`` are the edges of
            the wait-for graph.
        """
        self.search.counters[:] = 0
        call = _Call(self, problem)
        call.plan()
        call.resolve()
        paths = settle(problem, call.order, call.next)
        return PlanResult(
            Status.SOLVED, paths, counters=Counters(*self.search.counters.tolist()), waits=tuple(call.waits)
        )


class _Call:
    """One planning call.

    Attributes:
        order: the agents by priority.
        table: the reservations.
        waits: edges of the wait-for graph.
        members: agents that have somewhere to go and can set out within the window.
        next: where each agent is after its next move.
    """

    def __init__(self, planner: Pipeline, problem: PlanningProblem) -> None:
        self.planner = planner
        self.problem = problem
        self.order = sorted(problem.agents, key=lambda a: (-a.priority, a.agv))
        moves = min(problem.window_steps, FOREVER) // planner.floor.cell_steps
        self.table = MoveTable(max(1, min(moves, len(problem.graph.names))))
        self.waits: list[tuple[AgvNumber, AgvNumber]] = []
        self.members: dict[AgvNumber, Member] = {}
        self.next: dict[AgvNumber, Vertex] = {agent.agv: agent.vertex for agent in self.order}
        self._goals = {agent.goal for agent in self.order}

    def plan(self) -> None:
        """Plan and reserve the agents' next h cells, one after the other; note which AGV waits for which."""
        table = self.table
        for path in self.problem.fixed:
            for v in path.vertices:
                table.hold(AgvNumber(path.agv % TRAIL), v)
        going = [agent for agent in self.order if agent.vertex != agent.goal and self._ready(agent) < table.h]
        for agent in self.order:
            if agent in going:
                table.reserve(agent.agv, [agent.vertex])
            else:
                table.hold(agent.agv, agent.vertex)
        idle = [agent.vertex for agent in self.order if agent.vertex == agent.goal and agent.ready_step == 0]
        for agent in going:
            closed = blocked_for(self.problem, agent).copy()
            closed[idle] = 1
            closed[agent.goal] = 0
            search = self.planner.search.repair(agent, closed)
            self.members[agent.agv] = Member(agent, self._ready(agent), search, self.planner.floor)
        for agv, member in self.members.items():
            cells = self._next_cells(member)
            table.reserve(agv, cells)
            self.next[agv] = cells[1]
        for (a, one), (b, other) in combinations(self.members.items(), 2):
            swap = self.next[a] == other.agent.vertex and self.next[b] == one.agent.vertex
            if swap or self.next[a] == self.next[b]:
                self._wait(a, b)
                self._wait(b, a)

    def resolve(self) -> None:
        """Let each deadlock move on; if all wait without one, those of highest priority are planned together."""
        members = self.members
        graph: nx.DiGraph[AgvNumber] = nx.DiGraph(self.waits)
        deadlocks = [[n for n in members if n in ring] for ring in nx.strongly_connected_components(graph)]
        if not any(len(group) > 1 for group in deadlocks) and all(map(self._waits, members)):
            deadlocks = [list(members)]
        rank = {n: k for k, n in enumerate(members)}
        for group in sorted((group for group in deadlocks if len(group) > 1), key=lambda group: rank[group[0]]):
            self._resolve(group[: self.planner.options.group])

    def _waits(self, agv: AgvNumber) -> bool:
        """It could set out now, but stays."""
        return self.members[agv].ready == 0 and self.next[agv] == self.members[agv].agent.vertex

    # --- plans ------------------------------------------------------------------------------------------------------

    def _ready(self, agent: PlanAgent) -> int:
        """Moves for which an agent has to stay where it is."""
        return agent.ready_step // self.planner.floor.cell_steps

    def _next_cells(self, member: Member) -> list[Vertex]:
        """Where an agent's D* Lite leads it, around what is reserved; it stays if there is no way at present."""
        if member.search.rhs.item(member.agent.vertex) >= FOREVER:
            return [member.agent.vertex] * (self.table.h + 1)
        cells, in_edge = [member.agent.vertex] * (member.ready + 1), member.agent.in_edge
        while len(cells) <= self.table.h:
            edge = STAY if cells[-1] == member.agent.goal else self._choice(member, len(cells), cells[-1], in_edge)
            if edge != STAY:
                in_edge = edge
            cells.append(cells[-1] if edge == STAY else self.problem.graph.ends[edge][1])
        return cells

    def _choice(self, member: Member, t: int, u: Vertex, in_edge: EdgeIndex) -> EdgeIndex:
        """The edge for move ``t`` from ``u``: the first that no AGV has reserved. Each reservation is waited for."""
        chosen, agv = STAY, member.agent.agv
        ranked = self._ranked(member, u, in_edge)
        for edge, v in ranked if self.planner.options.sidestep else ranked[:1]:
            other = self.table.in_the_way(t, u, v)
            if other != NO_AGV:
                self._wait(agv, other)
            elif chosen == STAY:
                chosen = edge
        if self.planner.options.sidestep and (other := self.table.in_the_way(t, u, u)) != NO_AGV:
            self._wait(agv, other)
        return chosen

    def _ranked(self, member: Member, u: Vertex, in_edge: EdgeIndex) -> list[tuple[EdgeIndex, Vertex]]:
        """Moves from ``u`` by steps + g, then Manhattan distance to the goal, then order."""
        floor, goal, closed, g = self.planner.floor, member.agent.goal, member.search.closed, member.search.g
        steps = floor.steps[int(member.agent.loaded)]
        ways = [way for way in floor.after(u, in_edge) if not closed.item(way[1])]
        return sorted(ways, key=lambda way: (steps[way[0]] + g.item(way[1]), floor.manhattan(way[1], goal)))

    def _wait(self, agv: AgvNumber, other: AgvNumber) -> None:
        if other != agv and len(self.waits) < self.planner.options.wait_edges:
            self.waits.append((agv, other))

    # --- deadlocks --------------------------------------------------------------------------------------------------

    def _resolve(self, group: Sequence[AgvNumber]) -> None:
        """Partial CBS; if that moves no AGV on, the leader; if it can't, others pull over for it."""
        plans = self.planner.cbs.solve([self.members[n] for n in group], self.table)
        if plans and any(cells[1] != cells[0] for cells in plans.values()):
            self.planner.stages["partial_cbs"] += 1
            for n in plans:
                self.table.free(n)
            for n, cells in plans.items():
                self.table.reserve(n, cells)
                self.next[n] = cells[1]
            return
        for n in group:
            self.next[n] = self.members[n].agent.vertex
        self._lead(self.members[group[0]], group)

    def _lead(self, leader: Member, group: Sequence[AgvNumber]) -> None:
        """The leader makes its move; the others stay, or make way if one of them stands there."""
        u, agv = leader.agent.vertex, leader.agent.agv
        ranked = self._ranked(leader, u, leader.agent.in_edge)
        if leader.ready or not ranked or self.table.in_the_way(1, u, ranked[0][1], group) != NO_AGV:
            return
        self.next[agv] = ranked[0][1]
        others = [self.members[n].agent for n in group if n != agv]
        if self.next[agv] not in {agent.vertex for agent in others}:
            self.planner.stages["leader"] += 1
            return
        self.planner.stages["pull_over"] += 1
        taken = {u, self.next[agv]}
        for k, agent in enumerate(others, start=1):
            undecided = {other.vertex for other in others[k:]}
            self.next[agent.agv] = self._refuge(agent, taken | undecided, group)
            taken.add(self.next[agent.agv])

    def _refuge(self, agent: PlanAgent, taken: Collection[Vertex], group: Sequence[AgvNumber]) -> Vertex:
        """The first cell free after the next move: where it stands, right, left, down, up; never another's slot."""
        u, problem = agent.vertex, self.problem
        slots = {slot for slot in problem.graph.slots if slot in self._goals and slot != agent.goal}
        if self.members[agent.agv].ready:
            return u
        ways = [v for e, v in self.planner.aside[u] if self.planner.floor.leads_on(agent.in_edge, e)]
        for v in (u, *(v for v in ways if not problem.blocked[v] and v not in slots)):
            if v not in taken and self.table.in_the_way(1, u, v, group) == NO_AGV:
                return v
        return u


def settle(
    problem: PlanningProblem, order: Sequence[PlanAgent], wanted: Mapping[AgvNumber, Vertex]
) -> dict[AgvNumber, Path]:
    """Final conflict resolution: an AGV that would meet one of higher priority stays, until no two AGVs meet.

    Args:
        problem: what is planned.
        order: the agents by priority.
        wanted: where each of them would be after its next move.

    Returns:
        A path of one move, or none, for each agent.
    """
    paths = {}
    for agent in order:
        goes = wanted[agent.agv] != agent.vertex and not (problem.motion.following and agent.ready_step > 0)
        edge = problem.graph.edge_index[agent.vertex, wanted[agent.agv]] if goes else STAY
        paths[agent.agv] = one_move_path(problem, agent, edge)
    while (loser := _loser(problem, order, paths)) is not None:
        paths[loser.agv] = one_move_path(problem, loser, STAY)
    return paths


def _loser(problem: PlanningProblem, order: Sequence[PlanAgent], paths: Mapping[AgvNumber, Path]) -> PlanAgent | None:
    """An agent that has to stay: its cell is taken, or is not left in this very step, or it swaps."""
    taken = {v for path in problem.fixed for v in path.vertices}
    at = {agent.vertex: agent for agent in order}
    heads = {agent.agv: paths[agent.agv].vertices[1] for agent in order if len(paths[agent.agv].vertices) > 1}
    leaving = {agv for agv in heads if problem.motion.following and paths[agv].arrive[-1] == 1}
    for agent in order:
        if agent.agv not in heads:
            continue
        ahead = at.get(heads[agent.agv])
        if heads[agent.agv] in taken or (ahead and ahead.agv not in leaving):
            return agent
        taken.add(heads[agent.agv])
        line = [agent]
        while ahead and ahead not in line:
            line.append(ahead)
            ahead = at.get(heads.get(ahead.agv, NO_VERTEX))
        if ahead == agent and len(line) == 2:
            return max(line, key=order.index)
    return None


def make_pipeline(graph: Graph, motion: Motion, options: PipelineOptions | None = None) -> Pipeline:
    """The thesis's pipeline for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``PipelineOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Pipeline(Space(graph, motion), options or PipelineOptions())
