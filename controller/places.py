"""Choice of a slot for a car to park, and of a bay for a car to retrieve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from controller.costs import Costs
from controller.dispatch import AGE_WEIGHT, oldest_first, pairs
from controller.garage import Garage, Task
from controller.types import AgvNumber
from sumo_nets.graph import FloatArray, IntArray
from sumo_nets.numbering import NO_VERTEX, Vertex

#: Weight of the way from a slot to the next requested car when the slot is chosen. It is below 1 because another AGV
#: may take that car first.
ONWARD_WEIGHT = 0.5

#: Each second that a car has waited on its AGV counts as this many seconds of driving when bays are assigned. The
#: weight is lower than the one for tasks: while an AGV from far away is on its way to a bay, no other AGV can use
#: that bay.
WAIT_WEIGHT = 0.02


def choose_slot(garage: Garage, origin: Vertex, zone: str, costs: Costs, around_cars: bool = False) -> Vertex:
    """The free slot with the shortest way to it and on to the next requested car; -1 if all slots are taken.

    Args:
        garage: the books.
        origin: vertex where the car stands.
        zone: name prefix of the preferred slots, "" for any slot. If no preferred slot is free, any slot will do.
        costs: driving costs.
        around_cars: the way leads around the cars parked at present, and the way on to the next car does not count.
    """
    free = garage.slots[garage.slot_free & garage.slot_open]
    if zone:
        wanted = np.array([garage.graph.names[v].startswith(zone) for v in free], dtype=np.bool_)
        free = free[wanted] if wanted.any() else free
    if not len(free):
        return NO_VERTEX
    if around_cars:
        return Vertex(int(free[np.argmin(costs.around(origin)[free])]))
    cost = costs.out_of(origin)[free] + ONWARD_WEIGHT * _onward(free, garage.open, costs)
    return Vertex(int(free[np.argmin(cost)]))


def _onward(slots: IntArray, tasks: Sequence[Task], costs: Costs) -> FloatArray:
    """From each slot, the cost of the cheapest car to retrieve next, as in ``nearest_task``; 0 if there is none."""
    fetch = oldest_first([task for task in tasks if not task.is_park])
    if not fetch:
        return np.zeros(len(slots))
    younger = [AGE_WEIGHT * (task.requested_s - fetch[0].requested_s) / costs.step_s for task in fetch]
    return costs.turning_to_any([task.origin for task in fetch], younger)[slots]


def choose_bays(
    at: Mapping[AgvNumber, Vertex],
    since_s: Mapping[AgvNumber, float],
    free: Mapping[Vertex, int],
    leaving: Mapping[Vertex, int],
    costs: Costs,
) -> dict[AgvNumber, Vertex]:
    """Bays for AGVs that carry a car to a bay. Pairs of AGV and bay are chosen greedily, shortest way first.

    Args:
        at: the vertex of each of these AGVs.
        since_s: time at which the AGV lifted its car; a second since then counts as ``WAIT_WEIGHT`` seconds of driving.
        free: bays that may be chosen, with the steps until each bay can take a car.
        leaving: bays that another AGV is about to leave, with the steps until then. An AGV gets such a bay only if it
            would not arrive earlier.
        costs: driving costs.

    Returns:
        The bay of each AGV that gets one.
    """
    agvs, bays = sorted(at), sorted({*free, *leaving})
    if not bays:
        return {}
    here = [at[agv] for agv in agvs]
    way = np.column_stack([costs.turning_to(bay, loaded=True)[here] for bay in bays]).astype(np.float64)
    cost = way + [free.get(bay, 0) for bay in bays]
    cost += np.array([[WAIT_WEIGHT * since_s[agv] / costs.step_s] for agv in agvs])
    cost[way < [leaving.get(bay, 0) for bay in bays]] = np.inf
    return {agvs[row]: bays[column] for row, column in pairs(cost)}
