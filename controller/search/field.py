"""The search memory of one goal's distances, and how a whole one follows changes of what is blocked.

See ``distances`` for what a state is. A whole field is repaired instead of searched anew (Ramalingam and Reps 1996):
the states that have lost every tight way on are found in order of their distance, and only these, and the states that
a freed vertex brings nearer, get new distances.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.space import EXPANDED, GENERATED, HEAP_MOVES, VALID, Lanes
from controller.types import NEVER
from sumo_nets.graph import FloatArray, IntArray

#: Columns of ``Field.states``: g + 1 (0: not seen yet), f, place in OPEN + 1 (-1: closed), and OPEN itself.
G, F, PLACE, OPEN = 0, 1, 2, 3
#: Places of ``Field.meta``.
SIZE, GOAL, LOADED, AIM, READ = 0, 1, 2, 3, 4


class Field(NamedTuple):
    """The search memory of one goal.

    Attributes:
        states: shape (m, 4), int32; zeroed memory that is not touched costs nothing.
        meta: number of states in OPEN, the goal, 1 if loaded, the vertex it is aimed at, and, as long as all that is
            closed has been read from a table, the steps from there + 1 (else 0).
        rates: steps per metre by Manhattan and by Euclidean distance, shape (2,); 0 for a search without an aim.
        ahead: at least so many steps from the vertex it is aimed at over each edge, shape (m,); (0,) if no landmark.
    """

    states: IntArray
    meta: IntArray
    rates: FloatArray
    ahead: IntArray


@kernel
def may_enter(v: int, field: Field, blocked: NDArray[np.uint8]) -> bool:
    """Whether ways to the goal may lead through a vertex."""
    return not blocked[v] or v == field.meta[GOAL]


@njit(cache=True)
def repair(
    changed: IntArray, field: Field, lanes: Lanes, blocked: NDArray[np.uint8], counters: NDArray[np.int64]
) -> None:
    """Bring a whole field up to date.

    Args:
        changed: the vertices that have been blocked or freed since it was right.
        field: a field searched to its end; its distances are put right.
        lanes: the garage.
        blocked: shape (n,), what is blocked now.
        counters: search work is added.
    """
    states = field.states
    doubtful = [(np.int32(0), np.int32(0)) for _ in range(0)]
    for w in changed:
        if not may_enter(w, field, blocked):
            for i in range(lanes.first_in[w], lanes.first_in[w + 1]):
                _doubt(lanes.in_edges[i], doubtful, field, lanes, counters)
    lost = [0 for _ in range(0)]
    while doubtful:
        g, e = heapq.heappop(doubtful)
        counters[HEAP_MOVES] += 1
        counters[EXPANDED] += 1
        if states[e, G] == g and _least_way_on(int(e), field, lanes, blocked) != g:
            _doubt(e, doubtful, field, lanes, counters)
            states[e, G] = 0
            states[e, PLACE] = 0
            lost.append(int(e))
    better = [(np.int32(0), np.int32(0)) for _ in range(0)]
    for k in lost:
        _improve(k, _least_way_on(k, field, lanes, blocked), better, field, counters)
    for w in changed:
        if may_enter(w, field, blocked):
            for i in range(lanes.first_in[w], lanes.first_in[w + 1]):
                _improve_before(lanes.in_edges[i], better, field, lanes, counters)
    while better:
        g, e = heapq.heappop(better)
        counters[HEAP_MOVES] += 1
        counters[EXPANDED] += 1
        if states[e, G] == g:
            counters[VALID] += 1
            if may_enter(lanes.head[e], field, blocked):
                _improve_before(e, better, field, lanes, counters)


@njit(cache=True)
def _doubt(out, doubtful, field, lanes, counters):  # type: ignore[no-untyped-def]
    """Put the states whose distance may be that over the edge ``out`` on the heap."""
    states, v = field.states, lanes.tail[out]
    if states[out, G] == 0:
        return
    for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
        e = lanes.in_edges[i]
        if states[e, G] > 0 and states[e, G] == _over(e, out, field, lanes):
            counters[HEAP_MOVES] += 1
            heapq.heappush(doubtful, (states[e, G], np.int32(e)))


@njit(cache=True)
def _improve_before(out, better, field, lanes, counters):  # type: ignore[no-untyped-def]
    """Offer the way over the edge ``out`` to the states before it."""
    v = lanes.tail[out]
    if field.states[out, G] > 0:
        for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
            e = lanes.in_edges[i]
            _improve(e, _over(e, out, field, lanes), better, field, counters)


@njit(cache=True)
def _improve(e, g, better, field, counters):  # type: ignore[no-untyped-def]
    """Give a state a distance + 1 if that is less than it has, and put it on the heap."""
    if 0 < g < NEVER and (field.states[e, G] == 0 or g < field.states[e, G]):
        field.states[e, G] = g
        field.states[e, PLACE] = -1
        counters[GENERATED] += 1
        counters[HEAP_MOVES] += 1
        heapq.heappush(better, (np.int32(g), np.int32(e)))


@kernel
def _over(e: int, out: int, field: Field, lanes: Lanes) -> int:
    """The distance + 1 of a state by way of an edge that leaves its head; ``NEVER`` or more if no AGV can turn so."""
    v, loaded = lanes.tail[out], field.meta[LOADED]
    turn = lanes.turn_steps[loaded, lanes.first_transition[e] + out - lanes.first_out[v]]
    return int(field.states[out, G] + lanes.edge_steps[loaded, out] + turn)


@kernel
def _least_way_on(e: int, field: Field, lanes: Lanes, blocked: NDArray[np.uint8]) -> int:
    """The distance + 1 of a state by the distances of the edges that leave its head; 0 if there is no way."""
    v = lanes.head[e]
    if v == field.meta[GOAL]:
        return 1
    least = NEVER
    for out in range(lanes.first_out[v], lanes.first_out[v + 1]):
        if field.states[out, G] > 0 and may_enter(lanes.head[out], field, blocked):
            least = min(least, _over(e, out, field, lanes))
    return least if least < NEVER else 0
