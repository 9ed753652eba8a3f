"""The garage in SUMO: AGVs as rail vehicles under movement authority, customers as cars on a street.

An AGV's SUMO route always ends at the last vertex granted to it, with a stop there. What SUMO does with it, measured on
1.28:

- Route ids, not edge lists: ``setRoute`` keeps every edge ever driven and gets slower by 70 us per 1,000 of them, while
  ``setRouteID`` with a route of the few edges ahead takes 3.5 us for ever.
- While driving, the route and the new stop are set first, then the old stop is set again with duration 0, which removes
  it: the speed does not change. On a junction SUMO refuses routes, so that extension waits for the next normal edge.
- At a stop, when the next edge is the twin of the one it stands on, the vehicle reverses in place.
- Getters of the AGVs that move cost half of what subscriptions do, and those that stand cost nothing: 20 us a step with
  8 AGVs under way.
- A turn in place is a timed stop: the body stays where it is and swings round while it drives into the next edge.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.record import AgvSample
from controller.types import (
    Act,
    Action,
    Advance,
    AgvNumber,
    AgvState,
    CallForward,
    Command,
    DriveOff,
    HandOver,
    RequestNumber,
)
from parking_sim.footprint import Bodies
from parking_sim.plants import PlantEvent, StreetState
from parking_sim.plants.sumo_agv import AgvType, sumo_motion
from parking_sim.plants.sumo_api import PlantError, load_api, silent
from parking_sim.plants.sumo_customers import Customers
from parking_sim.plants.sumo_files import EMPTY, LOADED, agv_name, output_options, write_run
from parking_sim.plants.sumo_lanes import LaneProgress, Lanes
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Numbered, NumberedList, Vertex, numbered, numbers

if TYPE_CHECKING:
    from sumo_nets.read import GarageNet

#: Steps between two readings of a battery.
BATTERY_STEPS = 120
#: Steps SUMO may take to bring all AGVs to a stand at the start.
START_STEPS = 20

_STOPPED = 1  # bit of getStopState


class _Agv:
    """What the plant remembers of one AGV."""

    __slots__ = ("acting", "applied", "name", "pending", "progress", "share", "soc", "stopped")

    def __init__(self, name: str, progress: LaneProgress) -> None:
        self.name = name
        self.progress = progress
        self.applied = 0  # edges up to this one are in SUMO's route
        self.stopped = True
        self.pending = False  # granted further than ``applied``
        self.acting: Act | None = None
        self.soc = 1.0
        self.share = 1.0  # of its top speed


class SumoPlant:
    """A garage driven in SUMO, by libsumo or with ``gui`` by sumo-gui over TraCI.

    A few steps pass while the AGVs come to a stand, so ``time_s`` is about 2 when the loop begins. A command given
    before ``step`` works in that step: an AGV that stands moves at once.

    Args:
        garage: the net.
        starts: start vertex of each AGV; it stands on the first edge that leads there.
        agv_type: what the AGVs can do.
        seed: of SUMO's random numbers (drivers of customers' cars).
        step_s: seconds a step lasts.
        gui: show it in sumo-gui.
        outputs: folder for SUMO's outputs and a runnable ``run.sumocfg``; None for no files.
        fcd: write every position of every vehicle too (``fcd.xml.gz``).

    Raises:
        PlantError: another simulation is open in this process; SUMO doesn't load the net; an edge is too short for an
            AGV to stand clear of the vertex behind it; sumo-gui or traci is not installed.
    """

    def __init__(
        self,
        garage: GarageNet,
        starts: Numbered[AgvNumber, Vertex],
        agv_type: AgvType,
        seed: int,
        step_s: float = 0.5,
        gui: bool = False,
        outputs: Path | None = None,
        fcd: bool = False,
    ) -> None:
        self.graph = garage.graph
        self.agv_type, self.battery_wh = agv_type, agv_type.battery_wh
        self.motion = sumo_motion(garage.graph, agv_type, step_s)
        self.collisions = 0
        self.sumo_s = 0.0
        self._step = 0
        self._meeting: frozenset[tuple[str, str]] = frozenset()
        self._due = 0  # step at which the next action ends
        self._routes: set[tuple[EdgeIndex, ...]] = set()
        self._temporary = tempfile.TemporaryDirectory() if outputs is None else None
        folder = Path(self._temporary.name) if self._temporary else Path(outputs or ".")
        first_edges = _start_edges(garage.graph, starts)
        edge_names = [garage.graph.edge_names[e] for e in first_edges]
        config = write_run(folder, garage, edge_names, agv_type, seed, step_s)
        self._open = False
        self._api, binary = load_api(gui)
        self._errors: tuple[type[Exception], ...] = (self._api.TraCIException, self._api.FatalTraCIError)
        if self._api.isLoaded():
            raise PlantError("another SUMO simulation is open in this process: close it first, or use another process")
        command = [
            binary,
            "-c",
            str(config),
            "--no-warnings",
            "true",
            *(output_options(outputs, fcd) if outputs is not None else ()),
        ]
        try:
            with silent():
                self._api.start([*command, "--start", "--quit-on-end"] if gui else command)
            self._open = True
            self._read_lanes(garage)
            self._agvs: Numbered[AgvNumber, _Agv] = [
                _Agv(agv_name(i), LaneProgress(e, self._lanes)) for i, e in numbered(first_edges)
            ]
            self._customers = Customers(self._api, garage)
            self._stand()
        except (*self._errors, OSError) as error:
            self.close()
            raise PlantError(f"SUMO did not start: {error}") from None
        except BaseException:
            self.close()
            raise

    # ------------------------------------------------------------------ the Plant protocol

    @property
    def time_s(self) -> float:
        """Simulated seconds since SUMO's start."""
        return self.motion.seconds(self._step)

    def states(self) -> Numbered[AgvNumber, AgvState]:
        """One state for each AGV, in their order."""
        return self._states

    def events(self) -> Sequence[PlantEvent]:
        """What happened with customers' cars in the last step."""
        return self._customers.events

    def arrive(self, request: RequestNumber) -> None:
        """A customer comes and joins the queue in the street, or the backlog before it when the street is full.

        Raises:
            PlantError: the net has no street.
        """
        self._guard(lambda: self._customers.arrive(request))

    def execute(self, command: Command) -> None:
        """Carry out one command.

        Raises:
            PlantError: an AGV is told to act or reverse while it drives, to drive where no edge leads, or SUMO
                refuses the command.
        """
        if isinstance(command, Advance):
            self._advance(command)
        elif isinstance(command, Act):
            self._act(command)
        else:
            self._guard(lambda: self._execute_customer(command))

    def step(self) -> None:
        """Advance SUMO by one step and read what happened.

        Raises:
            PlantError: SUMO refuses something, or its window was closed.
        """
        try:
            for i in self._held & self._actions.keys():
                self._actions[i] += 1
                self._due = min(self._actions.values())
            for i in sorted(self._waiting):
                self._extend(i)
            self._customers.before_step()
            start = perf_counter()
            self._api.simulationStep()
            self.sumo_s += perf_counter() - start
            self._step += 1
            self._read()
            if self._actions and self._due <= self._step:
                self._finish_actions()
            self._customers.after_step()
            if self._step % BATTERY_STEPS == 0:
                self._read_batteries()
            if self._api.simulation.getCollidingVehiclesNumber():
                self._count_collisions()
            elif self._meeting:
                self._meeting = frozenset()
        except self._errors as error:
            raise PlantError(f"SUMO at {self.time_s:.1f} s: {error}") from None

    def samples(self) -> Sequence[AgvSample]:
        """Where each AGV is now."""
        speed = self._api.vehicle.getSpeed
        fronts = self._place.T.tolist()
        half = (self._length / 2).tolist()
        return [
            AgvSample(
                i, x - half[i] * math.cos(angle), y - half[i] * math.sin(angle), _half_turn(math.degrees(angle)),
                speed(self._agvs[i].name) if i in self._moving else 0.0,
            )
            for i, (x, y, angle) in zip(numbers(self._agvs), fronts, strict=True)
        ]  # fmt: skip

    def street(self) -> StreetState:
        """Customers waiting in the street now; zeros in a net without street."""
        return self._customers.street()

    def bodies(self) -> Bodies:
        """All AGV bodies as rectangles, for the footprint check."""
        x, y, angle = self._place.copy()
        return Bodies(x, y, angle, self._length, self._width, self._loaded.copy())

    def ending(self, before_s: float) -> frozenset[int]:
        """No fault: there are none in this plant."""
        return frozenset()

    def still(self, before_s: float) -> frozenset[AgvNumber]:
        """No AGV: no fault keeps one from moving."""
        return frozenset()

    def close(self) -> None:
        """End SUMO and release its files; safe to call twice."""
        if self._open:
            self._open = False
            with suppress(*self._errors):  # its window may be closed already
                self._api.close()
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    # ------------------------------------------------------------------ faults

    def hold(self, agv: AgvNumber, held: bool) -> None:
        """Brake an AGV to a stand and stop what it does, or let it go on.

        Raises:
            PlantError: SUMO refuses it.
        """
        (self._held.add if held else self._held.discard)(agv)
        self._guard(lambda: self._api.vehicle.setSpeed(self._agvs[agv].name, 0.0 if held else -1.0))

    def limit(self, agv: AgvNumber, share: float) -> None:
        """Let an AGV drive at a share of its top speed from now on.

        Raises:
            PlantError: SUMO refuses it.
        """
        self._agvs[agv].share = share
        self._guard(lambda: self._set_speed(agv))

    def set_soc(self, agv: AgvNumber, soc: float) -> None:
        """Set the state of charge of an AGV's battery, 0 to 1.

        Raises:
            PlantError: SUMO refuses it.
        """
        a = self._agvs[agv]
        level = f"{soc * self.agv_type.battery_wh:g}"
        self._guard(lambda: self._api.vehicle.setParameter(a.name, "device.battery.chargeLevel", level))
        a.soc = soc
        self._report(agv, self._states[agv].standing)

    # ------------------------------------------------------------------ start

    def _read_lanes(self, garage: GarageNet) -> None:
        length_m = [self._api.lane.getLength(f"{name}_0") for name in garage.graph.edge_names]
        self._lanes = Lanes(garage, self.agv_type, length_m, self.motion.step_s)
        for station in garage.charging_station_of_edge.values():
            self._api.chargingstation.setChargingPower(station, self.agv_type.charge_w)

    def _stand(self) -> None:
        n = len(self._agvs)
        self._place = np.zeros((3, n))
        self._x, self._y, self._angle = self._place
        self._loaded = np.zeros(n, dtype=np.bool_)
        self._length, self._width = np.full(n, self.agv_type.length_m), np.full(n, self.agv_type.width_m)
        self._moving: set[AgvNumber] = set()
        self._waiting: set[AgvNumber] = set()
        self._actions: dict[AgvNumber, int] = {}
        self._held: set[AgvNumber] = set()
        self._states: NumberedList[AgvNumber, AgvState] = [AgvState(i, 0, 0, True, 1.0) for i in numbers(self._agvs)]
        vehicle = self._api.vehicle
        for _ in range(START_STEPS):
            self._api.simulationStep()
            self._step += 1
            if len(vehicle.getIDList()) == n and all(vehicle.getStopState(a.name) for a in self._agvs):
                break
        else:
            raise PlantError("SUMO could not put all AGVs on their start vertices")
        for i in numbers(self._agvs):
            self._keep(i)

    # ------------------------------------------------------------------ reading

    def _read(self) -> None:
        """Look at the AGVs that move. Getters, as they cost libsumo half of what subscriptions do."""
        vehicle = self._api.vehicle
        for i in sorted(self._moving):
            a = self._agvs[i]
            pos = vehicle.getLanePosition(a.name)
            if not a.progress.near_end:
                a.progress.drive(pos)
            elif a.progress.enter(vehicle.getRoadID(a.name)):
                a.progress.drive(pos)
                if a.progress.near_end and self._stands(a, pos):
                    a.progress.reached = a.progress.k
                    if not a.pending:
                        self._keep(i)
                        self._rest(i)
                        continue
            self._keep(i)
            self._report(i, False)

    def _stands(self, a: _Agv, pos: float) -> bool:
        if a.progress.k == a.applied and a.progress.at_end(pos):
            a.stopped = bool(self._api.vehicle.getStopState(a.name) & _STOPPED)
        return a.stopped

    def _keep(self, i: AgvNumber) -> None:
        """Where it is, for the footprint check and the trajectory; SUMO counts degrees clockwise from north."""
        vehicle, name = self._api.vehicle, self._agvs[i].name
        self._x[i], self._y[i] = vehicle.getPosition(name)
        self._angle[i] = math.radians(90.0 - vehicle.getAngle(name))

    def _report(self, i: AgvNumber, standing: bool) -> None:
        a, old = self._agvs[i], self._states[i]
        reached, left = a.progress.reached, a.progress.left
        if reached != old.reached or left != old.left or standing != old.standing or a.soc != old.soc:
            self._states[i] = AgvState(i, reached, left, standing, a.soc)

    def _rest(self, i: AgvNumber) -> None:
        """It has come to a stand at the end of its authority: no need to look at it until it is told something."""
        self._moving.discard(i)
        self._read_battery(i)
        self._report(i, self._agvs[i].acting is None)

    def _read_battery(self, i: AgvNumber) -> None:
        charge = self._api.vehicle.getParameter(self._agvs[i].name, "device.battery.chargeLevel")
        self._agvs[i].soc = float(charge) / self.agv_type.battery_wh

    def _read_batteries(self) -> None:
        for i, state in numbered(self._states):
            self._read_battery(i)
            self._report(i, state.standing)

    def _count_collisions(self) -> None:
        pairs = frozenset((c.collider, c.victim) for c in self._api.simulation.getCollisions())
        self.collisions += len(pairs - self._meeting)
        self._meeting = pairs

    # ------------------------------------------------------------------ commanding

    def _guard(self, call: Any) -> None:
        try:
            call()
        except self._errors as error:
            raise PlantError(f"SUMO at {self.time_s:.1f} s: {error}") from None

    def _advance(self, command: Advance) -> None:
        i, a = command.agv, self._agvs[command.agv]
        progress = a.progress
        for vertex in command.vertices:
            last = progress.edges[-1]
            here, names = self.graph.ends[last][1], self.graph.names
            edge = self.graph.edge_index.get((here, vertex), NO_EDGE)
            if edge < 0:
                raise PlantError(f"no edge from {names[here]} to {names[vertex]} for AGV {i}")
            if edge == self.graph.reverse[last] and not (a.stopped and progress.k == len(progress.edges) - 1):
                raise PlantError(f"AGV {i} cannot reverse at {names[here]} while it drives")
            progress.grant(edge)
        a.pending = True
        self._waiting.add(i)
        self._report(i, False)

    def _extend(self, i: AgvNumber) -> None:
        """Extend route and stop to what is granted; on a junction or during an action it waits for a later step."""
        a = self._agvs[i]
        if a.progress.on_junction or a.acting is not None:
            return
        vehicle = self._api.vehicle
        edges, names, length_m = a.progress.edges, self._lanes.names, self._lanes.length_m
        ahead = tuple(edges[a.progress.k :])
        route = "_".join(map(str, ahead))
        if ahead not in self._routes:
            self._routes.add(ahead)
            self._api.route.add(route, [names[e] for e in ahead])
        old, last = edges[a.applied], ahead[-1]
        vehicle.setRouteID(a.name, route)
        vehicle.setStop(a.name, names[last], length_m[last])
        if a.stopped:
            a.stopped = False
            vehicle.resume(a.name)
            self._moving.add(i)
        else:
            vehicle.setStop(a.name, names[old], length_m[old], duration=0.0)
        a.applied = len(edges) - 1
        a.pending = False
        self._waiting.discard(i)

    def _act(self, command: Act) -> None:
        i, a = command.agv, self._agvs[command.agv]
        if not a.stopped or a.pending or a.acting is not None:
            raise PlantError(f"AGV {i} cannot {command.action.value}: it is not standing idle")
        a.acting = command
        self._actions[i] = self._step + command.steps
        self._due = min(self._actions.values())
        if command.steps <= 0:
            self._guard(self._finish_actions)
        else:
            self._report(i, False)

    def _finish_actions(self) -> None:
        for i in [i for i, until in self._actions.items() if until <= self._step]:
            del self._actions[i]
            a = self._agvs[i]
            act, a.acting = a.acting, None
            if act is not None and act.action is Action.LIFT:
                self._load(i, True)
                self._customers.take(act.request)
            elif act is not None and act.action is Action.LOWER:
                self._load(i, False)
            self._read_battery(i)
            self._report(i, not a.pending)
        self._due = min(self._actions.values(), default=0)

    def _load(self, i: AgvNumber, loaded: bool) -> None:
        self._loaded[i] = loaded
        self._api.vehicle.setType(self._agvs[i].name, LOADED if loaded else EMPTY)
        if self._agvs[i].share != 1.0:
            self._set_speed(i)

    def _set_speed(self, i: AgvNumber) -> None:
        a = self._agvs[i]
        self._api.vehicle.setMaxSpeed(a.name, self.agv_type.speed_mps(bool(self._loaded[i])) * a.share)

    def _execute_customer(self, command: CallForward | HandOver | DriveOff) -> None:
        if isinstance(command, CallForward):
            self._customers.call_forward(command.request, command.bay)
        elif isinstance(command, HandOver):
            self._customers.hand_over(command.request, command.bay)
        else:
            self._customers.drive_off(command.request)


def _start_edges(graph: Graph, starts: Numbered[AgvNumber, Vertex]) -> Numbered[AgvNumber, EdgeIndex]:
    """An edge into each start vertex, no two of them the two directions of one lane."""
    edges: list[EdgeIndex] = []
    for vertex in starts:
        into = [e for e in graph.in_edges(vertex) if graph.reverse[e] not in edges]
        if not into:
            raise PlantError(f"no edge leads to {graph.names[vertex]}: an AGV cannot start there")
        edges.append(into[0])
    return edges


def _half_turn(angle_deg: float) -> float:
    """The same direction between -180 (exclusive) and 180 degrees."""
    return angle_deg if angle_deg > -180.0 else angle_deg + 360.0
