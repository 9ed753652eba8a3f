"""The checker of plans: it finds agents that meet, and every reason why a plan cannot be driven.

The checker shares no code with the planners and their searches. ``controller.types.Path`` defines when a vertex is
occupied: in half-open intervals of steps.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from controller.types import FOREVER, AgvNumber, Conflict, Motion, Path, PlanAgent, PlanningProblem, PlanResult
from sumo_nets.numbering import EdgeIndex, Vertex


class _Visit(NamedTuple):
    """The ``i``-th vertex of a path belongs to its agent from step ``start`` to step ``end`` (exclusive)."""

    start: int
    end: int
    agv: AgvNumber
    path: Path
    i: int


class _Move(NamedTuple):
    """An agent drives from ``tail`` to ``head`` and arrives at ``step``."""

    agv: AgvNumber
    tail: Vertex
    head: Vertex
    step: int


def find_conflicts(paths: Iterable[Path], motion: Motion, until: int = FOREVER) -> list[Conflict]:
    """All conflicts of a set of paths.

    Args:
        paths: one path per agent.
        motion: decides whether a vertex may be entered in the step in which it is left.
        until: conflicts starting at this step or later do not count.

    Returns:
        Conflicts by (step, vertex, agents). Two agents that overlap at several places have one conflict for each, so
        head-on agents whose bodies need both vertices have a "swap" at either vertex. A swap without overlap is
        named by the lower AGV number and the vertex that it enters. Three or more may move in a ring. Each enters
        the vertex that the next one leaves; this is no conflict where following is allowed.
    """
    paths = list(paths)
    found = [*_overlaps(paths, motion.following)]
    if motion.following:
        found += _swaps(paths)
    return sorted((c for c in found if c.step < until), key=lambda c: (c.step, c.vertex, c.agents))


def validate(problem: PlanningProblem, result: PlanResult, one_move: bool = False) -> list[str]:
    """All reasons why a plan may not be carried out, in words; empty if there is no reason.

    The checks cover the problem: agents, starts, neighbours, blocked vertices, durations, order of times, how
    far paths reach, and conflicts with each other and with the fixed paths inside the window. Agents in
    ``result.failed`` keep their fixed path if they have one, else they stand at their start for the whole window.
    With ``one_move`` paths may end before the window does: the vertex after the move is reserved for no agent.
    """
    agents = {agent.agv: agent for agent in (*problem.carrying, *problem.agents)}
    asked = {agent.agv for agent in problem.agents}
    reasons = [f"AGV {agv}: a path, but it was not to be planned" for agv in result.paths.keys() - agents.keys()]
    reasons += [
        f"AGV {agv}: neither a path nor named as failed"
        for agv in sorted(asked - result.paths.keys() - result.failed.keys())
    ]
    for agv in sorted(result.paths.keys() & agents.keys()):
        reasons += [f"AGV {agv}: {reason}" for reason in _path_faults(problem, agents[agv], result.paths[agv])]
        if not one_move and result.paths[agv].until < min(problem.window_steps, FOREVER):
            reasons.append(f"AGV {agv}: its last vertex is kept until step {result.paths[agv].until} only")
    if reasons:
        return reasons
    kept = [path for path in problem.fixed if path.agv not in result.paths]
    fixed = {path.agv for path in kept}
    standing = [Path(n, (agents[n].vertex,), (0,), (), problem.window_steps) for n in result.failed if n not in fixed]
    paths = [*kept, *result.paths.values(), *standing]
    return [
        f"AGVs {c.agents[0]} and {c.agents[1]}: {c.kind} conflict at vertex {c.vertex}, step {c.step}"
        for c in find_conflicts(paths, problem.motion, problem.window_steps)
        if not fixed.issuperset(c.agents)
    ]


def _visits(path: Path, following: bool) -> Iterator[_Visit]:
    last = len(path.vertices) - 1
    for i in range(last + 1):
        start = 0 if i == 0 else (path.arrive[i] if following else path.depart[i - 1])
        yield _Visit(start, path.until if i == last else path.arrive[i + 1], path.agv, path, i)


def _overlaps(paths: list[Path], following: bool) -> Iterator[Conflict]:
    """Find overlapping visits at each vertex, in order of time."""
    by_vertex: defaultdict[Vertex, list[_Visit]] = defaultdict(list)
    for path in paths:
        for visit in _visits(path, following):
            by_vertex[path.vertices[visit.i]].append(visit)
    for vertex, visits in by_vertex.items():
        visits.sort(key=lambda visit: visit[:3])
        present: list[_Visit] = []
        for visit in visits:
            present = [other for other in present if other.end > visit.start]
            if visit.start < visit.end:
                for other in present:
                    if other.agv != visit.agv:
                        yield _overlap(vertex, other, visit)
                present.append(visit)


def _overlap(vertex: Vertex, first: _Visit, second: _Visit) -> Conflict:
    """Name the conflict of two visits that overlap; ``first`` starts no later."""
    step = second.start
    for a, b in ((first, second), (second, first)):
        if _head_on(a, b):
            return Conflict("swap", (b.agv, a.agv), vertex, step)
    path, i = first.path, first.i
    if i < len(path.depart) and path.depart[i] < step:
        return Conflict("following", (first.agv, second.agv), vertex, step)
    return Conflict("vertex", (min(first.agv, second.agv), max(first.agv, second.agv)), vertex, step)


def _head_on(a: _Visit, b: _Visit) -> bool:
    """Whether ``a`` leaves this vertex over the edge on which ``b`` arrives, at the same time."""
    if a.i >= len(a.path.depart) or b.i == 0 or a.path.vertices[a.i + 1] != b.path.vertices[b.i - 1]:
        return False
    return a.path.depart[a.i] < b.path.arrive[b.i] and b.path.depart[b.i - 1] < a.path.arrive[a.i + 1]


def _leaving(paths: Iterable[Path]) -> dict[int, dict[Vertex, list[_Move]]]:
    """Moves by step of arrival and by the vertex they leave; agents that overlap may leave one vertex together."""
    moves: defaultdict[int, dict[Vertex, list[_Move]]] = defaultdict(dict)
    for p in paths:
        for i in range(1, len(p.vertices)):
            move = _Move(p.agv, p.vertices[i - 1], p.vertices[i], p.arrive[i])
            moves[move.step].setdefault(move.tail, []).append(move)
    return moves


def _swaps(paths: list[Path]) -> Iterator[Conflict]:
    """Pairs of agents that exchange vertices in one step."""
    for step, leaving in _leaving(paths).items():
        for move in (move for moves in leaving.values() for move in moves):
            for other in leaving.get(move.head, ()):
                if other.head == move.tail and move.agv < other.agv:
                    yield Conflict("swap", (move.agv, other.agv), move.head, step)


def _path_faults(problem: PlanningProblem, agent: PlanAgent, path: Path) -> Iterator[str]:
    """Errors within one path."""
    v = path.vertices
    if path.agv != agent.agv:
        yield f"its path is that of AGV {path.agv}"
    if not v or len(path.arrive) != len(v) or len(path.depart) != len(v) - 1:
        yield "vertices, arrivals and departures don't fit in number"
        return
    if v[0] != agent.vertex:
        yield f"starts at vertex {v[0]} instead of {agent.vertex}"
        return
    if path.arrive[0] != 0:
        yield f"arrives at its start at step {path.arrive[0]} instead of 0"
    edge, ready = agent.in_edge, agent.ready_step
    for i in range(len(v) - 1):
        following_edge = problem.graph.edge_index.get((v[i], v[i + 1]))
        if following_edge is None:
            yield f"drives from vertex {v[i]} to {v[i + 1]}, which are not neighbours"
            return
        yield from _move_faults(problem, agent, path, i, ready, edge, following_edge)
        edge, ready = following_edge, path.arrive[i + 1]
    if path.until < path.arrive[-1]:
        yield f"its last vertex is kept until step {path.until} only, before it gets there"
    if problem.window_steps >= FOREVER and v[-1] != agent.goal:
        yield f"ends at vertex {v[-1]} instead of its goal {agent.goal}"


def _move_faults(
    problem: PlanningProblem, agent: PlanAgent, path: Path, i: int, ready: int, edge_in: EdgeIndex, edge: EdgeIndex
) -> Iterator[str]:
    """Errors in the move from the i-th to the next vertex of a path."""
    u, w, depart = path.vertices[i], path.vertices[i + 1], path.depart[i]
    earliest = ready + problem.motion.turn(problem.graph, edge_in, edge, agent.loaded)
    if depart < earliest:
        yield f"leaves vertex {u} at step {depart}, before it is ready at {earliest}"
    steps = int(problem.motion.edge_steps[int(agent.loaded), edge])
    if path.arrive[i + 1] - depart != steps:
        yield f"drives from vertex {u} to {w} in {path.arrive[i + 1] - depart} steps instead of {steps}"
    if problem.blocked[w] and w not in (agent.goal, agent.vertex):
        yield f"drives into the blocked vertex {w}"
