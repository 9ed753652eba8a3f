"""Large-neighbourhood improvement of complete plans (Li, Chen, Harabor, Stuckey and Koenig 2021, MAPF-LNS).

An agent that arrives late against driving alone, and those in its way, give back their paths and are planned again, it
first. The new paths are taken if the sum of their arrivals is less; otherwise the old ones stay, and the next time the
agents are planned in another order. Those that have been looked at in vain come behind all others.

Guarantee: whatever is returned is as free of conflicts as what came in, everybody still rests at the end of its path,
and the sum of arrivals never grows. Limits: a local search; somebody may be overtaken again and again by agents with
new goals. Departures from the paper: one kind of neighbourhood, and a number of tries instead of a time limit.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

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
        self._nobody = ReservationTable(len(problem.graph.names), problem.motion.following)

    def run(self, tries: int, threshold: int) -> None:
        """Try so many neighbourhoods of agents that are late by more than ``threshold`` steps."""
        late = self._late(threshold)
        while late and self.tried < tries:
            agv = late.pop(0)
            others = self._in_the_way(self.agents[agv])
            order = [agv, *others]
            before = self.looked.get(agv, 0)
            if before:  # the same order again would fare no better
                random.Random(agv + 1009 * before).shuffle(order)
            self.looked[agv] = before + 1
            self.tried += 1
            if others and self._again(order):
                self.taken += 1
                self.looked.update(dict.fromkeys([agv, *others], 0))
                late = self._late(threshold)

    def _late(self, threshold: int) -> list[int]:
        """AGVs that are late, those looked at least first, then the latest."""
        delays = {agv: self.paths[agv].arrive[-1] - self._alone(self.agents[agv]) for agv in self.agents}
        late = (agv for agv in delays if delays[agv] > threshold)
        return sorted(late, key=lambda agv: (self.looked.get(agv, 0), -delays[agv], agv))

    def _alone(self, a: PlanAgent) -> int:
        """When it would arrive if it were alone."""
        return a.ready_step + self.search.distances.distance(a.vertex, a.in_edge, a.goal, a.loaded)

    def _in_the_way(self, agent: PlanAgent) -> list[int]:
        """Those that the agent's way would meet if it drove as if alone, in the order of meeting."""
        way = self.search.find_path(self.problem, agent, self._nobody)
        if way is None:
            return []
        met: dict[int, None] = {}
        for i, v in enumerate(way.vertices):
            start = 0 if i == 0 else way.depart[i - 1]
            end = way.arrive[i + 1] if i < len(way.depart) else way.until
            for begins, ends, owner in self.table.intervals(v):
                if begins < end and ends > start and owner != agent.agv and owner in self.agents:
                    met[owner] = None
        return list(met)[:NEIGHBOURS]

    def _again(self, order: list[int]) -> bool:
        """Plan again in this order; whether that is better."""
        old = {agv: self.paths[agv] for agv in order}
        allowed = sum(path.arrive[-1] for path in old.values())
        alone = {agv: self._alone(self.agents[agv]) for agv in order}
        least = sum(alone.values())
        for agv in order:
            self.table.remove(agv)
        new: dict[int, Path] = {}
        for agv in order:
            path = self.search.find_path(self.problem, self.agents[agv], self.table)
            least += FOREVER if path is None else path.arrive[-1] - alone[agv]
            if path is None or least >= allowed:
                break
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
