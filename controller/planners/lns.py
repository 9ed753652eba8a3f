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
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.search.reservations import AGENT, END, START, ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Lanes
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem
from sumo_nets.graph import IntArray

#: At most so many others are planned again with an agent.
NEIGHBOURS = 4
#: Room for those that an agent meets, itself included.
MOST_MET = 32


class _Waits(NamedTuple):
    """Where agents wait on their paths.

    Attributes:
        path: number of the path among those asked for, shape (k,).
        vertex: what they wait for, shape (k,).
        first, last: the steps in which they could set out and in which they do, shape (k,).
    """

    path: NDArray[np.int64]
    vertex: IntArray
    first: IntArray
    last: IntArray


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
        waits = self._waits(agvs)
        late = np.zeros(len(agvs), dtype=np.int64)
        np.add.at(late, waits.path, waits.last - waits.first)
        return dict(zip(agvs, late.tolist(), strict=True))

    def _waits(self, agvs: Sequence[int]) -> _Waits:
        """Where these AGVs wait, path after path."""
        agents, paths = [self.agents[agv] for agv in agvs], [self.paths[agv] for agv in agvs]
        moves = np.fromiter((len(path.depart) for path in paths), dtype=np.int32, count=len(paths))
        way, arrive, depart = (
            np.fromiter(chain.from_iterable(times), dtype=np.int32)
            for times in ((p.vertices for p in paths), (p.arrive for p in paths), (p.depart for p in paths))
        )
        now = np.array([(a.in_edge, a.ready_step, a.loaded) for a in agents], dtype=np.int32).reshape(-1, 3)
        vertex, could = np.empty_like(depart), np.empty_like(depart)
        _set_out(moves, way, arrive, now, self.search.distances.space.lanes, vertex, could)
        waiting = depart > could
        which = np.repeat(np.arange(len(agvs)), moves)
        return _Waits(which[waiting], vertex[waiting], could[waiting], depart[waiting])

    def _in_the_way(self, agv: int, threshold: int) -> list[int]:
        """Those whom the agent waits for, in the order of meeting."""
        _, vertices, first, last = self._waits([agv])
        return self._met(agv, vertices, first, last)

    def _met(self, agv: int, vertices: IntArray, first: IntArray, last: IntArray) -> list[int]:
        """Whom an agent meets at some vertices, each between two steps."""
        found = np.empty(MOST_MET, dtype=np.int32)
        k = _meet(vertices, first, last, self.table.rows, self.table.count, found)
        return [other for other in found[:k].tolist() if other != agv and other in self.agents][:NEIGHBOURS]

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
        _, vertices, first, last = self._waits([agv])
        way, arrive = (np.array(part, dtype=np.int32) for part in (alone.vertices, (*alone.arrive, FOREVER)))
        legs = (way, arrive[:-1] + 1, arrive[1:])
        return self._met(agv, *(np.concatenate(pair) for pair in zip(legs, (vertices, first, last), strict=True)))


@kernel
def _set_out(
    moves: IntArray, way: IntArray, arrive: IntArray, now: IntArray, lanes: Lanes, vertex: IntArray, could: IntArray
) -> None:
    """For each move of several paths, one after the other in the arrays, where to and when it could have begun.

    Args:
        moves: number of moves of each path.
        way, arrive: as in ``Path``, one entry more than moves for each path.
        now: edge come by, first step at which the agent can leave, 1 if loaded; a row each.
        lanes: the garage.
        vertex, could: filled, an entry for each move.
    """
    k = 0
    for i in range(len(moves)):
        came, ready, loaded = now[i, 0], now[i, 1], now[i, 2]
        for j in range(k, k + moves[i]):
            u, v = way[i + j], way[i + j + 1]
            edge = lanes.first_out[u]
            while lanes.head[edge] != v:
                edge += 1
            if came >= 0:
                ready += lanes.turn_steps[loaded, lanes.first_transition[came] + edge - lanes.first_out[u]]
            vertex[j], could[j] = v, ready
            came, ready = edge, arrive[i + j + 1]
        k += moves[i]


@kernel
def _meet(vertices: IntArray, first: IntArray, last: IntArray, rows: IntArray, count: IntArray, met: IntArray) -> int:
    """Who owns some vertices between two steps each, those who end or begin just then included; how many there are.

    Args:
        vertices, first, last: where and when.
        rows, count: the reservations.
        met: filled with agents in the order of meeting, as far as there is room.
    """
    n = 0
    for i in range(len(vertices)):
        v = vertices[i]
        for k in range(count[v]):
            if rows[v, k, START] > last[i] or rows[v, k, END] < first[i]:
                continue
            j = 0
            while j < n and met[j] != rows[v, k, AGENT]:
                j += 1
            if j == n and n < len(met):
                met[n] = rows[v, k, AGENT]
                n += 1
    return n
