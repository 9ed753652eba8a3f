"""Reordering: late AGVs let other AGVs go first where that saves time.

The method follows Berndt, van Duijkeren, Palmieri, Kleiner and Keviczky (2024, switchable action dependency graph).

The executor keeps the visiting order of the plan, so other AGVs wait behind a late AGV. A switch helps an AGV that
stands before a free vertex reserved for a later visitor. The waiting AGV goes first, at this vertex and at all
following vertices that both ways share. The switched orders are simulated from now on. They are accepted under two
conditions: every AGV gets as far as before (so the orders have no cycle), and the total arrival time falls.

Departures from the paper: switches are tried one at a time; no optimisation covers all of them together. Guarantee: a
delay causes no deadlock, because the accepted orders have no cycle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping

from controller.executor import Executor
from controller.retiming import retime
from controller.types import AgvNumber, Path
from sumo_nets.numbering import Vertex, numbered


def reorder(
    executor: Executor, step: int, least_gain: int, keep: Collection[AgvNumber] = ()
) -> list[tuple[AgvNumber, AgvNumber, int]]:
    """Let AGVs that wait for a late AGV go first where that saves time.

    Args:
        executor: its visiting orders are changed.
        step: current step.
        least_gain: least total gain of a switch, in steps.
        keep: AGVs whose places in the orders stay as they are.

    Returns:
        The switches made: the AGV that now goes first, the AGV it passes, and the steps gained.
    """
    made = []
    before: Mapping[AgvNumber, Path] | None = None
    for agv, a in numbered(executor.agvs):
        if not (a.standing and a.acting_until < 0 and a.pending and a.able) or agv in keep:
            continue
        vertex = a.pending[0]
        ahead = executor.order[vertex][0]
        if executor.owner[vertex] != -1 or ahead == agv or ahead in keep:
            continue
        before = before or retime(executor, step)
        old = _switch(executor, agv, ahead)
        after = retime(executor, step)
        gain = _gain(before, after)
        if gain is not None and gain >= least_gain:
            executor.reconsider(agv)
            made.append((agv, ahead, gain))
            before = after
        else:
            for v, queue in old.items():
                executor.order[v] = queue
    return made


def _switch(executor: Executor, agv: AgvNumber, ahead: AgvNumber) -> dict[Vertex, deque[AgvNumber]]:
    """Put one AGV before another at their next common vertices. Returns the old orders."""
    old = {}
    for v in executor.agvs[agv].pending:
        queue = executor.order[v]
        if v in old or ahead not in queue or queue.index(ahead) > queue.index(agv):
            break
        old[v] = deque(queue)
        queue.remove(agv)
        queue.insert(queue.index(ahead), agv)
    return old


def _gain(before: Mapping[AgvNumber, Path], after: Mapping[AgvNumber, Path]) -> int | None:
    """Steps gained in total; None if some AGV no longer gets as far as before."""
    if any(len(after[n].vertices) < len(before[n].vertices) for n in before):
        return None
    return sum(path.arrive[-1] - after[n].arrive[len(path.vertices) - 1] for n, path in before.items())
