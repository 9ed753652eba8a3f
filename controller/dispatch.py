"""Dispatch: which AGV takes which job, and which slot a car gets. Rules stand in the table ``DISPATCH``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

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


#: A rule gets the open jobs in order of request, the vertices of the available AGVs, the origins that are taken by
#: an AGV, and the costs. It returns offers; each AGV, each job and each origin at most once.
Rule = Callable[[Sequence[Job], Mapping[int, int], Mapping[int, int], Costs], list[Offer]]


def nearest_agv(jobs: Sequence[Job], at: Mapping[int, int], taken: Mapping[int, int], costs: Costs) -> list[Offer]:
    """Jobs in order of request; each gets the available AGV that is nearest to the car."""
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


DISPATCH: dict[str, Rule] = {"nearest": nearest_agv, "id-order": in_id_order}


def choose_slot(garage: Garage, origin: int, zone: str, costs: Costs) -> int:
    """The free slot nearest to where the car stands, in the wanted zone if there is one; -1 when all are taken."""
    free = garage.slots[garage.slot_free]
    if zone:
        wanted = np.array([garage.graph.names[v].startswith(zone) for v in free], dtype=np.bool_)
        free = free[wanted] if wanted.any() else free
    return int(free[np.argmin(costs.to(origin)[free])]) if len(free) else -1
