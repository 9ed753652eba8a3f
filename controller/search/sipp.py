"""One agent's quickest path among reservations: safe-interval path planning in a window.

Phillips and Likhachev 2011 (SIPP): a state is an edge just driven and the safe interval of its head that the agent is
in; only its earliest arrival matters, since waiting inside a safe interval is free. Silver 2005: reservations from the
window's end on are ignored, what is left to drive there is judged by the exact distance to the goal (``distances``).

A path ends
- at the goal, in a safe interval that lasts to the end of the window (for ever without a window), f = t;
- at a vertex reached at or after the window's end, f = t + h;
- at a vertex where it can wait until the window's end, f = window + h, dearer by a quarter of the window where
  ``no_rest`` holds; or at the vertex that it would leave just then, f = t + h of the next one.

The exact distance of a state is only asked for when its turn comes, until then a bound below it serves (Tolpin et al.
2013, lazy A*): most of the graph around the path is never searched. A path may be looked for with ``slack``:
a state whose distance is not known yet goes by its bound, dearer by the slack, and nothing is asked for. A wait or a
little detour by known states then does not set off a search of everything around.

Departures from the papers: turns take time before a departure; with ``following`` False an agent owns both ends of an
edge while it drives; with ``following`` True two agents may not swap their vertices in one step.
Guarantee: the path of least f, with slack at most so much more, or none if there is none. Ties: smaller f, exact h
before a bound, larger g, the older state.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.distances import Distances, at_least, closed, settle, start_at_least
from controller.search.field import Field
from controller.search.landmarks import Bounds
from controller.search.reservations import (
    AGENT,
    EACH,
    END,
    HEAD,
    START,
    WORDS,
    ReservationTable,
    Reserved,
    drop,
    keep,
    swaps,
)
from controller.search.space import EXPANDED, GENERATED, HEAP_MOVES, VALID, Lanes
from controller.types import FOREVER, NEVER, NO_AGV, AgvNumber, Path, PlanAgent, PlanningProblem
from sumo_nets.graph import IntArray
from sumo_nets.numbering import EdgeIndex

#: Columns of ``_Memory.nodes``. EDGE is -1 for the start; SLOT numbers the safe interval of the vertex, which lasts
#: until LAST; T and LEAVE are the arrival and the departure before it; OLDER is the next node of the same vertex;
#: STALE is 1 once a better node has replaced it; FINAL is 1 where a path may end at arrival; EXACT is 1 when H is the
#: distance and no bound below it; from TURNED on it can leave over any edge.
EDGE, VERTEX, SLOT, T, LEAVE, LAST, H, PARENT, OLDER, STALE, FINAL, EXACT, TURNED = range(13)

#: Places of the query that the kernel reads.
Q_AGV, Q_VERTEX, Q_EDGE, Q_READY, Q_GOAL, Q_LOADED, Q_DWELL = range(7)
Q_WINDOW, Q_PENALTY, Q_FOLLOWING, Q_LIMIT, Q_SLACK, Q_LATEST, Q_SINCE = range(7, 14)
#: Bits of ``_Memory.keys``: f from F_FROM on, the lowest T_BITS for g.
F_FROM, T_BITS = 32, 31

_QUERY = struct.Struct("14i")

_NO_BANS: IntArray = np.zeros((0, 2), dtype=np.int32)

#: What kernels answer instead of a node number or an arrival: there is no path, the search memory is full, the search
#: ended at its limit, the table has no room for the path.
NONE, FULL, LIMIT, CROWDED = -1, -2, -3, -4


class _Memory(NamedTuple):
    """Search memory, reused without clearing.

    Attributes:
        nodes: shape (N, 13), see the columns above.
        keys: shape (N,), int64: where nodes stand in OPEN, see ``_key``.
        open: shape (N,), binary heap of node numbers.
        newest: shape (n, 2): newest node of each vertex, valid if the second column is the current generation.
        meta: number of nodes, size of OPEN, generation, blocking agent.
    """

    nodes: IntArray
    keys: NDArray[np.int64]
    open: IntArray
    newest: IntArray
    meta: IntArray


NODES, SIZE, GENERATION, BLOCKER = 0, 1, 2, 3

#: Where the parts begin in the plain tuple of arrays that the kernels are handed: ``Reserved`` (at 0), ``Field``,
#: ``Bounds``, ``Lanes``, three single arrays, ``_Memory``. See ``PathSearch._run`` and ``PathSearch._remember``.
_FIELD, _BOUNDS, _LANES, _BLOCKED = accumulate(len(part._fields) for part in (Reserved, Field, Bounds, Lanes))
_NO_REST, _COUNTERS, _MEMORY = _BLOCKED + 1, _BLOCKED + 2, _BLOCKED + 3


class PathSearch:
    """Finds paths for single agents; holds the search memory.

    Args:
        distances: the exact distances of the garage, shared with all others that need them.
        slack: steps by which complete paths may be later than the quickest ones.

    Attributes:
        blocker: after a search without a path the agent whose reservation cut off the last possibility, else -1.
        limited: the last search ended at ``max_expansions``.
    """

    def __init__(self, distances: Distances, slack: int = 0) -> None:
        self.distances = distances
        self.slack = slack
        self.blocker = NO_AGV
        self.limited = False
        self._no_rest: NDArray[np.uint8] = np.zeros(len(distances.blocked), dtype=np.uint8)
        self._remember(1024)

    def begin(self, problem: PlanningProblem) -> None:
        """Take over the blocked and no-rest vertices of a problem; to be called before the searches for it."""
        self.distances.update(problem.blocked)
        self._no_rest[:] = problem.no_rest

    def find_path(
        self,
        problem: PlanningProblem,
        agent: PlanAgent,
        table: ReservationTable,
        *,
        forbidden: Collection[tuple[EdgeIndex, int]] = (),
        max_expansions: int = FOREVER,
        since: int = 0,
    ) -> Path | None:
        """The agent's quickest way towards its goal.

        Args:
            problem: window, resting rules and motion; ``begin`` must have been called with it.
            agent: the agent to find a path for; its own reservations must not be in the table.
            table: the reservations to keep clear of.
            forbidden: (edge, step): the edge may not be arrived by at that step.
            max_expansions: give up after that many.
            since: step from which on it is where the path begins; it gets there by a path found before.

        Returns:
            The path, or None (then see ``blocker`` and ``limited``).
        """
        query = self._query(problem, agent, limit=max_expansions, since=since)
        bans = np.array(sorted(forbidden), dtype=np.int32).reshape(-1, 2) if forbidden else _NO_BANS
        return self._path(self._run(_find, query, bans, agent, table), query)

    def reserve_path(
        self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable, latest: int = FOREVER
    ) -> int:
        """Reserve in the table what ``find_path`` would find.

        Args:
            problem, agent, table: as for ``find_path``.
            latest: a path that arrives later is of no use: it may be reserved, too, or not.

        Returns:
            Step of arrival, -1 if there is no path.
        """
        query = self._query(problem, agent, latest=latest)
        return self._run(_find_and_reserve, query, _NO_BANS, agent, table)

    def find_refuge(self, problem: PlanningProblem, agent: PlanAgent, table: ReservationTable) -> Path | None:
        """The agent's quickest way to any vertex where it is in no other agent's way to the end of the window.

        Vertices with ``no_rest`` are not taken. Arguments and result as for ``find_path``; the goal is ignored.
        """
        query = self._query(problem, agent)
        query[Q_GOAL] = -1
        return self._path(self._run(_find, query, _NO_BANS, agent, table), query)

    def _query(
        self, problem: PlanningProblem, agent: PlanAgent, limit: int = FOREVER, latest: int = FOREVER, since: int = 0
    ) -> IntArray:
        window = min(problem.window_steps, FOREVER)
        slack = self.slack
        packed = _QUERY.pack(
            agent.agv, agent.vertex, agent.in_edge, agent.ready_step, agent.goal, agent.loaded, agent.dwell_steps,
            window, window // 4, problem.motion.following, min(limit, FOREVER), slack, min(latest + slack, FOREVER),
            since,
        )  # fmt: skip
        return np.frombuffer(bytearray(packed), dtype=np.int32)

    def _run(
        self, search: Callable[..., int], query: IntArray, bans: IntArray, agent: PlanAgent, table: ReservationTable
    ) -> int:
        """What a kernel answers once there is room for it."""
        d = self.distances
        known = (*d.field(agent.goal, agent.loaded, agent.vertex), *d.bounds(agent.goal, agent.loaded))
        while True:
            table.make_room(HEAD + EACH * len(self._memory.nodes), 1)
            answer = int(search(query, bans, (*table.reserved, *known, *self._arrays)))
            if answer == FULL:
                self._remember(2 * len(self._memory.nodes))
            elif answer == CROWDED:
                table.grow()
            else:
                break
        self.limited = answer == LIMIT
        self.blocker = AgvNumber(int(self._memory.meta[BLOCKER])) if answer < 0 else NO_AGV
        return answer

    def _path(self, last: int, query: IntArray) -> Path | None:
        if last < 0:
            return None
        vertices, arrive, leave = _trace(last, query, self._memory.nodes).tolist()
        return Path(AgvNumber(int(query[Q_AGV])), tuple(vertices), tuple(arrive), tuple(leave[:-1]), leave[-1])

    def _remember(self, nodes: int) -> None:
        """Make search memory for so many nodes."""
        d = self.distances
        self._memory = _new_memory(nodes, len(d.space.lanes.xy))
        self._arrays = (*d.space.lanes, d.blocked, self._no_rest, d.counters, *self._memory)


def _new_memory(nodes: int, vertices: int) -> _Memory:
    return _Memory(
        np.zeros((nodes, 13), dtype=np.int32),
        np.zeros(nodes, dtype=np.int64),
        np.zeros(nodes, dtype=np.int32),
        np.zeros((vertices, 2), dtype=np.int32),
        np.zeros(4, dtype=np.int32),
    )


@kernel
def _find(query: IntArray, bans: IntArray, arrays: tuple[Any, ...]) -> int:
    """:func:`_sipp` for arrays in a plain tuple: numba takes long to look at each named one that it is handed."""
    return _sipp(
        query, bans, Reserved(*arrays[:_FIELD]), Field(*arrays[_FIELD:_BOUNDS]), Bounds(*arrays[_BOUNDS:_LANES]),
        Lanes(*arrays[_LANES:_BLOCKED]), arrays[_BLOCKED], arrays[_NO_REST], arrays[_COUNTERS],
        _Memory(*arrays[_MEMORY:]),
    )  # fmt: skip


@kernel
def _find_and_reserve(query: IntArray, bans: IntArray, arrays: tuple[Any, ...]) -> int:
    """Step of arrival of the path that has been found and reserved, or NONE, FULL, LIMIT or CROWDED."""
    last = _find(query, bans, arrays)
    return last if last < 0 else _reserve(last, query, _Memory(*arrays[_MEMORY:]).nodes, Reserved(*arrays[:_FIELD]))


@kernel
def _sipp(
    query: IntArray, bans: IntArray, reserved: Reserved, field: Field, bounds: Bounds, lanes: Lanes,
    blocked: NDArray[np.uint8], no_rest: NDArray[np.uint8], counters: NDArray[np.int64], memory: _Memory,
) -> int:  # fmt: skip
    """Number of the node at which the best path ends, or NONE, FULL or LIMIT."""
    # --- empty memory
    rows, count = reserved.rows, reserved.counts
    nodes, meta = memory.nodes, memory.meta
    start, goal, window = query[Q_VERTEX], query[Q_GOAL], query[Q_WINDOW]
    loaded = query[Q_LOADED]
    meta[NODES] = 0
    meta[SIZE] = 0
    meta[GENERATION] += 1
    meta[BLOCKER] = -1
    latest = -1  # end of the last safe interval; the agent that ends it is reported as the blocker if no path is found
    nearest = FOREVER  # if no safe interval ended: the agent that stands for ever nearest to the goal is reported
    wait_f, wait_node = FOREVER, NONE  # the best path that ends by waiting until the window's end
    # --- the safe interval in which the agent starts; none means that another agent holds the start
    slot = 0
    while slot < count[start] and rows[start, slot, END] <= query[Q_SINCE]:
        slot += 1
    if slot < count[start] and rows[start, slot, START] <= query[Q_SINCE]:
        meta[BLOCKER] = rows[start, slot, AGENT]
        return NONE
    # --- the first node
    h = 0
    if goal >= 0:
        h = start_at_least(start, query[Q_EDGE], field, lanes, blocked, counters)
        if h >= FOREVER:
            return NONE
    _generate(-1, start, slot, query[Q_READY], 0, _safe_until(rows, count, start, slot, window), h, True, -1,
              query, no_rest, lanes, memory, counters)  # fmt: skip
    expanded = 0
    while meta[SIZE] > 0:
        # --- the node with the least f; the search ends when no path is better than to wait until the window's end
        n = memory.open[0]
        if wait_node >= 0 and wait_f <= memory.keys[n] >> F_FROM:
            break
        _pop(memory, counters)
        # --- a lower bound of the way to the goal becomes the exact length; a node that gets longer goes back
        if goal >= 0 and not nodes[n, STALE] and not nodes[n, EXACT] and query[Q_SLACK] == 0:
            h = settle(nodes[n, EDGE], field, lanes, blocked, counters)
            if h >= FOREVER:
                continue
            nodes[n, EXACT] = 1
            if h > nodes[n, H]:
                nodes[n, H] = h
                memory.keys[n] = _key(nodes[n, T] + h, True, nodes[n, T])
                _push(n, memory, counters)
                continue
        # --- the node is expanded: a stale one has been reached at less cost since, a final one ends the search
        counters[EXPANDED] += 1
        if nodes[n, STALE]:
            continue
        counters[VALID] += 1
        if nodes[n, FINAL]:
            return int(n)
        expanded += 1
        if expanded > query[Q_LIMIT]:
            return LIMIT
        # --- a path may end here: by resting until the window's end, or by a move that begins at its end
        v, t, last = nodes[n, VERTEX], nodes[n, T], nodes[n, LAST]
        if last >= FOREVER and window < FOREVER and goal >= 0:
            f = max(t, window) + nodes[n, H] + (0 if nodes[n, EXACT] else query[Q_SLACK])
            if no_rest[v] and v != goal and v != start:
                f += query[Q_PENALTY]
            if f < wait_f:
                wait_f, wait_node = f, n
        elif last < FOREVER and last > latest:
            latest = last
            meta[BLOCKER] = rows[v, nodes[n, SLOT], AGENT]
        into = query[Q_EDGE] if nodes[n, EDGE] < 0 else nodes[n, EDGE]
        if window < FOREVER and goal >= 0:
            f = _leaves_at_end(n, into, wait_f, query, bans, field, bounds, lanes, blocked, counters, nodes)
            if f < wait_f:
                wait_f, wait_node = f, n
        # --- successors: each edge that the agent can take before the safe interval ends
        for e in range(lanes.first_out[v], lanes.first_out[v + 1]):
            w = lanes.head[e]
            if blocked[w] and w != goal and w != start:
                continue
            depart = t
            if into >= 0:
                depart += lanes.turn_steps[loaded, lanes.first_transition[into] + e - lanes.first_out[v]]
            if depart >= t + NEVER:
                continue
            steps = lanes.edge_steps[loaded, e]
            if depart + steps > last:
                continue
            h = 0
            if goal >= 0:
                h = max(at_least(e, goal, field, bounds, lanes), nodes[n, H] - (depart - t) - steps)
            if depart + steps + h > query[Q_LATEST]:
                continue
            # an agent that stands there for ever is the blocker, unless the end of a safe interval has named one
            if h < nearest and latest < 0 and count[w] > 0 and rows[w, count[w] - 1, END] >= FOREVER:
                nearest = h
                meta[BLOCKER] = rows[w, count[w] - 1, AGENT]
            # each safe interval of the edge's end that the agent can reach in time
            for k in range(count[w] + 1):
                begin = rows[w, k - 1, END] if k > 0 else 0
                end = _safe_until(rows, count, w, k, window)
                a = max(depart + steps, begin) if query[Q_FOLLOWING] else max(depart, begin) + steps
                a = _after_bans(bans, e, a)
                if a > last:
                    break
                entered = a if query[Q_FOLLOWING] else a - steps
                if entered >= window:
                    break
                if a >= end:
                    continue
                if query[Q_FOLLOWING] and a == last and a == begin and swaps(rows, count, v, w, a):
                    continue
                if meta[NODES] == nodes.shape[0]:
                    return FULL
                _generate(e, w, k, a, a - steps, end, h, closed(e, field), n, query, no_rest, lanes, memory, counters)
                if end >= FOREVER:
                    break
    return wait_node


@kernel
def _leaves_at_end(
    n: int, into: int, best: int, query: IntArray, bans: IntArray, field: Field, bounds: Bounds, lanes: Lanes,
    blocked: NDArray[np.uint8], counters: NDArray[np.int64], nodes: IntArray,
) -> int:  # fmt: skip
    """Least f of a path that ends at a node because its next move begins at the window's end; ``best`` if none is less.

    Edges whose distance is known go first: what they cost may spare the search for the others.
    """
    v, t, loaded = nodes[n, VERTEX], nodes[n, T], query[Q_LOADED]
    for known in (True, False):
        for e in range(lanes.first_out[v], lanes.first_out[v + 1]):
            w = lanes.head[e]
            if (known and not closed(e, field)) or (blocked[w] and w != query[Q_GOAL] and w != query[Q_VERTEX]):
                continue
            steps = lanes.edge_steps[loaded, e]
            turn = 0 if into < 0 else lanes.turn_steps[loaded, lanes.first_transition[into] + e - lanes.first_out[v]]
            a = t + turn + steps
            entered = a if query[Q_FOLLOWING] else a - steps
            if turn >= NEVER or entered < query[Q_WINDOW] or a > nodes[n, LAST] or a != _after_bans(bans, e, a):
                continue
            h = max(at_least(e, query[Q_GOAL], field, bounds, lanes), nodes[n, H] - turn - steps)
            if query[Q_SLACK] > 0 and not closed(e, field):
                best = min(best, a + h + query[Q_SLACK])
            elif a + h < best:
                best = min(best, a + settle(e, field, lanes, blocked, counters))
    return best


@kernel
def _generate(
    edge: int, vertex: int, slot: int, t: int, leave: int, last: int, h: int, exact: bool, parent: int,
    query: IntArray, no_rest: NDArray[np.uint8], lanes: Lanes, memory: _Memory, counters: NDArray[np.int64],
) -> None:  # fmt: skip
    """Put a state on OPEN unless another one can do all that it can; those that it makes useless become stale.

    Of two nodes of one safe interval the later one is useless if both came over the same edge, or if the earlier one
    has turned wherever it wants by then (and paths are complete: at the end of a window turns still to come count).
    """
    nodes, newest, meta = memory.nodes, memory.newest, memory.meta
    complete = query[Q_WINDOW] >= FOREVER
    turned = t + _longest_turn(edge, query, lanes)
    older = newest[vertex, 0] if newest[vertex, 1] == meta[GENERATION] else -1
    other = older
    while other >= 0:
        if nodes[other, SLOT] == slot and not nodes[other, STALE]:
            same = nodes[other, EDGE] == edge
            if nodes[other, T] <= t if same else complete and nodes[other, TURNED] <= t:
                return
            if same or (complete and turned <= nodes[other, T]):
                nodes[other, STALE] = 1
        other = nodes[other, OLDER]
    n = meta[NODES]
    meta[NODES] += 1
    newest[vertex, 0] = n
    newest[vertex, 1] = meta[GENERATION]
    nodes[n, EDGE] = edge
    nodes[n, VERTEX] = vertex
    nodes[n, SLOT] = slot
    nodes[n, T] = t
    nodes[n, LEAVE] = leave
    nodes[n, LAST] = last
    nodes[n, H] = h
    memory.keys[n] = _key(t + h if exact else t + h + query[Q_SLACK], exact, t)
    nodes[n, PARENT] = parent
    nodes[n, OLDER] = older
    nodes[n, STALE] = 0
    nodes[n, EXACT] = exact
    nodes[n, TURNED] = turned
    if query[Q_GOAL] < 0:
        nodes[n, FINAL] = last >= FOREVER and not no_rest[vertex]
    else:
        nodes[n, FINAL] = last >= FOREVER and (vertex == query[Q_GOAL] or t >= query[Q_WINDOW])
    counters[GENERATED] += 1
    _push(n, memory, counters)


@kernel
def _longest_turn(edge: int, query: IntArray, lanes: Lanes) -> int:
    """Steps after which an AGV that came over an edge can leave over any other one."""
    into = query[Q_EDGE] if edge < 0 else edge
    return 0 if into < 0 else int(lanes.longest_turn[query[Q_LOADED], into])


@kernel
def _safe_until(rows: IntArray, count: IntArray, v: int, k: int, window: int) -> int:
    """End of the k-th safe interval of a vertex, FOREVER if only the window's end cuts it."""
    if k == count[v] or rows[v, k, START] >= window:
        return FOREVER
    return int(rows[v, k, START])


@kernel
def _after_bans(bans: IntArray, edge: int, step: int) -> int:
    """First step from ``step`` on at which the edge may be arrived by; ``bans`` is sorted by edge and step."""
    for i in range(bans.shape[0]):
        if bans[i, 0] == edge and bans[i, 1] == step:
            step += 1
    return step


@njit(cache=True)
def _trace(last: int, query: IntArray, nodes: IntArray) -> IntArray:
    """Rows vertices, arrivals and departures (of the last vertex the end of its occupation) on the way to a node."""
    n = _length(last, nodes)
    out = np.empty((3, n), dtype=np.int32)
    _write_path(last, query, nodes, out.reshape(-1))
    return out


@kernel
def _reserve(last: int, query: IntArray, nodes: IntArray, reserved: Reserved) -> int:
    """Keep and reserve the path to a node; step of arrival, or CROWDED."""
    words, place = reserved.words, reserved.used[WORDS]
    n = _length(last, nodes)
    words[place], words[place + 1] = query[Q_AGV], n
    _write_path(last, query, nodes, words[place + HEAD : place + HEAD + EACH * n])
    if keep(place, reserved, bool(query[Q_FOLLOWING])):
        return int(words[place + HEAD + 2 * n - 1])
    for k in range(place + HEAD, place + HEAD + n):
        drop(reserved.rows, reserved.counts, words[k], query[Q_AGV])
    return CROWDED


@kernel
def _length(last: int, nodes: IntArray) -> int:
    """Number of vertices on the way to a node."""
    n = 0
    while last >= 0:
        n += 1
        last = nodes[last, PARENT]
    return n


@kernel
def _write_path(last: int, query: IntArray, nodes: IntArray, words: IntArray) -> None:
    """The vertices, arrivals and departures on the way to a node, as a table keeps them."""
    n = len(words) // EACH
    leave = query[Q_WINDOW]
    if leave < FOREVER:
        dwell = query[Q_DWELL] if nodes[last, VERTEX] == query[Q_GOAL] else 0
        leave = max(leave, nodes[last, T] + dwell)
    for k in range(n - 1, -1, -1):
        words[k] = nodes[last, VERTEX]
        words[n + k] = nodes[last, T] if k > 0 else 0
        words[2 * n + k] = leave
        leave = nodes[last, LEAVE]
        last = nodes[last, PARENT]


@kernel
def _key(f: int, exact: bool, t: int) -> int:
    """Order of OPEN in one number: smaller f, then those with an exact distance, then larger g."""
    return (f << F_FROM) + ((0 if exact else 1) << T_BITS) + 2 * FOREVER - t


@kernel
def _before(a: int, b: int, keys: NDArray[np.int64]) -> bool:
    """Order of OPEN: by key, then the older node."""
    return bool(keys[a] < keys[b] or (keys[a] == keys[b] and a < b))


@kernel
def _push(n: int, memory: _Memory, counters: NDArray[np.int64]) -> None:
    OPEN, keys = memory.open, memory.keys
    i = memory.meta[SIZE]
    memory.meta[SIZE] += 1
    counters[HEAP_MOVES] += 1
    while i > 0:
        up = (i - 1) >> 1
        if not _before(n, OPEN[up], keys):
            break
        OPEN[i] = OPEN[up]
        i = up
        counters[HEAP_MOVES] += 1
    OPEN[i] = n


@kernel
def _pop(memory: _Memory, counters: NDArray[np.int64]) -> None:
    OPEN, keys = memory.open, memory.keys
    memory.meta[SIZE] -= 1
    size = memory.meta[SIZE]
    n = OPEN[size]
    i = 0
    while 2 * i + 1 < size:
        down = 2 * i + 1
        if down + 1 < size and _before(OPEN[down + 1], OPEN[down], keys):
            down += 1
        if not _before(OPEN[down], n, keys):
            break
        OPEN[i] = OPEN[down]
        i = down
        counters[HEAP_MOVES] += 1
    OPEN[i] = n
    counters[HEAP_MOVES] += 1
