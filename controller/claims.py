"""Promises of bays and chargers to AGVs, and the next AGV at each bay.

Each place is promised to one AGV at a time. When no bay is free, an AGV waiting with a car may be promised a bay where
another AGV is finishing its work. Its arrival is planned for after that AGV has left.

A bay stands empty while the AGV that comes next is on its way. Two rules shorten that time. A bay promised to an AGV
that is still far away goes to a waiting AGV that is ``NEARER_S`` nearer (``trade_bays``). And an AGV that waits with a
car takes the home of an AGV that is away on a task, if this home is so much nearer to the bays (``absent_nearer``): the
two exchange homes. Every AGV still has a home of its own, so that what a planner guarantees of homes still holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from controller.costs import Costs
from controller.dispatch import pairs
from controller.executor import Executor
from controller.fleet import Agv
from controller.garage import Garage, Task
from controller.places import choose_bays
from controller.types import NO_AGV, Action, AgvMode, AgvNumber
from sumo_nets.graph import IntArray
from sumo_nets.numbering import Numbered, Vertex

#: A bay, or a home nearer to the bays, goes to another AGV only if this saves so many seconds of driving.
NEARER_S = 20.0


@dataclass(eq=False)
class Claims:
    """The promises of one garage.

    Attributes:
        garage, agvs, executor, costs: read only.
        lift_steps: steps to lift a car at a bay.
        holder: for each place, the AGV it is promised to.
        next: for each bay, the AGV that comes after the holder.
    """

    garage: Garage
    agvs: Numbered[AgvNumber, Agv]
    executor: Executor
    costs: Costs
    lift_steps: int
    holder: dict[Vertex, AgvNumber] = field(default_factory=dict)
    next: dict[Vertex, AgvNumber] = field(default_factory=dict)

    def nearer_to_bays(self, a: Vertex, b: Vertex) -> bool:
        """Whether vertex ``a`` is closer than vertex ``b`` to its nearest bay, for a loaded AGV."""
        return bool(self._steps_to_bays[a] < self._steps_to_bays[b])

    @cached_property
    def _steps_to_bays(self) -> IntArray:
        tables = [self.costs.turning_to(bay, loaded=True) for bay in self.garage.bays]
        nearest: IntArray = np.min(tables, axis=0)
        return nearest

    def release(self, place: Vertex, agv: AgvNumber) -> None:
        """Withdraw a promise: the AGV has finished its work there, or does not come."""
        for promised in (self.holder, self.next):
            if promised.get(place) == agv:
                del promised[place]

    def move_up(self) -> None:
        """Promise released bays to the AGVs that come next."""
        for bay in [bay for bay in self.next if bay not in self.holder]:
            self.holder[bay] = self.next.pop(bay)

    def promise_bays(
        self, waiting: Mapping[AgvNumber, Task], step: int, closed: frozenset[Vertex], behind_others: bool
    ) -> dict[AgvNumber, Vertex]:
        """Promise bays to AGVs that carry a car to a bay.

        Args:
            waiting: tasks of these AGVs, by AGV number.
            step: current step.
            closed: vertices out of order.
            behind_others: also promise bays that another AGV is about to leave.

        Returns:
            The bay of each AGV that gets one.
        """
        at = {n: self.executor.agvs[n].last for n in waiting}
        since_s = {n: task.lifted_s for n, task in waiting.items()}
        # a taken outbound place frees once its customer has got in; half a lift is a fair estimate of the wait
        free = {
            bay: self.lift_steps // 2 if places.outbound else 0
            for bay, places in self.garage.bays.items()
            if bay not in self.holder and bay not in closed
        }
        leaving = self._leaving(step, closed) if behind_others and not free else {}
        chosen = choose_bays(at, since_s, free, leaving, self.costs)
        for n, bay in chosen.items():
            (self.holder if bay in free else self.next)[bay] = n
        return chosen

    def trade_bays(
        self, waiting: Mapping[AgvNumber, Task], step: int, closed: frozenset[Vertex]
    ) -> dict[AgvNumber, AgvNumber]:
        """Pass bays that are promised to AGVs far away on to AGVs that are much nearer, most time saved first.

        Args:
            waiting: tasks of the AGVs that carry a car to a bay and have none, by AGV number.
            step: current step.
            closed: vertices out of order.

        Returns:
            For each AGV that gets a bay, the AGV that loses it.
        """
        promised = [
            (promises, bay, far)
            for promises in (self.holder, self.next)
            for bay, far in promises.items()
            if bay not in closed and self._is_far(far, bay)
        ]
        if not promised or not waiting:
            return {}
        near, at = sorted(waiting), self.executor.agvs
        more = np.empty((len(near), len(promised)))  # steps by which each of them is farther away, less than 0
        for column, (promises, bay, far) in enumerate(promised):
            way = self.costs.turning_to(bay, loaded=True)
            ways = way[[at[n].last for n in near]]
            busy = self.executor.ready_step(self.holder[bay], step) if promises is self.next else 0
            is_worth_it = (ways <= way[at[far].last] - self._nearer) & (ways >= busy)
            more[:, column] = np.where(is_worth_it, ways - way[at[far].last], np.inf)
        traded = {}
        for row, column in pairs(more):
            promises, bay, far = promised[column]
            promises[bay] = near[row]
            traded[near[row]] = far
        return traded

    def _is_far(self, n: AgvNumber, bay: Vertex) -> bool:
        """Whether an AGV carries a car to this bay and is not there yet."""
        agv, a = self.agvs[n], self.executor.agvs[n]
        return agv.mode is AgvMode.RETURNING_WITH_CAR and agv.goal == bay and bay not in a.trail

    def absent_nearer(self, agv: Agv, closed: frozenset[Vertex]) -> AgvNumber:
        """The AGV away from home whose home is the nearest to the bays, if much nearer than this AGV's; else -1."""
        steps, most = self._steps_to_bays, self._steps_to_bays[agv.home] - self._nearer
        homes = [
            (int(steps[other.home]), other.number)
            for other in self.agvs
            if steps[other.home] <= most and other.home not in closed and self._is_away(other)
        ]
        return min(homes)[1] if homes else NO_AGV

    def _is_away(self, agv: Agv) -> bool:
        """Whether nobody is at an AGV's home, and its own plan leads elsewhere."""
        if agv.immobile or agv.off_duty or agv.home in (agv.goal, agv.heads_for):
            return False
        return self.executor.owner[agv.home] == NO_AGV and agv.home not in self.executor.agvs[agv.number].pending

    @cached_property
    def _nearer(self) -> float:
        return NEARER_S / self.costs.step_s

    def _leaving(self, step: int, closed: frozenset[Vertex]) -> dict[Vertex, int]:
        """Bays that a working AGV is about to leave, with the steps until the bay is free.

        A bay where a customer is still busy is left out: the AGV already there takes that customer's car.
        """
        found = {}
        for bay, n in self.holder.items():
            agv = self.agvs[n]
            at_work = bay in self.garage.bays and agv.goal == bay and agv.action is not None and not agv.immobile
            if at_work and bay not in self.next and bay not in closed:
                car = self.garage.waiting_at(bay) if agv.action is Action.LOWER else None
                if car is None or self._is_ready(car, step):
                    found[bay] = self.executor.ready_step(n, step) + (car is not None) * self.lift_steps
        return found

    def only(self, step: int) -> dict[Vertex, AgvNumber]:
        """For each place, the only AGV that may fetch a car there.

        A bay just released belongs to the AGV that comes next. The AGV that has been at work there goes first if it can
        take the car waiting at the bay without waiting for the customer.
        """
        only = dict(self.holder)
        for bay, comes in self.next.items():
            here = self.executor.owner[bay]
            stands = here >= 0 and self.executor.agvs[here].standing and self.executor.agvs[here].last == bay
            car = self.garage.waiting_at(bay)
            only.setdefault(bay, here if stands and car and self._is_ready(car, step) else comes)
        return only

    def _is_ready(self, car: Task, step: int) -> bool:
        return car.ready_s <= self.executor.motion.seconds(step)
