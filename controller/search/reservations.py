"""Who owns which vertex when: the reservation table of cooperative A* (Silver 2005), as intervals (SIPP, 2011).

Each vertex has a row of disjoint occupied intervals ``[start, end)``, sorted by start. What is between them are the
safe intervals of Phillips and Likhachev (2011). The table keeps the paths it was made from, as plain numbers one after
the other, so that kernels can take them back, look at them and reserve them again.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from controller.kernel import kernel
from controller.types import FOREVER, NO_AGV, AgvNumber, Path
from sumo_nets.graph import IntArray
from sumo_nets.numbering import Vertex

#: Columns of ``Reserved.rows``.
START, END, AGENT, NEXT = 0, 1, 2, 3
#: Columns of ``Reserved.spans``.
OWNER, PLACE = 0, 1
#: Places of ``Reserved.used``.
WORDS, SPANS = 0, 1
#: Numbers before the vertices of a path, and for each vertex.
HEAD, EACH = 2, 3


class Reserved(NamedTuple):
    """What kernels read and write of a table.

    A path of n vertices is kept as its agent, n, the vertices, the arrivals, and the departures with the end of the
    last vertex's occupation: ``HEAD + EACH * n`` numbers.

    Attributes:
        rows: shape (vertices, K, 4), int32: start, end, agent and the vertex it goes on to at the end (or -1).
        counts: shape (vertices,), number of intervals of each vertex.
        words: shape (W,), the paths.
        spans: shape (S, 2), agent of each path and where the path begins in ``words``; in no order.
        used: numbers used of ``words``, and paths.
    """

    rows: IntArray
    counts: IntArray
    words: IntArray
    spans: IntArray
    used: IntArray


class ReservationTable:
    """Occupied intervals per vertex, made once per garage and reused between planning calls.

    Overlapping reservations are allowed: what is already taken stays with its owner and only the gaps are added.

    Attributes:
        following: see ``Motion``; decides from when on a path owns a vertex.
        reserved: the arrays; others whenever room has run out.
    """

    def __init__(self, n: int, following: bool, capacity: int = 8) -> None:
        self.following = following
        self.reserved = Reserved(
            np.zeros((n, capacity, 4), dtype=np.int32),
            np.zeros(n, dtype=np.int32),
            np.zeros(4096, dtype=np.int32),
            np.zeros((64, 2), dtype=np.int32),
            np.zeros(2, dtype=np.int32),
        )

    def reset(self, paths: Sequence[Path] = ()) -> None:
        """Take back everything, then reserve these paths; quicker than one by one."""
        self.reserved.counts[:] = 0
        self.reserved.used[:] = 0
        self.put(_packed(paths), len(paths))

    def add(self, path: Path) -> None:
        """Reserve all vertices of a path for its agent."""
        self.put(_packed((path,)), 1)

    def hold(self, vertex: Vertex, start: int, end: int, agv: AgvNumber) -> None:
        """Reserve one vertex for the steps ``start`` to ``end`` (exclusive)."""
        self.put(np.array((agv, 1, vertex, start, end), dtype=np.int32), 1)

    def admits(self, path: Path) -> bool:
        """Whether a path of an agent without reservations keeps clear of all others."""
        return bool(_admits(_packed((path,)), self.reserved, self.following))

    def put(self, words: IntArray, paths: int) -> None:
        """Reserve ``n`` paths, given as the table keeps them, see ``Reserved``."""
        self.make_room(len(words), paths)
        done = 0
        while True:
            done = _put(words, done, self.reserved, self.following)
            if done == len(words):
                return
            self.grow()

    def take(self, agvs: Sequence[AgvNumber]) -> IntArray:
        """Take back all reservations of some agents; their paths, for :meth:`put`."""
        words = np.empty(self.reserved.used[WORDS], dtype=np.int32)
        return words[: _take(np.array(agvs, dtype=np.int32), self.reserved, words)]

    def put_back(self, words: IntArray, paths: int) -> None:
        """Reserve so many paths, see :meth:`put`, instead of what their agents have."""
        _remove_owners(words, self.reserved)
        self.put(words, paths)

    def remove(self, agv: AgvNumber) -> None:
        """Take back all reservations of an agent; nothing happens if it has none."""
        _remove(agv, self.reserved)

    def path(self, agv: AgvNumber) -> Path:
        """The path reserved for an agent that has one."""
        words, span = self.reserved.words, span_of(agv, 0, self.reserved)
        if span < 0:
            raise KeyError(agv)
        place = int(self.reserved.spans[span, PLACE])
        n = int(words[place + 1])
        numbers = words[place + HEAD : place + HEAD + EACH * n].tolist()
        return Path(agv, tuple(numbers[:n]), tuple(numbers[n : 2 * n]), tuple(numbers[2 * n : -1]), numbers[-1])

    def rests(self, but: AgvNumber) -> IntArray:
        """Vertices where an agent rests for ever; one agent does not count."""
        vertices = np.empty(self.reserved.used[SPANS], dtype=np.int32)
        return vertices[: _rests(but, self.reserved, vertices)]

    def owner(self, vertex: Vertex, step: int) -> AgvNumber:
        """Agent that owns a vertex at a step, -1 if it is free."""
        for start, end, agv in self.intervals(vertex):
            if start <= step < end:
                return agv
        return NO_AGV

    def intervals(self, vertex: Vertex) -> Iterator[tuple[int, int, AgvNumber]]:
        """The (start, end, agent) of a vertex, in order of time."""
        for row in self.reserved.rows[vertex, : self.reserved.counts[vertex]].tolist():
            yield row[START], row[END], AgvNumber(row[AGENT])

    def make_room(self, words: int, paths: int) -> None:
        """See to it that so many more numbers and paths can be kept."""
        r = self.reserved
        if r.used[WORDS] + words > len(r.words):
            r = r._replace(words=np.concatenate((r.words, np.zeros(len(r.words) + words, dtype=np.int32))))
        if r.used[SPANS] + paths > len(r.spans):
            r = r._replace(spans=np.concatenate((r.spans, np.zeros((len(r.spans) + paths, 2), dtype=np.int32))))
        self.reserved = r

    def grow(self) -> None:
        """Double the room for intervals."""
        rows = self.reserved.rows
        self.reserved = self.reserved._replace(rows=np.concatenate((rows, np.zeros_like(rows)), axis=1))


def _packed(paths: Iterable[Path]) -> IntArray:
    """Paths as a table keeps them."""
    words: list[int] = []
    for path in paths:
        words += (path.agv, len(path.vertices))
        words += path.vertices
        words += path.arrive
        words += path.depart
        words.append(path.until)
    return np.frombuffer(bytearray(struct.pack(f"{len(words)}i", *words)), dtype=np.int32)


@kernel
def fill(rows: IntArray, count: IntArray, v: int, start: int, end: int, agv: int, after: int) -> bool:
    """Add the parts of ``[start, end)`` that are still free; False if the row may not have room for them."""
    k = 0
    while start < end:
        c = count[v]
        while k < c and rows[v, k, END] <= start:
            k += 1
        stop = end if k == c else min(end, rows[v, k, START])
        if start < stop:
            if c == rows.shape[1]:
                return False
            for i in range(c, k, -1):
                _copy(rows, v, i - 1, i)
            rows[v, k, START] = start
            rows[v, k, END] = stop
            rows[v, k, AGENT] = agv
            rows[v, k, NEXT] = after if stop == end else -1
            count[v] = c + 1
            k += 1
        if k == count[v] or stop == end:
            return True
        start = max(stop, rows[v, k, END])
    return True


@kernel
def _put(words: IntArray, done: int, reserved: Reserved, following: bool) -> int:
    """Keep and reserve packed paths from number ``done`` on; the number up to which there was room for intervals."""
    while done < len(words):
        size = HEAD + EACH * words[done + 1]
        place = reserved.used[WORDS]
        for k in range(size):
            reserved.words[place + k] = words[done + k]
        if not keep(place, reserved, following):
            return done
        done += size
    return done


@kernel
def keep(place: int, reserved: Reserved, following: bool) -> bool:
    """Reserve the path that begins at a place behind all others in ``words``; False if some row has no room.

    To be repeated then with more room: what has been reserved already is left as it is.
    """
    words, used = reserved.words, reserved.used
    agv, n = words[place], words[place + 1]
    way = place + HEAD
    arrive, leave = way + n, way + 2 * n
    for k in range(n):
        start = words[arrive + k] if k == 0 or following else words[leave + k - 1]
        last = k == n - 1
        end = words[leave + k] if last else words[arrive + k + 1]
        after = -1 if last else words[way + k + 1]
        if not fill(reserved.rows, reserved.counts, words[way + k], start, end, agv, after):
            return False
    reserved.spans[used[SPANS], OWNER] = agv
    reserved.spans[used[SPANS], PLACE] = place
    used[SPANS] += 1
    used[WORDS] = place + HEAD + EACH * n
    return True


@kernel
def _admits(words: IntArray, reserved: Reserved, following: bool) -> bool:
    """Whether nothing of a packed path is reserved by others, and no move of it is a swap."""
    rows, counts = reserved.rows, reserved.counts
    n = words[1]
    arrive, leave = HEAD + n, HEAD + 2 * n
    for k in range(n):
        v = words[HEAD + k]
        start = words[arrive + k] if k == 0 or following else words[leave + k - 1]
        end = words[leave + k] if k == n - 1 else words[arrive + k + 1]
        for i in range(counts[v]):
            if rows[v, i, START] < end and rows[v, i, END] > start:
                return False
        if k > 0 and following and swaps(rows, counts, words[HEAD + k - 1], v, start):
            return False
    return True


@kernel
def swaps(rows: IntArray, count: IntArray, v: int, w: int, step: int) -> bool:
    """Whether the agent that leaves ``w`` at this step enters ``v``."""
    found = False
    for k in range(count[w]):
        found |= rows[w, k, END] == step and rows[w, k, NEXT] == v
    return found


@kernel
def _take(agvs: IntArray, reserved: Reserved, out: IntArray) -> int:
    """Take back the paths of some agents and copy them; how many numbers these are."""
    size = 0
    for agv in agvs:
        for s in range(reserved.used[SPANS]):
            if reserved.spans[s, OWNER] == agv:
                place = reserved.spans[s, PLACE]
                for k in range(HEAD + EACH * reserved.words[place + 1]):
                    out[size] = reserved.words[place + k]
                    size += 1
        _remove(agv, reserved)
    return size


@kernel
def _remove_owners(words: IntArray, reserved: Reserved) -> None:
    """Take back all paths of the agents of packed paths."""
    place = 0
    while place < len(words):
        _remove(words[place], reserved)
        place += HEAD + EACH * words[place + 1]


@kernel
def _remove(agv: int, reserved: Reserved) -> None:
    """Take back all paths of an agent; those at the end of ``words`` leave their room to others."""
    words, spans, used = reserved.words, reserved.spans, reserved.used
    for s in range(used[SPANS] - 1, -1, -1):
        if spans[s, OWNER] != agv:
            continue
        place = spans[s, PLACE]
        n = words[place + 1]
        for k in range(place + HEAD, place + HEAD + n):
            drop(reserved.rows, reserved.counts, words[k], agv)
        if place + HEAD + EACH * n == used[WORDS]:
            used[WORDS] = place
        used[SPANS] -= 1
        spans[s, OWNER] = spans[used[SPANS], OWNER]
        spans[s, PLACE] = spans[used[SPANS], PLACE]


@kernel
def span_of(agv: int, first: int, reserved: Reserved) -> int:
    """Where a path of an agent is among ``spans``, looked for from ``first`` on, then from the start; -1 if nowhere."""
    n = reserved.used[SPANS]
    for k in range(n):
        span = (first + k) % n
        if reserved.spans[span, OWNER] == agv:
            return int(span)
    return -1


@kernel
def _rests(but: int, reserved: Reserved, vertices: IntArray) -> int:
    """Where paths end that last for ever, but for those of one agent; how many these are."""
    words, found = reserved.words, 0
    for s in range(reserved.used[SPANS]):
        place = reserved.spans[s, PLACE]
        n = words[place + 1]
        if reserved.spans[s, OWNER] != but and words[place + HEAD + EACH * n - 1] >= FOREVER:
            vertices[found] = words[place + HEAD + n - 1]
            found += 1
    return found


@kernel
def drop(rows: IntArray, count: IntArray, v: int, agv: int) -> None:
    """Take all intervals of an agent from a vertex."""
    kept = 0
    for k in range(count[v]):
        if rows[v, k, AGENT] != agv:
            if kept < k:
                _copy(rows, v, k, kept)
            kept += 1
    count[v] = kept


@kernel
def _copy(rows: IntArray, v: int, source: int, target: int) -> None:
    """Copy an interval over another one; to assign a whole row would make an array."""
    for column in range(rows.shape[2]):
        rows[v, target, column] = rows[v, source, column]
