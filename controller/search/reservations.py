"""Who owns which vertex when: the reservation table of cooperative A* (Silver 2005), as intervals (SIPP, 2011).

Each vertex has a row of disjoint occupied intervals ``[start, end)``, sorted by start. What is between them are the
safe intervals of Phillips and Likhachev (2011).
"""

from __future__ import annotations

from collections.abc import Iterator

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

    def add(self, path: Path) -> None:
        """Reserve all vertices of a path for its agent."""
        steps = (path.arrive, (*path.depart, path.until))
        vertices = np.array(path.vertices, dtype=np.int32)
        self._note(path.agv, vertices)
        times = np.array(steps, dtype=np.int32)
        done = 0
        while True:
            done = _add_path(self.rows, self.count, vertices, times, path.agv, self.following, done)
            if done == len(vertices):
                return
            self.grow()

    def hold(self, vertex: int, start: int, end: int, agv: int) -> None:
        """Reserve one vertex for the steps ``start`` to ``end`` (exclusive)."""
        self._note(agv, np.array([vertex], dtype=np.int32))
        while not fill(self.rows, self.count, vertex, start, end, agv, -1):
            self.grow()

    def remove(self, agv: int) -> None:
        """Take back all reservations of an agent; nothing happens if it has none."""
        for vertices in self._touched.pop(agv, ()):
            _remove(self.rows, self.count, vertices, agv)

    def clear(self) -> None:
        """Take back everything, at a cost proportional to what is reserved."""
        for parts in self._touched.values():
            for vertices in parts:
                self.count[vertices] = 0
        self._touched.clear()

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

    def _note(self, agv: int, vertices: IntArray) -> None:
        self._touched.setdefault(agv, []).append(vertices)

    def grow(self) -> None:
        """Double the room for intervals."""
        self.rows = np.concatenate((self.rows, np.zeros_like(self.rows)), axis=1)


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
def _add_path(
    rows: IntArray, count: IntArray, vertices: IntArray, times: IntArray, agv: int, following: bool, done: int
) -> int:
    """Add a path's occupations from vertex number ``done`` on; the number up to which they found room."""
    last = len(vertices) - 1
    for i in range(done, last + 1):
        start = 0 if i == 0 else (times[0, i] if following else times[1, i - 1])
        end = times[1, i] if i == last else times[0, i + 1]
        if not fill(rows, count, vertices[i], start, end, agv, -1 if i == last else vertices[i + 1]):
            return i
    return last + 1


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
