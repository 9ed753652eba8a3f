"""Orders get a clock again: when each AGV will be where, if nothing else delays it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.executor import Executor
from controller.kernel import kernel
from controller.types import FOREVER, AgvNumber, Path
from controller.visits import FloorTables, edge_between, floor_tables, longs, starts
from sumo_nets.numbering import numbered, numbers

Longs = NDArray[np.int64]


def retime(executor: Executor, step: int, leaving: Mapping[AgvNumber, int] | None = None) -> dict[AgvNumber, Path]:
    """When each AGV will be where if the accepted orders are carried out without delay from now on.

    Args:
        executor: with its accepted orders.
        step: now; the result counts from it.
        leaving: AGVs that will have a further plan when theirs has come to its end, and from which step on they may
            be expected to leave its last vertex.

    Returns:
        A path for every AGV, from the end of its authority along its pending vertices. An AGV whose way is closed by
        one that has no plan to leave is cut there.
    """
    agvs, n = executor.agvs, len(executor.graph.names)
    clock = np.array([executor.ready_step(agv, step) for agv in numbers(agvs)], dtype=np.int64)
    free_at = np.zeros(n, dtype=np.int64)
    for agv, a in numbered(agvs):
        if len(a.trail) > 1:
            free_at[list(a.trail)[:-1]] = clock[agv]
    here = np.array([a.last for a in agvs], dtype=np.int64)
    free_at[here] = FOREVER
    now = np.array([(a.in_edge, a.turned_to, a.leaves_loaded) for a in agvs], dtype=np.int64).reshape(-1, 3)
    first = starts(len(a.pending) for a in agvs)
    way = longs(a.pending for a in agvs)
    queues = starts(len(queue) for queue in executor.order.values())
    turn = np.zeros((n, 2), dtype=np.int64)  # of each vertex's queue: next one in turn, and end
    turn[list(executor.order)] = np.column_stack((queues[:-1], queues[1:]))
    queue = longs(executor.order.values())
    rest_until = np.array([(leaving or {}).get(agv, FOREVER) for agv in numbers(agvs)], dtype=np.int64)
    arrive, depart, done = _drive(
        way, first, here, now, clock, rest_until, free_at, turn, queue, executor.motion.following,
        floor_tables(executor.graph, executor.motion),
    )  # fmt: skip
    v, t, d = way.tolist(), arrive.tolist(), depart.tolist()
    return {
        agv: Path(agv, (a.last, *v[i:j]), (0, *t[i:j]), tuple(d[i:j]))
        for (agv, a), i, j in zip(numbered(agvs), first[:-1].tolist(), (first[:-1] + done).tolist(), strict=True)
    }


@kernel
def _turn_ring(
    i: int, stack: Longs, size: int, way: Longs, first: Longs, done: Longs, here: Longs, now: Longs, clock: Longs,
    occupant: Longs, turn: Longs, queue: Longs, arrive: Longs, depart: Longs, floor: FloorTables,
) -> int:  # fmt: skip
    """Move a ring of three or more on at once if ``i`` closes one; its members go on the stack, whose size is returned.

    Each enters the vertex of the next one, as the first in its order. All arrive in one step.
    """
    members, latest, j = 0, 0, i
    while True:
        if first[j] + done[j] == first[j + 1]:
            return size
        w = way[first[j] + done[j]]
        if turn[w, 0] == turn[w, 1] or queue[turn[w, 0]] != j or occupant[w] < 0 or members > len(here):
            return size
        latest = max(latest, _earliest(j, w, done[j] == 0, here, now, clock, floor))
        members += 1
        j = occupant[w]
        if j == i:
            break
    if members < 3:
        return size
    for _ in range(members):
        k = first[j] + done[j]
        w = way[k]
        edge = edge_between(here[j], w, floor)
        ahead = occupant[w]
        arrive[k], depart[k] = latest, latest - floor.edge_steps[now[j, 2], edge]
        clock[j], now[j, 0] = latest, edge
        turn[w, 0] += 1
        done[j] += 1
        stack[size] = j
        size += 1
        j = ahead
    for k in range(size - members, size):
        j = stack[k]
        here[j] = way[first[j] + done[j] - 1]
        occupant[here[j]] = j
    return size


@kernel
def _earliest(j: int, w: int, first_move: bool, here: Longs, now: Longs, clock: Longs, floor: FloorTables) -> int:
    """First step at which an AGV can be on the next vertex of its way, if that is free."""
    in_edge, turned_to, loaded = now[j, 0], now[j, 1], now[j, 2]
    edge = edge_between(here[j], w, floor)
    leave = clock[j]
    if in_edge >= 0 and not (first_move and turned_to == w):
        leave += floor.turn_steps[loaded, floor.first_transition[in_edge] + edge - floor.first_out[here[j]]]
    return int(leave + floor.edge_steps[loaded, edge])


@njit(cache=True)
def _drive(
    way: Longs, first: Longs, here: Longs, now: Longs, clock: Longs, rest_until: Longs, free_at: Longs, turn: Longs,
    queue: Longs, following: bool, floor: FloorTables,
) -> tuple[Longs, Longs, Longs]:  # fmt: skip
    """Drive every AGV as far as the orders allow: arrivals and departures on ``way``, and how many of each."""
    arrive, depart = np.zeros(len(way), dtype=np.int64), np.zeros(len(way), dtype=np.int64)
    done = np.zeros(len(here), dtype=np.int64)
    occupant = np.full(len(free_at), -1, dtype=np.int64)
    occupant[here] = np.arange(len(here))
    stack = np.empty(2 * len(here) + len(way), dtype=np.int64)
    stack[: len(here)] = np.arange(len(here))
    size = len(here)
    while size > 0:
        size -= 1
        i = stack[size]
        while first[i] + done[i] < first[i + 1]:
            k = first[i] + done[i]
            u, w = here[i], way[k]
            mine = turn[w, 0] < turn[w, 1] and queue[turn[w, 0]] == i
            if not mine:
                break
            if free_at[w] == FOREVER and occupant[w] != i:
                if following:
                    size = _turn_ring(i, stack, size, way, first, done, here, now, clock, occupant, turn, queue,
                                      arrive, depart, floor)  # fmt: skip
                break
            free = free_at[w] if occupant[w] != i else 0
            edge = edge_between(u, w, floor)
            drive = floor.edge_steps[now[i, 2], edge]
            leave = _earliest(i, w, done[i] == 0, here, now, clock, floor) - drive
            leave = max(leave, free - drive if following else free)
            depart[k], arrive[k] = leave, leave + drive
            clock[i] = leave + drive
            now[i, 0] = edge
            here[i] = w
            turn[w, 0] += 1
            done[i] += 1
            free_at[w], occupant[w] = FOREVER, i
            free_at[u], occupant[u] = clock[i], -1
            if turn[u, 0] < turn[u, 1]:
                stack[size] = queue[turn[u, 0]]
                size += 1
        if first[i] + done[i] == first[i + 1] and rest_until[i] < FOREVER and occupant[here[i]] == i:
            v = here[i]
            free_at[v], occupant[v] = max(clock[i], rest_until[i]), -1
            if turn[v, 0] < turn[v, 1]:
                stack[size] = queue[turn[v, 0]]
                size += 1
    return arrive, depart, done
