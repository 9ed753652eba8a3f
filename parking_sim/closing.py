"""What is told of requests at the end of a run: their rows in the record, and what holds the open ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.record import TaskRow
from controller.garage import Task
from controller.holds import Hold
from controller.types import RequestNumber
from sumo_nets.numbering import Numbered, Vertex

if TYPE_CHECKING:
    from analysis.holds import Held


def task_row(task: Task, names: Numbered[Vertex, str]) -> TaskRow:
    """A task's row in the record.

    Args:
        task: the task.
        names: of the vertices.
    """
    return TaskRow(
        request=task.number,
        kind=task.request.kind.value,
        car=task.car,
        state=task.state,
        reason=task.reason,
        agv=task.agv,
        origin=_name(task.origin, names),
        destination=_name(task.destination, names),
        requested_s=task.requested_s,
        at_bay_s=task.at_bay_s,
        ready_s=task.ready_s,
        assigned_s=task.assigned_s,
        lifted_s=task.lifted_s,
        delivered_s=task.delivered_s,
        done_s=task.done_s,
    )


def held_work(hold: Hold, tasks: Numbered[RequestNumber, Task], names: Numbered[Vertex, str]) -> Held:
    """A hold with names instead of numbers.

    Args:
        hold: why an AGV or a request makes no progress.
        tasks: all tasks of the run.
        names: of the vertices.
    """
    from analysis.holds import Held

    return Held(
        hold.agv,
        hold.request,
        car=tasks[hold.request].car if hold.request >= 0 else "",
        cause=hold.cause.value,
        chain=hold.chain,
        faults=hold.faults,
        place=_name(hold.vertex, names),
    )


def _name(vertex: Vertex, names: Numbered[Vertex, str]) -> str:
    return names[vertex] if vertex >= 0 else ""
