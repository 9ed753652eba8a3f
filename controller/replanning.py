"""Events that trigger a new plan (Shin et al. 2022, section 3), as far as the executor shows them.

The ACS reports new goals. This module finds the other events: collisions predicted within a look-ahead, plans that have
ended, and AGVs that stand still on the way to a goal. The executor never lets two AGVs meet, so a predicted collision
appears as a predicted wait: by the present orders and times, an AGV will wait where its plan does not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from controller.executor import Executor
from controller.fleet import Agv
from controller.retiming import retime
from controller.types import AgvNumber, Path
from sumo_nets.numbering import Vertex

#: Shorter waits than this many moves do not count.
LEAST_WAIT_MOVES = 0.5


def waits_ahead(executor: Executor, step: int, within: int, cell_steps: int) -> frozenset[tuple[AgvNumber, Vertex]]:
    """Where AGVs will have to wait for other AGVs.

    Args:
        executor: holds the accepted orders.
        step: current step.
        within: look-ahead, steps.
        cell_steps: steps of one ordinary move.

    Returns:
        Each AGV, and the vertex before which it waits.
    """
    least = max(1, round(LEAST_WAIT_MOVES * cell_steps))
    return frozenset(
        (agv, vertex)
        for agv, path in retime(executor, step).items()
        for vertex, wait in _waits(executor, step, path, within)
        if wait >= least
    )


def _waits(executor: Executor, step: int, path: Path, within: int) -> Iterator[tuple[Vertex, int]]:
    """Vertices before which a path waits, and how long."""
    a = executor.agvs[path.agv]
    ready, in_edge = executor.ready_step(path.agv, step), a.in_edge
    for i, vertex in enumerate(a.pending):
        if ready > within:
            return
        if i + 1 == len(path.vertices):  # the path is cut here: the AGV on the next vertex has no plan to leave it
            yield vertex, within
            return
        edge = executor.graph.edge_index[path.vertices[i], vertex]
        if i or a.turned_to != vertex:
            ready += executor.motion.turn(executor.graph, in_edge, edge, a.leaves_loaded)
        yield vertex, path.depart[i] - ready
        ready, in_edge = path.arrive[i + 1], edge


def without_plan(executor: Executor, agvs: Collection[Agv]) -> frozenset[AgvNumber]:
    """AGVs whose plan has ended short of the goal."""
    states = ((agv, executor.agvs[agv.number]) for agv in agvs if not agv.immobile)
    return frozenset(agv.number for agv, a in states if not a.pending and a.last != agv.goal)


def anybody_stands(executor: Executor, agvs: Collection[Agv]) -> bool:
    """Whether an AGV stands still although it has a goal elsewhere."""
    states = ((agv, executor.agvs[agv.number]) for agv in agvs if not agv.immobile)
    return any(a.standing and a.acting_until < 0 and a.last != agv.goal for agv, a in states)
