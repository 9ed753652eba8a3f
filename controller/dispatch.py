"""Dispatch assigns tasks to AGVs. The table ``DISPATCH`` holds the rules. ``places`` chooses slots and bays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import nsmallest

import numpy as np

from controller.costs import Costs
from controller.garage import Task
from controller.types import NO_AGV, AgvNumber
from sumo_nets.graph import FloatArray
from sumo_nets.numbering import Vertex


@dataclass(frozen=True, slots=True)
class Offer:
    """An open task offered to an AGV.

    Attributes:
        task: the task.
        agv: number of the AGV.
        origin: vertex where the AGV fetches the car.
    """

    task: Task
    agv: AgvNumber
    origin: Vertex


#: ``OLDEST``: number of tasks ``nearest_task`` compares. ``AGE_WEIGHT``: seconds of driving per second of waiting.
OLDEST = 400
AGE_WEIGHT = 0.2

#: A rule gets the open tasks in order of opening, the vertices of the available AGVs, the origins promised to an AGV,
#: and the costs. The task of a parked car is opened when the car is asked for; the task of a
#: car to be parked is opened when the car stands at a bay. The rule returns offers; each AGV, each task and each origin
#: occurs at most once.
Rule = Callable[[Sequence[Task], Mapping[AgvNumber, Vertex], Mapping[Vertex, AgvNumber], Costs], list[Offer]]


def nearest_agv(
    tasks: Sequence[Task], at: Mapping[AgvNumber, Vertex], taken: Mapping[Vertex, AgvNumber], costs: Costs
) -> list[Offer]:
    """First task first: each task, oldest first, gets the available AGV closest to its car."""
    free = dict(at)
    busy = dict(taken)
    offers = []
    for task in tasks:
        if not free:
            break
        holder = busy.get(task.origin, NO_AGV)
        if holder >= 0 and holder not in free:
            continue
        if holder >= 0:
            agv = holder
        elif task.origin < 0:  # a car stands ready at every home
            agv = min(free)
        else:
            to = costs.to(task.origin)
            agv = min(free, key=lambda a: (int(to[free[a]]), a))
        offers.append(Offer(task, agv, task.origin))
        if task.origin >= 0:
            busy[task.origin] = agv
        del free[agv]
    return offers


def nearest_task(
    tasks: Sequence[Task], at: Mapping[AgvNumber, Vertex], taken: Mapping[Vertex, AgvNumber], costs: Costs
) -> list[Offer]:
    """Repeatedly pair the AGV and task with the shortest way, among the oldest tasks and the available AGVs.

    Two effects save empty driving: an AGV that has delivered a car to a bay takes the car waiting at that bay, and
    among many requested cars those close to an AGV go first. Each second that a request has waited counts as
    ``AGE_WEIGHT`` seconds of driving, so that no request is passed over for ever.
    """
    oldest = oldest_first(tasks)
    agvs = np.array(sorted(at))
    here = np.array([at[agv] for agv in sorted(at)])
    younger_s = np.array([task.requested_s for task in oldest]) - oldest[0].requested_s
    cost = np.repeat(AGE_WEIGHT * younger_s[:, None] / costs.step_s, len(agvs), axis=1)
    for row, task in zip(cost, oldest, strict=True):
        if task.origin >= 0:  # otherwise a car stands ready at every home
            row += costs.turning_to(task.origin)[here]
        if taken.get(task.origin, NO_AGV) >= 0:
            row[agvs != taken[task.origin]] = np.inf
    return [Offer(oldest[j], AgvNumber(int(agvs[a])), oldest[j].origin) for j, a in pairs(cost)]


def oldest_first(tasks: Sequence[Task]) -> list[Task]:
    """The ``OLDEST`` oldest requests, in order of request time."""
    return nsmallest(OLDEST, tasks, key=lambda task: (task.requested_s, task.number))


def pairs(cost: FloatArray) -> Iterator[tuple[int, int]]:
    """Match rows with columns, cheapest pair first. Infinite entries are never matched. ``cost`` is overwritten."""
    for _ in range(min(cost.shape)):
        row, column = divmod(int(cost.argmin()), cost.shape[1])
        if cost[row, column] == np.inf:
            return
        yield row, column
        cost[row, :] = cost[:, column] = np.inf


def in_id_order(
    tasks: Sequence[Task], at: Mapping[AgvNumber, Vertex], taken: Mapping[Vertex, AgvNumber], costs: Costs
) -> list[Offer]:
    """In order of their numbers, AGVs take the first task whose place is not taken (thesis 2025)."""
    busy = dict(taken)
    left = list(tasks)
    offers = []
    for agv in sorted(at):
        task = next((j for j in left if busy.get(j.origin, agv) == agv), None)
        if task is None:
            continue
        left.remove(task)
        if task.origin >= 0:
            busy[task.origin] = agv
        offers.append(Offer(task, agv, task.origin))
    return offers


def first_come(
    tasks: Sequence[Task], at: Mapping[AgvNumber, Vertex], taken: Mapping[Vertex, AgvNumber], costs: Costs
) -> list[Offer]:
    """In order of their numbers, AGVs take parking tasks in turn, but fetch the nearest requested car.

    The thesis (2025) retrieves cars this way. "Nearest" counts the way around the cars parked at present.
    """
    left = [task for task in tasks if task.is_park == tasks[0].is_park]
    if left[0].is_park:
        return in_id_order(left, at, taken, costs)
    offers = []
    for agv in sorted(at)[: len(left)]:
        steps = costs.around(at[agv])
        task = min(left, key=lambda j: (int(steps[j.origin]), j.origin))
        left.remove(task)
        offers.append(Offer(task, agv, task.origin))
    return offers


DISPATCH: dict[str, Rule] = {
    "nearest-task": nearest_task,
    "nearest": nearest_agv,
    "id-order": in_id_order,
    "first-come": first_come,
}
