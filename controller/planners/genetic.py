"""Genetic planning in a garage: the default planner's window, bred further in one stage or two (after the 2025 paper).

Meant for batches planned ahead, such as many departures at once. WHCA* plans first. Each AGV then has a few routes:
what WHCA* found for it, its quickest way as if it were alone, and ways around places on that one. In a chromosome its
*order* is the number of a route, and its *stops* are waits on it, one before each move, in units of a typical move.
WHCA*'s own plan (all zeros) is in the first generation; the fitness counts collisions and delay in units.

Departures from the paper: a garage's lanes seldom leave several shortest ways, so that directions are routes to choose
from, and delay, which on shortest ways is the stops, stands for the stops. Fixed paths collide as robots do.
Guarantee: free of conflicts like WHCA*'s plan, and never worse than it in agents that hold, then in delay. What still
collides after the last generation holds its place, those in most collisions first; if that is worse than WHCA*'s plan,
WHCA*'s plan is the answer. Without a delay to remove nothing is bred.
Limits: some thirty times the work of WHCA* with the defaults; what it wins is waiting that the order of priorities
caused, a few per cent of the delay. It helps where many agents meet in one window.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from controller.conflicts import find_conflicts
from controller.genetic.evolution import (
    Floats,
    Genes,
    Options,
    Population,
    Stage,
    evolve,
    single_stage,
    step_stop,
    two_stage,
)
from controller.kernel import kernel
from controller.planners.whca import make_whca
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.types import FOREVER, NO_AGV, AgvNumber, Motion, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import Graph, IntArray

#: Largest stop gene, and the probability that a stop gene of the first generation is 1.
MOST = 9
FIRST = 0.1

#: Owner of places closed while a way around them is looked for.
_NOBODY = AgvNumber(-2)


@dataclass(frozen=True, slots=True)
class GeneticOptions:
    """Options of genetic planning.

    Attributes:
        generations: in all stages together.
        population: chromosomes.
        routes: routes of each agent, WHCA*'s and the quickest one included.
        mutation: probability that a child mutates.
        beta: weight of a unit of delay against a collision.
    """

    generations: int = field(default=60, metadata={"least": 1})
    population: int = field(default=40, metadata={"least": 2})
    routes: int = field(default=4, metadata={"least": 2})
    mutation: float = 0.1
    beta: float = 0.02


class GeneticPlanner:
    """The planner.

    Args:
        graph, motion: the garage and how long moves take.
        options: see ``GeneticOptions``.
        stages: from a number of generations to the stages of the evolution.
    """

    def __init__(
        self, graph: Graph, motion: Motion, options: GeneticOptions, stages: Callable[[int], tuple[Stage, ...]]
    ) -> None:
        self.options = options
        self._whca = make_whca(graph, motion)
        self._stages = stages(options.generations)
        self._search = PathSearch(self._whca.distances)
        self._table = ReservationTable(len(graph.names), motion.following)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem; status and holding agents as for WHCA*. Counters are those of WHCA*."""
        default = self._whca(problem)
        fleet = _Fleet(problem, self._whca.distances)
        if fleet.score(default.paths) == (0, 0):
            return default
        self._search.begin(problem)
        self._table.reset(problem.fixed)
        candidates = [self._candidates(problem, agent, default) for agent in problem.agents]
        species = _Species(fleet, candidates)
        options = Options(self.options.population, mutation=self.options.mutation, beta=self.options.beta)
        rng = np.random.default_rng(problem.seed)
        population = species.first_generation(options.population, rng)
        best = evolve(species, population, self._stages, options, rng)
        paths = _repair(problem, species.paths(best.order[:, 0], best.stops))
        if fleet.score(paths) >= fleet.score(default.paths):
            return default
        failed = {a.agv: default.failed.get(a.agv, NO_AGV) for a in problem.agents if a.agv not in paths}
        return PlanResult(Status.PARTIAL if failed else Status.SOLVED, paths, failed, default.counters)

    def _candidates(self, problem: PlanningProblem, agent: PlanAgent, default: PlanResult) -> list[Path]:
        """The agent's routes, the default planner's first; an agent that holds in it has its place as a route."""
        stay = Path(agent.agv, (agent.vertex,), (0,), (), problem.window_steps)
        routes = [default.paths.get(agent.agv, stay)]
        alone = self._search.find_path(problem, agent, self._table)
        if alone is None:
            return routes
        routes.append(alone)
        inner = alone.vertices[1:-1]
        for k in np.unique(np.linspace(0, len(inner) - 1, self.options.routes - 2).astype(int)) if inner else ():
            self._table.hold(inner[k], 0, FOREVER, _NOBODY)
            around = self._search.find_path(problem, agent, self._table)
            self._table.remove(_NOBODY)
            if around is not None:
                routes.append(around)
        return routes


class _Fleet:
    """The agents of a problem, and how good a plan is for them.

    Attributes:
        free: earliest step at which each agent could be at its goal if it were alone.
        unit: steps of a typical move.
    """

    def __init__(self, problem: PlanningProblem, distances: Distances) -> None:
        self.problem = problem
        self.distances = distances
        self.unit = int(np.median(problem.motion.edge_steps))
        self.free = [a.ready_step + distances.distance(a.vertex, a.in_edge, a.goal, a.loaded) for a in problem.agents]

    def arrival(self, agent: PlanAgent, path: Path) -> int:
        """Step at which the agent is at its goal at the earliest if it follows a path and is alone afterwards."""
        last = path.arrive[-1] if len(path.vertices) > 1 else agent.ready_step
        if path.vertices[-1] == agent.goal:
            return last
        return max(last, min(self.problem.window_steps, FOREVER)) + self.rest(agent, path)

    def rest(self, agent: PlanAgent, path: Path) -> int:
        """Steps from a path's end to the goal."""
        v = path.vertices
        edge = self.problem.graph.edge_index[v[-2], v[-1]] if len(v) > 1 else agent.in_edge
        return self.distances.distance(v[-1], edge, agent.goal, agent.loaded)

    def score(self, paths: Mapping[AgvNumber, Path]) -> tuple[int, int]:
        """Agents without a path, and steps of delay of the others; less is better."""
        late = [
            self.arrival(agent, paths[agent.agv]) - free
            for agent, free in zip(self.problem.agents, self.free, strict=True)
            if agent.agv in paths and free < FOREVER
        ]
        return len(self.problem.agents) - len(paths), sum(late)


class _Routes(NamedTuple):
    """The candidates of n agents, at most K routes of M vertices each, padded.

    Attributes:
        vertex: shape (n, K, M).
        size: vertices of each route, shape (n, K).
        pause: least steps between arrival (or being ready) and departure at each vertex, shape (n, K, M).
        drive: steps of each move, shape (n, K, M).
        least, rest: an agent is at its goal ``rest`` after the end of the route, or after step ``least``, (n, K).
        ready, free: of each agent, shape (n,).
        scale: unit, window, 1 if following.
    """

    vertex: IntArray
    size: IntArray
    pause: IntArray
    drive: IntArray
    least: IntArray
    rest: IntArray
    ready: IntArray
    free: IntArray
    scale: IntArray


#: Columns of ``_Visits.rows``: steps from START to END at a vertex, coming from BEFORE, going on to AFTER; OLDER is the
#: next row of the same vertex, -1 for none.
START, END, AGENT, BEFORE, AFTER, OLDER = range(6)


class _Visits(NamedTuple):
    """Who is where when, as a list for each vertex; those of the fixed paths are there for all chromosomes.

    Attributes:
        rows: shape (R, 6); the first ones are those of fixed paths.
        fixed: newest of them for each vertex, shape (v,), -1 for none.
        newest: newest row of each vertex and the chromosome it is of, shape (v, 2).
        counts: number of fixed rows, chromosomes counted so far.
    """

    rows: IntArray
    fixed: IntArray
    newest: IntArray
    counts: IntArray


class _Species:
    """AGVs on routes of their own; see ``evolution.Species``."""

    def __init__(self, fleet: _Fleet, candidates: Sequence[Sequence[Path]]) -> None:
        self.fleet = fleet
        self.candidates = candidates
        self._routes = _tabulate(fleet, candidates)
        self._choices: IntArray = np.array([len(routes) for routes in candidates], dtype=np.int32)
        self._visits = _fixed_visits(fleet.problem, int(self._routes.vertex.size // self._routes.vertex.shape[1]))

    def first_generation(self, size: int, rng: Generator) -> Population:
        """The default plan, then random routes with few stops."""
        n, _, longest = self._routes.vertex.shape
        order = (rng.random((size, n, 1)) * self._choices[:, None]).astype(np.int8)
        stops = (rng.random((size, n, longest)) < FIRST).astype(np.int8)
        order[0], stops[0] = 0, 0
        return Population(order, stops)

    def cost(self, population: Population) -> tuple[Floats, Floats]:
        """Collisions, and delay in units."""
        found = np.zeros((len(population.order), 2), dtype=np.int64)
        _cost(*population, self._routes, self._visits, found)
        return found[:, 0].astype(np.float64), found[:, 1] / self.fleet.unit

    def mutate(self, population: Population, chosen: NDArray[np.intp], rng: Generator) -> None:
        """In each agent of each chosen chromosome draw a route and change one stop by one."""
        _mutate(population.order, population.stops, chosen, self._choices, rng)

    def paths(self, order: Genes, stops: Genes) -> dict[AgvNumber, Path]:
        """A chromosome's paths, as far as the window and with complete windows only those that reach the goal."""
        problem = self.fleet.problem
        paths = {}
        for i, agent in enumerate(problem.agents):
            path = _timed(problem, agent, self.candidates[i][order[i]], stops[i], self.fleet.unit)
            if path.vertices[-1] == agent.goal or problem.window_steps < FOREVER:
                paths[agent.agv] = path
        return paths


def _timed(problem: PlanningProblem, agent: PlanAgent, route: Path, stops: Genes, unit: int) -> Path:
    """A candidate with a chromosome's stops, cut where the next vertex would be entered beyond the window."""
    following, window = problem.motion.following, min(problem.window_steps, FOREVER)
    arrive, depart = [0], list[int]()
    t = was = agent.ready_step
    for j, left in enumerate(route.depart):
        t += left - was + unit * int(stops[j])
        was = route.arrive[j + 1]
        steps = was - left
        if (t + steps if following else t) >= window:
            break
        depart.append(t)
        t += steps
        arrive.append(t)
    end = route.vertices[len(depart)]
    until = window if window >= FOREVER or end != agent.goal else max(window, arrive[-1] + agent.dwell_steps)
    return Path(agent.agv, route.vertices[: len(arrive)], tuple(arrive), tuple(depart), max(until, arrive[-1]))


def _repair(problem: PlanningProblem, paths: dict[AgvNumber, Path]) -> dict[AgvNumber, Path]:
    """Let those that collide hold their places, the ones in most collisions first, until none collides."""
    paths = dict(paths)
    starts = {agent.agv: agent.vertex for agent in problem.agents}
    while True:
        standing = [Path(n, (v,), (0,), (), problem.window_steps) for n, v in starts.items() if n not in paths]
        found = find_conflicts([*problem.fixed, *paths.values(), *standing], problem.motion, problem.window_steps)
        involved = Counter(agv for conflict in found for agv in conflict.agents if agv in paths)
        if not involved:
            return paths
        del paths[max(involved, key=lambda agv: (involved[agv], agv))]


def _tabulate(fleet: _Fleet, candidates: Sequence[Sequence[Path]]) -> _Routes:
    problem = fleet.problem
    n, most = len(candidates), max(map(len, candidates))
    longest = max(len(path.vertices) for routes in candidates for path in routes)
    window = min(problem.window_steps, FOREVER)
    deep, flat = (n, most, longest), (n, most)
    vertex, pause, drive = (np.zeros(deep, dtype=np.int32) for _ in range(3))
    size, least, rest = (np.zeros(flat, dtype=np.int32) for _ in range(3))
    for i, (agent, routes) in enumerate(zip(problem.agents, candidates, strict=True)):
        for k, path in enumerate(routes):
            length = len(path.vertices)
            arrive = np.array((agent.ready_step, *path.arrive[1:]))
            vertex[i, k, :length] = path.vertices
            size[i, k] = length
            pause[i, k, : length - 1] = np.array(path.depart, dtype=np.int64) - arrive[:-1]
            drive[i, k, : length - 1] = arrive[1:] - np.array(path.depart, dtype=np.int64)
            if path.vertices[-1] != agent.goal:
                least[i, k], rest[i, k] = window, fleet.rest(agent, path)
    ready = np.array([agent.ready_step for agent in problem.agents], dtype=np.int32)
    scale = np.array([fleet.unit, window, problem.motion.following], dtype=np.int32)
    return _Routes(vertex, size, pause, drive, least, rest, ready, np.array(fleet.free, dtype=np.int32), scale)


def _fixed_visits(problem: PlanningProblem, more: int) -> _Visits:
    """The visits of the fixed paths, and room for so many more."""
    rows: list[tuple[int, ...]] = []
    newest = np.full(len(problem.graph.names), -1, dtype=np.int32)
    for path in problem.fixed:
        v = (-1, *path.vertices, -1)
        begins = path.arrive if problem.motion.following else (0, *path.depart)
        for i, (start, end) in enumerate(zip(begins, (*path.arrive[1:], path.until), strict=True)):
            rows.append((start, end, -1, v[i], v[i + 2], int(newest[v[i + 1]])))
            newest[v[i + 1]] = len(rows) - 1
    table = np.zeros((len(rows) + more, 6), dtype=np.int32)
    table[: len(rows)] = np.array(rows, dtype=np.int32).reshape(-1, 6)
    return _Visits(table, newest, np.zeros((len(newest), 2), dtype=np.int32), np.array([len(rows), 0], dtype=np.int32))


@kernel
def _cost(order: Genes, stops: Genes, routes: _Routes, visits: _Visits, found: NDArray[np.int64]) -> None:
    """Add collisions and steps of delay of each chromosome to ``found``, shape (P, 2)."""
    for p in range(len(order)):
        visits.counts[1] += 1
        row = visits.counts[0]
        for i in range(len(routes.ready)):
            met, row, arrival = _drive(i, order[p, i, 0], stops[p, i], routes, visits, row)
            found[p, 0] += met
            found[p, 1] += max(0, arrival - routes.free[i])


@kernel
def _drive(i: int, k: int, stops: Genes, routes: _Routes, visits: _Visits, row: int) -> tuple[int, int, int]:
    """Let an agent drive among those before it: the agents it meets, the next free row, and its arrival at the goal."""
    unit, window, following = routes.scale
    size = routes.size[i, k]
    met, entered, t = 0, 0, routes.ready[i]
    for j in range(size):
        end = FOREVER
        depart = 0
        if j + 1 < size:
            depart = t + routes.pause[i, k, j] + unit * stops[j]
            t = depart + routes.drive[i, k, j]
            end = t
        if entered < window:
            new = visits.rows[row]
            new[START], new[END], new[AGENT] = entered, end, i
            new[BEFORE] = routes.vertex[i, k, j - 1] if j > 0 else -1
            new[AFTER] = routes.vertex[i, k, j + 1] if j + 1 < size else -1
            met += _enter(routes.vertex[i, k, j], row, visits, following, window)
            row += 1
        entered = t if following else depart
    return met, row, max(t, routes.least[i, k]) + routes.rest[i, k]


@kernel
def _enter(v: int, row: int, visits: _Visits, following: int, window: int) -> int:
    """Add a visit to its vertex; how many earlier ones it overlaps, or swaps with."""
    now = visits.counts[1]
    if visits.newest[v, 1] != now:
        visits.newest[v, 0] = visits.fixed[v]
        visits.newest[v, 1] = now
    new = visits.rows[row]
    new[OLDER] = visits.newest[v, 0]
    visits.newest[v, 0] = row
    met = 0
    other = new[OLDER]
    while other >= 0:
        old = visits.rows[other]
        if old[AGENT] != new[AGENT]:
            overlap = old[START] < new[END] and new[START] < old[END] and old[START] < window
            swap = following and (
                (old[END] == new[START] and old[AFTER] == new[BEFORE] and old[AFTER] >= 0)
                or (new[END] == old[START] and new[AFTER] == old[BEFORE] and new[AFTER] >= 0)
            )
            met += overlap or swap
        other = old[OLDER]
    return met


@njit(cache=True)
def _mutate(order: Genes, stops: Genes, chosen: NDArray[np.intp], choices: IntArray, rng: Generator) -> None:
    for p in chosen:
        for i in range(len(choices)):
            order[p, i, 0] = int(rng.random() * choices[i])
            step_stop(stops[p, i], int(rng.random() * stops.shape[2]), MOST, rng)


def make_ga_single(graph: Graph, motion: Motion, options: GeneticOptions | None = None) -> GeneticPlanner:
    """A single-stage genetic planner for one garage; see ``make_ga_two_stage``."""
    return GeneticPlanner(graph, motion, options or GeneticOptions(), single_stage)


def make_ga_two_stage(graph: Graph, motion: Motion, options: GeneticOptions | None = None) -> GeneticPlanner:
    """A two-stage genetic planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``GeneticOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return GeneticPlanner(graph, motion, options or GeneticOptions(), two_stage)
