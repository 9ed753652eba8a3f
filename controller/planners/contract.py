"""The contract of all planners, tested on random problems: ``parking-sim check-planner file.py:function``.

The problems use small garages with dead ends, one-way lanes and loops. AGVs stand, drive or have turned. Some vertices
are blocked, and at some vertices no AGV may rest. Time is counted in ticks, or AGVs have bodies. ``conflicts.validate``
checks each answer.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from controller.conflicts import validate
from controller.flags import flags_of
from controller.planners.guest import PlannerError
from controller.types import FOREVER, AgvNumber, Motion, Path, PlanAgent, Planner, PlanningProblem, Status, make_motion
from sumo_nets.graph import Graph, make_graph
from sumo_nets.numbering import NO_EDGE, Vertex

#: Builds a planner for a garage.
Maker = Callable[[Graph, Motion], Planner]


@dataclass(frozen=True, slots=True)
class Violation:
    """What a planner did wrong.

    Attributes:
        number: number of the problem; ``random_problem`` makes it again.
        problem: the problem.
        reasons: in words.
    """

    number: int
    problem: PlanningProblem
    reasons: tuple[str, ...]


def check_planner(make: Maker, problems: int = 200) -> Iterator[Violation]:
    """Try a planner on random problems.

    Args:
        make: makes the planner for a garage.
        problems: how many; equal numbers are equal problems.

    Yields:
        The problems whose answer breaks the contract, and how.
    """
    for number in range(problems):
        problem = random_problem(number)
        try:
            planner = make(problem.graph, problem.motion)
            if flags_of(planner).complete:
                problem = all_standing(random_problem(number, FOREVER))
            reasons = violations(planner, problem)
            if not reasons and planner(problem).paths != make(problem.graph, problem.motion)(problem).paths:
                reasons = ["equal problems, different plans: draw random numbers from problem.seed"]
        except PlannerError as error:
            reasons = [str(error)]
        if reasons:
            yield Violation(number, problem, tuple(reasons))


def violations(planner: Planner, problem: PlanningProblem) -> list[str]:
    """What is wrong with a planner's answer to a problem, in words; empty if nothing is."""
    masks = problem.blocked.copy(), problem.no_rest.copy()
    result = planner(problem)
    reasons = []
    if not all(np.array_equal(a, b) for a, b in zip(masks, (problem.blocked, problem.no_rest), strict=True)):
        reasons.append("it changes the problem's arrays")
    if result.status in (Status.INFEASIBLE, Status.TIMEOUT):
        return reasons + ([f"{result.status} with paths"] if result.paths else [])
    if (result.status is Status.PARTIAL) != bool(result.failed):
        reasons.append(f"{result.status} with {len(result.failed)} agents named as failed")
    return reasons + validate(problem, result, flags_of(planner).one_move)


def random_problem(number: int, window: int | None = None) -> PlanningProblem:
    """A small problem; the same for the same number.

    Args:
        number: which one.
        window: planning window; drawn unless given.
    """
    rng = random.Random(number)
    graph = _garage(rng)
    n = len(graph.names)
    motion = _motion(graph, rng)
    starts, goals = (rng.sample(graph.vertices, min(n - 1, 1 + number % 6)) for _ in range(2))
    agents = tuple(_agent(rng, graph, AgvNumber(agv), pair) for agv, pair in enumerate(zip(starts, goals, strict=True)))
    blocked, no_rest = (np.array([rng.random() < 0.1 for _ in range(n)], dtype=np.uint8) for _ in range(2))
    steps = rng.choice((3, 8, 30)) if window is None else window
    return PlanningProblem(graph, motion, agents, (), blocked, no_rest, steps, number)


def all_standing(problem: PlanningProblem) -> PlanningProblem:
    """The same problem for planners of complete paths: each agent's present path is fixed."""
    return replace(problem, fixed=tuple(Path(a.agv, (a.vertex,), (0,), ()) for a in problem.agents))


def _garage(rng: random.Random) -> Graph:
    """A random tree on a lattice, with dead ends, and further lanes one-way or two-way."""
    places = rng.sample([(x, y) for x in range(4) for y in range(4)], rng.randint(3, 12))
    links: set[tuple[int, int]] = set()
    for v in range(1, len(places)):
        u = min(range(v), key=lambda w: abs(places[w][0] - places[v][0]) + abs(places[w][1] - places[v][1]))
        links |= {(u, v), (v, u)}
    for _ in range(rng.randint(0, len(places))):
        u, v = rng.sample(range(len(places)), 2)
        links |= {(u, v)} if rng.random() < 0.5 else {(u, v), (v, u)}
    metres = {(u, v): 5.0 * sum(abs(a - b) for a, b in zip(places[u], places[v], strict=True)) for u, v in links}
    vertices = [(str(v), 5.0 * x, 5.0 * y) for v, (x, y) in enumerate(places)]
    return make_graph("random", vertices, [(f"{u}>{v}", str(u), str(v), metres[u, v]) for u, v in sorted(links)])


def _motion(graph: Graph, rng: random.Random) -> Motion:
    """Ticks, or bodies that take 1 to 3 steps a move, a step more when loaded, and up to 2 for a turn."""
    if rng.random() < 0.4:
        return make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)
    return make_motion(
        graph, 0.5, lambda metres, loaded: min(3, round(metres / 5)) + loaded, lambda deg, _: round(deg / 90),
        rng.random() < 0.3,
    )  # fmt: skip


def _agent(rng: random.Random, graph: Graph, agv: AgvNumber, start_goal: tuple[Vertex, Vertex]) -> PlanAgent:
    start, goal = start_goal
    return PlanAgent(
        agv, start, rng.choice([NO_EDGE, *graph.in_edges(start)]), rng.randint(0, 2), goal, rng.random() < 0.5,
        dwell_steps=rng.randint(0, 3), priority=rng.randint(0, 2),
    )  # fmt: skip
