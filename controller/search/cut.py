"""Closed places that cut an agent off from its goal, found by a flood from the goal backwards."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.search.space import EXPANDED, Lanes
from sumo_nets.graph import IntArray


@njit(cache=True)
def closed_around(
    start: int, goal: int, closed: NDArray[np.uint8], lanes: Lanes, counters: NDArray[np.int64]
) -> IntArray:
    """The closed vertices around all places from which the goal can be reached; empty if the start is one of these.

    Args:
        start, goal: vertices; the start may be closed, a closed goal is all that is returned.
        closed: shape (n,), 1 where no AGV may drive.
        lanes: the garage.
        counters: gets an expansion for each of these places.

    Returns:
        As long as all of these are closed there is no way to the goal.
    """
    around = np.empty(len(closed), dtype=np.int32)
    seen = np.zeros(len(closed), dtype=np.bool_)
    stack = np.empty(len(closed), dtype=np.int32)
    if closed[goal]:
        around[0] = goal
        return around[:1]
    stack[0], size, found = goal, 1, 0
    seen[goal] = True
    while size:
        size -= 1
        v = stack[size]
        counters[EXPANDED] += 1
        for i in range(lanes.first_in[v], lanes.first_in[v + 1]):
            u = lanes.tail[lanes.in_edges[i]]
            if u == start:
                return around[:0]
            if seen[u]:
                continue
            seen[u] = True
            if closed[u]:
                around[found] = u
                found += 1
            else:
                stack[size] = u
                size += 1
    return around[:found]
