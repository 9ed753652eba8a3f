"""The genetic algorithm's operators keep what they must; collisions against a slow count; CBS against its promises."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.genetic.evolution import (
    Options,
    Population,
    diversity,
    evolve,
    roulette,
    single_stage,
    two_stage,
)
from controller.genetic.lattice import MOST, STEP, Instance, Robots, plan_genetic, random_instance
from controller.genetic.lattice_cbs import count_collisions, meetings, plan_cbs

FEW = Options(population=12)


def make(seed, robots, columns=8, rows=5):
    return random_instance(robots, np.random.default_rng(seed), columns, rows)


def way(instance, i, order, stops):
    """Where robot ``i`` is in each step until it arrives."""
    places = [tuple(2 * instance.starts[i])]
    places += places * (2 * int(stops[0]))
    for k in range(int(instance.lengths[i])):
        x, y = places[-1]
        dx, dy = STEP[order[k]].tolist()
        places += [(x + dx, y + dy)] * (1 + 2 * int(stops[k + 1]))
        places.append((x + 2 * dx, y + 2 * dy))
    return tuple(places)


def slow_collisions(ways):
    """Pair by pair and step by step."""
    found = 0
    for a, b in combinations(ways, 2):
        for t in range(min(len(a), len(b)) - 1):
            found += a[t] == b[t]
            found += a[t] != b[t] and (a[t], a[t + 1]) == (b[t + 1], b[t])
    return found


def is_valid(instance, population):
    """Directions are permutations of a shortest way's, stops are in range, padding is zero."""
    fresh = Robots(instance).first_generation(1, np.random.default_rng(0))
    for i, length in enumerate(instance.lengths.tolist()):
        for p in range(len(population.order)):
            assert sorted(population.order[p, i].tolist()) == sorted(fresh.order[0, i].tolist())
            assert not population.order[p, i, length:].any()
            assert population.stops[p, i].min() >= 0
            assert population.stops[p, i].max() <= MOST
            assert not population.stops[p, i, length + 1 :].any()
            end = way(instance, i, population.order[p, i], population.stops[p, i])[-1]
            assert end == tuple(2 * instance.goals[i])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 8))
def test_every_generation_holds_shortest_ways_and_stops_in_range(seed, robots, generations):
    instance, rng = make(seed, robots, 5, 3), np.random.default_rng(seed)
    species = Robots(instance)
    population = species.first_generation(8, rng)
    is_valid(instance, population)
    species.mutate(population, np.arange(8), rng)
    is_valid(instance, population)
    outcome = evolve(species, population, two_stage(generations), Options(population=8, mutation=1.0), rng)
    is_valid(instance, Population(outcome.order[None], outcome.stops[None]))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 15))
def test_collisions_and_stops_against_a_slow_count(seed, robots):
    instance = make(seed, robots, 4, 4)
    population = Robots(instance).first_generation(5, np.random.default_rng(seed))
    collisions, stops = Robots(instance).cost(population)
    for p in range(5):
        ways = [way(instance, i, population.order[p, i], population.stops[p, i]) for i in range(robots)]
        assert collisions[p] == slow_collisions(ways) == count_collisions(ways) == len(list(meetings(ways)))
        assert stops[p] == population.stops[p].sum()
        assert stops[p] == sum(len(w) - 1 - 2 * n for w, n in zip(ways, instance.lengths, strict=True)) / 2


def test_meetings_that_can_be_counted_by_hand():
    head_on = Instance(3, 1, np.array([(0, 0), (2, 0)]), np.array([(2, 0), (0, 0)]))
    population = Population(np.array([[[3, 3], [4, 4]]], dtype=np.int8), np.zeros((1, 2, 3), dtype=np.int8))
    assert Robots(head_on).cost(population)[0] == 1  # both at the middle intersection
    population.stops[0, 0, 0] = 1
    assert Robots(head_on).cost(population)[0] == 1  # now in the middle of the first aisle
    behind = Instance(3, 1, np.array([(0, 0), (1, 0)]), np.array([(2, 0), (0, 0)]))
    into_the_goal = Population(np.array([[[3, 3], [4, 0]]], dtype=np.int8), np.zeros((1, 2, 3), dtype=np.int8))
    assert Robots(behind).cost(into_the_goal)[0] == 1  # in the middle of the aisle; afterwards the second one is gone


@settings(deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 9))
def test_diversity_is_the_mean_over_all_pairs(seed, size):
    population = Robots(make(seed, 6)).first_generation(size, np.random.default_rng(seed))
    flat = np.concatenate([genes.reshape(size, -1) for genes in population], axis=1)
    pairs = [np.count_nonzero(a != b) for a, b in combinations(flat, 2)]
    assert diversity(population) == pytest.approx(np.mean(pairs))


def test_the_wheel_draws_by_weight_and_never_the_worst():
    drawn = roulette(np.array([0.0, 1.0, 3.0, 4.0]), 40_000, np.random.default_rng(1))
    share = np.bincount(drawn, minlength=4) / len(drawn)
    assert share == pytest.approx([4 / 8, 3 / 8, 1 / 8, 0], abs=0.01)
    assert len(set(roulette(np.ones(3), 100, np.random.default_rng(1)).tolist())) == 3


def test_the_best_never_gets_worse_within_a_stage_and_both_begin_alike():
    instance = make(3, 15)
    single = plan_genetic(instance, single_stage(40), FEW, np.random.default_rng(5))[1].history
    two = plan_genetic(instance, two_stage(40), FEW, np.random.default_rng(5))[1].history
    assert single.shape == two.shape == (41, 3)
    assert (np.diff(single[:, 0]) <= 1e-12).all()
    assert (np.diff(two[:20, 0]) <= 1e-12).all()
    assert (np.diff(two[20:, 0]) <= 1e-12).all()
    assert (two[:20, 0] == two[:20, 1]).all()
    assert single[0, 2] == two[0, 2]


def test_same_seed_same_plan_and_figures_fit_together():
    instance = make(8, 10)
    plans = [plan_genetic(instance, two_stage(60), FEW, np.random.default_rng(2))[0] for _ in range(2)]
    assert plans[0] == plans[1]
    assert plans[0].work_steps == pytest.approx(2 * instance.lengths.mean() + plans[0].stop_steps)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 7))
def test_cbs_plans_are_free_of_collisions_and_drivable(seed, robots):
    instance = make(seed, robots, 4, 3)
    answer = plan_cbs(instance, 2.0)
    assert answer.timeout == (answer.plan.collisions > 0)
    assert answer.plan.collisions == slow_collisions(answer.ways)
    for i, w in enumerate(answer.ways):
        assert w[0] == tuple(2 * instance.starts[i])
        assert w[-1] == tuple(2 * instance.goals[i])
        assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) <= 1 for a, b in pairwise(w))
        left = next(t for t in range(len(w)) if w[t] != w[0])
        crossings = [p[0] % 2 == 0 and p[1] % 2 == 0 for p in w]
        assert not any(crossings[t] and w[t] == w[t + 1] for t in range(left, len(w) - 1))  # no stop at intersections
    if not answer.timeout:
        genetic = plan_genetic(instance, single_stage(30), FEW, np.random.default_rng(seed))[0]
        assert genetic.collisions > 0 or genetic.work_steps >= answer.plan.work_steps - 1e-9


def test_cbs_stops_when_time_is_up():
    answer = plan_cbs(make(1, 25, 6, 5), 0.0)
    assert answer.nodes == 1
    assert answer.timeout
    assert answer.plan.collisions > 0


def test_more_robots_than_intersections():
    with pytest.raises(ValueError, match="13: 4 x 3 intersections have room for 12"):
        make(0, 13, 4, 3)
