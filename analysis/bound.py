"""Bounds on throughput that no controller can pass: before a run, and for the tasks that a run has done.

``least_steps``, for cars handed over at the AGVs' homes (see docs/thesis.md):

Parking a car takes an AGV at least its quickest way from its home to the slot, the lowering, and the quickest way back
before it can begin with the next one; fetching a car is the same with a lift. Nobody is ever in the way. All the work
together, shared out evenly, is a time that no controller can beat. Charging is left out, and so is the way back from
each AGV's last car of a run that only parks.

``least_work``, for tasks of any kind, by the places between which they were done: the quickest ways with the cars, the
lifts, and the ways without cars from the place where one task ends, or from home, to the one where another begins,
paired off so that they are as short as possible in all. No order of the tasks needs less.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from controller.rules import Rules
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import Motion
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, Vertex


def least_steps(
    graph: Graph, motion: Motion, rules: Rules, homes: Collection[Vertex], cars: int, park_only: bool = False
) -> int:
    """Steps that no controller can undercut when it parks ``cars`` cars, and fetches all of them unless ``park_only``.

    Args:
        graph, motion: the garage and how long moves take.
        rules: how long lifting and lowering takes; AGVs take tasks at home only (not ``assign_on_return``).
        homes: home of each AGV.
        cars: number of cars; they may be parked in the slots that are quickest to serve.
        park_only: the run ends with the last car parked.

    Returns:
        Planning steps.
    """
    distances = Distances(Space(graph, motion))
    empty, loaded = (_ways(distances, graph, homes, is_loaded) for is_loaded in (False, True))
    park = np.sort((loaded[0] + empty[1]).min(axis=0) + rules.lift_bay + rules.lower_slot)[:cars]
    fetch = np.sort((empty[0] + loaded[1]).min(axis=0) + rules.lift_slot + rules.lower_bay)[:cars]
    if not park_only:
        return math.ceil(int(park.sum() + fetch.sum()) / len(homes))
    back = int(empty[1].min(axis=0).max())
    return math.ceil(int(park.sum()) / len(homes)) - back


def least_work(
    graph: Graph, motion: Motion, rules: Rules, homes: Collection[Vertex], tasks: Sequence[tuple[Vertex, Vertex]]
) -> int:
    """Steps of all AGVs together that these tasks take at least.

    Args:
        graph, motion: the garage and how long moves take.
        rules: how long lifting and lowering takes.
        homes: home of each AGV.
        tasks: for each task where the car is lifted and where it is lowered.

    Returns:
        Planning steps; ways home and charging are left out.
    """
    if not tasks:
        return 0
    distances = Distances(Space(graph, motion))
    steps = _with_cars(distances, graph, rules, tasks)
    before = [destination for _, destination in tasks] + list(homes)
    empty = np.array([[distances.distance(v, NO_EDGE, origin, False) for origin, _ in tasks] for v in before])
    return int(steps + empty[linear_sum_assignment(empty)].sum())


def work_alone(graph: Graph, motion: Motion, rules: Rules, home: Vertex, tasks: Sequence[tuple[Vertex, Vertex]]) -> int:
    """Steps that one AGV takes for its tasks in this order with nobody in its way, and no customer to wait for.

    Args:
        graph, motion, rules: see :func:`least_work`.
        home: where it starts.
        tasks: where the car is lifted and where it is lowered, in the order of its tasks.

    Returns:
        Planning steps until the last car is down.
    """
    distances = Distances(Space(graph, motion))
    before = [home, *(destination for _, destination in tasks)]
    empty = (distances.distance(v, NO_EDGE, origin, False) for v, (origin, _) in zip(before, tasks, strict=False))
    return _with_cars(distances, graph, rules, tasks) + sum(empty)


def _with_cars(distances: Distances, graph: Graph, rules: Rules, tasks: Sequence[tuple[Vertex, Vertex]]) -> int:
    """Steps of the tasks themselves: lifts, and the quickest ways with the cars."""
    slots = set(graph.slots)
    steps = 0
    for origin, destination in tasks:
        steps += distances.distance(origin, NO_EDGE, destination, True)
        steps += rules.lift_slot if origin in slots else rules.lift_bay
        steps += rules.lower_slot if destination in slots else rules.lower_bay
    return steps


def _ways(
    distances: Distances, graph: Graph, homes: Collection[Vertex], loaded: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Steps from each home to each slot, and from each slot back, shape (homes, slots); first turns are free."""
    out = [[distances.distance(home, NO_EDGE, slot, loaded) for slot in graph.slots] for home in homes]
    back = [[distances.distance(slot, NO_EDGE, home, loaded) for slot in graph.slots] for home in homes]
    return np.array(out, dtype=np.int64), np.array(back, dtype=np.int64)
