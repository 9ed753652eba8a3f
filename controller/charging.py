"""When each AGV charges, and whether an AGV has enough charge for a task.

An AGV is *due* when its charge has fallen to ``Rules.charge_below``, or when it lacks the charge for a
task offered to it. If more AGVs are due than chargers are free, the AGVs queue and the emptiest one gets the next
charger. An AGV in the queue waits at its home, where it blocks no other AGV.

Two rules look ahead if ``Rules.by_charge`` is set (the thesis's program has neither). Both rules learn the battery's
behaviour during the run:

- A task *needs* the length of its way, times the mean charge per step of earlier tasks, times ``MARGIN``. The way leads
  to the car, to the car's destination, home, and from home to the nearest charger. An AGV with less charge takes no
  task and is due. An AGV that has charged since its last task takes any task, because it cannot have more charge.
  Until the first task is done, a task needs ``charge_below``.
- The emptiest AGV charges *early*, before it is due, if a charger is free and the chargers are scarce. Chargers are
  scarce if replacing the fleet's loss of charge keeps all of them busy for more than ``BUSY_SHARE`` of the time. Such
  chargers could not catch up after standing idle. An AGV above the middle of ``charge_below`` and ``charge_to`` never
  charges early.
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

#: A task needs this many times the charge that a way of its length has taken on average.
MARGIN = 1.5

#: AGVs charge early when more than this share of the chargers' time is needed to replace the fleet's loss of charge.
BUSY_SHARE = 2 / 3

#: For each full charge's time that an AGV has waited, its state of charge counts as this much lower in the queue.
AGE_SOC = 0.1


@dataclass(eq=False)
class Charging:
    """The queue for the chargers of one garage.

    Attributes:
        rules: when charging is due and how long it takes.
        garage, agvs, executor, costs, outages: read only, but for ``Agv.soc`` and ``Agv.due_at``.
        claims: promises of chargers to AGVs.
        log: receives events.
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
        """Read the states of charge, learn the AGVs' loss of charge, and mark AGVs as due."""
        self._step = step
        for n in changed:
            agv, soc = self.agvs[n], states[n].soc
            if soc == agv.soc:
                continue
            if soc > agv.soc:
                self._short.discard(n)
            elif soc <= 0.0:  # the battery was emptied by a fault, so this loss teaches nothing
                self._under_way.pop(n, None)
            else:
                self._lost += agv.soc - soc
            agv.soc, self._news = soc, True
            if soc > max(self.rules.charge_below, agv.due_at):
                self._leave_queue(agv)
            elif self._chargers and agv.mode not in (AgvMode.GOING_TO_CHARGE, AgvMode.CHARGING):
                agv.due_at = max(agv.due_at, self.rules.charge_below)

    def charged(self, agv: Agv) -> None:
        """Record that an AGV has charged."""
        self._tasks_then[agv.number] = agv.tasks_done

    def has_to_wait(self, agv: Agv) -> None:
        """Withdraw the AGV's promised charger."""
        agv.due_at = max(agv.soc, self.rules.charge_below)

    def _leave_queue(self, agv: Agv) -> None:
        agv.due_at = -1.0
        self._queued.pop(agv.number, None)

    # --- who goes to a charger ------------------------------------------------------------------------------------

    def next_to_go(self) -> Iterator[tuple[Agv, Vertex]]:
        """AGVs that leave for a charger now, each with the charger promised to it."""
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
        """The AGV that must give up its promised charger to an AGV in the queue, if any.

        An AGV that cannot move gives up its charger. An AGV that could still work gives up its charger to an AGV that
        lacks the charge for a task, provided that the second AGV arrives before the first one would have charged.
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
        """Rank in the queue, lowest first: state of charge, less ``AGE_SOC`` per full charge's time spent waiting."""
        if not self.rules.by_charge:
            return 0.0, agv.number
        waited = self._step - self._queued.get(agv.number, self._step)
        return agv.soc - AGE_SOC * waited / self.rules.charging_steps(self.rules.charge_below), agv.number

    def _at(self, agv: Agv) -> Vertex:
        return self.executor.agvs[agv.number].last

    def _may_go(self, agv: Agv) -> bool:
        """Whether the AGV is free and stands where it may leave for a charger."""
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
        """The emptiest AGV that may charge early, if the chargers are scarce."""
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
        """Available AGVs in the order in which they are offered tasks. AGVs that are due come last.

        An AGV that lacked the charge for a task is offered no task until it has charged, if it can charge.
        """
        if not self.rules.by_charge:
            return [at]
        due = {n: v for n, v in at.items() if self.agvs[n].due}
        last = {n: v for n, v in due.items() if n not in self._short or not self._can_charge(self.agvs[n])}
        return [{n: v for n, v in at.items() if n not in due}, last]

    def takes(self, agv: Agv, origin: Vertex, destination: Vertex) -> bool:
        """Whether a free AGV has enough charge for a task and takes it. Otherwise the AGV becomes due.

        Args:
            agv: the AGV.
            origin: vertex where the car stands.
            destination: vertex where the car goes; -1 is the nearest bay.
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
        """Learn from the charge that a finished task has taken."""
        if agv.number in self._under_way:
            soc, steps = self._under_way.pop(agv.number)
            self._spent += max(0.0, soc - agv.soc)
            self._steps += steps

    def _can_charge(self, agv: Agv) -> bool:
        here = self._at(agv)
        return any(self.costs.to(c)[here] < FOREVER for c in self._open_chargers())

    def _task_steps(self, agv: Agv, origin: Vertex, destination: Vertex) -> tuple[int, int]:
        """Steps to the car and on to its destination, lifts included; then the steps home and on to a charger.

        Turns with the car and waits are left out: the charge of a task is learnt per step of this way.
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
