"""Robots between obstacles set in a grid: the environment of the two-stage genetic algorithm (2025, sections II, III).

Intersections stand in rows and columns; the aisle between two of them takes two time steps, so that its middle is a
place of its own. A robot waits before it leaves its start, or in the middle of an aisle, two steps at a time, and goes
a shortest way. On arrival it is gone.

A chromosome holds for each robot its directions, 1 up, 2 down, 3 right, 4 left, and then one stop more than directions:
before leaving, then in each aisle. Both parts are padded with zeros to the length of the longest way.

Where the paper is silent: each pair of robots in one place counts in each step, a swap counts if both robots were still
under way when it began, a robot is gone in the very step in which it arrives, a stop gene is at most ``MOST``, and it
is 1 at first with probability ``FIRST``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from controller.genetic.evolution import Floats, Genes, Options, Outcome, Population, Stage, evolve, step_stop
from controller.kernel import kernel

UP, DOWN, RIGHT, LEFT = 1, 2, 3, 4

#: Columns and rows a direction goes on.
STEP = np.array([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)], dtype=np.int64)

#: Largest stop gene, and the probability that a stop gene of the first generation is 1.
MOST = 5
FIRST = 0.5

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Instance:
    """Robots with starts and goals on a lattice.

    Attributes:
        columns, rows: intersections.
        starts, goals: column and row of each robot's intersections, shape (n, 2).
    """

    columns: int
    rows: int
    starts: Ints
    goals: Ints

    @property
    def lengths(self) -> Ints:
        """Aisles on each robot's shortest way, shape (n,)."""
        return np.asarray(np.abs(self.goals - self.starts).sum(axis=1))


def random_instance(robots: int, rng: Generator, columns: int = 8, rows: int = 5) -> Instance:
    """Starts at random, all different, and goals at random, all different; no robot's goal is its own start.

    Raises:
        ValueError: more robots than intersections.
    """
    places = columns * rows
    if robots > places:
        raise ValueError(f"robots: {robots}: {columns} x {rows} intersections have room for {places}")
    starts = rng.permutation(places)[:robots]
    goals = rng.permutation(places)[:robots]
    while (starts == goals).any():
        goals = rng.permutation(places)[:robots]
    return Instance(columns, rows, *(np.stack((v % columns, v // columns), axis=1) for v in (starts, goals)))


@dataclass(frozen=True, eq=False)
class Robots:
    """The species of an instance.

    Attributes:
        instance: the robots.
    """

    instance: Instance
    _scratch: _Scratch = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_scratch", _make_scratch(self.instance))

    def first_generation(self, size: int, rng: Generator) -> Population:
        """Random shortest ways and random stops, for so many chromosomes."""
        lengths = self.instance.lengths
        n, longest = len(lengths), int(lengths.max(initial=0))
        order = np.zeros((size, n, longest), dtype=np.int8)
        for i, (across, along) in enumerate((self.instance.goals - self.instance.starts).tolist()):
            ways = [RIGHT if across > 0 else LEFT] * abs(across) + [UP if along > 0 else DOWN] * abs(along)
            order[:, i, : len(ways)] = rng.permuted(np.tile(np.array(ways, dtype=np.int8), (size, 1)), axis=1)
        stops = (rng.random((size, n, longest + 1)) < FIRST).astype(np.int8)
        stops[:, np.arange(longest + 1) > lengths[:, None]] = 0
        return Population(order, stops)

    def cost(self, population: Population) -> tuple[Floats, Floats]:
        """Collisions and stops of each chromosome."""
        found = _cost(population.order, population.stops, self.instance.lengths, self._scratch)
        return found[:, 0].astype(np.float64), found[:, 1].astype(np.float64)

    def mutate(self, population: Population, chosen: NDArray[np.intp], rng: Generator) -> None:
        """In each robot of each chosen chromosome swap two directions and change one stop by one."""
        _mutate(population.order, population.stops, chosen, self.instance.lengths, rng)


@dataclass(frozen=True, slots=True)
class LatticePlan:
    """A plan's figures as the paper prints them.

    Attributes:
        collisions: of all robots.
        work_steps: mean steps from the beginning to arrival.
        stop_steps: mean steps of waiting.
    """

    collisions: int
    work_steps: float
    stop_steps: float


def plan_genetic(
    instance: Instance, stages: tuple[Stage, ...], options: Options, rng: Generator
) -> tuple[LatticePlan, Outcome]:
    """Plan by the genetic algorithm.

    Args:
        instance: the robots.
        stages: ``single_stage(1000)`` or ``two_stage(1000)`` in the paper.
        options, rng: see ``evolve``.

    Returns:
        The best plan's figures, and the evolution.
    """
    robots = Robots(instance)
    outcome = evolve(robots, robots.first_generation(options.population, rng), stages, options, rng)
    n = len(instance.starts)
    stop_steps = 2.0 * outcome.stop_count / n
    return LatticePlan(int(outcome.collisions), 2.0 * float(instance.lengths.mean()) + stop_steps, stop_steps), outcome


class _Scratch(NamedTuple):
    """Memory of the collision counter. Places are numbered on the grid of intersections and middles of aisles.

    Attributes:
        start: place of each robot's start, shape (n,).
        step: change of the place number in each direction, shape (5,).
        here: by step and place which chromosome was there last (in order of counting), and with how many robots,
            shape (T, places, 2).
        moves: the same for moves between a place and the next one to the right or above, four a place: right, back
            from there, up, back from there, shape (T, 4 places, 2).
        clock: chromosomes counted so far, shape (1,).
    """

    start: Ints
    step: Ints
    here: NDArray[np.int32]
    moves: NDArray[np.int32]
    clock: NDArray[np.int32]


def _make_scratch(instance: Instance) -> _Scratch:
    width, height = 2 * instance.columns - 1, 2 * instance.rows - 1
    longest = int(instance.lengths.max(initial=0))
    steps = 2 * (longest + MOST * (longest + 1)) + 1
    return _Scratch(
        start=2 * instance.starts[:, 1] * width + 2 * instance.starts[:, 0],
        step=STEP @ np.array([1, width]),
        here=np.zeros((steps, width * height, 2), dtype=np.int32),
        moves=np.zeros((steps, 4 * width * height, 2), dtype=np.int32),
        clock=np.zeros(1, dtype=np.int32),
    )


@njit(cache=True)
def _cost(order: Genes, stops: Genes, lengths: Ints, scratch: _Scratch) -> Ints:
    """Collisions and stops of each chromosome, shape (P, 2)."""
    found = np.zeros((len(order), 2), dtype=np.int64)
    for p in range(len(order)):
        scratch.clock[0] += 1
        for i in range(len(lengths)):
            found[p, 0] += _drive(scratch.start[i], order[p, i], stops[p, i], lengths[i], scratch)
            for k in range(lengths[i] + 1):
                found[p, 1] += stops[p, i, k]
    return found


@kernel
def _drive(at: int, order: Genes, stops: Genes, length: int, scratch: _Scratch) -> int:
    """Let a robot drive among those that have driven before; how many of them it meets, step by step."""
    here, moves, now = scratch.here, scratch.moves, scratch.clock[0]
    met, t = 0, 0
    for half in range(2 * length):
        k = (half + 1) // 2  # stops are made at the start and in the middle of aisles, which even halves lead into
        waits = 2 * stops[k] if half == 0 or half % 2 else 0
        for _ in range(waits + 1):
            met += _note(here, (t, at), now)
            t += 1
        step = scratch.step[order[half // 2]]
        low, back = (at, 0) if step > 0 else (at + step, 1)
        side = 0 if abs(step) == 1 else 2
        _note(moves, (t - 1, 4 * low + side + back), now)
        opposite = 4 * low + side + 1 - back
        if moves[t - 1, opposite, 0] == now:
            met += moves[t - 1, opposite, 1]
        at += step
    return met


@kernel
def _note(table: NDArray[np.int32], spot: tuple[int, int], now: int) -> int:
    """Count one more robot of this chromosome at (step, place); how many there were before."""
    t, place = spot
    before = table[t, place, 1] if table[t, place, 0] == now else np.int32(0)
    table[t, place, 0] = now
    table[t, place, 1] = before + 1
    return int(before)


@njit(cache=True)
def _mutate(order: Genes, stops: Genes, chosen: NDArray[np.intp], lengths: Ints, rng: Generator) -> None:
    for p in chosen:
        for i in range(len(lengths)):
            a, b = int(rng.random() * lengths[i]), int(rng.random() * lengths[i])
            order[p, i, a], order[p, i, b] = order[p, i, b], order[p, i, a]
            step_stop(stops[p, i], int(rng.random() * (lengths[i] + 1)), MOST, rng)
