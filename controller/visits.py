"""From timed paths to visiting orders.

``visiting_order`` turns a plan into the order in which AGVs visit each vertex, and refuses plans that cannot be carried
out. ``controller.retiming`` gives orders a clock again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.types import FOREVER, NEVER, AgvNumber, Motion, Path
from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import NO_VERTEX, EdgeIndex, Vertex

Longs = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a plan is not carried out.

    Attributes:
        kind: "form", "start", "edge", "blocked", "conflict" or "swap".
        agents: the AGVs concerned.
        vertex: where.
        reason: in words.
    """

    kind: Literal["form", "start", "edge", "blocked", "conflict", "swap"]
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


@dataclass(frozen=True, eq=False)
class Barred:
    """Where agents may not drive: a parked car stands there, or an AGV that is out of order.

    Attributes:
        blocked: 1 for such a vertex, shape (n,).
        goals: goal of each agent that has a new path; it may drive there. Paths of other agents are not looked at:
            they were taken when something else was blocked.
    """

    blocked: NDArray[np.uint8]
    goals: Mapping[AgvNumber, Vertex]

    def on(self, path: Path) -> Vertex:
        """The first vertex of a path where its agent may not drive; ``NO_VERTEX`` if there is none."""
        if path.agv not in self.goals or not self.blocked[list(path.vertices)].any():
            return NO_VERTEX
        free = path.vertices[0], self.goals[path.agv]
        return next((v for v in path.vertices if self.blocked[v] and v not in free), NO_VERTEX)


class FloorTables(NamedTuple):
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
        ends: until when no other AGV may come: ``Path.until`` instead of ``FOREVER``.
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
        holding: vertex of each AGV that has no path: it stays there, and AGVs sent through it wait until a later
            plan moves it away.
        graph, motion: the garage and how long moves take.
        in_edges: edge by which each AGV has come to where its path begins; not needed where it has turned already.

    Returns:
        AGV numbers by vertex in the order of their visits (without the vertices where they start), or a refusal.
    """
    first = starts(len(path.vertices) for path in paths.values())
    vertices = longs(path.vertices for path in paths.values())
    came = np.array([(in_edges or {}).get(agv, -1) for agv in paths], dtype=np.int64)
    k = _undrivable(vertices, first, came, floor_tables(graph, motion))
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


def starts(sizes: Iterable[int]) -> Longs:
    """Where each of several sequences begins when all stand in one array, and where the last one ends."""
    return np.cumsum([0, *sizes])


def longs(parts: Iterable[Collection[int]]) -> Longs:
    """Several sequences of numbers in one array."""
    return np.fromiter(chain.from_iterable(parts), dtype=np.int64)


def floor_tables(graph: Graph, motion: Motion) -> FloorTables:
    """What the kernels read of a graph and its durations."""
    arrays = (graph.head, graph.first_out, motion.edge_steps, motion.turn_steps, motion.first_transition)
    return FloorTables(*(np.ascontiguousarray(array, dtype=np.int32) for array in arrays))


@kernel
def edge_between(u: int, v: int, floor: FloorTables) -> int:
    """The edge from one vertex to the next, -1 if there is none."""
    for e in range(floor.first_out[u], floor.first_out[u + 1]):
        if floor.head[e] == v:
            return e
    return -1


@kernel
def _undrivable(vertices: Longs, first: Longs, in_edges: Longs, floor: FloorTables) -> int:
    """Number of the first vertex that has no lane from the one before, or needs a turn that no AGV makes; -1: none."""
    for p in range(len(in_edges)):
        came = in_edges[p]
        for k in range(first[p] + 1, first[p + 1]):
            u = vertices[k - 1]
            e = edge_between(u, vertices[k], floor)
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
    arrive = longs(path.arrive for path in paths.values())
    ends = np.roll(arrive, -1)
    left = ends.copy()
    left[last] = FOREVER
    ends[last] = [path.until for path in paths.values()]
    departures = longs((*path.depart, 0) for path in paths.values())
    entered = arrive if following else np.roll(departures, 1)
    entered[start] = 0
    agv = np.repeat(np.array(list(paths), dtype=np.int64), np.diff(first))
    nothing = np.zeros(len(holding), dtype=np.int64)
    stays = (longs([holding.values()]), longs([holding]), nothing, nothing, nothing)
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
