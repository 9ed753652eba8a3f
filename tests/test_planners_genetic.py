"""Genetic planning in a garage: always valid, and never worse than the plan it starts from."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from brute_force import bodies, classic, problems
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import find_conflicts, validate
from controller.planners import genetic
from controller.planners.genetic import GeneticOptions, make_ga_single, make_ga_two_stage
from controller.planners.whca import make_whca
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem, Status
from sumo_nets.graph import make_graph

QUICK = GeneticOptions(generations=10, population=10)

CROSS = make_graph(
    "crossing with a way around",
    [(str(v), 5.0 * x, 5.0 * y) for v, (x, y) in enumerate([(0, 1), (1, 1), (2, 1), (1, 0), (1, 2), (0, 0), (2, 0)])],
    [(f"{a}>{b}", a, b, 5.0) for u, v in ("01", "12", "13", "14", "35", "36", "05", "26") for a, b in (u + v, v + u)],
)


def problem(agents, make_motion=bodies, window=30):
    free = np.zeros(len(CROSS.names), dtype=np.uint8)
    return PlanningProblem(CROSS, make_motion(CROSS), tuple(agents), (), free, free, window)


def agent(agv, vertex, goal, **rest):
    return PlanAgent(agv, vertex, -1, 0, goal, False, **rest)


def score(p, paths):
    fleet = genetic._Fleet(p, make_whca(p.graph, p.motion).distances)
    fleet.distances.update(p.blocked)
    return fleet.score(paths)


@pytest.mark.parametrize("make", [make_ga_single, make_ga_two_stage])
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_every_plan_is_valid_and_no_worse_than_the_default(make, data):
    p = data.draw(problems(largest=10, agents=5))
    starts = {a.vertex for a in p.agents}
    walls = data.draw(st.permutations(range(len(p.graph.names))))[:2]
    until = data.draw(st.integers(1, 12))
    p = replace(p, fixed=tuple(Path(90 + i, (v,), (0,), (), until) for i, v in enumerate(walls) if v not in starts))
    result = make(p.graph, p.motion, QUICK)(p)
    assert validate(p, result) == []
    assert (result.status is Status.PARTIAL) == bool(result.failed)
    assert score(p, result.paths) <= score(p, make_whca(p.graph, p.motion)(p).paths)


@pytest.mark.parametrize("make_motion", [classic, bodies])
@pytest.mark.parametrize("window", [30, FOREVER])
def test_a_bad_order_of_priorities_is_bred_away(make_motion, window):
    agents = [agent(0, 4, 1, priority=9, dwell_steps=0), agent(1, 0, 2, priority=1)]
    p = problem(agents, make_motion, window)
    default, bred = make_whca(p.graph, p.motion)(p), make_ga_two_stage(p.graph, p.motion)(p)
    assert validate(p, bred) == []
    assert score(p, bred.paths) <= score(p, default.paths)


def test_same_problem_same_plan():
    p = problem([agent(0, 0, 2), agent(1, 2, 0), agent(2, 4, 3)])
    planner = make_ga_two_stage(p.graph, p.motion)
    assert planner(p).paths == planner(p).paths


def test_nothing_is_bred_where_nothing_is_late(monkeypatch):
    monkeypatch.setattr(genetic, "evolve", None)
    p = problem([agent(0, 0, 2)])
    assert make_ga_single(p.graph, p.motion)(p).status is Status.SOLVED


@settings(max_examples=60, deadline=None)
@given(problems(largest=8, agents=4, window=20), st.integers(0, 10**6))
def test_the_fitness_counts_what_the_checker_finds(p, seed):
    planner = make_ga_single(p.graph, p.motion)
    default = planner._whca(p)
    planner._search.begin(p)
    species = genetic._Species(
        genetic._Fleet(p, planner._whca.distances), [planner._candidates(p, a, default) for a in p.agents]
    )
    population = species.first_generation(6, np.random.default_rng(seed))
    collisions, _ = species.cost(population)
    for c in range(6):
        paths = list(species.paths(population.order[c, :, 0], population.stops[c]).values())
        apart = all(not find_conflicts(pair, p.motion, p.window_steps) for pair in combinations(paths, 2))
        assert (collisions[c] == 0) == apart


def test_what_collides_holds_its_place():
    p = problem([agent(0, 0, 1), agent(1, 2, 1), agent(2, 4, 4)], classic)
    paths = {0: Path(0, (0, 1), (0, 1), (0,), 30), 1: Path(1, (2, 1), (0, 1), (0,), 30), 2: Path(2, (4,), (0,), (), 30)}
    repaired = genetic._repair(p, paths)
    assert repaired == {0: paths[0], 2: paths[2]}
