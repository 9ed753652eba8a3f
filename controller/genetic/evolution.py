"""The genetic algorithm: roulette wheel, crossover, elite, and one or two stages (two-stage paper 2025, III and IV).

A chromosome has two parts for each agent: *order* says which way it goes, *stops* how long it waits where. What the
genes mean, how they mutate and what they cost is for the ``Species``: robots on a lattice, or AGVs in a garage.

Departures from the paper, which is silent about them: the weight on the wheel is f_max - f, the best chromosome lives
on unchanged, and the numbers in ``Options``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

Genes = NDArray[np.int8]
Floats = NDArray[np.float64]


class Population(NamedTuple):
    """Chromosomes of P individuals for n agents.

    Attributes:
        order: shape (P, n, A).
        stops: shape (P, n, B).
    """

    order: Genes
    stops: Genes


class Species(Protocol):
    """What the genes mean."""

    def cost(self, population: Population) -> tuple[Floats, Floats]:
        """Collisions and stops of each chromosome, shape (P,) each."""

    def mutate(self, population: Population, chosen: NDArray[np.intp], rng: Generator) -> None:
        """Change the chosen chromosomes in place."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the genetic algorithm.

    Attributes:
        population: chromosomes.
        crossover: probability that a child has two parents instead of being the copy of one.
        mutation: probability that a child mutates.
        elite: how many of the best live on unchanged.
        alpha, beta: weight of a collision and of a stop in the fitness.
    """

    population: int = 100
    crossover: float = 1.0
    mutation: float = 0.1
    elite: int = 1
    alpha: float = 1.0
    beta: float = 0.02


class Stage(NamedTuple):
    """So many generations with or without the stops in the fitness."""

    generations: int
    count_stops: bool


def single_stage(generations: int) -> tuple[Stage, ...]:
    """Collisions and stops from the beginning (equation 3)."""
    return (Stage(generations, True),)


def two_stage(generations: int) -> tuple[Stage, ...]:
    """Collisions alone in the first half (equation 4), stops as well in the second (equation 3)."""
    return (Stage(generations // 2, False), Stage(generations - generations // 2, True))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an evolution led to.

    Attributes:
        order, stops: the best chromosome, shapes (n, A) and (n, B).
        collisions, stop_count: its cost.
        history: fitness, collisions and diversity at the beginning of each generation and at the end, the first two
            of the best chromosome, shape (generations + 1, 3); the fitness is that of the stage.
    """

    order: Genes
    stops: Genes
    collisions: float
    stop_count: float
    history: Floats


def evolve(
    species: Species, population: Population, stages: Sequence[Stage], options: Options, rng: Generator
) -> Outcome:
    """Breed a population through stages, each starting from the one before.

    Args:
        species: what the genes mean.
        population: the first generation; its size is kept.
        stages: see ``single_stage`` and ``two_stage``.
        options: see ``Options``.
        rng: source of all chance.

    Returns:
        The best chromosome of the last generation by the last stage's fitness, and the history.
    """
    collisions, stops = species.cost(population)
    history = []
    for stage in stages:
        beta = options.beta if stage.count_stops else 0.0
        for _ in range(stage.generations):
            f = options.alpha * collisions + beta * stops
            best = int(np.argmin(f))
            history.append((f[best], collisions[best], diversity(population)))
            population = _next_generation(species, population, f, options, rng)
            collisions, stops = species.cost(population)
    beta = options.beta if stages[-1].count_stops else 0.0
    f = options.alpha * collisions + beta * stops
    best = int(np.argmin(f))
    history.append((f[best], collisions[best], diversity(population)))
    return Outcome(
        population.order[best], population.stops[best], float(collisions[best]), float(stops[best]), np.array(history)
    )


def diversity(population: Population) -> float:
    """Mean Hamming distance over all pairs of chromosomes (equations 5 to 7), from the counts of each gene's values."""
    size = len(population.order)
    pairs = size * (size - 1) / 2
    return float(sum(_different_pairs(genes.reshape(size, -1)) for genes in population)) / pairs if pairs else 0.0


def _next_generation(
    species: Species, population: Population, f: Floats, options: Options, rng: Generator
) -> Population:
    order, stops, mutants = _breed(*population, f, options.elite, options.crossover, options.mutation, rng)
    children = Population(order, stops)
    species.mutate(children, mutants, rng)
    return children


@njit(cache=True)
def _breed(
    order: Genes, stops: Genes, f: Floats, elite: int, crossover: float, mutation: float, rng: Generator
) -> tuple[Genes, Genes, NDArray[np.intp]]:
    """Both parts of the children, the elite first, and which of the others mutate."""
    size = len(f)
    pairs = np.empty((size, 2), dtype=np.intp)
    best = np.argsort(f, kind="mergesort")[:elite]
    pairs[:elite, 0] = pairs[:elite, 1] = best
    pairs[elite:] = roulette(f, 2 * (size - elite), rng).reshape(-1, 2)
    alone = np.flatnonzero(rng.random(size - elite) >= crossover) + elite
    pairs[alone, 1] = pairs[alone, 0]
    orders = _cross(order, pairs, rng)
    stops = _cross(stops, pairs, rng)
    mutants = np.flatnonzero(rng.random(size) < mutation)
    return orders, stops, mutants[mutants >= elite]


@njit(cache=True)
def roulette(f: Floats, k: int, rng: Generator) -> NDArray[np.intp]:
    """Draw k chromosomes with weight f_max - f; all alike if all are equal."""
    weight = f.max() - f
    wheel = np.cumsum(weight if weight.any() else np.ones_like(f))
    drawn: NDArray[np.intp] = np.searchsorted(wheel, rng.random(k) * wheel[-1], side="right")
    return drawn


@njit(cache=True)
def _cross(genes: Genes, pairs: NDArray[np.intp], rng: Generator) -> Genes:
    """Children that have each agent's genes of this part from either parent, shape (P, n, A)."""
    _, n, length = genes.shape
    children = np.empty((len(pairs), n, length), dtype=genes.dtype)
    for c in range(len(pairs)):
        for i in range(n):
            parent = pairs[c, 0] if rng.random() < 0.5 else pairs[c, 1]
            for k in range(length):
                children[c, i, k] = genes[parent, i, k]
    return children


@njit(cache=True)
def _different_pairs(genes: Genes) -> int:
    """Pairs of chromosomes that differ, summed over the genes; genes are not negative."""
    size, length = genes.shape
    count = np.zeros(128, dtype=np.int64)
    total = 0
    for k in range(length):
        count[:] = 0
        same = 0
        for p in range(size):
            same += count[genes[p, k]]
            count[genes[p, k]] += 1
        total += size * (size - 1) // 2 - same
    return total


@njit(cache=True)
def step_stop(stops: Genes, k: int, most: int, rng: Generator) -> None:
    """Mutate one stop gene of an agent by one, up or down, within 0 and ``most``; stops has shape (B,)."""
    change = 1 if rng.random() < 0.5 else -1
    stops[k] = min(max(stops[k] + change, 0), most)
