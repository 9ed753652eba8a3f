"""Dispatch: which AGV takes which job, and which slot a car gets. Rules stand in the table ``DISPATCH``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from heapq import nsmallest

import numpy as np

from controller.costs import Costs
from controller.garage import Garage, Job


@dataclass(frozen=True, slots=True)
class Offer:
    """An open job for an AGV, with where to fetch the car.

    Attributes:
        job: the job.
        agv: number of the AGV.
        origin: vertex where the car is fetched.
    """

    job: Job
    agv: int
    origin: int


#: How many jobs ``nearest_job`` looks at, and the seconds of driving that a second of waiting outweighs.
OLDEST = 200
AGE_WEIGHT = 0.2

#: A rule gets the open jobs in the order in which they were opened (cars to be fetched when they are asked for, cars to
#: be parked when they stand at a bay), the vertices of the available AGVs, the origins that are taken by an AGV, and
#: the costs. It returns offers; each AGV, each job and each origin at most once.
Rule = Callable[[Sequence[Job], Mapping[int, int], Mapping[int, int], Costs], list[Offer]]


def nearest_agv(jobs: Sequence[Job], at: Mapping[int, int], taken: Mapping[int, int], costs: Costs) -> list[Offer]:
    """Jobs in the order in which they were opened; each gets the available AGV that is nearest to the car."""
    free = dict(at)
    busy = dict(taken)
    offers = []
    for job in jobs:
        if not free:
            break
        holder = busy.get(job.origin, -1)
        if holder >= 0 and holder not in free:
            continue
        if holder >= 0:
            agv = holder
        elif job.origin < 0:  # cars stand ready at every home
            agv = min(free)
        else:
            to = costs.to(job.origin)
            agv = min(free, key=lambda a: (int(to[free[a]]), a))
        offers.append(Offer(job, agv, job.origin))
        if job.origin >= 0:
            busy[job.origin] = agv
        del free[agv]
    return offers


def nearest_job(jobs: Sequence[Job], at: Mapping[int, int], taken: Mapping[int, int], costs: Costs) -> list[Offer]:
    """Of the oldest jobs and the available AGVs the pair with the shortest way, then the next one.

    An AGV that has brought a car to a bay takes the one that waits there, and of many cars that are asked for those on
    its way go first; both save empty ways. Each second that a request is older counts as ``AGE_WEIGHT`` seconds of
    driving, so that nobody is passed over for ever.
    """
    oldest = nsmallest(OLDEST, jobs, key=lambda job: (job.requested_s, job.number))
    agvs = np.array(sorted(at))
    here = np.array([at[agv] for agv in sorted(at)])
    cost = np.empty((len(oldest), len(agvs)))
    for row, job in zip(cost, oldest, strict=True):
        row[:] = AGE_WEIGHT * (job.requested_s - oldest[0].requested_s) / costs.step_s
        if job.origin >= 0:  # else a car stands ready at every home
            row += costs.to(job.origin)[here]
            holder = taken.get(job.origin, -1)
            if holder >= 0:
                row[agvs != holder] = np.inf
    offers: list[Offer] = []
    while len(offers) < min(cost.shape):
        j, a = divmod(int(cost.argmin()), len(agvs))
        if cost[j, a] == np.inf:
            break
        offers.append(Offer(oldest[j], int(agvs[a]), oldest[j].origin))
        cost[j, :] = cost[:, a] = np.inf
    return offers


def in_id_order(jobs: Sequence[Job], at: Mapping[int, int], taken: Mapping[int, int], costs: Costs) -> list[Offer]:
    """AGVs in order of their numbers; each takes the first job whose place is not taken (thesis 2025)."""
    busy = dict(taken)
    left = list(jobs)
    offers = []
    for agv in sorted(at):
        job = next((j for j in left if busy.get(j.origin, agv) == agv), None)
        if job is None:
            continue
        left.remove(job)
        if job.origin >= 0:
            busy[job.origin] = agv
        offers.append(Offer(job, agv, job.origin))
    return offers


def first_come(jobs: Sequence[Job], at: Mapping[int, int], taken: Mapping[int, int], costs: Costs) -> list[Offer]:
    """AGVs in order of their numbers; a car is parked in its turn, but of those to be fetched the nearest goes first.

    So the thesis (2025) fetches cars: whichever parked car is nearest to the AGV as the cars stand now.
    """
    left = [job for job in jobs if job.is_park == jobs[0].is_park]
    if left[0].is_park:
        return in_id_order(left, at, taken, costs)
    offers = []
    for agv in sorted(at)[: len(left)]:
        steps = costs.around(at[agv])
        job = min(left, key=lambda j: (int(steps[j.origin]), j.origin))
        left.remove(job)
        offers.append(Offer(job, agv, job.origin))
    return offers


DISPATCH: dict[str, Rule] = {
    "nearest-job": nearest_job,
    "nearest": nearest_agv,
    "id-order": in_id_order,
    "first-come": first_come,
}


def choose_slot(garage: Garage, origin: int, zone: str, costs: Costs, around_cars: bool = False) -> int:
    """The free slot nearest to where the car stands, in the wanted zone if there is one; -1 when all are taken.

    Args:
        garage: the books.
        origin: where the car stands.
        zone: beginning of the wanted slots' names, "" for any.
        costs: driving costs.
        around_cars: count the way from there around parked cars, instead of the way back with all slots passable.
    """
    free = garage.slots[garage.slot_free & garage.slot_open]
    if zone:
        wanted = np.array([garage.graph.names[v].startswith(zone) for v in free], dtype=np.bool_)
        free = free[wanted] if wanted.any() else free
    steps = costs.around(origin) if around_cars else costs.to(origin)
    return int(free[np.argmin(steps[free])]) if len(free) else -1
