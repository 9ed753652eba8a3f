"""Who charges when, and who has charge enough for a task.

An AGV is *due* when its charge has fallen to ``Rules.charge_below``, or when it lacks the charge for a task that it was
to get. While more AGVs are due than chargers are free they queue: the emptiest one gets the next charger. An AGV in the
queue goes home and stands there, in nobody's way.

Two rules look ahead, where ``Rules.by_charge`` is set (the thesis's program has neither). What they have to know about
the battery they learn from the run:

- A task *needs* ``MARGIN`` times the charge that tasks have taken so far per step of their ways: the way to the car, on
  to where the car goes, from there home, and from home to the nearest charger. An AGV with less takes no task, and is
  due; but one that has charged since its last task takes any, because it cannot have more. Before a first task is done,
  ``charge_below`` is what a task needs.
- The emptiest AGV charges *early*, before it is due, where a charger is free and the fleet loses charge so fast that
  all chargers have to work for more than ``BUSY_SHARE`` of the time to make up for it. Chargers that stood idle until
  AGVs are due could not catch up then. AGVs fuller than halfway from ``charge_below`` to ``charge_to`` never do that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from controller.claims import Claims
from controller.costs import Costs
from controller.events import Event, Log
from controller.executor import Executor
from controller.faults import Outages
from controller.fleet import FREE_MODES, Agv
from controller.garage import Garage
from controller.rules import Rules
from controller.types import FOREVER, AgvMode, AgvNumber, AgvState
from sumo_nets.numbering import Numbered, Vertex

#: A task needs so many times what ways as long have taken on average.
MARGIN = 1.5

#: Share of the time that the chargers may have to work to make up for what the fleet loses, while AGVs charge when due.
BUSY_SHARE = 2 / 3

#: An AGV counts as so much emptier for each whole charge that it has waited for, so that none is passed over for ever.
AGE_SOC = 0.1


@dataclass(eq=False)
class Charging:
    """The queue for the chargers of one garage.

    Attributes:
        rules: when charging is due and how long it takes.
        garage, agvs, executor, costs, outages: read only, but for ``Agv.soc`` and ``Agv.due_at``.
        claims: holds which charger is promised to which AGV.
        log: takes events.
    """

    rules: Rules
    garage: Garage
    agvs: Numbered[AgvNumber, Agv]
    executor: Executor
    costs: Costs
    outages: Outages
    claims: Claims
    log: Log
    _lost: float = 0.0
    _spent: float = 0.0
    _steps: int = 0
    _under_way: dict[AgvNumber, tuple[float, int]] = field(default_factory=dict)
    _tasks_then: dict[AgvNumber, int] = field(default_factory=dict)
    _queued: dict[AgvNumber, int] = field(default_factory=dict)
    _short: set[AgvNumber] = field(default_factory=set)
    _news: bool = False
    _step: int = 0

    def __post_init__(self) -> None:
        self._chargers = self.garage.graph.chargers

    # --- batteries ------------------------------------------------------------------------------------------------

    def read(self, changed: Iterable[AgvNumber], states: Numbered[AgvNumber, AgvState], step: int) -> None:
        """Take over the states of charge, learn from them what AGVs lose, and note who is due."""
        self._step = step
        for n in changed:
            agv, soc = self.agvs[n], states[n].soc
            if soc == agv.soc:
                continue
            if soc > agv.soc:
                self._short.discard(n)
            elif soc <= 0.0:  # whatever emptied it teaches nothing
                self._under_way.pop(n, None)
            else:
                self._lost += agv.soc - soc
            agv.soc, self._news = soc, True
            if soc > max(self.rules.charge_below, agv.due_at):
                self._leave_queue(agv)
            elif self._chargers and agv.mode not in (AgvMode.GOING_TO_CHARGE, AgvMode.CHARGING):
                agv.due_at = max(agv.due_at, self.rules.charge_below)

    def charged(self, agv: Agv) -> None:
        """An AGV has charged."""
        self._tasks_then[agv.number] = agv.tasks_done

    def has_to_wait(self, agv: Agv) -> None:
        """An AGV does not get the charger that it was promised."""
        agv.due_at = max(agv.soc, self.rules.charge_below)

    def _leave_queue(self, agv: Agv) -> None:
        agv.due_at = -1.0
        self._queued.pop(agv.number, None)

    # --- who goes to a charger ------------------------------------------------------------------------------------

    def next_to_go(self) -> Iterator[tuple[Agv, Vertex]]:
        """AGVs that go to a charger now, each with the charger, which is promised to it."""
        free = self._free_chargers()
        going = [agv for agv in self.agvs if agv.due and self._may_go(agv)]
        if not going and free:
            going = self._early()
        for agv in sorted(going, key=self._rank):
            here = self._at(agv)
            if not free:
                self._queue(agv)
                continue
            charger = min(free, key=lambda c, here=here: int(self.costs.to(c)[here]))  # type: ignore[misc]
            free.remove(charger)
            self.claims.holder[charger] = agv.number
            self._leave_queue(agv)
            yield agv, charger

    def gives_way(self) -> Agv | None:
        """An AGV on its way to a charger that has to leave it to one in the queue.

        An AGV that cannot move keeps no charger from others. An AGV that could still work leaves its charger to one
        that lacks the charge for a task, if that one is there before the other would have charged.
        """
        queue = [self.agvs[n] for n in self._queued if self._may_go(self.agvs[n])]
        if not queue or self._free_chargers():
            return None
        coming = [agv for agv in self.agvs if agv.mode is AgvMode.GOING_TO_CHARGE and self._may_turn_back(agv)]
        late = max(coming, key=lambda agv: (agv.immobile, agv.soc, agv.number), default=None)
        if late is None or late.immobile:
            return late
        lacking = [agv for agv in queue if agv.number in self._short and agv.soc < late.soc]
        steps, charge = self.costs.to(late.goal), self.rules.charging_steps(late.soc)
        in_time = late.number not in self._short and any(steps[self._at(agv)] < charge for agv in lacking)
        return late if in_time else None

    def _may_turn_back(self, agv: Agv) -> bool:
        return agv.goal not in self.executor.agvs[agv.number].trail

    def _rank(self, agv: Agv) -> tuple[float, AgvNumber]:
        """The lower the sooner: the state of charge, less ``AGE_SOC`` for each whole charge that it has waited for."""
        if not self.rules.by_charge:
            return 0.0, agv.number
        waited = self._step - self._queued.get(agv.number, self._step)
        return agv.soc - AGE_SOC * waited / self.rules.charging_steps(self.rules.charge_below), agv.number

    def _at(self, agv: Agv) -> Vertex:
        return self.executor.agvs[agv.number].last

    def _may_go(self, agv: Agv) -> bool:
        """It is free of tasks, and where it is to be looked at."""
        if agv.mode not in FREE_MODES or agv.action is not None or agv.immobile or agv.off_duty:
            return False
        return self.rules.charge_anywhere or self._at(agv) == agv.home or self._at(agv) in self.garage.slot_of

    def _open_chargers(self) -> list[Vertex]:
        return [c for c in self._chargers if c not in self.outages.closed]

    def _free_chargers(self) -> list[Vertex]:
        return [c for c in self._open_chargers() if c not in self.claims.holder]

    def _queue(self, agv: Agv) -> None:
        if self.rules.by_charge and agv.number not in self._queued:
            self._queued[agv.number] = self._step
            self.log(Event("charge_wait", agv.number, detail={"soc": round(agv.soc, 4)}))

    def _early(self) -> list[Agv]:
        """The emptiest AGV that may go, if it has to charge before it is due."""
        rules = self.rules
        if not self._news or not rules.by_charge:
            return []
        self._news = False
        if self._lost * rules.charge_steps <= BUSY_SHARE * len(self._chargers) * self._step:
            return []
        emptiest = min((agv for agv in self.agvs if self._may_go(agv)), key=self._rank, default=None)
        fullest = (rules.charge_below + rules.charge_to) / 2
        return [emptiest] if emptiest is not None and emptiest.soc <= fullest else []

    # --- who takes a task -----------------------------------------------------------------------------------------

    def in_turn(self, at: dict[AgvNumber, Vertex]) -> list[dict[AgvNumber, Vertex]]:
        """Available AGVs in the order in which they are offered tasks: who is due takes what the others leave.

        An AGV that lacked the charge for a task is offered none until it has charged, if it can.
        """
        if not self.rules.by_charge:
            return [at]
        due = {n: v for n, v in at.items() if self.agvs[n].due}
        last = {n: v for n, v in due.items() if n not in self._short or not self._can_charge(self.agvs[n])}
        return [{n: v for n, v in at.items() if n not in due}, last]

    def takes(self, agv: Agv, origin: Vertex, destination: Vertex) -> bool:
        """Whether an AGV without a task has the charge for one, and takes it; else the AGV is due.

        Args:
            agv: the AGV.
            origin: where the car stands.
            destination: where it goes; -1 is the nearest bay.
        """
        if not self.rules.by_charge or not self._chargers:
            return True
        steps, onward = self._task_steps(agv, origin, destination)
        known = self._steps > 0
        need = MARGIN * self._spent / self._steps * (steps + onward) if known else self.rules.charge_below
        fresh = self._tasks_then.get(agv.number, 0) == agv.tasks_done and agv.soc > self.rules.charge_below
        if agv.soc < need and not fresh and self._can_charge(agv):
            agv.due_at = max(agv.due_at, need)
            self._short.add(agv.number)
            return False
        self._under_way[agv.number] = (agv.soc, steps)
        return True

    def task_done(self, agv: Agv) -> None:
        """Learn from what a task has taken of the charge."""
        if agv.number in self._under_way:
            soc, steps = self._under_way.pop(agv.number)
            self._spent += max(0.0, soc - agv.soc)
            self._steps += steps

    def _can_charge(self, agv: Agv) -> bool:
        here = self._at(agv)
        return any(self.costs.to(c)[here] < FOREVER for c in self._open_chargers())

    def _task_steps(self, agv: Agv, origin: Vertex, destination: Vertex) -> tuple[int, int]:
        """Steps to the car and with it to where it goes, lifts included; and from there home and to a charger.

        Turns with the car and waits are left out: what a task takes is learnt per step of this way.
        """
        costs, rules = self.costs, self.rules
        if destination < 0:
            destination = min(self.garage.bays, key=lambda bay: int(costs.to(bay)[origin]), default=agv.home)
            carry = int(costs.to(destination)[origin])
        else:
            carry = int(costs.out_of(origin)[destination])
        way = int(costs.turning_to(origin)[self._at(agv)]) + rules.lift_slot + carry + rules.lower_slot
        charger = min((int(costs.to(c)[agv.home]) for c in self._open_chargers()), default=0)
        return way, int(costs.to(agv.home)[destination]) + charger
