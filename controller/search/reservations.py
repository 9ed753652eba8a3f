"""Who owns which vertex when: the reservation table of cooperative A* (Silver 2005), as intervals (SIPP, 2011).

Each vertex has a row of disjoint occupied intervals ``[start, end)``, sorted by start. What is between them are the
safe intervals of Phillips and Likhachev (2011).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate, chain

import numpy as np

from controller.kernel import kernel
from controller.types import Path
from sumo_nets.graph import IntArray

#: Columns of ``ReservationTable.rows``.
START, END, AGENT, NEXT = 0, 1, 2, 3


class ReservationTable:
    """Occupied intervals per vertex, made once per garage and reused between planning calls.

    Overlapping reservations are allowed: what is already taken stays with its owner and only the gaps are added.

    Attributes:
        following: see ``Motion``; decides from when on a path owns a vertex.
        rows: shape (n, K, 4), int32: start, end, agent and the vertex it goes on to at the end (or -1).
        count: shape (n,), number of intervals of each vertex.
    """

    def __init__(self, n: int, following: bool, capacity: int = 8) -> None:
        self.following = following
        self.rows: IntArray = np.zeros((n, capacity, 4), dtype=np.int32)
        self.count: IntArray = np.zeros(n, dtype=np.int32)
        self._touched: dict[int, list[IntArray]] = {}

    def reset(self, paths: Sequence[Path] = ()) -> None:
        """Take back everything, then reserve these paths; quicker than one by one."""
        self.count[:] = 0
        self._touched.clear()
        first = list(accumulate((len(path.vertices) for path in paths), initial=0))
        vertices = _flat((path.vertices for path in paths), first[-1])
        arrive = _flat((path.arrive for path in paths), first[-1])
        leave = _flat(((*path.depart, path.until) for path in paths), first[-1])
        for path, a, b in zip(paths, first, first[1:], strict=False):
            self._note(path.agv, vertices[a:b])
        agvs = np.array([path.agv for path in paths], dtype=np.int32)
        self._reserve(np.array(first, dtype=np.int32), vertices, np.stack((arrive, leave)), agvs)

    def add(self, path: Path) -> None:
        """Reserve all vertices of a path for its agent."""
        vertices = np.array(path.vertices, dtype=np.int32)
        self._note(path.agv, vertices)
        times = np.array((path.arrive, (*path.depart, path.until)), dtype=np.int32)
        first, agvs = (np.array(part, dtype=np.int32) for part in ((0, len(vertices)), (path.agv,)))
        self._reserve(first, vertices, times, agvs)

    def hold(self, vertex: int, start: int, end: int, agv: int) -> None:
        """Reserve one vertex for the steps ``start`` to ``end`` (exclusive)."""
        self._note(agv, np.array([vertex], dtype=np.int32))
        while not fill(self.rows, self.count, vertex, start, end, agv, -1):
            self.grow()

    def remove(self, agv: int) -> None:
        """Take back all reservations of an agent; nothing happens if it has none."""
        for vertices in self._touched.pop(agv, ()):
            _remove(self.rows, self.count, vertices, agv)

    def owner(self, vertex: int, step: int) -> int:
        """Agent that owns a vertex at a step, -1 if it is free."""
        for start, end, agv in self.intervals(vertex):
            if start <= step < end:
                return agv
        return -1

    def intervals(self, vertex: int) -> Iterator[tuple[int, int, int]]:
        """The (start, end, agent) of a vertex, in order of time."""
        for row in self.rows[vertex, : self.count[vertex]].tolist():
            yield row[START], row[END], row[AGENT]

    def _reserve(self, first: IntArray, vertices: IntArray, times: IntArray, agvs: IntArray) -> None:
        done = 0
        while True:
            done = _add(self.rows, self.count, first, vertices, times, agvs, self.following, done)
            if done == len(vertices):
                return
            self.grow()

    def _note(self, agv: int, vertices: IntArray) -> None:
        self._touched.setdefault(agv, []).append(vertices)

    def grow(self) -> None:
        """Double the room for intervals."""
        self.rows = np.concatenate((self.rows, np.zeros_like(self.rows)), axis=1)


def _flat(parts: Iterable[Iterable[int]], length: int) -> IntArray:
    return np.fromiter(chain.from_iterable(parts), dtype=np.int32, count=length)


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
def _add(
    rows: IntArray, count: IntArray, first: IntArray, vertices: IntArray, times: IntArray, agvs: IntArray,
    following: bool, done: int,
) -> int:  # fmt: skip
    """Add the occupations of several paths from entry ``done`` on; the entry up to which there was room.

    Args:
        rows, count: the table.
        first: where each path begins among the entries, and their number.
        vertices: of all entries, path after path.
        times: rows arrival and departure; for the end of a path, until when it stays.
        agvs: whose paths.
        following: see ``Motion``.
        done: entries that have been added.
    """
    for i in range(len(agvs)):
        for k in range(max(first[i], done), first[i + 1]):
            start = 0 if k == first[i] else (times[0, k] if following else times[1, k - 1])
            last = k == first[i + 1] - 1
            end = times[1, k] if last else times[0, k + 1]
            if not fill(rows, count, vertices[k], start, end, agvs[i], -1 if last else vertices[k + 1]):
                return k
    return len(vertices)


@kernel
def _remove(rows: IntArray, count: IntArray, vertices: IntArray, agv: int) -> None:
    for v in vertices:
        drop(rows, count, v, agv)


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
