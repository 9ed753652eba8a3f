"""From timed paths to visiting orders, and back.

``visiting_order`` turns a plan into the order in which AGVs visit each vertex, and refuses plans that cannot be carried
out. ``retime`` gives orders a clock again: when each AGV will be where, if nothing else delays it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import networkx as nx

from controller.types import FOREVER, NEVER, Motion, Path
from sumo_nets.graph import Graph

if TYPE_CHECKING:
    from controller.executor import Executor


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a plan is not carried out.

    Attributes:
        kind: "form", "start", "edge", "conflict" or "cycle".
        agents: the AGVs concerned.
        vertex: where.
        reason: in words.
    """

    kind: str
    agents: tuple[int, ...]
    vertex: int
    reason: str


def malformed(agv: int, path: Path) -> str:
    """What is wrong with a path by itself, whatever the graph; "" if nothing."""
    arrive, depart = path.arrive, path.depart
    if path.agv != agv:
        return f"AGV {agv} is given the path of AGV {path.agv}"
    if not path.vertices or len(arrive) != len(path.vertices) or len(depart) != len(arrive) - 1:
        return f"AGV {agv}: {len(path.vertices)} vertices, {len(arrive)} arrivals and {len(depart)} departures"
    if arrive[0] < 0 or any(not arrive[i] <= t < arrive[i + 1] for i, t in enumerate(depart)):
        return f"AGV {agv}: its times do not run forwards"
    return ""


def visiting_order(
    paths: Mapping[int, Path],
    holding: Mapping[int, int],
    graph: Graph,
    motion: Motion,
    in_edges: Mapping[int, int] | None = None,
) -> dict[int, deque[int]] | Refusal:
    """Order the visits of each vertex by the plan's times.

    Two visits of one vertex must not overlap in time: then every wait points back in time, so that the orders have no
    cycle and any delay only delays. Where following is allowed a ring of AGVs could still wait for one another in one
    and the same step; that is looked for as well.

    Args:
        paths: by AGV number.
        holding: vertex of each AGV that has no path: it stays there, and whoever is sent through waits until a later
            plan moves it away.
        graph, motion: the garage and how long moves take.
        in_edges: edge by which each AGV has come to where its path begins; not needed where it has turned already.

    Returns:
        AGV numbers by vertex in the order of their visits (without the vertices where they start), or a refusal.
    """
    visits: dict[int, list[tuple[int, int, int, int]]] = {}
    for agv, path in paths.items():
        wrong = _undrivable(path, (in_edges or {}).get(agv, -1), graph, motion)
        if wrong:
            return wrong
        entered = 0
        for i, v in enumerate(path.vertices):
            left = path.arrive[i + 1] if i + 1 < len(path.vertices) else FOREVER
            visits.setdefault(v, []).append((entered, left, agv, i))
            if i + 1 < len(path.vertices):
                entered = path.arrive[i + 1] if motion.following else path.depart[i]
    for agv, v in holding.items():
        visits.setdefault(v, []).append((0, 0, agv, 0))
    order: dict[int, deque[int]] = {}
    for v, rows in visits.items():
        rows.sort()
        for a, b in pairwise(rows):
            # the end of a windowed path is not a rest: whoever comes later waits until the next plan moves it away
            ends = paths[a[2]].until if a[2] in paths and a[3] + 1 == len(paths[a[2]].vertices) else a[1]
            if b[0] < ends and a[2] != b[2]:
                reason = f"AGVs {a[2]} and {b[2]} both plan to be on {graph.names[v]} at step {b[0]}"
                return Refusal("conflict", (a[2], b[2]), v, reason)
        order[v] = deque(agv for _, _, agv, i in rows if i > 0)
    ring = _ring(paths, visits) if motion.following else None
    return ring or order


def _undrivable(path: Path, in_edge: int, graph: Graph, motion: Motion) -> Refusal | None:
    """The first move of a path that has no lane, or needs a turn that no AGV makes."""
    for u, v in pairwise(path.vertices):
        edge = graph.edge_index.get((u, v), -1)
        if edge < 0:
            return Refusal("edge", (path.agv,), v, f"no lane from {graph.names[u]} to {graph.names[v]}")
        if motion.turn(graph, in_edge, edge, False) >= NEVER:
            came = graph.names[graph.tail[in_edge]]
            reason = f"no AGV can turn at {graph.names[u]}, coming from {came}, towards {graph.names[v]}"
            return Refusal("edge", (path.agv,), v, reason)
        in_edge = edge
    return None


def _ring(paths: Mapping[int, Path], visits: Mapping[int, list[tuple[int, int, int, int]]]) -> Refusal | None:
    """A ring of AGVs that would all move on in one step, each into the vertex the next one leaves (or a swap)."""
    g: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for v, rows in visits.items():
        for a, b in pairwise(rows):
            if a[2] != b[2] and a[1] == b[0] and a[2] in paths:
                # b's arrival at v needs a's arrival at its next vertex, in the same step
                g.add_edge((a[2], a[3] + 1), (b[2], b[3]), vertex=v)
    for group in nx.strongly_connected_components(g):
        if len(group) > 1:
            members = tuple(sorted({agv for agv, _ in group}))
            agv, i = min(group)
            return Refusal("cycle", members, paths[agv].vertices[i], f"AGVs {members} would have to move on in a ring")
    return None


def retime(executor: Executor, step: int) -> dict[int, Path]:
    """When each AGV will be where if the accepted orders are carried out without delay from now on.

    Args:
        executor: with its accepted orders.
        step: now; the result counts from it.

    Returns:
        A path for every AGV, from the end of its authority along its pending vertices. An AGV whose way is closed by
        one that has no plan to leave is cut there.
    """
    graph, motion, agvs = executor.graph, executor.motion, executor.agvs
    position = dict.fromkeys(executor.order, 0)
    free_at: dict[int, int] = {}
    for agv, a in enumerate(agvs):
        ready = executor.ready_step(agv, step)
        for v in list(a.trail)[:-1]:
            free_at[v] = ready
    occupant = {a.last: agv for agv, a in enumerate(agvs)}
    free_at.update(dict.fromkeys(occupant, FOREVER))
    rows: list[tuple[list[int], list[int], list[int]]] = [([a.last], [0], []) for a in agvs]
    clock = [executor.ready_step(agv, step) for agv in range(len(agvs))]
    in_edge = [a.in_edge for a in agvs]
    done = [0] * len(agvs)
    stack = list(range(len(agvs)))
    while stack:
        agv = stack.pop()
        vertices, arrive, depart = rows[agv]
        pending = agvs[agv].pending
        loaded = agvs[agv].loaded
        while done[agv] < len(pending):
            w = pending[done[agv]]
            here = vertices[-1]
            mine = executor.order[w][position[w]] == agv
            free = 0 if w == here else free_at.get(w, 0)
            if not mine or (free == FOREVER and occupant[w] != agv):
                break
            edge = graph.edge_index[here, w]
            has_turned = done[agv] == 0 and agvs[agv].turned_to == w
            turned = 0 if has_turned else motion.turn(graph, in_edge[agv], edge, loaded)
            drive = int(motion.edge_steps[int(loaded), edge])
            free = 0 if free == FOREVER else free
            leave = max(clock[agv] + turned, free - drive if motion.following else free)
            depart.append(leave)
            arrive.append(leave + drive)
            vertices.append(w)
            clock[agv] = leave + drive
            in_edge[agv] = edge
            position[w] += 1
            done[agv] += 1
            free_at[w], occupant[w] = FOREVER, agv
            if here != w:
                free_at[here] = clock[agv]
                waiting = executor.order.get(here)
                if waiting and position[here] < len(waiting):
                    stack.append(waiting[position[here]])
    return {agv: Path(agv, tuple(v), tuple(a), tuple(d)) for agv, (v, a, d) in enumerate(rows)}
