"""The executor carries out plans despite delays and faults, and never lets two AGVs meet.

A plan is taken as a visiting order for each vertex; its clock is forgotten (Hönig et al. 2019, action dependency graph;
Ma, Kumar and Koenig 2017, MAPF-POST). The story of a vertex:

1. *order*: the accepted plan says in which order AGVs visit it;
2. *claim*: the first in the order claims it when it is free, neither closed nor barred by a parked car, and the AGV's
   authority ends next door;
3. *grant*: a claimed vertex is granted to the plant, the AGV may drive there; where a vertex may be entered in the
   tick in which it is left, a ring of three or more is granted together as soon as all of them are ready;
4. *free*: the vertex belongs to the AGV until the plant says that its rear has left.

Both directions of a lane join the same two vertices. An AGV on the lane owns the vertex ahead, and the vertex behind
until its rear has left. Opposite moves on one lane therefore exclude each other. A wrong plan is refused or stops the
garage; it cannot make two AGVs meet.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from controller.types import (
    NEVER,
    NO_AGV,
    NO_REQUEST,
    Act,
    Action,
    Advance,
    AgvNumber,
    AgvState,
    Command,
    Motion,
    Path,
    RequestNumber,
)
from controller.visits import Barred, Refusal, malformed, visiting_order
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, NO_VERTEX, EdgeIndex, Numbered, NumberedList, Vertex, numbered, numbers


@dataclass(slots=True)
class Authority:
    """What one AGV may do.

    Attributes:
        trail: vertices that belong to the AGV, oldest first; the last one is where its authority ends.
        first: number (in the plant's counting) of ``trail[0]``.
        reached: number of the last vertex its front has reached.
        in_edge: edge into the last vertex of the trail, -1 before the first move; after a turn in place the one from
            where it has turned to, unless the edge by which it came bars some way on.
        pending: vertices planned but not granted.
        standing: at the end of its authority with nothing under way.
        acting_until: step at which the action under way ends, -1 when none is.
        acting: that action.
        turned_to: vertex it has turned towards, -1 when it has not.
        since: step of the last change of ``reached``.
        acted: step at which the last action ended.
        loaded: it carries a car.
        able: it takes orders; nothing is granted to one that does not.
    """

    trail: deque[Vertex]
    first: int = 0
    reached: int = 0
    in_edge: EdgeIndex = NO_EDGE
    pending: deque[Vertex] = field(default_factory=deque)
    standing: bool = True
    acting_until: int = -1
    acting: Action | None = None
    turned_to: Vertex = NO_VERTEX
    since: int = 0
    acted: int = 0
    loaded: bool = False
    able: bool = True

    @property
    def last(self) -> Vertex:
        """Vertex where the authority ends."""
        return self.trail[-1]

    @property
    def leaves_loaded(self) -> bool:
        """It carries a car when the action under way, if any, has ended."""
        return self.acting is Action.LIFT or (self.loaded and self.acting is not Action.LOWER)

    @property
    def granted(self) -> int:
        """Number of the last granted vertex."""
        return self.first + len(self.trail) - 1


class Executor:
    """Keeps the visiting orders and grants vertices.

    Args:
        graph, motion: the garage and how long moves take.
        starts: start vertex of each AGV, all different.
        lookahead: vertices granted ahead of the last reached one; 1 where following is allowed (one cell a tick).
        barred: says of an AGV and a vertex that the AGV must not drive there now, whatever was planned: a car stands
            there that is none of its business. By default nothing is barred.

    Raises:
        ValueError: two AGVs start on one vertex.
    """

    def __init__(
        self,
        graph: Graph,
        motion: Motion,
        starts: Numbered[AgvNumber, Vertex],
        lookahead: int = 3,
        barred: Callable[[AgvNumber, Vertex], bool] = lambda _agv, _vertex: False,
    ) -> None:
        if len(set(starts)) != len(starts):
            raise ValueError("two AGVs start on one vertex")
        self.graph = graph
        self.motion = motion
        self.lookahead = 1 if motion.following else lookahead
        self.agvs: Numbered[AgvNumber, Authority] = [Authority(trail=deque([v])) for v in starts]
        self.owner: NumberedList[Vertex, AgvNumber] = [NO_AGV] * len(graph.names)
        for agv, v in numbered(starts):
            self.owner[v] = agv
        self.order: dict[Vertex, deque[AgvNumber]] = {}
        self.moves: NumberedList[AgvNumber, int] = [0] * len(starts)
        self.distance_m: NumberedList[AgvNumber, float] = [0.0] * len(starts)
        self.closed: frozenset[Vertex] = frozenset()
        self._barred = barred
        # lanes that do not lead on to every lane at their end: SUMO swings a body round only when it drives on, so that
        # an AGV that has turned there still lies on such a lane, and the ways that it bars stay barred
        lane_of = np.repeat(np.arange(len(graph.tail)), np.diff(motion.first_transition))
        self._hindered = frozenset(lane_of[motion.turn_steps[0] >= NEVER].tolist())
        self._due: set[AgvNumber] = set()
        self._seen: NumberedList[AgvNumber, AgvState | None] = [None] * len(starts)
        self._unable_since: dict[AgvNumber, int] = {}
        self._stops: tuple[int, int] = (0, 0)  # ended outages of AGVs: number, and total steps

    def close(self, vertices: frozenset[Vertex]) -> None:
        """Grant these vertices to no AGV until the next call. An AGV that stands on one may leave."""
        self.closed = vertices
        self._due.update(numbers(self.agvs))

    def accept(self, paths: Mapping[AgvNumber, Path], barred: Barred | None = None) -> Refusal | None:
        """Replace all visiting orders by a plan; AGVs without a path keep their place.

        Args:
            paths: by AGV number; each starts where that AGV's authority ends.
            barred: where the AGVs that have a new path may not drive; None bars nothing.

        Returns:
            None when the plan is taken, otherwise why it is refused; then the orders are as before.
        """
        for agv, path in paths.items():
            wrong = malformed(agv, path) if 0 <= agv < len(self.agvs) else f"there is no AGV {agv}"
            if wrong:
                return Refusal("form", (agv,), NO_VERTEX, wrong)
            if path.vertices[0] != self.agvs[agv].last:
                return Refusal("start", (agv,), path.vertices[0], "the path does not start where the authority ends")
            if barred and (v := barred.on(path)) != NO_VERTEX:
                name = self.graph.names[v]
                return Refusal("blocked", (agv,), v, f"AGV {agv} would drive through {name}, which is blocked")
        holding = {agv: a.last for agv, a in numbered(self.agvs) if agv not in paths}
        agvs = self.agvs
        in_edges = {n: agvs[n].in_edge for n, p in paths.items() if agvs[n].turned_to not in p.vertices[1:2]}
        order = visiting_order(paths, holding, self.graph, self.motion, in_edges)
        if isinstance(order, Refusal):
            return order
        self.order = order
        for agv, a in numbered(self.agvs):
            a.pending = deque(paths[agv].vertices[1:]) if agv in paths else deque()
        self._due.update(numbers(self.agvs))
        return None

    def update(self, states: Iterable[AgvState], step: int) -> tuple[list[AgvNumber], list[AgvNumber]]:
        """Take over what the plant saw; free what has been left.

        Returns:
            The AGVs of which something is new, and those whose action ended.
        """
        changed, finished = [], []
        for s in states:
            a = self.agvs[s.agv]
            if s is self._seen[s.agv] and not (s.standing and a.acting_until >= 0):
                continue
            self._seen[s.agv] = s
            changed.append(s.agv)
            while a.first < s.left:
                a.first += 1
                self._free(s.agv, a.trail.popleft())
            if s.reached != a.reached:
                a.reached, a.since = s.reached, step
                self._due.add(s.agv)
            if s.able != a.able:
                a.able = s.able
                self._due.add(s.agv)
                self._count_stop(s.agv, step)
            standing = s.standing and a.reached == a.granted
            if standing != a.standing:
                a.standing = standing
                self._due.add(s.agv)
            if standing and 0 <= a.acting_until <= step:
                a.acting_until, a.acting, a.acted = -1, None, step
                finished.append(s.agv)
                self._due.add(s.agv)
        return changed, finished

    def _count_stop(self, agv: AgvNumber, step: int) -> None:
        if not self.agvs[agv].able:
            self._unable_since[agv] = step
        elif agv in self._unable_since:
            count, steps = self._stops
            self._stops = count + 1, steps + step - self._unable_since.pop(agv)

    def cancel(self, agv: AgvNumber) -> None:
        """Drop the vertices that are planned but not granted."""
        for v in self.agvs[agv].pending:
            self.order[v].remove(agv)
            if self.owner[v] == -1 and self.order[v]:
                self._due.add(self.order[v][0])
        self.agvs[agv].pending.clear()

    def reconsider(self, agv: AgvNumber) -> None:
        """Check in the next call of ``grants`` whether this AGV can go on, because an order has changed."""
        self._due.add(agv)

    def act(self, agv: AgvNumber, action: Action, steps: int, step: int, request: RequestNumber = NO_REQUEST) -> Act:
        """Start an action of a standing AGV and return the command for it.

        Raises:
            RuntimeError: the AGV does not stand or is acting already.
        """
        a = self.agvs[agv]
        if not a.standing or a.acting_until >= 0:
            raise RuntimeError(f"AGV {agv} cannot {action.value}: it is not standing idle")
        if steps:
            a.acting_until, a.acting = step + steps, action
            a.standing = False
        return Act(agv, action, steps, request)

    def grants(self, step: int) -> list[Command]:
        """Grant what the orders allow now.

        Returns:
            Advances and turns, in the order in which they have to be carried out.
        """
        commands: list[Command] = []
        due = sorted(self._due)
        self._due.clear()
        while due:
            for agv in due:
                self._extend(agv, step, commands)
            due = sorted(self._due)
            self._due.clear()
        return commands

    def _extend(self, agv: AgvNumber, step: int, commands: list[Command]) -> None:
        a = self.agvs[agv]
        run: list[Vertex] = []
        while a.pending and a.able and a.acting_until < 0 and a.granted - a.reached < self.lookahead:
            w = a.pending[0]
            if self._must_turn(a, w):
                if not a.standing or run:
                    break
                rotation = self._turn(a, w)
                if rotation:
                    commands.append(self.act(agv, Action.TURN, rotation, step))
                    break
            if not self._claim(agv, w):
                if self.motion.following and not run:
                    self._rotate(self._ring_of(agv), commands)
                break
            self._enter(agv, w)
            if self.motion.following:
                self._leave_behind(agv)
            run.append(w)
        if run:
            if len(a.trail) == len(run) + 1 and a.reached == a.granted - len(run):
                a.since = step
            self.moves[agv] += len(run)
            commands.append(Advance(agv, tuple(run)))

    def _must_turn(self, a: Authority, vertex: Vertex) -> bool:
        """Whether the AGV has to turn before it drives to the next vertex."""
        if a.in_edge < 0 or a.turned_to == vertex:
            return False
        k = self.motion.transition(self.graph, a.in_edge, self.graph.edge_index[a.last, vertex])
        return bool(self.motion.turn_steps[int(a.loaded), k])

    def _turn(self, a: Authority, vertex: Vertex) -> int:
        """Turn a standing AGV towards the next vertex of its way; the steps of rotation that this takes."""
        edge = self.graph.edge_index[a.last, vertex]
        rotation = int(self.motion.rotation_steps[int(a.loaded), self.motion.transition(self.graph, a.in_edge, edge)])
        a.turned_to = vertex
        if self.graph.reverse[edge] >= 0 and a.in_edge not in self._hindered:
            # the AGV now stands as if it had come over this edge
            a.in_edge = EdgeIndex(int(self.graph.reverse[edge]))
        return rotation

    def _enter(self, agv: AgvNumber, vertex: Vertex) -> None:
        """Move the end of an AGV's authority on to the next vertex of its way, which belongs to it by now."""
        a = self.agvs[agv]
        edge = self.graph.edge_index[a.last, vertex]
        a.pending.popleft()
        a.turned_to = NO_VERTEX
        a.trail.append(vertex)
        a.in_edge = edge
        self.distance_m[agv] += float(self.graph.length_m[edge])
        a.standing = False

    def _ring_of(self, agv: AgvNumber) -> list[AgvNumber]:
        """Three or more AGVs, this one first, that are ready to enter the vertex of the next one; empty if none."""
        ring = [agv]
        while self._ready_to_enter(ring[-1]):
            ahead = self.owner[self.agvs[ring[-1]].pending[0]]
            if ahead == agv:
                return ring if len(ring) > 2 else []
            if ahead == NO_AGV or ahead in ring:
                break
            ring.append(ahead)
        return []

    def _ready_to_enter(self, agv: AgvNumber) -> bool:
        """Whether only the AGV on the next vertex keeps this AGV from entering it."""
        a = self.agvs[agv]
        if not a.pending or not a.able or a.acting_until >= 0 or a.granted > a.reached:
            return False
        w = a.pending[0]
        return not self._must_turn(a, w) and self.order[w][0] == agv and not self._shut(agv, w)

    def _shut(self, agv: AgvNumber, vertex: Vertex) -> bool:
        """Whether an AGV must not enter a vertex now, even if no AGV is there."""
        return vertex in self.closed or self._barred(agv, vertex)

    def _rotate(self, ring: Collection[AgvNumber], commands: list[Command]) -> None:
        """Let each AGV of a ring enter the vertex of the next one, all in this tick."""
        for agv in ring:
            a = self.agvs[agv]
            w = a.pending[0]
            self.order[w].popleft()
            self._enter(agv, w)
            a.first += 1
            a.trail.popleft()
            self.owner[w] = agv
            self.moves[agv] += 1
            commands.append(Advance(agv, (w,)))

    def _claim(self, agv: AgvNumber, vertex: Vertex) -> bool:
        if self.owner[vertex] not in (-1, agv) or self.order[vertex][0] != agv or self._shut(agv, vertex):
            return False
        self.order[vertex].popleft()
        self.owner[vertex] = agv
        return True

    def _leave_behind(self, agv: AgvNumber) -> None:
        """Free the vertex an AGV stands on: with discrete ticks, a granted move is completed within the tick."""
        a = self.agvs[agv]
        a.first += 1
        self._free(agv, a.trail.popleft())

    def _free(self, agv: AgvNumber, vertex: Vertex) -> None:
        if vertex in self.agvs[agv].trail:
            return
        self.owner[vertex] = NO_AGV
        waiting = self.order.get(vertex)
        if waiting:
            self._due.add(waiting[0])

    def leave_steps(self, agv: AgvNumber, step: int) -> list[int]:
        """Estimated steps until an AGV has left each vertex of its trail; for the last one, until it can leave it."""
        a = self.agvs[agv]
        if a.acting_until >= 0:
            return [max(a.acting_until - step, 0)] * len(a.trail)
        trail = list(a.trail)
        steps = self.motion.edge_steps[int(a.loaded)]
        clock = a.since - step
        left = []
        for number, (u, v) in enumerate(pairwise(trail), start=a.first):
            if number >= a.reached:
                clock += int(steps[self.graph.edge_index[u, v]])
            left.append(max(clock, 1))
        return [*left, 0 if a.standing else max(clock, 1)]

    def ready_step(self, agv: AgvNumber, step: int) -> int:
        """Estimated steps until an AGV can leave the end of its authority.

        One that takes no orders is expected to go on so for as long as that has taken on average so far.
        """
        count, steps = self._stops
        more = 0 if self.agvs[agv].able or not count else round(steps / count)
        return self.leave_steps(agv, step)[-1] + more
