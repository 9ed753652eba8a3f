"""An indexed binary heap for search kernels. Each vertex is in it at most once, and its key may change.

Keys are single integers. All arrays are changed in place. ``counters`` counts a heap move for each push, removal and
swap, and a generated state for each push.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.space import GENERATED, HEAP_MOVES
from sumo_nets.graph import IntArray

Counts = NDArray[np.int64]


class Heap(NamedTuple):
    """The queue of one search.

    Attributes:
        key: key of each vertex that is inside, shape (n,).
        place: its place in ``items``, -1 for those outside, shape (n,).
        items: the heap, shape (n,).
        size: number of vertices inside, shape (1,).
    """

    key: NDArray[np.int64]
    place: IntArray
    items: IntArray
    size: IntArray


def make_heap(n: int) -> Heap:
    """An empty heap for vertices 0 to ``n - 1``."""
    return Heap(
        np.zeros(n, dtype=np.int64),
        np.full(n, -1, dtype=np.int32),
        np.zeros(n, dtype=np.int32),
        np.zeros(1, dtype=np.int32),
    )


@kernel
def clear(heap: Heap) -> None:
    """Remove all vertices, without counting the removals."""
    for i in range(heap.size[0]):
        heap.place[heap.items[i]] = -1
    heap.size[0] = 0


@kernel
def put(v: int, key: int, heap: Heap, counters: Counts) -> None:
    """Insert a vertex, or change its key."""
    i = heap.place[v]
    heap.key[v] = key
    if i < 0:
        i = heap.size[0]
        heap.size[0] += 1
        heap.items[i] = v
        heap.place[v] = i
        counters[HEAP_MOVES] += 1
        counters[GENERATED] += 1
    _sift(i, heap, counters)


@kernel
def take(v: int, heap: Heap, counters: Counts) -> None:
    """Remove a vertex that is in the heap."""
    i = heap.place[v]
    heap.place[v] = -1
    heap.size[0] -= 1
    counters[HEAP_MOVES] += 1
    last = heap.items[heap.size[0]]
    if last != v:
        heap.items[i] = last
        heap.place[last] = i
        _sift(i, heap, counters)


@kernel
def _sift(i: int, heap: Heap, counters: Counts) -> None:
    """Move the vertex at place ``i`` up or down until the heap is in order."""
    while i > 0 and heap.key[heap.items[i]] < heap.key[heap.items[(i - 1) >> 1]]:
        _swap(i, (i - 1) >> 1, heap, counters)
        i = (i - 1) >> 1
    while 2 * i + 1 < heap.size[0]:
        down = 2 * i + 1
        if down + 1 < heap.size[0] and heap.key[heap.items[down + 1]] < heap.key[heap.items[down]]:
            down += 1
        if heap.key[heap.items[i]] <= heap.key[heap.items[down]]:
            break
        _swap(i, down, heap, counters)
        i = down


@kernel
def _swap(i: int, j: int, heap: Heap, counters: Counts) -> None:
    heap.items[i], heap.items[j] = heap.items[j], heap.items[i]
    heap.place[heap.items[i]] = i
    heap.place[heap.items[j]] = j
    counters[HEAP_MOVES] += 1
