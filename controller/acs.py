"""The ACS (AGV control system) turns the state of the garage into commands, once per planning step.

A step runs these phases in order: finished actions, actions at goals, customers, charging, dispatch, planning, deadlock
handling, grants. The ACS reads states and gives commands. It does not know SUMO, files or wall-clock time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from controller.charging import Charging
from controller.claims import Claims
from controller.costs import Costs
from controller.dispatch import Offer, Rule
from controller.events import Event, Log
from controller.executor import Executor
from controller.faults import CLOSING, FaultReport, Outages
from controller.fleet import FREE_MODES, Agv
from controller.garage import Garage, Task
from controller.holds import Holds
from controller.places import choose_slot
from controller.planning import ControlOptions, Mask, Planning
from controller.rules import Rules
from controller.types import NO_AGV, NO_REQUEST, Action, AgvMode, AgvNumber, AgvState, Command, Motion, Planner
from controller.wait_log import WaitLog
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Numbered, Vertex, numbered


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything an ACS is built from.

    Attributes:
        graph, motion: the garage, and the duration of each move.
        homes: home vertex of each AGV; each AGV starts at its home.
        garage: books of cars, requests and places.
        rules: lift durations, charging and assignment rules.
        options: planning period, windows, deadlock limits.
        planner: answers planning problems.
        dispatch: assigns tasks to AGVs.
        log: receives events.
        clock: returns wall-clock seconds; the value is only recorded.
    """

    graph: Graph
    motion: Motion
    homes: Numbered[AgvNumber, Vertex]
    garage: Garage
    rules: Rules
    options: ControlOptions
    planner: Planner
    dispatch: Rule
    log: Log
    clock: Callable[[], float]


class Acs:
    """Controls one garage.

    Attributes:
        agvs: the fleet.
        executor: visiting orders of vertices, and the vertices granted to each AGV.
        planning: decides when and what to plan; handles deadlocks.
        costs: driving costs for choosing AGVs, slots and bays.
        holds: explains why an AGV or a request makes no progress.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.graph, self.garage, self.rules = setup.graph, setup.garage, setup.rules
        self.log = setup.log
        self.agvs: Numbered[AgvNumber, Agv] = [Agv(n, home, home) for n, home in numbered(setup.homes)]
        self.executor = Executor(setup.graph, setup.motion, setup.homes, barred=self._barred)
        self.costs = Costs(setup.graph, setup.motion, setup.garage.blocked)
        self.planning = Planning(
            setup.planner, setup.options, self.agvs, self.executor, setup.rules, self.costs, self.log, setup.clock
        )
        self.outages = Outages()
        self.holds = Holds(setup.garage, self.agvs, self.executor, self.outages, self.costs)
        long_steps = setup.options.ladder.stuck_steps
        self._wait_log = WaitLog(self.holds, self.executor, self.agvs, long_steps, self.log)
        self._claims = Claims(setup.garage, self.agvs, self.executor, self.costs, setup.rules.lift_bay)
        self._charging = Charging(
            setup.rules, setup.garage, self.agvs, self.executor, self.costs, self.outages, self._claims, self.log
        )
        self._attend: set[AgvNumber] = set()
        self._places: Mask = np.zeros(len(setup.graph.names), dtype=np.uint8)
        self._places[[*setup.graph.bays, *setup.graph.chargers, *setup.homes]] = 1
        self._now_s = 0.0
        self._step = 0
        self._commands: list[Command] = []

    def step(self, step: int, states: Numbered[AgvNumber, AgvState]) -> list[Command]:
        """Decide what happens next.

        Args:
            step: current planning step.
            states: state of each AGV, as the plant reported it.

        Returns:
            Commands, in the order in which the plant must carry them out.
        """
        self._step, self._now_s = step, self._setup.motion.seconds(step)
        self._commands = []
        changed, finished = self.executor.update(states, step)
        self._charging.read(changed, states, step)
        for n in finished:
            self._complete(self.agvs[n])
        self._attend.update(changed)
        self._work_at_goals()
        if self.garage.handover == "bay":
            self._commands += self.garage.board(self._now_s)
            self._commands += self.garage.call_forward(self._now_s, self.outages.closed)
        self._send_charging()
        self._dispatch()
        self._choose_bays()
        self.planning.step(step, self._blocked(), self._no_rest)
        self._commands += self.executor.grants(step)
        self._wait_log.step(step)
        return self._commands

    # --- work at the goals ----------------------------------------------------------------------------------------

    def _work_at_goals(self) -> None:
        """Start the work of AGVs that have arrived. An AGV that must still wait is looked at again in the next step."""
        for n in sorted(self._attend):
            agv, a = self.agvs[n], self.executor.agvs[n]
            ready = agv.action is None and a.standing and a.acting_until < 0
            if ready and a.last == agv.goal and agv.mode is not AgvMode.IDLE:
                if a.pending:
                    self.executor.cancel(n)
                if not self._begin(agv):
                    continue
            self._attend.discard(n)

    def _begin(self, agv: Agv) -> bool:
        """Start the work at the AGV's goal. False while the AGV waits for a customer, a bay or a free place."""
        task = agv.task
        at_slot = agv.goal in self.garage.slot_of
        if agv.mode is AgvMode.GOING_TO_COLLECT and task and task.ready_s <= self._now_s:
            self._act(agv, Action.LIFT, self.rules.lift_slot if at_slot else self.rules.lift_bay)
        elif agv.mode in (AgvMode.GOING_TO_PARK, AgvMode.RETURNING_WITH_CAR) and task and task.destination == agv.goal:
            if self.garage.may_lower(task):
                self.garage.lower_starts(task)
                self._act(agv, Action.LOWER, self.rules.lower_slot if at_slot else self.rules.lower_bay)
        elif agv.mode is AgvMode.GOING_TO_CHARGE:
            self.log(Event("charge_start", agv.number, vertex=agv.goal, detail={"soc": round(agv.soc, 4)}))
            self._set_mode(agv, AgvMode.CHARGING)
            self._act(agv, Action.CHARGE, self.rules.charging_steps(agv.soc))
        elif agv.mode in (AgvMode.RETURNING_HOME_EMPTY, AgvMode.RETURNING_HOME_MAINTENANCE):
            self._set_mode(agv, AgvMode.IDLE)
        return agv.action is not None or agv.mode is AgvMode.IDLE

    def _act(self, agv: Agv, action: Action, steps: int) -> None:
        agv.action = action
        if agv.goal in self._claims.next:
            self._plan_way_out(agv)
        request = agv.task.number if agv.task else NO_REQUEST
        self._commands.append(self.executor.act(agv.number, action, steps, self._step, request))
        if steps == 0:
            self._complete(agv)

    def _complete(self, agv: Agv) -> None:
        action, agv.action = agv.action, None
        agv.then = NO_VERTEX
        if action is Action.CHARGE:
            self.log(Event("charge_end", agv.number, vertex=agv.goal, detail={"soc": round(agv.soc, 4)}))
            self._charging.charged(agv)
            self._release(agv)
            self._set_mode(agv, AgvMode.RETURNING_HOME_MAINTENANCE)
            self._set_goal(agv, agv.home)
        elif action is Action.LIFT and agv.task:
            self._lifted(agv, agv.task)
        elif action is Action.LOWER and agv.task:
            self._lowered(agv, agv.task)

    def _lifted(self, agv: Agv, task: Task) -> None:
        self.garage.lifted(task, self._now_s)
        self.executor.agvs[agv.number].loaded = True
        self.log(Event("lift", agv.number, task.car, agv.goal, {"request": task.number}))
        self._release(agv)
        if task.is_park:
            self._set_mode(agv, AgvMode.GOING_TO_PARK)
            self._set_goal(agv, task.destination)
            if task.destination in self.outages.closed:
                self._change_goal(agv)
        else:
            self._set_mode(agv, AgvMode.RETURNING_WITH_CAR)

    def _choose_bays(self) -> None:
        """Give AGVs that have lifted a car a bay. While every bay is claimed, move these AGVs closer to the bays.

        This phase follows dispatch: an AGV that has just put a car down at a bay may fetch the car waiting at that bay
        before the bay is promised to another AGV.
        """
        self._claims.move_up()
        waiting = {
            agv.number: agv.task
            for agv in self.agvs
            if agv.mode is AgvMode.RETURNING_WITH_CAR and agv.task and agv.task.destination < 0 and not agv.immobile
        }
        if not waiting:
            return
        if self.garage.handover == "home":
            for n, task in waiting.items():
                self._carry_to(self.agvs[n], task, self.agvs[n].home)
            return
        closed = self.outages.closed
        chosen = self._claims.promise_bays(waiting, self._step, closed, self.planning.flags.rests)
        without = {n: task for n, task in waiting.items() if n not in chosen}
        for n, bay in chosen.items():
            self._promise(self.agvs[n], waiting[n], bay, NO_AGV)
        for near, far in self._claims.trade_bays(without, self._step, closed).items():
            loser = self.agvs[far].task
            assert loser is not None, "who has no car has no bay to lose"
            self._promise(self.agvs[near], without.pop(near), loser.destination, far)
            loser.destination = NO_VERTEX
            without[far] = loser
        for n, task in without.items():
            self._wait_with_car(self.agvs[n], task)

    def _promise(self, agv: Agv, task: Task, bay: Vertex, instead_of: AgvNumber) -> None:
        """Send an AGV to a bay that is promised to it; ``instead_of`` has lost it, -1 if nobody has."""
        behind = self._claims.holder[bay] if self._claims.next.get(bay) == agv.number else NO_AGV
        detail = {"request": task.number, "behind": behind, "instead_of": instead_of}
        self.log(Event("bay_promised", agv.number, task.car, bay, detail))
        self._carry_to(agv, task, bay)
        if behind >= 0:
            self._plan_way_out(self.agvs[behind])

    def _carry_to(self, agv: Agv, task: Task, place: Vertex) -> None:
        task.destination = place
        self._send(agv, task, place)

    def _wait_with_car(self, agv: Agv, task: Task) -> None:
        """Let an AGV wait for a bay at a home near the bays, or at the slot if that is nearer."""
        at = self.executor.agvs[agv.number].last
        absent = self._claims.absent_nearer(agv, self.outages.closed)
        if absent >= 0:
            self._exchange_homes(agv, self.agvs[absent])
        if not at == agv.goal == task.origin or self._claims.nearer_to_bays(agv.home, at):
            self._send(agv, task, agv.home)

    def _exchange_homes(self, agv: Agv, other: Agv) -> None:
        agv.home, other.home = other.home, agv.home
        homes = {each.number: self.graph.names[each.home] for each in (agv, other)}
        self.log(Event("homes_exchanged", agv.number, detail={"waiting": agv.number, "homes": homes}))

    def _send(self, agv: Agv, task: Task, place: Vertex) -> None:
        """Send an AGV on with its car; once it has somewhere to go, other cars may have the slot where it lifted it."""
        if agv.goal == task.origin:  # wherever it is: in a deadlock it may have been moved out of the slot
            self.garage.vacate(task.origin)
        self._set_goal(agv, place)

    def _plan_way_out(self, agv: Agv) -> None:
        """Plan the AGV's departure from the bay early, so that the next AGV can plan its arrival."""
        agv.then = agv.task.destination if agv.task and agv.action is Action.LIFT else agv.home
        self.planning.goal_changed()

    def _lowered(self, agv: Agv, task: Task) -> None:
        self._commands += self.garage.lowered(task, self._now_s)
        self.executor.agvs[agv.number].loaded = False
        self.log(Event("lower", agv.number, task.car, agv.goal, {"request": task.number}))
        if task.state == "served":
            self.log(Event("task_done", agv.number, task.car, agv.goal, {"request": task.number}))
        self._release(agv)
        self._charging.task_done(agv)
        agv.tasks_done += 1
        agv.task = None
        if agv.goal == agv.home:
            self._set_mode(agv, AgvMode.IDLE)
        else:
            self._set_mode(agv, AgvMode.RETURNING_HOME_EMPTY)
            self._set_goal(agv, agv.home)

    # --- assignment -----------------------------------------------------------------------------------------------

    def _available(self, agv: Agv) -> bool:
        if agv.immobile or agv.off_duty:
            return False
        if self.rules.assign_on_return:
            return agv.mode in FREE_MODES and agv.action is None
        return agv.mode is AgvMode.IDLE

    def _send_charging(self) -> None:
        if not (self.garage.unfinished or self.rules.charge_unasked):
            return
        late = self._charging.gives_way()
        if late:
            self._give_back(late)
        for agv, charger in self._charging.next_to_go():
            self._set_mode(agv, AgvMode.GOING_TO_CHARGE)
            self._set_goal(agv, charger)

    def _dispatch(self) -> None:
        if not self.garage.open:
            return
        count = len(self.garage.open)
        if self.rules.keep_for_returning:
            count -= sum(1 for a in self.agvs if a.mode is AgvMode.RETURNING_HOME_EMPTY)
        available = {a.number: self.executor.agvs[a.number].last for a in self.agvs if self._available(a)}
        for at in self._charging.in_turn(available):
            while at and count > 0 and self.garage.open:
                offers = self._offers(at)[:count]
                refused = {offer.agv for offer in offers if not self._take(offer)}
                count -= len(offers) - len(refused)
                if not refused:
                    break
                at = {n: v for n, v in at.items() if n not in {offer.agv for offer in offers}}

    def _offers(self, at: Mapping[AgvNumber, Vertex]) -> list[Offer]:
        before = self.costs.expanded
        offers = self._setup.dispatch(self.garage.open, at, self._claims.only(self._step), self.costs)
        self.planning.slot_choice += self.costs.expanded - before
        return offers

    def _take(self, offer: Offer) -> bool:
        """Give the task to the AGV if a slot is free for the car. False if the AGV lacks the charge for the task."""
        task, agv = offer.task, self.agvs[offer.agv]
        origin = agv.home if offer.origin < 0 else offer.origin
        slot = NO_VERTEX
        if task.is_park:
            before = self.costs.expanded
            slot = choose_slot(self.garage, origin, task.request.zone, self.costs, self.rules.around_cars)
            self.planning.slot_choice += self.costs.expanded - before
            if slot < 0:
                return True
        if not self._charging.takes(agv, origin, slot):
            return False
        self._assign(task, agv, origin, slot)
        return True

    def _assign(self, task: Task, agv: Agv, origin: Vertex, slot: Vertex) -> None:
        self.garage.assign(task, agv.number, self._now_s, origin, slot)
        agv.task = task
        if origin in self.garage.bays and self.garage.handover == "bay":
            self._claims.holder[origin] = agv.number
        names = self.graph.names
        detail = {"request": task.number, "origin": names[origin], "destination": names[slot] if slot >= 0 else ""}
        self.log(Event("task_assigned", agv.number, task.car, origin, detail))
        self._set_mode(agv, AgvMode.GOING_TO_COLLECT)
        self._set_goal(agv, origin)
        a = self.executor.agvs[agv.number]
        if a.standing and a.last == origin:
            self._begin(agv)

    def _set_goal(self, agv: Agv, goal: Vertex) -> None:
        if agv.goal != goal:
            agv.goal = goal
            self.planning.goal_changed()

    def _set_mode(self, agv: Agv, mode: AgvMode) -> None:
        if agv.mode is not mode:
            self.log(Event("agv_mode", agv.number, detail={"from": agv.mode.value, "to": mode.value}))
            agv.mode = mode
            self._attend.add(agv.number)

    def _release(self, agv: Agv) -> None:
        self._claims.release(agv.goal, agv.number)

    # --- faults ---------------------------------------------------------------------------------------------------

    def report(self, fault: FaultReport) -> None:
        """Record the start or end of a fault and respond to it; see ``controller.faults``."""
        self.outages.take(fault)
        self.executor.close(self.outages.closed)
        self.garage.close(self.outages.closed)
        for n in fault.agvs:
            agv = self.agvs[n]
            agv.immobile, agv.off_duty = n in self.outages.immobile, n in self.outages.off_duty
            if agv.off_duty:
                self._give_back(agv)
            self._attend.add(n)
        lost: set[Vertex] = {*fault.vertices} if fault.started and fault.kind in CLOSING else set()
        lost |= {bay for bay in self._claims.next if self._claims.holder.get(bay) in self.outages.immobile}
        for agv in self.agvs:
            if agv.goal in lost and agv.goal not in self.executor.agvs[agv.number].trail:
                self._change_goal(agv)
        self._drop_plans_through(self._in_the_way())
        self.planning.goal_changed()

    def _in_the_way(self) -> set[Vertex]:
        """Vertices that are closed, or held by AGVs that cannot move."""
        return {*self.outages.closed, *(v for n in self.outages.immobile for v in self.executor.agvs[n].trail)}

    def _drop_plans_through(self, vertices: set[Vertex]) -> None:
        for agv, a in zip(self.agvs, self.executor.agvs, strict=True):
            if agv.immobile or vertices.intersection(a.pending):
                self.executor.cancel(agv.number)
                comes = self._claims.next.get(agv.goal, NO_AGV)
                if agv.then >= 0 and comes >= 0:  # the next AGV would block the AGV that is to leave
                    self.executor.cancel(comes)

    def _give_back(self, agv: Agv) -> None:
        """Return the task to the open tasks if the AGV has not lifted its car, and send the AGV home."""
        task = agv.task
        if agv.mode is AgvMode.GOING_TO_COLLECT and task and agv.action is None:
            self._release(agv)
            self.garage.unassign(task)
            agv.task = None
            self.log(Event("task_returned", agv.number, task.car, detail={"request": task.number}))
        elif agv.mode is AgvMode.GOING_TO_CHARGE:
            self._release(agv)
            self._charging.has_to_wait(agv)
        else:
            return
        self._set_mode(agv, AgvMode.RETURNING_HOME_EMPTY)
        self._set_goal(agv, agv.home)

    def _change_goal(self, agv: Agv) -> None:
        """Replace a closed goal by another one; wait if there is no other goal."""
        task = agv.task
        if agv.mode is AgvMode.GOING_TO_PARK and task:
            slot = choose_slot(self.garage, self.executor.agvs[agv.number].last, task.request.zone, self.costs)
            if slot >= 0:
                self.garage.move_reservation(task, slot)
                self._set_goal(agv, slot)
        elif agv.mode is AgvMode.RETURNING_WITH_CAR and task and agv.goal in self.garage.bays:
            self._release(agv)
            task.destination = NO_VERTEX
            self._set_goal(agv, self.executor.agvs[agv.number].last)  # until ``_choose_bays`` finds another bay
            self._attend.add(agv.number)
        else:
            self._give_back(agv)

    # --- what planning has to know --------------------------------------------------------------------------------

    def _barred(self, n: AgvNumber, vertex: Vertex) -> bool:
        """A car is parked there, and it is not the one that the AGV goes for."""
        return bool(self.garage.blocked[vertex]) and vertex not in (self.agvs[n].goal, self.agvs[n].heads_for)

    def _blocked(self) -> Mask:
        if not (self.outages.closed or self.outages.immobile):
            return self.garage.blocked
        mask = self.garage.blocked.copy()
        mask[list(self._in_the_way())] = 1
        return mask

    def _no_rest(self) -> Mask:
        mask = self._places.copy()
        mask[list(self.garage.reserved)] = 1
        return mask
