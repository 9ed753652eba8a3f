"""From timed paths to visiting orders, and back.

``visiting_order`` turns a plan into the order in which AGVs visit each vertex, and refuses plans that cannot be carried
out. ``retime`` gives orders a clock again: when each AGV will be where, if nothing else delays it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.types import FOREVER, NEVER, AgvNumber, Motion, Path
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import EdgeIndex, Vertex, numbered, numbers

if TYPE_CHECKING:
    from controller.executor import Executor

Longs = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a plan is not carried out.

    Attributes:
        kind: "form", "start", "edge", "conflict" or "swap".
        agents: the AGVs concerned.
        vertex: where.
        reason: in words.
    """

    kind: str
    agents: tuple[AgvNumber, ...]
    vertex: Vertex
    reason: str


def malformed(agv: AgvNumber, path: Path) -> str:
    """What is wrong with a path by itself, whatever the graph; "" if nothing."""
    arrive, depart = path.arrive, path.depart
    if path.agv != agv:
        return f"AGV {agv} is given the path of AGV {path.agv}"
    if not path.vertices or len(arrive) != len(path.vertices) or len(depart) != len(arrive) - 1:
        return f"AGV {agv}: {len(path.vertices)} vertices, {len(arrive)} arrivals and {len(depart)} departures"
    if arrive[0] < 0 or any(not arrive[i] <= t < arrive[i + 1] for i, t in enumerate(depart)):
        return f"AGV {agv}: its times do not run forwards"
    return ""


class _Floor(NamedTuple):
    """What the kernels read of a graph and its durations, as in ``search.space.Lanes``."""

    head: IntArray
    first_out: IntArray
    edge_steps: IntArray
    turn_steps: IntArray
    first_transition: IntArray


class _Rows(NamedTuple):
    """All visits of a plan, path after path, then of those that hold their place.

    Attributes:
        vertex: where.
        agv: whose visit.
        entered, left: it is there from when until when; the end of a path is left ``FOREVER``.
        ends: until when nobody else may come: ``Path.until`` instead of ``FOREVER``.
    """

    vertex: Longs
    agv: Longs
    entered: Longs
    left: Longs
    ends: Longs


def visiting_order(
    paths: Mapping[AgvNumber, Path],
    holding: Mapping[AgvNumber, Vertex],
    graph: Graph,
    motion: Motion,
    in_edges: Mapping[AgvNumber, EdgeIndex] | None = None,
) -> dict[Vertex, deque[AgvNumber]] | Refusal:
    """Order the visits of each vertex by the plan's times.

    Two visits of one vertex must not overlap in time: then every wait points back in time, so that the orders have no
    cycle and any delay only delays. Where following is allowed, AGVs in a ring may each enter the vertex that the next
    one leaves in one and the same step: three or more move on together, when all of them are ready. Two that would
    change places are refused.

    Args:
        paths: by AGV number.
        holding: vertex of each AGV that has no path: it stays there, and whoever is sent through waits until a later
            plan moves it away.
        graph, motion: the garage and how long moves take.
        in_edges: edge by which each AGV has come to where its path begins; not needed where it has turned already.

    Returns:
        AGV numbers by vertex in the order of their visits (without the vertices where they start), or a refusal.
    """
    first = _starts(len(path.vertices) for path in paths.values())
    vertices = _longs(path.vertices for path in paths.values())
    came = np.array([(in_edges or {}).get(agv, -1) for agv in paths], dtype=np.int64)
    k = _undrivable(vertices, first, came, _floor(graph, motion))
    if k >= 0:
        return _no_move(list(paths.values())[int(np.searchsorted(first, k, side="right")) - 1], vertices, k, graph)
    rows = _rows(paths, holding, vertices, first, motion.following)
    in_order = np.lexsort((rows.agv, rows.left, rows.entered, rows.vertex))
    vertex, agv, entered, left, ends = (column[in_order] for column in rows)
    others = (vertex[1:] == vertex[:-1]) & (agv[1:] != agv[:-1])
    meet = np.flatnonzero(others & (entered[1:] < ends[:-1]))
    if len(meet):
        k = int(meet[0])
        a, b, v = AgvNumber(int(agv[k])), AgvNumber(int(agv[k + 1])), Vertex(int(vertex[k]))
        reason = f"AGVs {a} and {b} both plan to be on {graph.names[v]} at step {entered[k + 1]}"
        return Refusal("conflict", (a, b), v, reason)
    if motion.following:
        at_once = np.flatnonzero(others & (left[:-1] == entered[1:]))
        swap = _swap(in_order[at_once], in_order[at_once + 1], rows, len(vertices))
        if swap:
            return swap
    moves = np.ones(len(vertex), dtype=bool)
    moves[np.isin(in_order, [*first[:-1], *range(len(vertices), len(rows.vertex))])] = False
    return _queues(vertex[moves], agv[moves])


def _starts(sizes: Iterable[int]) -> Longs:
    return np.cumsum([0, *sizes])


def _longs(parts: Iterable[Collection[int]]) -> Longs:
    return np.fromiter(chain.from_iterable(parts), dtype=np.int64)


def _floor(graph: Graph, motion: Motion) -> _Floor:
    arrays = (graph.head, graph.first_out, motion.edge_steps, motion.turn_steps, motion.first_transition)
    return _Floor(*(np.ascontiguousarray(array, dtype=np.int32) for array in arrays))


@kernel
def _edge(u: int, v: int, floor: _Floor) -> int:
    """The edge from one vertex to the next, -1 if there is none."""
    for e in range(floor.first_out[u], floor.first_out[u + 1]):
        if floor.head[e] == v:
            return e
    return -1


@kernel
def _undrivable(vertices: Longs, first: Longs, in_edges: Longs, floor: _Floor) -> int:
    """Number of the first vertex that has no lane from the one before, or needs a turn that no AGV makes; -1: none."""
    for p in range(len(in_edges)):
        came = in_edges[p]
        for k in range(first[p] + 1, first[p + 1]):
            u = vertices[k - 1]
            e = _edge(u, vertices[k], floor)
            if e < 0:
                return k
            if came >= 0 and floor.turn_steps[0, floor.first_transition[came] + e - floor.first_out[u]] >= NEVER:
                return k
            came = e
    return -1


def _no_move(path: Path, vertices: Longs, k: int, graph: Graph) -> Refusal:
    """Why the move to the ``k``-th vertex can't be driven."""
    u, v = Vertex(int(vertices[k - 1])), Vertex(int(vertices[k]))
    to = graph.names[v] if 0 <= v < len(graph.names) else f"vertex {v}"
    reason = f"no lane from {graph.names[u]} to {to}"
    if (u, v) in graph.edge_index:
        reason = f"no AGV can turn at {graph.names[u]}, as it comes, towards {to}"
    return Refusal("edge", (path.agv,), v, reason)


def _rows(
    paths: Mapping[AgvNumber, Path], holding: Mapping[AgvNumber, Vertex], vertices: Longs, first: Longs, following: bool
) -> _Rows:
    """The visits of a plan."""
    start, last = first[:-1], first[1:] - 1
    arrive = _longs(path.arrive for path in paths.values())
    ends = np.roll(arrive, -1)
    left = ends.copy()
    left[last] = FOREVER
    ends[last] = [path.until for path in paths.values()]
    departures = _longs((*path.depart, 0) for path in paths.values())
    entered = arrive if following else np.roll(departures, 1)
    entered[start] = 0
    agv = np.repeat(np.array(list(paths), dtype=np.int64), np.diff(first))
    nothing = np.zeros(len(holding), dtype=np.int64)
    stays = (_longs([holding.values()]), _longs([holding]), nothing, nothing, nothing)
    moving = (vertices, agv, entered, left, ends)
    return _Rows(*(np.concatenate(parts) for parts in zip(moving, stays, strict=True)))


def _swap(before: Longs, after: Longs, rows: _Rows, moving: int) -> Refusal | None:
    """Two AGVs that would change places in one step.

    Args:
        before, after: numbers of visits; the second enters in the very step in which the first leaves.
        rows: the visits.
        moving: visits from this number on are of AGVs that hold their place.
    """
    needed = np.full(moving + 1, -1, dtype=np.int64)  # whose arrival depends on this one's
    needed[before[before < moving] + 1] = after[before < moving]
    pairs = np.flatnonzero((needed >= 0) & (needed[needed] == np.arange(len(needed))))
    if not len(pairs):
        return None
    k = min((int(i) for i in pairs), key=lambda i: (rows.agv[i], i))
    a, b = AgvNumber(int(rows.agv[k])), AgvNumber(int(rows.agv[needed[k]]))
    return Refusal("swap", (a, b), Vertex(int(rows.vertex[k])), f"AGVs {a} and {b} would have to change places")


def _queues(vertex: Longs, agv: Longs) -> dict[Vertex, deque[AgvNumber]]:
    """AGVs by vertex; both sorted by vertex."""
    agvs = agv.tolist()
    starts = np.flatnonzero(np.diff(vertex, prepend=-1)).tolist()
    ends = [*starts[1:], len(agvs)][: len(starts)]
    return {v: deque(agvs[a:b]) for v, a, b in zip(vertex[starts].tolist(), starts, ends, strict=True)}


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
    first = _starts(len(a.pending) for a in agvs)
    way = _longs(a.pending for a in agvs)
    queues = _starts(len(queue) for queue in executor.order.values())
    turn = np.zeros((n, 2), dtype=np.int64)  # of each vertex's queue: next one in turn, and end
    turn[list(executor.order)] = np.column_stack((queues[:-1], queues[1:]))
    queue = _longs(executor.order.values())
    rest_until = np.array([(leaving or {}).get(agv, FOREVER) for agv in numbers(agvs)], dtype=np.int64)
    arrive, depart, done = _drive(
        way, first, here, now, clock, rest_until, free_at, turn, queue, executor.motion.following,
        _floor(executor.graph, executor.motion),
    )  # fmt: skip
    v, t, d = way.tolist(), arrive.tolist(), depart.tolist()
    return {
        agv: Path(agv, (a.last, *v[i:j]), (0, *t[i:j]), tuple(d[i:j]))
        for (agv, a), i, j in zip(numbered(agvs), first[:-1].tolist(), (first[:-1] + done).tolist(), strict=True)
    }


@kernel
def _turn_ring(
    i: int, stack: Longs, size: int, way: Longs, first: Longs, done: Longs, here: Longs, now: Longs, clock: Longs,
    occupant: Longs, turn: Longs, queue: Longs, arrive: Longs, depart: Longs, floor: _Floor,
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
        edge = _edge(here[j], w, floor)
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
def _earliest(j: int, w: int, first_move: bool, here: Longs, now: Longs, clock: Longs, floor: _Floor) -> int:
    """First step at which an AGV can be on the next vertex of its way, if that is free."""
    in_edge, turned_to, loaded = now[j, 0], now[j, 1], now[j, 2]
    edge = _edge(here[j], w, floor)
    leave = clock[j]
    if in_edge >= 0 and not (first_move and turned_to == w):
        leave += floor.turn_steps[loaded, floor.first_transition[in_edge] + edge - floor.first_out[here[j]]]
    return int(leave + floor.edge_steps[loaded, edge])


@njit(cache=True)
def _drive(
    way: Longs, first: Longs, here: Longs, now: Longs, clock: Longs, rest_until: Longs, free_at: Longs, turn: Longs,
    queue: Longs, following: bool, floor: _Floor,
) -> tuple[Longs, Longs, Longs]:  # fmt: skip
    """Drive everybody as far as the orders allow: arrivals and departures on ``way``, and how many of each."""
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
            edge = _edge(u, w, floor)
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
