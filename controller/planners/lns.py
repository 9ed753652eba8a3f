"""Large-neighbourhood improvement of complete plans (Li, Chen, Harabor, Stuckey and Koenig 2021, MAPF-LNS).

An agent that waits long on its way, and those it waits for, give back their paths and are planned again, it first. The
new paths are taken if the sum of their arrivals is less; otherwise the old ones stay, and the next time the agents are
planned in another order. Those that have been looked at in vain come behind all others. With ``Detours`` an agent that
goes a long way round is late as well, and those whom it would meet on the short way are planned again with it.

Guarantee: whatever is returned is as free of conflicts as what came in, everybody still rests at the end of its path,
and the sum of arrivals never grows. Limits: a local search; somebody may be overtaken again and again by agents with
new goals. Departures from the paper: one kind of neighbourhood, and a number of tries instead of a time limit.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise

import numpy as np
from numba import njit

from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem

#: At most so many others are planned again with an agent.
NEIGHBOURS = 4


class Improvement:
    """The improvement of one plan.

    Args:
        problem: what was planned; ``search.begin`` must have been called with it.
        agents: those that may be planned again, by AGV number.
        paths: path of each of them, ending at its goal; changed in place.
        table: the reservations of these paths and of all others; changed in place.
        search: finds paths.
        looked: how often each agent has been looked at in vain; those looked at least come first. Changed in place.

    Attributes:
        changed: AGVs that have got another path.
        tried, taken: neighbourhoods planned again, and those that were better.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        agents: Mapping[int, PlanAgent],
        paths: dict[int, Path],
        table: ReservationTable,
        search: PathSearch,
        looked: dict[int, int],
    ) -> None:
        self.problem = problem
        self.agents = agents
        self.paths = paths
        self.table = table
        self.search = search
        self.looked = looked
        self.changed: set[int] = set()
        self.tried, self.taken = 0, 0

    def run(self, tries: int, threshold: int) -> None:
        """Try so many neighbourhoods of agents that are late by more than ``threshold`` steps."""
        lateness = self._lateness(list(self.agents))
        late = self._late(lateness, threshold)
        while late and self.tried < tries:
            agv = late.pop(0)
            others = self._in_the_way(agv, threshold)
            order = [agv, *others]
            before = self.looked.get(agv, 0)
            if before:  # the same order again would fare no better
                random.Random(agv + 1009 * before).shuffle(order)
            self.looked[agv] = before + 1
            self.tried += 1
            if others and self._again(order):
                self.taken += 1
                self.looked.update(dict.fromkeys(order, 0))
                lateness.update(self._lateness(order))
                late = self._late(lateness, threshold)

    def _late(self, lateness: Mapping[int, int], threshold: int) -> list[int]:
        """AGVs that are too late, those looked at least first, then the latest."""
        late = (agv for agv in lateness if lateness[agv] > threshold)
        return sorted(late, key=lambda agv: (self.looked.get(agv, 0), -lateness[agv], agv))

    def _lateness(self, agvs: Sequence[int]) -> dict[int, int]:
        """For how many steps each of these AGVs waits on its way, all in all."""
        if not agvs:
            return {}
        agents, paths = [self.agents[agv] for agv in agvs], [self.paths[agv] for agv in agvs]
        first = np.cumsum([0, *(len(path.vertices) for path in paths)], dtype=np.int32)
        way, arrive, depart = (
            np.fromiter(chain.from_iterable(times), dtype=np.int32)
            for times in ((p.vertices for p in paths), (p.arrive for p in paths), (p.depart for p in paths))
        )
        now = np.array([(a.in_edge, a.ready_step, a.loaded) for a in agents], dtype=np.int32)
        steps = _steps_waited(first, way, arrive, depart, now, self.search.distances.space.lanes)
        return dict(zip(agvs, steps.tolist(), strict=True))

    def _waits(self, agv: int) -> Iterator[tuple[int, int, int]]:
        """Where an agent waits: the vertex it waits for, the steps in which it could set out and in which it does."""
        agent, path = self.agents[agv], self.paths[agv]
        graph, motion = self.problem.graph, self.problem.motion
        into, ready = agent.in_edge, agent.ready_step
        for (u, v), arrive, depart in zip(pairwise(path.vertices), path.arrive[1:], path.depart, strict=True):
            edge = graph.edge_index[u, v]
            could = ready + motion.turn(graph, into, edge, agent.loaded)
            if depart > could:
                yield v, could, depart
            into, ready = edge, arrive

    def _in_the_way(self, agv: int, threshold: int) -> list[int]:
        """Those whom the agent waits for, in the order of meeting."""
        return self._met(agv, self._waits(agv))

    def _met(self, agv: int, places: Iterable[tuple[int, int, int]]) -> list[int]:
        """Whom an agent meets at some vertices, each between two steps."""
        met: dict[int, None] = {}
        for vertex, first, last in places:
            for begins, ends, owner in self.table.intervals(vertex):
                if begins <= last and ends >= first and owner != agv and owner in self.agents:
                    met[owner] = None
        return list(met)[:NEIGHBOURS]

    def _again(self, order: list[int]) -> bool:
        """Plan again in this order; whether that is better."""
        old = {agv: self.paths[agv] for agv in order}
        allowed = sum(path.arrive[-1] for path in old.values())
        spent = 0
        for agv in order:
            self.table.remove(agv)
        new: dict[int, Path] = {}
        for agv in order:
            path = self.search.find_path(self.problem, self.agents[agv], self.table)
            if path is None or spent + path.arrive[-1] >= allowed:
                break
            spent += path.arrive[-1]
            new[agv] = path
            self.table.add(path)
        better = len(new) == len(order)
        if better:
            self.paths.update(new)
            self.changed.update(order)
        else:
            for agv in new:
                self.table.remove(agv)
            for path in old.values():
                self.table.add(path)
        return better


class Detours(Improvement):
    """An improvement for which late is who arrives later than it would if it were alone."""

    def _lateness(self, agvs: Sequence[int]) -> dict[int, int]:
        """How many steps later each of these AGVs arrives than if it were alone, as far as is known unsearched."""
        steps = {}
        for agv in agvs:
            a = self.agents[agv]
            alone = a.ready_step + self.search.distances.known(a.vertex, a.in_edge, a.goal, a.loaded)
            steps[agv] = self.paths[agv].arrive[-1] - alone
        return steps

    def _in_the_way(self, agv: int, threshold: int) -> list[int]:
        """Those whom the agent would meet if it went as if it were alone, and those it waits for as it goes.

        Nobody if it turns out that even alone it would hardly be earlier.
        """
        nobody = ReservationTable(len(self.problem.graph.names), self.table.following, capacity=1)
        alone = self.search.find_path(self.problem, self.agents[agv], nobody)
        if alone is None or self.paths[agv].arrive[-1] <= alone.arrive[-1] + threshold:
            return []
        legs = zip(alone.vertices, (step + 1 for step in alone.arrive), (*alone.arrive[1:], FOREVER), strict=True)
        return self._met(agv, chain(legs, self._waits(agv)))


@njit(cache=True)
def _steps_waited(first, way, arrive, depart, now, lanes):  # type: ignore[no-untyped-def]
    """For each of several paths, one after the other in the arrays, how much later it sets out than it could.

    Args:
        first: where each path begins in ``way`` and ``arrive``; ``depart`` has one entry less for each path.
        way, arrive, depart: as in ``Path``.
        now: edge come by, first step at which the agent can leave, 1 if loaded; a row each.
        lanes: the garage.
    """
    waited = np.zeros(len(now), dtype=np.int64)
    for i in range(len(now)):
        came, could, loaded = now[i]
        for k in range(first[i], first[i + 1] - 1):
            u = way[k]
            edge = lanes.first_out[u]
            while lanes.head[edge] != way[k + 1]:
                edge += 1
            if came >= 0:
                could += lanes.turn_steps[loaded, lanes.first_transition[came] + edge - lanes.first_out[u]]
            waited[i] += max(0, depart[k - i] - could)
            came, could = edge, arrive[k + 1]
    return waited
