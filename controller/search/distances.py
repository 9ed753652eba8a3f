"""Exact remaining steps to a goal, found only as far as a caller asks: RRA* (Silver 2005, reverse resumable A*).

A state is an edge: "at its head, having come over it", so that turns count. The search runs backwards from the goal and
is aimed at the first vertex that asked; a later question resumes it where it stopped. Other agents are ignored, blocked
vertices are not: they may be left, never driven into, unless they are the goal. (An agent that starts on a blocked
vertex may come back to it; that its best way leads through it a second time is left out of account.)

Departures from the paper: durations differ per edge, turns cost time, and the estimate is the larger of the Manhattan
and the Euclidean distance times the fastest pace of any edge (consistent, so a closed state is final). A search aimed
at a landmark goes straight to it by the landmark's table, see ``landmarks``; a quickest way from there is even read
from the table, and searched for only when a caller asks for more.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.field import AIM, GOAL, LOADED, OPEN, PLACE, READ, SIZE, F, Field, G, may_enter, repair
from controller.search.landmarks import Bounds, Landmarks
from controller.search.landmarks import at_least as landmarks_say
from controller.search.space import EXPANDED, GENERATED, HEAP_MOVES, VALID, Lanes, Space, by_air
from controller.types import FOREVER, NEVER
from sumo_nets.graph import IntArray
from sumo_nets.numbering import NO_VERTEX, EdgeIndex, Vertex


class Distances:
    """Distance fields by (goal, loaded), the least recently used ones dropped beyond ``max_bytes``.

    Args:
        space: the garage.
        max_bytes: memory for fields.
        ends: shape (n,), 1 at vertices that are never driven through, whatever ``update`` says; None for none.
        whole: the field of a landmark is whole from the start and lasts whatever ``update`` says: what it says is a
            bound below the distance, exact while nothing but ``ends`` is closed. For searches without a window.
        windowed: for searches in windows, which ask for one goal again and again from further on. The field of a
            landmark is whole and repaired when ``update`` changes it; of other goals the newest field is resumed,
            whoever asks.

    Attributes:
        space: the garage.
        blocked: shape (n,), where no AGV may drive; set by ``update``.
        counters: search work so far, int64: expanded, heap moves, generated, valid.
    """

    def __init__(
        self,
        space: Space,
        max_bytes: int = 1 << 29,
        ends: NDArray[np.uint8] | None = None,
        whole: bool = False,
        windowed: bool = False,
    ) -> None:
        self.space = space
        self._ends = np.zeros(len(space.lanes.xy), dtype=np.uint8) if ends is None else ends
        self._landmarks = Landmarks(space, self._ends)
        self._whole = whole
        self._windowed = windowed
        self._newest: dict[tuple[Vertex, bool], tuple[Vertex, bool, Vertex]] = {}
        self._ready: dict[tuple[Vertex, bool], Field] = {}
        motion = space.motion
        self._speeds_differ = bool(
            (motion.edge_steps[0] != motion.edge_steps[1]).any() or (motion.turn_steps[0] != motion.turn_steps[1]).any()
        )
        self.blocked: NDArray[np.uint8] = np.zeros(len(space.lanes.xy), dtype=np.uint8)
        self.counters: NDArray[np.int64] = np.zeros(4, dtype=np.int64)
        self._fields: OrderedDict[tuple[Vertex, bool, Vertex], Field] = OrderedDict()
        self._cap = max(64, max_bytes // (16 * max(1, len(space.lanes.tail))))

    def update(self, blocked: NDArray[np.uint8]) -> None:
        """Take over a new set of blocked vertices and drop the fields that would not be the same any more."""
        if blocked.tobytes() == self.blocked.tobytes():
            return
        changed = np.flatnonzero(blocked != self.blocked).astype(np.int32)
        self.blocked[:] = blocked
        lanes = self.space.lanes
        for key in [k for k, field in self._fields.items() if _differs(changed, field, lanes, self.blocked)]:
            del self._fields[key]
        if not self._whole:
            for field in self._ready.values():
                repair(changed, field, lanes, self.blocked, self.counters)

    def prepare(self, goals: Iterable[Vertex]) -> None:
        """Find all distances to these vertices now, not when they are first asked for, as far as memory allows.

        With a field for each end point, memory and time grow with the square of the garage. Public solvers do so before
        their clock runs.
        """
        wanted = [(goal, loaded) for goal in goals for loaded in {False, self._speeds_differ}]
        for goal, loaded in wanted[: self._cap]:
            self._make_ready(goal, loaded)
            self._landmarks.bounds(goal, loaded)

    def field(self, goal: Vertex, loaded: bool, asker: Vertex) -> Field:
        """The field of a goal, new ones aimed at the vertex ``asker``."""
        loaded = loaded and self._speeds_differ
        field = self._ready.get((goal, loaded))
        if field is not None:
            return field
        if (self._whole or self._windowed) and goal in self._landmarks.vertices:
            return self._make_ready(goal, loaded)
        key = self._key(goal, loaded, asker)
        if self._windowed:
            newest = self._newest.get((goal, loaded), key)
            key = self._newest[goal, loaded] = newest if newest in self._fields else key
        field = self._fields.get(key)
        if field is None:
            field = self._new_field(goal, loaded, asker)
            self._fields[key] = field
            if len(self._fields) > self._cap:
                self._fields.popitem(last=False)
        else:
            self._fields.move_to_end(key)
        return field

    def bounds(self, goal: Vertex, loaded: bool) -> Bounds:
        """What is known of the way to a goal without any search, for :func:`at_least`."""
        return self._landmarks.bounds(goal, loaded and self._speeds_differ)

    def distance(self, vertex: Vertex, in_edge: EdgeIndex, goal: Vertex, loaded: bool) -> int:
        """Steps from a vertex to a goal, turns included.

        Args:
            vertex: where the AGV is.
            in_edge: edge it came by; -1 if its first move needs no turn.
            goal: where it wants to go.
            loaded: it carries a car.

        Returns:
            Planning steps; ``FOREVER`` if there is no way.
        """
        if vertex == goal:
            return 0
        field = self.field(goal, loaded, vertex)
        return int(distance_from(vertex, in_edge, field, self.space.lanes, self.blocked, self.counters))

    def way(self, vertex: Vertex, in_edge: EdgeIndex, goal: Vertex, loaded: bool) -> IntArray:
        """A quickest way to a goal, same arguments as for :meth:`distance`.

        Returns:
            For each vertex of the way, the first one too, its number and the steps until it is reached; shape (k, 2),
            k = 0 if there is no way or, with ``whole``, if the one that is known is blocked now.
        """
        way = np.empty((len(self.space.lanes.tail) + 1, 2), dtype=np.int32)
        field = self.field(goal, loaded, vertex)
        return way[: _descend(vertex, in_edge, field, self.space.lanes, self.blocked, self.counters, way)]

    def known(self, vertex: Vertex, in_edge: EdgeIndex, goal: Vertex, loaded: bool) -> int:
        """A bound below :meth:`distance` that takes no search and changes nothing; same arguments.

        Exact where one has been already.
        """
        if vertex == goal:
            return 0
        lanes, moving = self.space.lanes, loaded and self._speeds_differ
        field = self._ready.get((goal, moving)) or self._fields.get(self._key(goal, moving, vertex))
        if field is None or in_edge < 0:
            manhattan, euclidean = self.space.rates[int(loaded)].tolist()
            return int(by_air(vertex, goal, manhattan, euclidean, lanes))
        if field.states.item(in_edge, PLACE) == -1:  # to call a kernel would take longer than all else here
            return field.states.item(in_edge, G) - 1
        return int(at_least(in_edge, goal, field, self.bounds(goal, loaded), lanes))

    def _key(self, goal: Vertex, loaded: bool, asker: Vertex) -> tuple[Vertex, bool, Vertex]:
        """Under which a field is kept."""
        return goal, loaded, asker if self._goes_straight(asker, goal) else NO_VERTEX

    def _goes_straight(self, asker: Vertex, goal: Vertex) -> bool:
        """A field of its own, by the asker's table, pays where few others will ask for this goal."""
        return asker in self._landmarks.vertices and goal not in self._landmarks.vertices

    def _make_ready(self, goal: Vertex, loaded: bool) -> Field:
        """Find the whole field of a goal, which is used from now on."""
        closed = self._ends if self._whole else self.blocked
        field = _whole(goal, loaded, closed, self.space.lanes, self.counters)
        self._ready[goal, loaded] = field
        return field

    def _new_field(self, goal: Vertex, loaded: bool, asker: Vertex) -> Field:
        s = self.space
        straight = self._goes_straight(asker, goal)
        field = Field(
            np.zeros((len(s.lanes.tail), 4), dtype=np.int32),
            np.array([0, goal, loaded, asker, 0], dtype=np.int32),
            s.rates[int(loaded)].copy(),
            self._landmarks.steps_from(asker, loaded, self.counters) if straight else np.zeros(0, dtype=np.int32),
        )
        if not straight or not _read_way(field, s.lanes, self.blocked):
            _begin(field, s.lanes, self.counters)
        return field


def _whole(goal: Vertex, loaded: bool, blocked: NDArray[np.uint8], lanes: Lanes, counters: NDArray[np.int64]) -> Field:
    """A field without an aim, searched to its end."""
    field = Field(
        np.zeros((len(lanes.tail), 4), dtype=np.int32),
        np.array([0, goal, loaded, goal, 0], dtype=np.int32),
        np.zeros(2),
        np.zeros(0, dtype=np.int32),
    )
    _close_all(field, lanes, blocked, counters)
    return field


@kernel
def distance_from(
    vertex: int, in_edge: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]
) -> int:
    """Remaining steps from a vertex entered over ``in_edge``; -1 for an AGV whose first move needs no turn."""
    meta = field.meta
    if vertex == meta[GOAL]:
        return 0
    if in_edge >= 0 and vertex != meta[AIM]:
        return settle(in_edge, field, lanes, blocked, counters)
    while True:
        best, open_turn = _best_way_out(vertex, in_edge, field, lanes, blocked)
        if meta[READ]:
            if vertex == meta[AIM] and best < meta[READ]:
                return best
            _search_instead(field, lanes, counters)
            continue
        if open_turn >= NEVER or meta[SIZE] == 0:
            return best
        # Whatever leaves over an edge not closed yet needs at least the least f of OPEN, if the search is aimed here.
        if vertex == meta[AIM] and best <= field.states[field.states[0, OPEN], F] - 1 + open_turn:
            return best
        _close_next(field, lanes, blocked, counters)


@kernel
def start_at_least(
    vertex: int, in_edge: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]
) -> int:
    """A bound below :func:`distance_from`: without the first turn where the way has been read from a table."""
    if field.meta[READ] and vertex == field.meta[AIM]:
        return int(field.meta[READ]) - 1
    return distance_from(vertex, in_edge, field, lanes, blocked, counters)


@kernel
def _best_way_out(vertex: int, in_edge: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8]) -> tuple[int, int]:
    """Remaining steps over the best closed edge, and the least turn towards one not closed, ``NEVER`` if all are."""
    states, loaded = field.states, field.meta[LOADED]
    best, open_turn = FOREVER, NEVER
    first = lanes.first_out[vertex]
    for e in range(first, lanes.first_out[vertex + 1]):
        turn = 0 if in_edge < 0 else lanes.turn_steps[loaded, lanes.first_transition[in_edge] + e - first]
        if turn >= NEVER or not may_enter(lanes.head[e], field, blocked):
            continue
        if states[e, PLACE] == -1:
            best = min(best, turn + lanes.edge_steps[loaded, e] + states[e, G] - 1)
        else:
            open_turn = min(open_turn, turn)
    return best, open_turn


@kernel
def _descend(
    vertex: int, in_edge: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64],
    way: IntArray,
) -> int:  # fmt: skip
    """Follow the distances down to the goal; how many vertices that are."""
    states, loaded = field.states, field.meta[LOADED]
    left = distance_from(vertex, in_edge, field, lanes, blocked, counters)
    if left >= FOREVER:
        return 0
    way[0, 0], way[0, 1] = vertex, 0
    k = 1
    while left > 0:
        first = lanes.first_out[vertex]
        taken, steps = -1, 0
        for e in range(first, lanes.first_out[vertex + 1]):
            turn = 0 if in_edge < 0 else lanes.turn_steps[loaded, lanes.first_transition[in_edge] + e - first]
            known = states[e, PLACE] == -1 and may_enter(lanes.head[e], field, blocked)
            if known and turn + lanes.edge_steps[loaded, e] + states[e, G] - 1 == left:
                taken, steps = e, turn + lanes.edge_steps[loaded, e]
                break
        if taken < 0:  # a field that lasts may lead through what is blocked now
            return 0
        way[k, 0], way[k, 1] = lanes.head[taken], way[k - 1, 1] + steps
        left -= steps
        vertex, in_edge = lanes.head[taken], taken
        k += 1
    return k


@kernel
def settle(edge: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]) -> int:
    """Resume the search until ``edge`` is closed; its remaining steps, ``FOREVER`` if OPEN runs empty before."""
    while field.states[edge, PLACE] != -1:
        if field.meta[READ]:
            _search_instead(field, lanes, counters)
        if field.meta[SIZE] == 0:
            return FOREVER
        _close_next(field, lanes, blocked, counters)
    return int(field.states[edge, G]) - 1


@kernel
def _close_next(field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]) -> None:
    """Close the first edge of OPEN, and open those from which it can be reached."""
    states, meta = field.states, field.meta
    loaded = meta[LOADED]
    out = _pop(states, meta, counters)
    counters[EXPANDED] += 1
    counters[VALID] += 1
    if not may_enter(lanes.head[out], field, blocked):
        return
    v = lanes.tail[out]
    for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
        e = lanes.in_edges[i]
        if states[e, PLACE] == -1:
            continue
        turn = lanes.turn_steps[loaded, lanes.first_transition[e] + out - lanes.first_out[v]]
        if turn >= NEVER:
            continue
        g = states[out, G] + lanes.edge_steps[loaded, out] + turn
        if states[e, G] == 0 or g < states[e, G]:
            _push(e, g, _estimate(e, field, lanes), states, meta, counters)


@kernel
def _close_all(field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]) -> None:
    _begin(field, lanes, counters)
    while field.meta[SIZE] > 0:
        _close_next(field, lanes, blocked, counters)


@kernel
def closed(edge: int, field: Field) -> bool:
    """The exact distance of an edge is known already."""
    return bool(field.states[edge, PLACE] == -1)


@kernel
def at_least(edge: int, goal: int, field: Field, bounds: Bounds, lanes: Lanes) -> int:
    """A bound below the remaining steps from an edge to the goal, without any search; exact where it is closed."""
    if closed(edge, field):
        return int(field.states[edge, G]) - 1
    straight = by_air(lanes.head[edge], goal, field.rates[0], field.rates[1], lanes)
    return int(max(straight, landmarks_say(edge, bounds)))


@kernel
def _differs(changed: IntArray, field: Field, lanes: Lanes, blocked: NDArray[np.uint8]) -> bool:
    """Whether what the search has found so far depends on any of the vertices that changed to or from blocked.

    It does where an edge into such a vertex is closed and some state before it got its g from there, or, now that the
    vertex is free, would get a better one.
    """
    states, loaded = field.states, field.meta[LOADED]
    for w in changed:
        if w == field.meta[GOAL]:
            continue
        for i in range(lanes.first_in[w], lanes.first_in[w + 1]):
            out = lanes.in_edges[i]
            if states[out, PLACE] != -1:
                continue
            v = lanes.tail[out]
            for j in range(lanes.first_in[v], lanes.first_in[v + 1]):
                e = lanes.in_edges[j]
                turn = lanes.turn_steps[loaded, lanes.first_transition[e] + out - lanes.first_out[v]]
                g = states[out, G] + lanes.edge_steps[loaded, out] + turn
                if turn < NEVER and (states[e, G] == g if blocked[w] else states[e, G] == 0 or g < states[e, G]):
                    return True
    return False


@kernel
def _read_way(field: Field, lanes: Lanes, blocked: NDArray[np.uint8]) -> bool:
    """Close the edges of a quickest way from the landmark without a search; False if something on it is blocked."""
    states, meta, ahead = field.states, field.meta, field.ahead
    loaded, goal = meta[LOADED], meta[GOAL]
    edge = -1
    for i in range(lanes.first_in[goal], lanes.first_in[goal + 1]):
        e = lanes.in_edges[i]
        if edge < 0 or ahead[e] < ahead[edge]:
            edge = e
    if edge < 0 or ahead[edge] >= FOREVER:
        return False
    steps = ahead[edge]
    while edge >= 0:
        if not may_enter(lanes.head[edge], field, blocked):
            states[:] = 0
            return False
        states[edge, G] = steps - ahead[edge] + 1
        states[edge, PLACE] = -1
        edge = _edge_before(edge, loaded, ahead, lanes)
    meta[READ] = steps + 1
    return True


@kernel
def _edge_before(edge: int, loaded: int, ahead: IntArray, lanes: Lanes) -> int:
    """The edge before another one on a quickest way, -1 if that is the first."""
    v = lanes.tail[edge]
    here = ahead[edge] - lanes.edge_steps[loaded, edge]
    if here == 0:
        return -1
    for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
        e = lanes.in_edges[i]
        if ahead[e] + lanes.turn_steps[loaded, lanes.first_transition[e] + edge - lanes.first_out[v]] == here:
            return int(e)
    return -1


@kernel
def _search_instead(field: Field, lanes: Lanes, counters: NDArray[np.int64]) -> None:
    """Forget what has been read, and begin the search."""
    field.states[:] = 0
    field.meta[READ] = 0
    _begin(field, lanes, counters)


@kernel
def _begin(field: Field, lanes: Lanes, counters: NDArray[np.int64]) -> None:
    goal = field.meta[GOAL]
    for i in range(lanes.first_in[goal], lanes.first_in[goal + 1]):
        e = lanes.in_edges[i]
        _push(e, 1, _estimate(e, field, lanes), field.states, field.meta, counters)


@kernel
def _estimate(edge: int, field: Field, lanes: Lanes) -> int:
    """At least so many steps from the vertex the search is aimed at until the edge has been driven."""
    if len(field.ahead) > 0:
        return int(field.ahead[edge])
    return by_air(lanes.head[edge], field.meta[AIM], field.rates[0], field.rates[1], lanes)


@kernel
def _before(a: int, b: int, states: IntArray) -> bool:
    """Order of OPEN: smaller f, then larger g, then the smaller edge number."""
    if states[a, F] != states[b, F]:
        return bool(states[a, F] < states[b, F])
    if states[a, G] != states[b, G]:
        return bool(states[a, G] > states[b, G])
    return a < b


@kernel
def _push(e: int, g: int, h: int, states: IntArray, meta: IntArray, counters: NDArray[np.int64]) -> None:
    """Put an edge on OPEN, or move it up if it is there already."""
    states[e, G] = g
    states[e, F] = g + h
    i = states[e, PLACE] - 1
    if i < 0:
        i = meta[SIZE]
        meta[SIZE] += 1
        counters[GENERATED] += 1
        counters[HEAP_MOVES] += 1
    while i > 0:
        up = (i - 1) >> 1
        other = states[up, OPEN]
        if not _before(e, other, states):
            break
        states[i, OPEN] = other
        states[other, PLACE] = i + 1
        i = up
        counters[HEAP_MOVES] += 1
    states[i, OPEN] = e
    states[e, PLACE] = i + 1


@kernel
def _pop(states: IntArray, meta: IntArray, counters: NDArray[np.int64]) -> int:
    """Take the first edge from OPEN and close it."""
    first = states[0, OPEN]
    meta[SIZE] -= 1
    size = meta[SIZE]
    e = states[size, OPEN]
    i = 0
    while 2 * i + 1 < size:
        down = 2 * i + 1
        if down + 1 < size and _before(states[down + 1, OPEN], states[down, OPEN], states):
            down += 1
        other = states[down, OPEN]
        if not _before(other, e, states):
            break
        states[i, OPEN] = other
        states[other, PLACE] = i + 1
        i = down
        counters[HEAP_MOVES] += 1
    states[i, OPEN] = e
    states[e, PLACE] = i + 1
    states[first, PLACE] = -1
    counters[HEAP_MOVES] += 1
    return int(first)
