"""Why an AGV or a request makes no progress.

A *hold* names the cause at the root of a wait: if AGV 3 waits for AGV 2, which waits for AGV 1, which has broken down,
then all three are held by the breakdown. Holds are worked out from the state of the garage alone, so they are the same
whatever planner is in use.

``Holds.for_ever`` answers another question: is every open request lost, if no fault begins or ends any more? It says
yes only on proof, from the lanes, the closed places and the AGVs that will not move again. If the outcome depends on
planners, on customers or on the street, the answer is no.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from controller.costs import Costs
from controller.deadlock.waits import WaitGraph, wait_graph
from controller.executor import Executor
from controller.faults import Outages
from controller.fleet import Agv
from controller.garage import Garage, Task
from controller.types import FOREVER, NO_AGV, NO_REQUEST, AgvMode, AgvNumber, RequestNumber
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Numbered, Vertex


class Cause(StrEnum):
    """What holds an AGV or a request."""

    FAULT = "fault"  # the AGV, or the last one of the chain, cannot move because of a fault
    CLOSED = "closed"  # the place where it has to go is closed
    CUT_OFF = "cut_off"  # the only ways lead through places that are closed, or held by AGVs that cannot move
    NOT_MOVING = "not_moving"  # it may drive on, and does not
    CUSTOMER = "customer"  # the customer is still at the car
    NOT_COME = "not_come"  # the customer's car has been called to a bay and has not come
    BAY_TAKEN = "bay_taken"  # the place beside the bay still has the car before
    NO_BAY = "no_bay"  # no bay is open, or none is free
    NO_SLOT = "no_slot"  # no slot is open and free
    NO_CHARGER = "no_charger"  # no charger is open, or none is free for an AGV that has to charge
    NO_AGV = "no_agv"  # every AGV is out of order, or none is free
    IDLE_AGV = "idle_agv"  # the last AGV of the chain has nothing to do and stands in the way
    TRAFFIC = "traffic"  # the last AGV of the chain drives or works
    RING = "ring"  # the AGVs wait for one another in a ring
    NO_PLAN = "no_plan"  # the planner has found no way yet


@dataclass(frozen=True, slots=True)
class Hold:
    """Why an AGV, or a request that no AGV works on, makes no progress.

    Attributes:
        cause: what holds it.
        agv: its number, -1 for a request.
        request: number of the request, or of the one that the AGV works on; -1 for none.
        vertex: the place concerned, -1 for none.
        chain: AGVs it waits for: each waits for the next one, the last one is at the root.
        faults: numbers of the faults at the root.
    """

    cause: Cause
    agv: AgvNumber = NO_AGV
    request: RequestNumber = NO_REQUEST
    vertex: Vertex = NO_VERTEX
    chain: tuple[AgvNumber, ...] = ()
    faults: tuple[int, ...] = ()


class Holds:
    """Finds what holds AGVs and requests of one garage.

    Args:
        garage, agvs, executor, outages: read only.
        costs: tells where an AGV without a plan wants to go.
    """

    def __init__(
        self, garage: Garage, agvs: Numbered[AgvNumber, Agv], executor: Executor, outages: Outages, costs: Costs
    ) -> None:
        self._garage = garage
        self._agvs = agvs
        self._executor = executor
        self._outages = outages
        self._costs = costs

    def of_all(self) -> list[Hold]:
        """What holds AGVs with something to do, and requests that no AGV works on, now."""
        held = self.of_agvs(agv.number for agv in self._agvs if self.has_work(agv))
        waiting = [task for task in self._garage.tasks if task.state == "waiting" and task.agv < 0]
        return [*held, *(hold for task in waiting if (hold := self._of_request(task)))]

    def of_agvs(self, numbers: Iterable[AgvNumber]) -> Iterator[Hold]:
        """What holds these AGVs, for those that something holds."""
        waits = wait_graph(self._executor, self._agvs, self._costs)
        walls = set(walls_of(self._executor, self._outages.closed, self._outages.immobile))
        for n in numbers:
            hold = self._of_agv(self._agvs[n], waits, walls)
            if hold:
                task = self._agvs[n].task
                yield replace(hold, agv=n, request=task.number if task else NO_REQUEST)

    def has_work(self, agv: Agv) -> bool:
        """It has a task, or somewhere to go, or has to charge."""
        return agv.task is not None or agv.due or agv.goal != self._executor.agvs[agv.number].last

    # --- AGVs -----------------------------------------------------------------------------------------------------

    def _of_agv(self, agv: Agv, waits: WaitGraph, walls: Collection[Vertex]) -> Hold | None:
        chain = [agv.number]
        while chain[-1] in waits.edges:
            after = waits.edges[chain[-1]]
            if after in chain:
                return Hold(Cause.RING, chain=(*chain[1:], after))
            chain.append(after)
        own = self._by_itself(agv, walls)
        if len(chain) == 1 or (own and own.cause in (Cause.CLOSED, Cause.CUT_OFF)):
            return own
        last = self._agvs[chain[-1]]
        root = self._by_itself(last, walls)
        if root is None:
            idle = not self.has_work(last) and last.action is None
            root = Hold(Cause.IDLE_AGV if idle else Cause.TRAFFIC, vertex=self._executor.agvs[last.number].last)
        return replace(root, chain=(*chain[1:], *root.chain))

    def _by_itself(self, agv: Agv, walls: Collection[Vertex]) -> Hold | None:
        """What holds an AGV that waits for no other one; None if it works, drives, or has nothing to do."""
        a = self._executor.agvs[agv.number]
        if agv.immobile:
            return Hold(Cause.FAULT, vertex=a.last, faults=self._outages.holding(agv.number))
        if a.acting_until >= 0 or agv.action is not None:
            return None
        ahead = list(a.trail)[max(0, a.reached - a.first) + 1 :]
        shut = [v for v in ahead if v in self._outages.closed]
        if shut:
            return Hold(Cause.CLOSED, vertex=shut[0], faults=self._outages.closing(shut[0]))
        if not a.standing:
            return Hold(Cause.NOT_MOVING, vertex=a.last)
        if agv.goal == a.last:
            return self._at_goal(agv)
        if agv.goal in self._outages.closed:
            return Hold(Cause.CLOSED, vertex=agv.goal, faults=self._outages.closing(agv.goal))
        if agv.goal in walls or not self._costs.has_way(a.last, agv.goal, self._mask(walls)):
            return self._cut_off(agv, walls)
        return Hold(Cause.NO_PLAN, vertex=agv.goal) if not a.pending else None

    def _mask(self, walls: Collection[Vertex]) -> NDArray[np.uint8]:
        mask = np.zeros_like(self._costs.blocked)
        mask[list(walls)] = 1
        return mask

    def _at_goal(self, agv: Agv) -> Hold | None:
        """What holds an AGV that stands where it was to go."""
        task = agv.task
        if task is None:
            return self._none_free(Cause.NO_CHARGER, self._garage.graph.chargers) if agv.due else None
        if agv.mode is AgvMode.GOING_TO_COLLECT:
            return Hold(Cause.CUSTOMER, vertex=agv.goal)
        if task.destination < 0:
            return self._none_free(Cause.NO_BAY, self._garage.bays)
        return None if self._garage.may_lower(task) else Hold(Cause.BAY_TAKEN, vertex=agv.goal)

    def _cut_off(self, agv: Agv, walls: Collection[Vertex]) -> Hold:
        """The wall that is first on the shortest way to the goal, and the faults behind it."""
        graph, to = self._executor.graph, self._costs.to(agv.goal)
        v = self._executor.agvs[agv.number].last
        if to[v] >= FOREVER:
            return Hold(Cause.NO_PLAN, vertex=agv.goal)
        while v not in walls:
            v = min(graph.successors[v], key=lambda u: (int(to[u]), u))
        stopped = [n for n in self._outages.immobile if v in self._executor.agvs[n].trail]
        faults = self._outages.closing(v) + tuple(f for n in stopped for f in self._outages.holding(n))
        return Hold(Cause.CUT_OFF, vertex=v, chain=tuple(stopped[:1]), faults=tuple(dict.fromkeys(faults)))

    def _none_free(self, cause: Cause, places: Iterable[Vertex]) -> Hold:
        """None of these places is open and free; the faults are those that close some of them."""
        shut = [v for v in places if v in self._outages.closed]
        return Hold(cause, faults=tuple(dict.fromkeys(f for v in shut for f in self._outages.closing(v))))

    # --- requests -------------------------------------------------------------------------------------------------

    def _of_request(self, task: Task) -> Hold | None:
        """What holds a request that no AGV works on; None if it waits for its car to be parked first."""
        hold = self._in_the_street(task) if task.at_bay_s != task.at_bay_s else self._for_an_agv(task)
        return replace(hold, request=task.number) if hold else None

    def _in_the_street(self, task: Task) -> Hold | None:
        if not task.is_park:
            return self._for_an_agv(task) if task.origin >= 0 else None
        return (
            Hold(Cause.NOT_COME, vertex=task.origin)
            if task.origin >= 0
            else self._none_free(Cause.NO_BAY, self._garage.bays)
        )

    def _for_an_agv(self, task: Task) -> Hold:
        garage = self._garage
        if task.is_park and not (garage.slot_free & garage.slot_open).any():
            return self._none_free(Cause.NO_SLOT, garage.slot_of)
        if any(agv.due and agv.task is None and not (agv.immobile or agv.off_duty) for agv in self._agvs):
            return replace(self._none_free(Cause.NO_CHARGER, garage.graph.chargers), vertex=task.origin)
        out = [agv for agv in self._agvs if agv.immobile or agv.off_duty]
        faults = tuple(dict.fromkeys(f for agv in out for f in self._outages.holding(agv.number)))
        return Hold(Cause.NO_AGV, vertex=task.origin, faults=faults if len(out) == len(self._agvs) else ())

    # --- for ever -------------------------------------------------------------------------------------------------

    def for_ever(self, still: Collection[AgvNumber]) -> bool:
        """No request can ever be served, if no fault begins or ends any more and no request comes.

        Args:
            still: AGVs that will never move again.

        Returns:
            True on proof; False where it is not known.
        """
        garage, closed = self._garage, self._outages.closed
        waiting = [task for task in garage.tasks if task.state == "waiting"]
        walls = walls_of(self._executor, closed, still)
        at = {agv.number: self._executor.agvs[agv.number].last for agv in self._agvs if agv.number not in still}
        ways = {n: reachable(self._executor.graph, v, walls) for n, v in at.items()}
        free = [ways[n] for n in at if self._agvs[n].task is None]
        return all(self._is_lost(task, ways, free) for task in waiting)

    def _is_lost(self, task: Task, ways: dict[AgvNumber, set[Vertex]], free: Sequence[set[Vertex]]) -> bool:
        garage, closed = self._garage, self._outages.closed
        if task.agv >= 0 and task.delivered_s != task.delivered_s:
            return task.agv not in ways or self._goal_is_lost(task, ways[task.agv])
        if task.agv >= 0:  # its customer is getting in or driving off
            return False
        if task.origin < 0 and task.is_park and garage.handover == "bay":  # in the queue
            return all(bay in closed or places.inbound is not None for bay, places in garage.bays.items())
        if task.origin < 0 and not task.is_park:  # its car is being parked, and that request is lost itself
            return True
        if task.is_park and task.at_bay_s != task.at_bay_s:  # its customer is on the way to the bay
            return False
        if task.is_park and not (garage.slot_free & garage.slot_open).any():
            return True
        if task.origin < 0:  # a car to be fetched from the home of whichever AGV takes it
            return not free
        return not any(task.origin in way for way in free)

    def _goal_is_lost(self, task: Task, way: set[Vertex]) -> bool:
        """The AGV that works on the request will never be where it has to go."""
        goal = self._agvs[task.agv].goal
        if not task.is_park and task.destination < 0 and task.lifted_s == task.lifted_s:
            return not any(bay in way for bay in self._garage.bays)
        return goal not in way


def walls_of(executor: Executor, closed: Collection[Vertex], still: Collection[AgvNumber]) -> frozenset[Vertex]:
    """Vertices that no other AGV can enter while these vertices are closed and these AGVs do not move."""
    return frozenset(closed) | {v for n in still for v in executor.agvs[n].trail}


def reachable(graph: Graph, start: Vertex, walls: Collection[Vertex]) -> set[Vertex]:
    """Vertices that can be reached from a vertex without entering a wall; turns and parked cars are no hindrance."""
    found, new = {start}, {start}
    while new:
        new = {u for v in new for u in graph.successors[v] if u not in walls} - found
        found |= new
    return found
