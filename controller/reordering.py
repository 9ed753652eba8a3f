"""Reordering: who is late lets others go first where that pays (Berndt, van Duijkeren, Palmieri, Kleiner and Keviczky
2024, switchable action dependency graph).

The executor keeps the visiting order of the plan, so everybody waits behind an AGV that is late. Here an AGV that
stands before a free vertex which another one shall visit first is put before it, there and at all vertices that
follow on the ways of both. The switched orders are taken if everybody gets as far as before when they are driven
through from now, which shows that they have no cycle, and if all together arrive earlier.

Departures from the paper: one switch at a time, found by trying, no optimisation over all of them. Guarantee: as
before, a delay only delays, since the orders taken have no cycle.
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
    """Let AGVs that wait for a late one go first where that pays.

    Args:
        executor: its orders are changed.
        step: now.
        least_gain: steps that all AGVs together must gain by a switch.
        keep: AGVs whose place in the orders is not touched.

    Returns:
        The switches made: who goes first now, before whom, and the steps gained.
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
    """Put one AGV before another at its next vertices, as long as that one is before it; returns the old orders."""
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
    """Steps by which all together arrive earlier; None if somebody does not get as far any more."""
    if any(len(after[n].vertices) < len(before[n].vertices) for n in before):
        return None
    return sum(path.arrive[-1] - after[n].arrive[len(path.vertices) - 1] for n, path in before.items())
