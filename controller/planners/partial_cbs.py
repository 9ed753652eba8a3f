"""Partial CBS of the thesis's pipeline: a deadlocked group over the reservations of the others (2025, III-3.3).

Time is counted in moves, as in the thesis: a plan is the cell that an AGV is on after each of the next h moves. The
constraint tree (Sharon et al. 2015) is searched best first until a limit ends the search: 64 expansions, 128 nodes, 64
constraints. A plan of the group costs ``moves + 0.5 waits + 0.1 residual``; the residual is the Manhattan distance, in
cells, that is left to go at the end of the window.

Our choices where the thesis is silent:

- A single plan ends at the window's end, with as little as possible left to go. That is read from the AGV's own D* Lite
  where D* Lite has found it, and is bounded from below elsewhere. A group's cost has the Manhattan distance.
- Parked cars are obstacles.
- A child of the tree plans the constrained agent alone anew.
- Turns are left out of the costs.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, count, pairwise
from typing import NamedTuple

import numpy as np

from controller.planners.dstar_lite import Memory
from controller.planners.one_step import DOWN_UP_RIGHT_LEFT, ranked_edges
from controller.search.heap import Counts
from controller.search.space import EXPANDED, GENERATED, HEAP_MOVES, VALID, Space
from controller.types import FOREVER, NEVER, NO_AGV, AgvNumber, PlanAgent
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Vertex

#: Where an AGV is after 0, 1, ... h moves.
Cells = tuple[Vertex, ...]


@dataclass(frozen=True, slots=True)
class CbsBounds:
    """Limits and weights. The defaults are those of the thesis's program.

    Attributes:
        expansions, nodes, constraints: nodes of the constraint tree taken from OPEN, nodes in OPEN at a time, and
            constraints of one node, at most.
        move_cost, wait_cost, residual_cost: what a move, a wait, and a cell left to go at the window's end cost.
    """

    expansions: int = 64
    nodes: int = 128
    constraints: int = 64
    move_cost: float = 1.0
    wait_cost: float = 0.5
    residual_cost: float = 0.1


class MoveTable:
    """Who is where after how many moves: the thesis's reservation table ``[t][x][y]``; t = 0 is now.

    Attributes:
        h: moves in the window.
    """

    def __init__(self, h: int) -> None:
        self.h = h
        self._holder: dict[tuple[int, Vertex], AgvNumber] = {}

    def reserve(self, agv: AgvNumber, cells: Sequence[Vertex]) -> None:
        """Reserve a plan; the last to reserve a cell holds it."""
        for t, v in enumerate(cells):
            self._holder[t, v] = agv

    def hold(self, agv: AgvNumber, vertex: Vertex) -> None:
        """Reserve one place for the whole window."""
        self.reserve(agv, [vertex] * (self.h + 1))

    def free(self, agv: AgvNumber) -> None:
        """Take back all that an AGV has reserved, but for where it is now."""
        for key in [key for key, holder in self._holder.items() if holder == agv and key[0] > 0]:
            del self._holder[key]

    def in_the_way(self, t: int, u: Vertex, v: Vertex, but: Collection[AgvNumber] = ()) -> AgvNumber:
        """Who keeps an AGV from being on ``v`` after move ``t``, coming from ``u``.

        Args:
            t, u, v: the move; ``u`` is ``v`` for an AGV that stays.
            but: AGVs that do not count.

        Returns:
            The holder of ``v``, or the one that moves from ``v`` to ``u`` at the same time, or ``NO_AGV``.
        """
        holder = self._holder
        other = holder.get((t, v), NO_AGV)
        if other != NO_AGV and other not in but:
            return other
        if u == v:
            return NO_AGV
        coming = holder.get((t, u), NO_AGV)
        return coming if coming not in but and holder.get((t - 1, v)) == coming else NO_AGV


class Floor:
    """A garage as the pipeline sees it: cells and moves.

    Attributes:
        motion: how long moves take.
        cell_steps: steps of an ordinary move.
        steps: steps over each edge, for empty and loaded AGVs.
    """

    def __init__(self, space: Space) -> None:
        graph, motion = space.graph, space.motion
        self.cell_steps = int(np.median(motion.edge_steps[1])) if graph.ends else 1
        self.steps: list[list[int]] = motion.edge_steps.tolist()
        self._cell_m = float(np.median(graph.length_m)) if graph.ends else 1.0
        self._xy: list[list[float]] = space.lanes.xy.tolist()
        self.motion, self._graph = motion, graph
        self._out = self.ways(space, DOWN_UP_RIGHT_LEFT)
        first = motion.first_transition.tolist()
        worst = [motion.turn_steps[0, a:b].max(initial=0) for a, b in pairwise(first)]
        self._hindered = frozenset(EdgeIndex(e) for e, steps in enumerate(worst) if steps >= NEVER)

    @staticmethod
    def ways(space: Space, headings: Sequence[int]) -> list[list[tuple[EdgeIndex, Vertex]]]:
        """The edges out of each vertex with their heads, in an order of headings."""
        out: list[list[tuple[EdgeIndex, Vertex]]] = [[] for _ in space.graph.names]
        for e in ranked_edges(space, headings).tolist():
            tail, head = space.graph.ends[EdgeIndex(e)]
            out[tail].append((EdgeIndex(e), head))
        return out

    def after(self, vertex: Vertex, in_edge: EdgeIndex) -> list[tuple[EdgeIndex, Vertex]]:
        """Edges and their heads, down, up, right, left on the map, for an AGV that has come to a vertex by an edge."""
        out = self._out[vertex]
        return [way for way in out if self.leads_on(in_edge, way[0])] if in_edge in self._hindered else out

    def leads_on(self, in_edge: EdgeIndex, edge: EdgeIndex) -> bool:
        """Whether an AGV can turn from one edge to the next."""
        return in_edge not in self._hindered or self.motion.turn(self._graph, in_edge, edge, False) < NEVER

    def matters(self, in_edge: EdgeIndex) -> EdgeIndex:
        """The edge an AGV has come by if that bars some way out, else ``NO_EDGE``."""
        return in_edge if in_edge in self._hindered else NO_EDGE

    def manhattan(self, u: Vertex, v: Vertex) -> float:
        """Manhattan distance in cells."""
        a, b = self._xy[u], self._xy[v]
        return round((abs(a[0] - b[0]) + abs(a[1] - b[1])) / self._cell_m, 6)


@dataclass(frozen=True, eq=False)
class Member:
    """An AGV that has somewhere to go.

    Attributes:
        agent: the AGV.
        ready: number of moves for which it has to stay where it is.
        search: its own D* Lite.
        floor: the garage.
    """

    agent: PlanAgent
    ready: int
    search: Memory
    floor: Floor

    def left_to_go(self, vertex: Vertex) -> float:
        """Moves from a vertex to the goal: exact where D* Lite has found them, else at least so many.

        What D* Lite has left alone lies on no way to the goal that is shorter than the one it has found.
        """
        g = self.search.g.item(vertex)
        if g < FOREVER and g == self.search.rhs.item(vertex):
            return g / self.floor.cell_steps
        found = self.search.rhs.item(self.agent.vertex) / self.floor.cell_steps
        return max(
            self.floor.manhattan(vertex, self.agent.goal), found - self.floor.manhattan(vertex, self.agent.vertex)
        )


class _Constraint(NamedTuple):
    """An AGV may not be on ``to`` after move ``t``, or not come there from ``origin`` if that is not -1."""

    agv: AgvNumber
    t: int
    origin: int
    to: Vertex


#: Moves made, vertex, and the edge come by where it matters.
_State = tuple[int, Vertex, EdgeIndex]


class PartialCbs:
    """Conflict-based search for one group at a time.

    Args:
        floor: the garage.
        bounds: limits and weights.
        counters: take the work of the single-agent searches; swaps inside their heaps are not seen.
    """

    def __init__(self, floor: Floor, bounds: CbsBounds, counters: Counts) -> None:
        self._floor = floor
        self._bounds = bounds
        self._counters = counters

    def solve(self, group: Sequence[Member], table: MoveTable) -> Mapping[AgvNumber, Cells] | None:
        """Plans for all members that conflict neither with each other nor with what others have reserved.

        Args:
            group: the members.
            table: reservations; those of the members do not count.

        Returns:
            Each member's cells, or None if a limit ends the search or there are none.
        """
        members = {member.agent.agv: member for member in group}
        root: dict[AgvNumber, Cells] = {}
        for agv, member in members.items():
            cells = self._plan(member, table, members.keys(), ())
            if cells is None:
                return None
            root[agv] = cells
        tie = count()
        nothing: tuple[_Constraint, ...] = ()
        OPEN = [(self._cost(members, root), next(tie), nothing, root)]
        for _ in range(self._bounds.expansions):
            if not OPEN:
                return None
            _, _, constraints, plans = heapq.heappop(OPEN)
            split = list(_first_conflict(plans))
            if not split:
                return plans
            if len(constraints) >= self._bounds.constraints:
                continue
            for constraint in split:
                if len(OPEN) >= self._bounds.nodes:
                    break
                more = (*constraints, constraint)
                cells = self._plan(members[constraint.agv], table, members.keys(), more)
                if cells is not None:
                    child = {**plans, constraint.agv: cells}
                    heapq.heappush(OPEN, (self._cost(members, child), next(tie), more, child))
        return None

    def _cost(self, members: Mapping[AgvNumber, Member], plans: Mapping[AgvNumber, Cells]) -> float:
        bounds, cost = self._bounds, 0.0
        for agv, cells in plans.items():
            moves = sum(u != v for u, v in pairwise(cells))
            residual = self._floor.manhattan(cells[-1], members[agv].agent.goal)
            cost += bounds.move_cost * moves + bounds.wait_cost * (len(cells) - 1 - moves)
            cost += bounds.residual_cost * residual
        return cost

    def _plan(
        self, member: Member, table: MoveTable, group: Collection[AgvNumber], constraints: tuple[_Constraint, ...]
    ) -> Cells | None:
        """The cells that bring one member as near to its goal as it can come in the window: A* over (t, vertex)."""
        agent, closed, counters = member.agent, member.search.closed, self._counters
        forbidden = {c[1:] for c in constraints if c.agv == agent.agv}
        start: _State = (member.ready, agent.vertex, self._floor.matters(agent.in_edge))
        came: dict[_State, _State | None] = {start: None}
        left, tie = member.left_to_go(agent.vertex), count()
        OPEN = [(left, left, next(tie), start)]
        while OPEN:
            f, before, _, state = heapq.heappop(OPEN)
            counters[[EXPANDED, VALID, HEAP_MOVES]] += 1
            t, u, in_edge = state
            if t == table.h:
                return (agent.vertex,) * member.ready + _traced(came, state)
            for edge, v in ((NO_EDGE, u), *self._floor.after(u, in_edge)):
                after = (t + 1, v, in_edge if edge == NO_EDGE else self._floor.matters(edge))
                if after in came or (v != u and closed[v]):
                    continue
                if (t + 1, -1, v) in forbidden or (t + 1, u, v) in forbidden:
                    continue
                if table.in_the_way(t + 1, u, v, group) != NO_AGV:
                    continue
                came[after] = state
                left = member.left_to_go(v)
                made = f - before + (not u == v == agent.goal)  # resting at the goal costs nothing
                heapq.heappush(OPEN, (made + left, left, next(tie), after))
                counters[[GENERATED, HEAP_MOVES]] += 1
        return None


def _traced(came: Mapping[_State, _State | None], last: _State) -> Cells:
    """The vertices on the way to a state."""
    cells = []
    state: _State | None = last
    while state is not None:
        cells.append(state[1])
        state = came[state]
    return tuple(reversed(cells))


def _first_conflict(plans: Mapping[AgvNumber, Cells]) -> Iterator[_Constraint]:
    """The two constraints that rule out the first conflict, one for each AGV; none if there is no conflict."""
    pairs = list(combinations(plans.items(), 2))
    for t in range(1, max(map(len, plans.values()), default=0)):
        for (a, one), (b, other) in pairs:
            if one[t] == other[t]:
                yield from (_Constraint(a, t, -1, one[t]), _Constraint(b, t, -1, other[t]))
                return
            if one[t] == other[t - 1] and other[t] == one[t - 1]:
                yield from (_Constraint(a, t, one[t - 1], one[t]), _Constraint(b, t, other[t - 1], other[t]))
                return
