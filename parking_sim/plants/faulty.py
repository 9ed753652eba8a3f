"""A plant in which things go wrong: it wraps another one and delays, stops, closes and breaks what it carries out.

Faults are physical here. The controller is told of those that a real one would be told of (``FaultReport`` among the
events, ``AgvState.able``) and sees the others only by where AGVs are.

Where following is allowed (the discrete plant) a granted move is made in the very tick, so an AGV that is late has to
say so before: every delay there makes it unable for some ticks, and a move takes its time before it begins.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.random import Generator

from analysis.record import AgvSample
from controller.faults import IMMOBILE, FaultKind, FaultReport
from controller.types import Act, Action, Advance, AgvNumber, AgvState, Command, RequestNumber, whole_steps
from demand.types import stream
from parking_sim.fault_config import Battery, Breakdown, FaultConfig, Slow, Stale, ZoneStop
from parking_sim.faults import Fault, fault_stream
from parking_sim.plants import Plant, PlantEvent, StreetState
from sumo_nets.numbering import NO_VERTEX, Numbered, Vertex, numbered, numbers

if TYPE_CHECKING:
    from parking_sim.footprint import Bodies


class BreakablePlant(Plant, Protocol):
    """What faults need of a plant besides the commands."""

    def hold(self, agv: AgvNumber, held: bool) -> None:
        """Stop an AGV and what it does, or let it go on."""

    def limit(self, agv: AgvNumber, share: float) -> None:
        """Let an AGV drive at a share of its speed from now on."""

    def set_soc(self, agv: AgvNumber, soc: float) -> None:
        """Set the state of charge of an AGV's battery, 0 to 1."""


@dataclass(slots=True)
class _Body:
    """What the plant knows of one AGV.

    Attributes:
        way: granted vertices, the first one is the oldest that its body may touch.
        first: number of ``way[0]``.
        reached: number of the last vertex reached.
        holds: how many faults hold it.
        out: how many of these it has reported.
        slow, tow, noise: shares of its speed.
        loaded: it carries a car.
        inbox: commands on their way, with the step at which each arrives and the number of its fault or -1.
        told: step of the last command carried out.
        owed: ticks that it is late (discrete plant).
        age: steps by which its reported positions are old.
    """

    way: deque[Vertex]
    first: int = 0
    reached: int = 0
    holds: int = 0
    out: int = 0
    slow: float = 1.0
    tow: float = 1.0
    noise: float = 1.0
    loaded: bool = False
    inbox: deque[tuple[int, Advance | Act, FaultReport | None]] = field(default_factory=deque)
    told: int = -1
    owed: float = 0.0
    age: int = 0

    @property
    def touched(self) -> list[Vertex]:
        """Vertices that the body touches or is driving at."""
        return list(self.way)[: self.reached - self.first + 2]

    @property
    def next(self) -> Vertex:
        """Vertex it is driving at, -1 for none."""
        k = self.reached - self.first + 1
        return self.way[k] if k < len(self.way) else NO_VERTEX


class FaultyPlant:
    """Another plant with faults.

    Args:
        plant: the plant.
        config: what can go wrong.
        homes: start vertex of each AGV.
        seed: seed of the run.

    Raises:
        InputError: a scripted fault names an AGV or a place that isn't there.
    """

    def __init__(
        self, plant: BreakablePlant, config: FaultConfig, homes: Numbered[AgvNumber, Vertex], seed: int
    ) -> None:
        self._plant = plant
        self._config = config
        self.graph, self.motion = plant.graph, plant.motion
        self._homes = frozenset(homes)
        self._bodies: Numbered[AgvNumber, _Body] = [_Body(deque([home])) for home in homes]
        self._faults: Iterator[Fault] = fault_stream(config, plant.graph, len(homes), seed)
        self._coming: Fault | None = next(self._faults, None)
        self._running: list[tuple[int, Fault, FaultReport]] = []
        self._postponed: list[Fault] = []
        self._towed: dict[AgvNumber, FaultReport] = {}
        self._closed: dict[Vertex, int] = {}
        self._braked: dict[AgvNumber, Vertex] = {}
        self._news: list[PlantEvent] = []
        self._count = 0
        self._step = 0
        self._travel: Numbered[AgvNumber, Generator] = [stream(seed, f"travel {i}") for i in range(len(homes))]
        self._radio: Numbered[AgvNumber, Generator] = [stream(seed, f"radio {i}") for i in range(len(homes))]
        self._seen: deque[Numbered[AgvNumber, AgvState]] = deque([list(plant.states())])
        self._quiet = not config.any  # nothing happens but that batteries run flat

    # --- the Plant protocol ---------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self._plant.time_s

    def states(self) -> Numbered[AgvNumber, AgvState]:
        """What the AGVs report: late where positions are stale, unable where a fault holds them."""
        return self._plant.states() if self._quiet else [self._reported(i) for i in numbers(self._bodies)]

    def events(self) -> Sequence[PlantEvent]:
        """What happened in the last step, faults included."""
        news, self._news = self._news, []
        return [*self._plant.events(), *news]

    def arrive(self, request: RequestNumber) -> None:
        """A customer comes to the garage."""
        self._plant.arrive(request)

    def execute(self, command: Command) -> None:
        """Carry out one command, or put it on its way if it comes late."""
        if not isinstance(command, Advance | Act):
            self._plant.execute(command)
            return
        if self._quiet:
            self._deliver(command)
            return
        body = self._bodies[command.agv]
        delay, kind = self._delay(command.agv)
        if self.motion.following:
            self._deliver(command)
            if delay:
                self._begin(Fault(self._now_s, kind, self.motion.seconds(delay), command.agv))
            return
        due = max(self._step + delay, body.inbox[-1][0] if body.inbox else 0)
        if due <= self._step and not body.inbox:
            self._deliver(command)
            return
        report = self._begin_report(kind, (command.agv,)) if delay else None
        body.inbox.append((due, command, report))

    def step(self) -> None:
        """Advance the world by one step, then let faults end and begin."""
        self._deliver_due()
        self._plant.step()
        self._step += 1
        if self._quiet and all(state.soc > 0.0 for state in self._plant.states()):
            return
        self._quiet = False
        self._follow()
        self._end_faults()
        self._begin_faults()
        self._brake()
        self._tow()

    def samples(self) -> Sequence[AgvSample]:
        """Where each AGV is now."""
        return self._plant.samples()

    def street(self) -> StreetState | None:
        """Customers waiting in the street now."""
        return self._plant.street()

    def bodies(self) -> Bodies | None:
        """All AGVs as rectangles."""
        return self._plant.bodies()

    @property
    def battery_wh(self) -> float:
        """Capacity of an AGV's battery."""
        return self._plant.battery_wh

    @property
    def collisions(self) -> int:
        """Collisions that SUMO has reported."""
        return self._plant.collisions

    @property
    def sumo_s(self) -> float:
        """Wall-clock seconds that SUMO has taken."""
        return self._plant.sumo_s

    # --- what is to come ------------------------------------------------------------------------------------------

    def ending(self, before_s: float) -> frozenset[int]:
        """Numbers of the faults under way that end before a time in seconds."""
        until = before_s / self.motion.step_s
        return frozenset(report.number for end, _, report in self._running if end < until)

    def still(self, before_s: float) -> frozenset[AgvNumber] | None:
        """AGVs that faults keep from moving until a time.

        Args:
            before_s: the time, seconds.

        Returns:
            Their numbers; None if a fault may begin or end before that time, or a command is on its way.
        """
        coming = self._coming is not None and self._coming.start_s < before_s
        if coming or self._postponed or self.ending(before_s) or any(body.inbox for body in self._bodies):
            return None
        return frozenset(i for i, body in numbered(self._bodies) if body.holds)

    def close(self) -> None:
        """Release what the plant holds."""
        self._plant.close()

    @property
    def _now_s(self) -> float:
        """Seconds since the loop began."""
        return self.motion.seconds(self._step)

    # --- what is reported -----------------------------------------------------------------------------------------

    def _reported(self, i: AgvNumber) -> AgvState:
        body = self._bodies[i]
        age = min(body.age, len(self._seen) - 1)
        state = self._seen[-1 - age][i]
        able = not (body.holds if self.motion.following else body.out)
        standing = state.standing and not body.inbox and (age == 0 or body.told < self._step - age)
        return state if able and standing == state.standing else replace(state, standing=standing, able=able)

    def _follow(self) -> None:
        """Take note of where the AGVs have got to."""
        states = list(self._plant.states())
        self._seen.append(states)
        keep = 1 + max((body.age for body in self._bodies), default=0)
        while len(self._seen) > keep:
            self._seen.popleft()
        for (i, body), state in zip(numbered(self._bodies), states, strict=True):
            while body.first < state.left:
                body.first += 1
                body.way.popleft()
            if state.reached != body.reached:
                for _ in range(state.reached - body.reached):
                    self._vary(i)
                body.reached = state.reached
            if body.owed >= 1:
                self._pay(i)
            if state.soc <= 0.0 and not body.out and (self._config.battery or not self.motion.following):
                service = self._config.battery or Battery(per_h=0)
                self._postponed.append(Fault(self._now_s, "battery", service.most_s, i))

    # --- travel time ----------------------------------------------------------------------------------------------

    def _vary(self, i: AgvNumber) -> None:
        """Draw how long the next move takes."""
        sigma, body = self._config.travel_noise, self._bodies[i]
        factor = math.exp(sigma * float(self._travel[i].standard_normal())) if sigma else 1.0
        body.noise = 1.0 / factor
        if not self.motion.following:
            if sigma:
                self._limit(i)
        else:  # no AGV is faster than a cell a tick
            body.owed += max(0.0, factor / (body.slow * body.tow) - 1.0)

    def _pay(self, i: AgvNumber) -> None:
        """Be late by whole ticks (discrete plant)."""
        body = self._bodies[i]
        ticks = int(body.owed)
        body.owed -= ticks
        self._hold(i, True)
        fault = Fault(self._now_s, "stop", self.motion.seconds(ticks), i)
        self._running.append((self._step + ticks, fault, FaultReport(-1, fault.kind, True, (i,))))

    def _limit(self, i: AgvNumber) -> None:
        body = self._bodies[i]
        self._plant.limit(i, body.noise * body.slow * body.tow)

    def _hold(self, i: AgvNumber, held: bool) -> None:
        body = self._bodies[i]
        body.holds += 1 if held else -1
        if body.holds == int(held):
            self._plant.hold(i, held)

    # --- commands -------------------------------------------------------------------------------------------------

    def _delay(self, i: AgvNumber) -> tuple[int, FaultKind]:
        """Steps by which the next command of an AGV is late, and why."""
        commands, rng = self._config.commands, self._radio[i]
        seconds = 0.0
        if commands.lost:
            seconds = commands.retry_s * (float(rng.geometric(1.0 - commands.lost)) - 1.0)
        kind: FaultKind = "lost" if seconds else "late"
        if commands.late and float(rng.random()) < commands.late:
            seconds += commands.late_s
        return whole_steps(seconds, self.motion.step_s), kind

    def _deliver_due(self) -> None:
        for body in self._bodies:
            while body.inbox and body.inbox[0][0] <= self._step:
                _, command, report = body.inbox.popleft()
                self._deliver(command)
                if report:
                    self._end_report(report)

    def _deliver(self, command: Advance | Act) -> None:
        body = self._bodies[command.agv]
        body.told = self._step
        if isinstance(command, Advance):
            body.way.extend(command.vertices)
        elif command.action is Action.LIFT:
            body.loaded = True
        elif command.action is Action.LOWER:
            body.loaded = False
        self._plant.execute(command)

    # --- faults begin and end -------------------------------------------------------------------------------------

    def _begin_report(
        self, kind: FaultKind, agvs: tuple[AgvNumber, ...], vertices: tuple[Vertex, ...] = ()
    ) -> FaultReport:
        report = FaultReport(self._count, kind, True, agvs, vertices)
        self._count += 1
        self._news.append(report)
        return report

    def _end_report(self, report: FaultReport) -> None:
        self._news.append(replace(report, started=False))

    def _begin_faults(self) -> None:
        waiting, self._postponed = self._postponed, []
        while self._coming is not None and self._coming.start_s <= self._now_s:
            waiting.append(self._coming)
            self._coming = next(self._faults, None)
        for fault in waiting:
            if fault.kind == "blocked" and self._occupied(fault.vertex):
                self._postponed.append(fault)
            else:
                self._begin(fault)

    def _occupied(self, vertex: Vertex) -> bool:
        """An AGV is there or can't be stopped before it: nobody steps in front of it."""
        return any(vertex in body.touched for body in self._bodies)

    def _begin(self, fault: Fault) -> None:
        agvs, vertices = self._concerned(fault)
        report = self._begin_report(fault.kind, agvs, vertices)
        until = self._step + max(1, round(fault.for_s / self.motion.step_s))
        self._running.append((until, fault, report))
        for i in agvs:
            self._begin_on(i, fault)
        for v in vertices if fault.kind in ("blocked", "zone_stop") else ():
            self._closed[v] = self._closed.get(v, 0) + 1

    def _concerned(self, fault: Fault) -> tuple[tuple[AgvNumber, ...], tuple[Vertex, ...]]:
        """AGVs and vertices of a fault that begins now."""
        if fault.agv >= 0:
            return (fault.agv,), ()
        if fault.kind == "all_stop":
            return tuple(numbers(self._bodies)), ()
        if fault.kind != "zone_stop":
            return (), (fault.vertex,)
        radius_m = (self._config.zone_stop or ZoneStop(per_h=0)).radius_m
        offset = self.graph.xy - self.graph.xy[fault.vertex]
        zone = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) <= radius_m)
        inside = tuple(i for i, body in numbered(self._bodies) if np.isin(body.touched, zone).any())
        return inside, (fault.vertex, *(Vertex(v) for v in zone.tolist() if v != fault.vertex))

    def _begin_on(self, i: AgvNumber, fault: Fault) -> None:
        body, config = self._bodies[i], self._config
        if fault.kind == "slow":
            body.slow = (config.slow or Slow(per_h=0)).share
            self._limit(i)
        elif fault.kind == "stale":
            body.age = whole_steps((config.stale or Stale(per_h=0)).age_s, self.motion.step_s)
        else:
            self._hold(i, True)
            body.out += fault.kind in IMMOBILE
        if fault.kind == "battery":
            self._plant.set_soc(i, 0.0)

    def _end_faults(self) -> None:
        over = [row for row in self._running if row[0] <= self._step]
        if over:
            self._running = [row for row in self._running if row[0] > self._step]
        for _, fault, report in over:
            for i in report.agvs:
                self._end_on(i, fault)
            for v in report.vertices if fault.kind in ("blocked", "zone_stop") else ():
                self._closed[v] -= 1
                if not self._closed[v]:
                    del self._closed[v]
            if report.number >= 0:
                self._end_report(report)
            if fault.kind == "breakdown":
                self._couple(fault.agv)

    def _end_on(self, i: AgvNumber, fault: Fault) -> None:
        body = self._bodies[i]
        if fault.kind == "slow":
            body.slow = 1.0
            self._limit(i)
        elif fault.kind == "stale":
            body.age = 0
        else:
            self._hold(i, False)
            body.out -= fault.kind in IMMOBILE
        if fault.kind == "battery":
            self._plant.set_soc(i, (self._config.battery or Battery(per_h=0)).brings)

    # --- people in the way, and tows ------------------------------------------------------------------------------

    def _brake(self) -> None:
        """AGVs stop before closed places that they were allowed to enter, and go on when these are free again."""
        if not self._closed and not self._braked:
            return
        now = {i: body.next for i, body in numbered(self._bodies) if body.next in self._closed}
        for i in self._braked.keys() - now.keys():
            self._hold(i, False)
        for i in now.keys() - self._braked.keys():
            self._hold(i, True)
        self._braked = now

    def _couple(self, i: AgvNumber) -> None:
        """The tow has come; another breakdown under tow needs no second one."""
        if i in self._towed:
            return
        self._bodies[i].tow = (self._config.breakdown or Breakdown(per_h=0)).tow_share
        self._limit(i)
        self._towed[i] = self._begin_report("tow", (i,))

    def _tow(self) -> None:
        """What has come home without a car is repaired there; AGVs may have exchanged homes."""
        for i, report in list(self._towed.items()):
            body = self._bodies[i]
            standing = self._seen[-1][i].standing and not body.inbox
            if standing and not body.loaded and body.way[-1] in self._homes:
                body.tow = 1.0
                self._limit(i)
                del self._towed[i]
                self._end_report(report)
                repair_s = (self._config.breakdown or Breakdown(per_h=0)).repair_s
                self._begin(Fault(self._now_s, "repair", repair_s, i))
