"""Who has been promised which bay or charger, and who comes next to a bay.

Each place is promised to one AGV at a time. Where no bay is free, an AGV that waits with a car is promised one that an
AGV at work there is about to leave; it is planned to come when that one has gone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from controller.costs import Costs
from controller.executor import Executor
from controller.fleet import Agv
from controller.garage import Garage, Task
from controller.places import choose_bays
from controller.types import Action, AgvNumber
from sumo_nets.graph import IntArray
from sumo_nets.numbering import Numbered, Vertex


@dataclass(eq=False)
class Claims:
    """The promises of one garage.

    Attributes:
        garage, agvs, executor, costs: read only.
        lift_steps: steps to lift a car at a bay.
        holder: by place the AGV it is promised to.
        next: by bay the AGV that comes when the holder has left.
    """

    garage: Garage
    agvs: Numbered[AgvNumber, Agv]
    executor: Executor
    costs: Costs
    lift_steps: int
    holder: dict[Vertex, AgvNumber] = field(default_factory=dict)
    next: dict[Vertex, AgvNumber] = field(default_factory=dict)

    def nearer_to_bays(self, a: Vertex, b: Vertex) -> bool:
        """From the first vertex it is less far with a car to some bay than from the second one to any."""
        return bool(self._steps_to_bays[a] < self._steps_to_bays[b])

    @cached_property
    def _steps_to_bays(self) -> IntArray:
        tables = [self.costs.turning_to(bay, loaded=True) for bay in self.garage.bays]
        nearest: IntArray = np.min(tables, axis=0)
        return nearest

    def release(self, place: Vertex, agv: AgvNumber) -> None:
        """The AGV has done what it came for, or does not come."""
        for promised in (self.holder, self.next):
            if promised.get(place) == agv:
                del promised[place]

    def move_up(self) -> None:
        """Let who comes next have the bays that have been released."""
        for bay in [bay for bay in self.next if bay not in self.holder]:
            self.holder[bay] = self.next.pop(bay)

    def promise_bays(
        self, waiting: Mapping[AgvNumber, Task], step: int, closed: frozenset[Vertex], behind_others: bool
    ) -> dict[AgvNumber, Vertex]:
        """Promise bays to AGVs that carry a car to one.

        Args:
            waiting: their tasks, by AGV number.
            step: now.
            closed: vertices that are out of order.
            behind_others: bays may be promised that are about to be left.

        Returns:
            The bay of each AGV that gets one.
        """
        at = {n: self.executor.agvs[n].last for n in waiting}
        since_s = {n: task.lifted_s for n, task in waiting.items()}
        # an occupied outbound place frees when its customer has got in: count it as half a lift
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

    def _leaving(self, step: int, closed: frozenset[Vertex]) -> dict[Vertex, int]:
        """Bays that an AGV at work there is about to leave, with the steps until it has.

        Not where a customer is still busy: that car is better taken by the AGV that is there already.
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
        """Places with the only AGV that may fetch a car there.

        A bay that has just been released is for the one that comes next, but who has been at work there takes the car
        that waits if it need not wait for its customer.
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
