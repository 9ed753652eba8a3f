"""Large-neighbourhood improvement of complete plans (Li, Chen, Harabor, Stuckey and Koenig 2021, MAPF-LNS).

A neighbourhood is an agent that waits long on its way, with the agents it waits for. These agents give back their paths
and are planned again, the late agent first. The new paths are accepted if the sum of their arrivals is smaller.
Otherwise the old paths stay, and the next attempt uses another order. Agents tried in vain come after all others.
``Detours`` also treats agents on long detours as late, and replans the agents that block their short way.

Guarantee: whatever is returned is as free of conflicts as what came in, every agent still rests at the end of its path,
and the sum of arrivals never grows. Limits: a local search; an agent may be overtaken again and again by agents with
new goals. Departures from the paper: one kind of neighbourhood, and a number of tries instead of a time limit.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping, Sequence

import numpy as np

from controller.kernel import kernel
from controller.search.reservations import (
    AGENT,
    EACH,
    END,
    HEAD,
    PLACE,
    START,
    ReservationTable,
    Reserved,
    span_of,
)
from controller.search.sipp import PathSearch
from controller.search.space import Lanes, by_air
from controller.types import FOREVER, AgvNumber, PlanAgent, PlanningProblem
from sumo_nets.graph import FloatArray, IntArray

#: At most so many others are planned again with an agent.
NEIGHBOURS = 4
#: Room for those that an agent meets, itself included.
MOST_MET = 32
#: Columns of what is told of agents: AGV number, edge come by, first step at which it can leave, 1 if loaded.
AGV, CAME, READY, LOADED = 0, 1, 2, 3
#: Columns of what is found out about their paths: steps waited on the way, step of arrival, and how much later that is
#: than straight through the air.
WAITED, ARRIVAL, LONGER = 0, 1, 2


class Improvement:
    """The improvement of one plan.

    Args:
        problem: what was planned; ``search.begin`` must have been called with it.
        agents: those that may be planned again, by AGV number.
        table: the reservations of their paths, which end at their goals, and of all others; changed in place.
        search: finds paths.
        looked: how often each agent has been looked at in vain; those looked at least come first. Changed in place.

    Attributes:
        changed: AGVs that have got another path.
        tried, taken: neighbourhoods planned again, and those that were better.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        agents: Mapping[AgvNumber, PlanAgent],
        table: ReservationTable,
        search: PathSearch,
        looked: dict[AgvNumber, int],
    ) -> None:
        self.problem = problem
        self.agents = agents
        self.table = table
        self.search = search
        self.looked = looked
        self.changed: set[AgvNumber] = set()
        self.tried, self.taken = 0, 0
        self._lanes = search.distances.space.lanes
        self._arrival: dict[AgvNumber, int] = {}

    def run(self, tries: int, threshold: int) -> None:
        """Try so many neighbourhoods of agents that are late by more than ``threshold`` steps."""
        lateness = self._lateness(list(self.agents), threshold)
        late = self._late(lateness, threshold)
        while late and self.tried < tries:
            agv = late.pop(0)
            others = self._in_the_way(agv, threshold)
            order = [agv, *others]
            before = self.looked.get(agv, 0)
            if before:  # the same order would fail again
                random.Random(agv + 1009 * before).shuffle(order)
            self.looked[agv] = before + 1
            self.tried += 1
            if others and self._again(order):
                self.taken += 1
                self.looked.update(dict.fromkeys(order, 0))
                lateness.update(self._lateness(order, threshold))
                late = self._late(lateness, threshold)

    def _late(self, lateness: Mapping[AgvNumber, int], threshold: int) -> list[AgvNumber]:
        """Late AGVs: first those tried least often, then the latest."""
        late = [agv for agv, steps in lateness.items() if steps > threshold]
        return sorted(late, key=lambda agv: (self.looked.get(agv, 0), -lateness[agv], agv))

    def _lateness(self, agvs: Sequence[AgvNumber], threshold: int) -> dict[AgvNumber, int]:
        """For how many steps each of these AGVs waits on its way, all in all."""
        return {agv: waited for agv, (waited, _, _) in zip(agvs, self._paths_of(agvs), strict=True)}

    def _paths_of(self, agvs: Sequence[AgvNumber]) -> list[list[int]]:
        """What is found out about the paths of these AGVs, see ``WAITED``."""
        found = np.empty((len(agvs), 3), dtype=np.int32)
        rates = self.search.distances.space.rates
        _look_at(self._told_of(agvs), self.table.reserved, self._lanes, rates, found)
        rows: list[list[int]] = found.tolist()
        return rows

    def _told_of(self, agvs: Sequence[AgvNumber]) -> IntArray:
        """What kernels have to know of these AGVs, a row each."""
        numbers: list[int] = []
        for agv in agvs:
            a = self.agents[agv]
            numbers += (agv, a.in_edge, a.ready_step, a.loaded)
        packed = bytearray(struct.pack(f"{len(numbers)}i", *numbers))
        return np.frombuffer(packed, dtype=np.int32).reshape(-1, 4)

    def _in_the_way(self, agv: AgvNumber, threshold: int) -> list[AgvNumber]:
        """The agents that the agent waits for, in the order of meeting."""
        met = np.empty(MOST_MET, dtype=np.int32)
        return self._neighbours(agv, met, 0)

    def _neighbours(self, agv: AgvNumber, met: IntArray, k: int) -> list[AgvNumber]:
        """Agents that may be planned again with this one: of the first ``k`` of ``met``, and of those it waits for."""
        k = _meet_waiting(self._told_of([agv]), self.table.reserved, self._lanes, met, k)
        return [other for other in met[:k].tolist() if other != agv and other in self.agents][:NEIGHBOURS]

    def _again(self, order: list[AgvNumber]) -> bool:
        """Plan the agents again in this order. True if the new paths are better."""
        old = self.table.take(order)
        least = [self._alone(self.agents[agv]) for agv in order]
        spare = _arrivals(old) - 1 - sum(least)  # steps that they may arrive later than alone, all in all
        for agv, alone in zip(order, least, strict=True):
            arrival = self.search.reserve_path(self.problem, self.agents[agv], self.table, latest=alone + spare)
            spare -= arrival - alone
            if arrival < 0 or spare < 0:
                break
        else:
            self.changed.update(order)
            return True
        self.table.put_back(old, len(order))
        return False

    def _alone(self, agent: PlanAgent) -> int:
        """When an agent would arrive at the earliest, as far as is known without a search."""
        if agent.vertex == agent.goal:
            return 0
        return agent.ready_step + self.search.distances.known(agent.vertex, agent.in_edge, agent.goal, agent.loaded)


class Detours(Improvement):
    """An improvement that calls an agent late if it arrives later than it would if it were alone."""

    def _lateness(self, agvs: Sequence[AgvNumber], threshold: int) -> dict[AgvNumber, int]:
        """How many steps later each of these AGVs arrives than if it were alone, as far as is known unsearched.

        Agents that go nearly straight all the way are not looked at further: they are not late.
        """
        lateness = {}
        for agv, (_, arrival, longer) in zip(agvs, self._paths_of(agvs), strict=True):
            self._arrival[agv] = arrival
            lateness[agv] = arrival - self._alone(self.agents[agv]) if longer > threshold else longer
        return lateness

    def _in_the_way(self, agv: AgvNumber, threshold: int) -> list[AgvNumber]:
        """The agents that this one would meet if it went as if alone, and the agents it waits for on its path.

        Nobody if it turns out that even alone it would hardly be earlier.
        """
        a = self.agents[agv]
        way = self.search.distances.way(a.vertex, a.in_edge, a.goal, a.loaded)
        if len(way) == 0 or self._arrival[agv] <= a.ready_step + int(way[-1, 1]) + threshold:
            return []
        met = np.empty(MOST_MET, dtype=np.int32)
        return self._neighbours(agv, met, _meet_on_way(way, a.ready_step, self.table.reserved, met))


@kernel
def _look_at(told: IntArray, reserved: Reserved, lanes: Lanes, rates: FloatArray, found: IntArray) -> None:
    """How long agents wait on the paths reserved for them, and when they arrive.

    Args:
        told: a row for each agent, see ``AGV``.
        reserved: the table; each has one path in it.
        lanes: the garage.
        rates: see ``Space``.
        found: filled, a row for each agent, see ``WAITED``.
    """
    span = -1
    for i in range(len(told)):
        span = span_of(told[i, AGV], span + 1, reserved)  # they mostly are in order
        place = reserved.spans[span, PLACE]
        n = reserved.words[place + 1]
        waited, came, ready = 0, told[i, CAME], told[i, READY]
        for k in range(n - 1):
            came, could = _set_out(place, k, came, ready, told[i, LOADED], reserved.words, lanes)
            waited += max(0, reserved.words[place + HEAD + 2 * n + k] - could)  # it may have turned already
            ready = reserved.words[place + HEAD + n + k + 1]
        arrival = reserved.words[place + HEAD + 2 * n - 1]
        u, v = reserved.words[place + HEAD], reserved.words[place + HEAD + n - 1]
        found[i, WAITED] = waited
        found[i, ARRIVAL] = arrival
        row = told[i, LOADED]
        least = told[i, READY] + by_air(u, v, rates[row, 0], rates[row, 1], lanes)
        found[i, LONGER] = arrival - least if n > 1 else 0


@kernel
def _set_out(place: int, k: int, came: int, ready: int, loaded: int, words: IntArray, lanes: Lanes) -> tuple[int, int]:
    """Edge of the k-th move of a path, and when the move could begin: after the turn from the edge come by."""
    u, v = words[place + HEAD + k], words[place + HEAD + k + 1]
    edge = lanes.first_out[u]
    while lanes.head[edge] != v:
        edge += 1
    if came >= 0:
        ready += lanes.turn_steps[loaded, lanes.first_transition[came] + edge - lanes.first_out[u]]
    return edge, ready


@kernel
def _meet_waiting(told: IntArray, reserved: Reserved, lanes: Lanes, met: IntArray, n: int) -> int:
    """Whom one agent waits for on its path; added to ``met``, see :func:`_meet`."""
    place = reserved.spans[span_of(told[0, AGV], 0, reserved), PLACE]
    words, length = reserved.words, reserved.words[place + 1]
    way, arrive, leave = place + HEAD, place + HEAD + length, place + HEAD + 2 * length
    came, ready = told[0, CAME], told[0, READY]
    for k in range(length - 1):
        came, could = _set_out(place, k, came, ready, told[0, LOADED], words, lanes)
        if words[leave + k] > could:
            n = _meet(words[way + k + 1], could, words[leave + k], reserved, met, n)
        ready = words[arrive + k + 1]
    return n


@kernel
def _meet_on_way(way: IntArray, ready: int, reserved: Reserved, met: IntArray) -> int:
    """Whom an agent would meet that set out at a step on a way, see ``Distances.way``; how many there are."""
    n = 0
    for k in range(len(way)):
        last = ready + way[k + 1, 1] if k + 1 < len(way) else FOREVER
        n = _meet(way[k, 0], ready + way[k, 1] + 1, last, reserved, met, n)
    return n


@kernel
def _meet(v: int, first: int, last: int, reserved: Reserved, met: IntArray, n: int) -> int:
    """The agents that own a vertex between two steps, with those that end or begin just then.

    Args:
        v, first, last: where and when.
        reserved: the table.
        met: agents in the order of meeting; new ones are added as far as there is room.
        n: number of agents in ``met`` so far.

    Returns:
        Number of agents in ``met``.
    """
    for k in range(reserved.counts[v]):
        if reserved.rows[v, k, START] > last or reserved.rows[v, k, END] < first:
            continue
        j = 0
        while j < n and met[j] != reserved.rows[v, k, AGENT]:
            j += 1
        if j == n and n < len(met):
            met[n] = reserved.rows[v, k, AGENT]
            n += 1
    return n


@kernel
def _arrivals(words: IntArray) -> int:
    """Sum of the arrivals of packed paths."""
    total, place = 0, 0
    while place < len(words):
        n = words[place + 1]
        total += words[place + HEAD + 2 * n - 1]
        place += HEAD + EACH * n
    return total
