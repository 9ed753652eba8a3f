"""A bound on throughput that no controller can pass, for cars handed over at the AGVs' homes (see docs/thesis.md).

Parking a car takes an AGV at least its quickest way from its home to the slot, the lowering, and the quickest way back
before it can begin with the next one; fetching a car is the same with a lift. Nobody is ever in the way. All the work
together, shared out evenly, is a time that no controller can beat. Charging is left out, and so is the way back from
each AGV's last car of a run that only parks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from controller.rules import Rules
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import Motion
from sumo_nets.graph import Graph


def least_steps(
    graph: Graph, motion: Motion, rules: Rules, homes: Sequence[int], cars: int, park_only: bool = False
) -> int:
    """Steps below which no controller can park so many cars, and fetch them all unless ``park_only``.

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


def _ways(
    distances: Distances, graph: Graph, homes: Sequence[int], loaded: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Steps from each home to each slot, and from each slot back, shape (homes, slots); first turns are free."""
    out = [[distances.distance(home, -1, slot, loaded) for slot in graph.slots] for home in homes]
    back = [[distances.distance(slot, -1, home, loaded) for slot in graph.slots] for home in homes]
    return np.array(out, dtype=np.int64), np.array(back, dtype=np.int64)
