"""Slow and obvious counterparts of the planners, for tests only: no intervals, no heuristics, one step at a time."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from itertools import count, product
from typing import Literal

import numpy as np
from hypothesis import strategies as st

from controller.types import NEVER, Motion, Path, PlanAgent, PlanningProblem, make_motion
from sumo_nets.graph import Graph, make_graph

#: An agent standing at (vertex, edge it came by, steps since it could leave), driving (edge, steps left), or done for
#: good (vertex,).
Standing = tuple[Literal["stand"], int, int, int]
Driving = tuple[Literal["drive"], int, int]
Done = tuple[Literal["done"], int]
State = Standing | Driving | Done


#: What an agent may do in a step: its state after it, the move (tail, head) completed with that, and the vertices it
#: owns during the step.
Option = tuple[State, tuple[int, int] | None, frozenset[int]]


def options(state: State, problem: PlanningProblem, agent: PlanAgent) -> Iterator[Option]:
    """What an agent in a state may do."""
    graph, motion = problem.graph, problem.motion
    if state[0] == "done":
        yield state, None, frozenset((state[1],))
    elif state[0] == "drive":
        yield from _drive(state[1], state[2], problem, agent)
    else:
        _, v, edge, since = state
        longest = int(motion.turn_steps[motion.turn_steps < NEVER].max(initial=0))
        yield ("stand", v, edge, min(since + 1, longest)), None, frozenset((v,))
        for out in range(int(graph.first_out[v]), int(graph.first_out[v + 1])):
            w = int(graph.head[out])
            free = not problem.blocked[w] or w in (agent.goal, agent.vertex)
            if free and since >= motion.turn(graph, edge, out, agent.loaded):
                yield from _drive(out, int(motion.edge_steps[int(agent.loaded), out]), problem, agent)


def _drive(edge: int, left: int, problem: PlanningProblem, agent: PlanAgent) -> Iterator[Option]:
    motion = problem.motion
    u, w = int(problem.graph.tail[edge]), int(problem.graph.head[edge])
    mine = frozenset((u,) if motion.following else (u, w))
    if left > 1:
        yield ("drive", edge, left - 1), None, mine
        return
    yield ("stand", w, edge if motion.turn_steps.any() else -1, 0), (u, w), mine
    if w == agent.goal:
        yield ("done", w), (u, w), mine


def has_swap(moves: Iterable[tuple[int, int]]) -> bool:
    """Whether two of the moves completed in one step change places."""
    ahead = dict(moves)
    return any(ahead.get(head) == tail for tail, head in ahead.items())


def _clash(parts: Iterable[Iterable[int]], taken: set[int]) -> bool:
    seen = set(taken)
    for mine in parts:
        if not seen.isdisjoint(mine):
            return True
        seen.update(mine)
    return False


def at_step(path: Path, step: int, following: bool) -> tuple[dict[int, int], tuple[int, int] | None]:
    """Vertices a path owns at a step, with their number in the path, and the move that it completes as it begins."""
    mine, move = {}, None
    last = len(path.vertices) - 1
    for i, v in enumerate(path.vertices):
        start = 0 if i == 0 else path.arrive[i] if following else path.depart[i - 1]
        end = path.until if i == last else path.arrive[i + 1]
        if start <= step < end:
            mine[v] = i
        if i > 0 and path.arrive[i] == step:
            move = (path.vertices[i - 1], v)
    return mine, move


def optimum(problem: PlanningProblem) -> int | None:
    """Least sum over all agents of the step of the last arrival at the goal, where they then rest; None if none.

    Dijkstra over joint states, step by step. Fixed paths that do not rest for ever must end within 200 steps.
    """
    following, agents = problem.motion.following, problem.agents
    horizon = max((t for p in problem.fixed for t in (p.arrive[-1], p.until) if t < 200), default=0) + 1
    fixed = [[at_step(p, t, following) for p in problem.fixed] for t in range(horizon + 1)]
    taken = [set().union(*(mine for mine, _ in row)) for row in fixed]
    begins: list[list[State]] = []
    for a in agents:
        edge = a.in_edge if problem.motion.turn_steps.any() else -1
        begin: list[State] = [("stand", a.vertex, edge, -a.ready_step)]
        begins.append([*begin, ("done", a.vertex)] if a.vertex == a.goal else begin)
    tie = count()
    OPEN = [(0, next(tie), 0, states) for states in product(*begins)]
    closed = set()
    known: list[dict[State, list[Option]]] = [{} for _ in agents]
    while OPEN:
        cost, _, t, states = heapq.heappop(OPEN)
        if (t, states) in closed:
            continue
        closed.add((t, states))
        done = [(state[1],) for state in states if state[0] == "done"]
        if len(done) == len(states) and not any(_clash(done, later) for later in taken[t:]):
            return cost
        later = min(t + 1, horizon)
        for memo, state, agent in zip(known, states, agents, strict=True):
            if state not in memo:
                memo[state] = list(options(state, problem, agent))
        for chosen in product(*(memo[state] for memo, state in zip(known, states, strict=True))):
            new = tuple(state for state, _, _ in chosen)
            if (later, new) in closed or _clash((mine for _, _, mine in chosen), taken[t]):
                continue
            moves = [move for _, move, _ in chosen if move]
            moves += [move for _, move in fixed[later] if move and t < horizon]
            if not (following and has_swap(moves)):
                heapq.heappush(OPEN, (cost + len(states) - len(done), next(tie), later, new))
    return None


def simulate(paths: list[Path], motion: Motion, until: int) -> set[tuple[int, frozenset[int]]]:
    """(step, pair) where two begin to share a vertex or change places, looked for step by step."""
    found: set[tuple[int, frozenset[int]]] = set()
    before: set[tuple[int, int, int, int, int]] = set()
    for t in range(until):
        rows = {p.agv: at_step(p, t, motion.following) for p in paths}
        shared = {
            (v, a, rows[a][0][v], b, rows[b][0][v])
            for a in rows
            for b in rows
            if a < b
            for v in rows[a][0]
            if v in rows[b][0]
        }
        found |= {(t, frozenset((a, b))) for _, a, _, b, _ in shared - before}
        before = shared
        if motion.following:
            done = [(a, move) for a, (_, move) in rows.items() if move]
            found |= {(t, frozenset((a, b))) for a, move in done for b, other in done if move == other[::-1]}
    return found


@st.composite
def garages(draw: st.DrawFn, largest: int = 8) -> Graph:
    """Random graphs: a tree of two-way edges (dead ends), and further edges one-way or two-way."""
    places = [(x, y) for x in range(4) for y in range(4)]
    n = draw(st.integers(3, largest))
    spots = draw(st.permutations(places))[:n]
    pairs = [(draw(st.integers(0, v - 1)), v) for v in range(1, n)]
    links = {link for u, v in pairs for link in ((u, v), (v, u))}
    vertex = st.integers(0, n - 1)
    links |= set(draw(st.lists(st.tuples(vertex, vertex).filter(lambda p: p[0] != p[1]), max_size=n)))
    for u, v in pairs[1:]:
        if draw(st.booleans()) and draw(st.booleans()):
            links.discard((u, v))
    vertices = [(str(v), 5.0 * x, 5.0 * y) for v, (x, y) in enumerate(spots)]
    edges = []
    for u, v in sorted(links):
        metres = 5.0 * sum(abs(a - b) for a, b in zip(spots[u], spots[v], strict=True))
        edges.append((f"{u}>{v}", str(u), str(v), metres))
    return make_graph("random", vertices, edges)


@st.composite
def problems(
    draw: st.DrawFn, *, largest: int = 8, agents: int = 3, unit: bool | None = None, window: int | None = None
) -> PlanningProblem:
    """Random problems without fixed paths on random graphs.

    Args:
        draw: given by hypothesis.
        largest: vertices at most.
        agents: agents at most.
        unit: True for classic MAPF (one step a move, following), False for bodies with durations, None for either.
        window: planning window; None draws one.
    """
    graph = draw(garages(largest))
    n = len(graph.names)
    motion = classic(graph) if (draw(st.booleans()) if unit is None else unit) else bodies(graph, draw(st.booleans()))
    k = draw(st.integers(1, min(agents, n - 1)))
    starts = draw(st.permutations(range(n)))[:k]
    goals = draw(st.permutations(range(n)))[:k]
    team = []
    for agv, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        into = [e for e in range(len(graph.tail)) if graph.head[e] == start]
        team.append(
            PlanAgent(
                agv=agv,
                vertex=start,
                in_edge=draw(st.sampled_from([-1, *into])),
                ready_step=draw(st.integers(0, 2)),
                goal=draw(st.sampled_from([goal, start])) if draw(st.booleans()) and start not in goals else goal,
                loaded=draw(st.booleans()),
                dwell_steps=draw(st.integers(0, 3)),
                priority=draw(st.integers(0, 2)),
            )
        )
    blocked = np.zeros(n, dtype=np.uint8)
    no_rest = np.zeros(n, dtype=np.uint8)
    folds = bool((motion.turn_steps >= NEVER).any())
    for v in draw(st.sets(st.integers(0, n - 1), max_size=2)):
        # around a bend that can't be driven the best way may lead through a start twice; ``Distances`` leaves that out
        blocked[v] = not (folds and v in starts)
    for v in draw(st.sets(st.integers(0, n - 1), max_size=2)):
        no_rest[v] = 1
    window = draw(st.sampled_from([3, 8, 30, 1 << 29])) if window is None else window
    return PlanningProblem(graph, motion, tuple(team), (), blocked, no_rest, window)


def classic(graph: Graph) -> Motion:
    """One step a move, no time for turns, a vertex may be entered in the step in which it is left."""
    return make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _deg, _loaded: 0, True)


def bodies(graph: Graph, following: bool = False) -> Motion:
    """Moves of 1 to 3 steps (a step more when loaded), turns of 0 to 2."""
    return make_motion(
        graph, 0.5, lambda metres, ld: min(3, round(metres / 5)) + ld, lambda deg, _loaded: round(deg / 90), following
    )
