"""Paths of several agents as arrays, for finding meetings and for loading a reservation table quickly.

The row of an agent holds its visits in order: vertex, first step, end (exclusive) and previous vertex (-1 at the
start). ``controller.types.Path`` defines when a vertex is occupied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controller.kernel import kernel
from controller.search.reservations import ReservationTable, drop, fill
from controller.types import FOREVER, Path
from sumo_nets.graph import IntArray

#: Columns of ``Group.visits``.
VERTEX, START, END, BEFORE = 0, 1, 2, 3


class Group(NamedTuple):
    """The paths of ``n`` agents.

    Attributes:
        visits: shape (n, L, 4), see the columns above.
        lengths: shape (n,), number of visits of each agent.
        meets: shape (n, n), symmetric: first step at which two agents meet, ``FOREVER`` if they don't.
    """

    visits: IntArray
    lengths: IntArray
    meets: IntArray

    def copy(self) -> Group:
        """A copy that can be changed."""
        return Group(self.visits.copy(), self.lengths.copy(), self.meets.copy())


def empty_group(n: int, length: int = 32) -> Group:
    """An empty group with room for ``n`` agents."""
    meets = np.full((n, n), FOREVER, dtype=np.int32)
    return Group(np.zeros((n, length, 4), dtype=np.int32), np.zeros(n, dtype=np.int32), meets)


def with_path(group: Group, i: int, path: Path, following: bool, window: int) -> Group:
    """Replace the path of agent ``i`` in place. If there is no room, a longer group is returned."""
    k = len(path.vertices)
    if k > group.visits.shape[1]:
        room = np.zeros((len(group.lengths), 2 * k, 4), dtype=np.int32)
        room[:, : group.visits.shape[1]] = group.visits
        group = group._replace(visits=room)
    row = group.visits[i]
    row[:k, VERTEX] = path.vertices
    row[:k, END] = (*path.arrive[1:], path.until)
    row[0, START], row[0, BEFORE] = 0, -1
    if k > 1:
        row[1:k, START] = path.arrive[1:] if following else path.depart
        row[1:k, BEFORE] = path.vertices[:-1]
    group.lengths[i] = k
    _meetings(i, group.visits, group.lengths, group.meets, following, window)
    return group


def load(table: ReservationTable, group: Group, chosen: IntArray, agvs: IntArray) -> None:
    """Reserve the paths of the chosen agents. ``unload`` with the same arguments removes them again."""
    while not _load(table.reserved.rows, table.reserved.counts, group.visits, group.lengths, chosen, agvs):
        unload(table, group, chosen, agvs)
        table.grow()


def unload(table: ReservationTable, group: Group, chosen: IntArray, agvs: IntArray) -> None:
    """Remove the reservations made by ``load``."""
    _unload(table.reserved.rows, table.reserved.counts, group.visits, group.lengths, chosen, agvs)


@kernel
def _meetings(i: int, visits: IntArray, lengths: IntArray, meets: IntArray, following: bool, window: int) -> None:
    """For each other agent, the first step below the window at which it shares a vertex or swaps with agent ``i``."""
    for j in range(visits.shape[0]):
        if j == i:
            continue
        first = FOREVER
        for a in range(lengths[i]):
            v, start, end, before = visits[i, a, 0], visits[i, a, 1], visits[i, a, 2], visits[i, a, 3]
            for b in range(lengths[j]):
                if visits[j, b, VERTEX] == v:
                    step = max(start, visits[j, b, START])
                    if step < min(end, visits[j, b, END]) and step < window:
                        first = min(first, step)
                elif following and before >= 0 and visits[j, b, VERTEX] == before and visits[j, b, BEFORE] == v:
                    first = min(first, start if visits[j, b, START] == start and start < window else FOREVER)
        meets[i, j] = first
        meets[j, i] = first


@kernel
def _load(
    rows: IntArray, table_count: IntArray, visits: IntArray, lengths: IntArray, chosen: IntArray, agvs: IntArray
) -> bool:
    """False when a row of the table has no room."""
    for i in chosen:
        for k in range(lengths[i]):
            after = visits[i, k + 1, VERTEX] if k + 1 < lengths[i] else -1
            start, end = visits[i, k, START], visits[i, k, END]
            if not fill(rows, table_count, visits[i, k, VERTEX], start, end, agvs[i], after):
                return False
    return True


@kernel
def _unload(
    rows: IntArray, table_count: IntArray, visits: IntArray, lengths: IntArray, chosen: IntArray, agvs: IntArray
) -> None:
    for i in chosen:
        for k in range(lengths[i]):
            drop(rows, table_count, visits[i, k, VERTEX], agvs[i])
