"""AGVs that a fault keeps from their goals.

An AGV is *cut off* when its goal is closed, is held by an AGV that cannot move, or can be reached only through such
places. A cut-off AGV waits for the end of the fault. An AGV is *barred* when a cut-off AGV, or another barred AGV,
stands in its way. The fault is the cause here too, but the way may clear before the fault ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.costs import Costs
from controller.executor import Executor
from controller.fleet import Agv
from controller.types import AgvNumber
from sumo_nets.numbering import Numbered, Vertex


@dataclass(frozen=True, slots=True)
class CutOff:
    """Effects of faults on the ways of AGVs.

    Attributes:
        by_fault: AGVs that are cut off.
        barred: AGVs whose way is blocked by a cut-off or barred AGV.
    """

    by_fault: frozenset[AgvNumber] = frozenset()
    barred: frozenset[AgvNumber] = frozenset()


def find_cut_off(
    executor: Executor, agvs: Numbered[AgvNumber, Agv], costs: Costs, blocked: NDArray[np.uint8]
) -> CutOff:
    """The AGVs that are cut off or barred now.

    Args:
        executor: where the AGVs are, and what is closed.
        agvs: the fleet.
        costs: finds ways.
        blocked: parked cars, closed vertices, and those held by AGVs that cannot move, shape (n,).

    Returns:
        The AGVs; those that cannot move themselves are in neither set.
    """
    stopped = {agv.number for agv in agvs if agv.immobile}
    if not executor.closed and not stopped:
        return CutOff()
    walls = blocked.copy()
    held = {v for n in stopped for v in executor.agvs[n].trail}
    others = [agv for agv in agvs if agv.number not in stopped]

    def without_way() -> list[Agv]:
        return [agv for agv in others if _has_no_way(executor, agv, costs, walls, held)]

    by_fault = without_way()
    found, new = list(by_fault), by_fault
    while new:
        for agv in new:
            held.update(executor.agvs[agv.number].trail)
        walls[list(held)] = 1
        others = [agv for agv in others if agv not in new]
        new = without_way()
        found += new
    names = frozenset(agv.number for agv in by_fault)
    return CutOff(names, frozenset(agv.number for agv in found) - names)


def _has_no_way(executor: Executor, agv: Agv, costs: Costs, walls: NDArray[np.uint8], held: set[Vertex]) -> bool:
    """Whether a goal is closed, held, or out of reach, although parked cars alone would not prevent reaching it."""
    at = executor.agvs[agv.number].last
    if agv.goal == at:
        return False
    if agv.goal in executor.closed or agv.goal in held:
        return True
    return not costs.has_way(at, agv.goal, walls) and costs.has_way(at, agv.goal, costs.blocked)
