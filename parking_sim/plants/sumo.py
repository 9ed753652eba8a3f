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

import io
import math
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.types import Act, Action, Advance, AgvState, CallForward, Command, DriveOff, HandOver
from parking_sim.footprint import Bodies
from parking_sim.plants import AgvSample, PlantEvent
from parking_sim.plants.sumo_agv import AgvType, sumo_motion
from parking_sim.plants.sumo_clearance import rear_clearances
from parking_sim.plants.sumo_customers import Customers, StreetState
from parking_sim.plants.sumo_files import EMPTY, LOADED, agv_name, output_options, write_run
from sumo_nets.graph import Graph

if TYPE_CHECKING:
    from sumo_nets.read import GarageNet

#: Steps between two readings of a battery.
BATTERY_STEPS = 120
#: Steps SUMO may take to bring all AGVs to a stand at the start.
START_STEPS = 20

#: An AGV this close to the end of its lane may have stopped there.
NEAR_END_M = 0.2
_STOPPED = 1  # bit of getStopState


class PlantError(RuntimeError):
    """SUMO refused something, or was asked for what it cannot do."""


class _Agv:
    """What the plant remembers of one AGV. Edge number k ends at granted vertex k; its front is on edge ``k``."""

    __slots__ = (
        "acting", "applied", "at_m", "edges", "k", "left", "name", "near_end", "on_junction", "pending", "reached",
        "rear_m", "road", "share", "soc", "stopped",
    )  # fmt: skip

    def __init__(self, name: str, edge: int, road: str, rear_m: float) -> None:
        self.name = name
        self.edges = [edge]  # driven and granted; the first one is where it starts
        self.at_m = [0.0]  # metres from the start vertex to each granted vertex, along the way
        self.k = 0
        self.applied = 0  # edges up to this one are in SUMO's route
        self.road = road
        self.rear_m = rear_m  # where the rear is on that scale when the lane position is 0
        self.reached = 0
        self.left = 0
        self.stopped = True
        self.near_end = True  # the next step may end on another edge
        self.on_junction = False
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
        starts: Sequence[int],
        agv_type: AgvType,
        seed: int,
        step_s: float = 0.5,
        gui: bool = False,
        outputs: Path | None = None,
        fcd: bool = False,
    ) -> None:
        self.graph = garage.graph
        self.agv_type = agv_type
        self.motion = sumo_motion(garage.graph, agv_type, step_s)
        self.collisions = 0
        self.sumo_s = 0.0
        self._step = 0
        self._meeting: frozenset[tuple[str, str]] = frozenset()
        self._reach_m = max(agv_type.empty_mps, agv_type.loaded_mps) * step_s + NEAR_END_M
        self._due = 0  # step at which the next action ends
        self._routes: set[tuple[int, ...]] = set()
        self._temporary = tempfile.TemporaryDirectory() if outputs is None else None
        folder = Path(self._temporary.name) if self._temporary else Path(outputs or ".")
        first_edges = _start_edges(garage.graph, starts)
        edge_names = [garage.graph.edge_names[e] for e in first_edges]
        config = write_run(folder, garage, edge_names, agv_type, seed, step_s)
        self._open = False
        self._api, binary = _load_api(gui)
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
            self._api.start([*command, "--start", "--quit-on-end"] if gui else command)
            self._open = True
            self._read_lanes(garage)
            self._agvs = [self._new_agv(i, e) for i, e in enumerate(first_edges)]
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
        return self._step * self.motion.step_s

    def states(self) -> Sequence[AgvState]:
        """One state for each AGV, in their order."""
        return self._states

    def events(self) -> Sequence[PlantEvent]:
        """What happened with customers' cars in the last step."""
        return self._customers.events

    def arrive(self, car: str) -> None:
        """A customer comes and joins the queue in the street, or the backlog before it when the street is full.

        Raises:
            PlantError: the net has no street.
        """
        self._guard(lambda: self._customers.arrive(car))

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
            for i, (x, y, angle) in enumerate(fronts)
        ]  # fmt: skip

    def close(self) -> None:
        """End SUMO and release its files; safe to call twice."""
        if self._open:
            self._open = False
            with suppress(*self._errors):  # its window may be closed already
                self._api.close()
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    # ------------------------------------------------------------------ beyond the protocol

    def street(self) -> StreetState:
        """Customers waiting in the street now; zeros in a net without street."""
        return self._customers.street()

    def bodies(self) -> Bodies:
        """All AGV bodies as rectangles, for the footprint check."""
        x, y, angle = self._place.copy()
        return Bodies(x, y, angle, self._length, self._width, self._loaded.copy())

    # ------------------------------------------------------------------ faults

    def hold(self, agv: int, held: bool) -> None:
        """Brake an AGV to a stand and stop what it does, or let it go on.

        Raises:
            PlantError: SUMO refuses it.
        """
        (self._held.add if held else self._held.discard)(agv)
        self._guard(lambda: self._api.vehicle.setSpeed(self._agvs[agv].name, 0.0 if held else -1.0))

    def limit(self, agv: int, share: float) -> None:
        """Let an AGV drive at a share of its top speed from now on.

        Raises:
            PlantError: SUMO refuses it.
        """
        self._agvs[agv].share = share
        self._guard(lambda: self._set_speed(agv))

    def set_soc(self, agv: int, soc: float) -> None:
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
        graph, lane = garage.graph, self._api.lane
        self._edge_names = graph.edge_names
        self._lane_m = [lane.getLength(f"{name}_0") for name in graph.edge_names]
        self._before_m: list[float] = []  # from the centre of the tail's node to the lane's begin
        self._pitch_m: list[float] = []  # from centre to centre
        for e, shape in enumerate(garage.shapes):
            before = math.dist(shape[0], graph.xy[graph.tail[e]])
            self._before_m.append(before)
            self._pitch_m.append(before + self._lane_m[e] + math.dist(shape[-1], graph.xy[graph.head[e]]))
        # from the tail's centre to where a rear is out of the way there
        self._clear_m = rear_clearances(garage, self.agv_type, self._lane_m, self._before_m)
        for e, name in enumerate(graph.edge_names):
            if self._before_m[e] + self._lane_m[e] - self.agv_type.length_m < self._clear_m[e] - 1e-6:
                raise PlantError(f"edge {name} is too short: an AGV that stands on it touches the vertex behind it")
        for station in garage.charging_station_of_edge.values():
            self._api.chargingstation.setChargingPower(station, self.agv_type.charge_w)

    def _new_agv(self, index: int, edge: int) -> _Agv:
        # the scale of at_m starts at the start vertex, so the lane's begin lies one pitch behind it
        begin = self._before_m[edge] - self._pitch_m[edge]
        return _Agv(agv_name(index), edge, self._edge_names[edge], begin - self.agv_type.length_m)

    def _stand(self) -> None:
        n = len(self._agvs)
        self._place = np.zeros((3, n))
        self._x, self._y, self._angle = self._place
        self._loaded = np.zeros(n, dtype=np.bool_)
        self._length, self._width = np.full(n, self.agv_type.length_m), np.full(n, self.agv_type.width_m)
        self._moving: set[int] = set()
        self._waiting: set[int] = set()
        self._actions: dict[int, int] = {}
        self._held: set[int] = set()
        self._states = [AgvState(i, 0, 0, True, 1.0) for i in range(n)]
        vehicle = self._api.vehicle
        for _ in range(START_STEPS):
            self._api.simulationStep()
            self._step += 1
            if len(vehicle.getIDList()) == n and all(vehicle.getStopState(a.name) for a in self._agvs):
                break
        else:
            raise PlantError("SUMO could not put all AGVs on their start vertices")
        for i in range(n):
            self._keep(i)

    # ------------------------------------------------------------------ reading

    def _read(self) -> None:
        """Look at the AGVs that move. Getters, as they cost libsumo half of what subscriptions do."""
        vehicle = self._api.vehicle
        for i in sorted(self._moving):
            a = self._agvs[i]
            pos = vehicle.getLanePosition(a.name)
            if a.near_end and not self._enter_next_edge(a, vehicle.getRoadID(a.name)):
                a.reached = a.k  # between two edges
            else:
                self._leave_behind(a, pos)
                if a.near_end and self._stands(a, pos):
                    a.reached = a.k
                    if not a.pending:
                        self._keep(i)
                        self._rest(i)
                        continue
            self._keep(i)
            self._report(i, False)

    def _enter_next_edge(self, a: _Agv, road: str) -> bool:
        """Move the front's edge up to where SUMO says it is; False on a junction."""
        a.on_junction = road[0] == ":"
        if a.on_junction:
            return False
        if road != a.road:
            while a.road != road:
                a.k += 1
                a.road = self._edge_names[a.edges[a.k]]
            a.reached = a.k - 1
            a.rear_m = a.at_m[a.k - 1] + self._before_m[a.edges[a.k]] - self.agv_type.length_m
        return True

    def _leave_behind(self, a: _Agv, pos: float) -> None:
        """Free the vertices that the rear has left, and see whether the next step may end on another edge."""
        a.near_end = pos + self._reach_m >= self._lane_m[a.edges[a.k]]
        rear = a.rear_m + pos + 1e-6
        while a.left < a.k and rear >= a.at_m[a.left] + self._clear_m[a.edges[a.left + 1]]:
            a.left += 1

    def _stands(self, a: _Agv, pos: float) -> bool:
        if a.k == a.applied and pos >= self._lane_m[a.edges[a.k]] - NEAR_END_M:
            a.stopped = bool(self._api.vehicle.getStopState(a.name) & _STOPPED)
        return a.stopped

    def _keep(self, i: int) -> None:
        """Where it is, for the footprint check and the trajectory; SUMO counts degrees clockwise from north."""
        vehicle, name = self._api.vehicle, self._agvs[i].name
        self._x[i], self._y[i] = vehicle.getPosition(name)
        self._angle[i] = math.radians(90.0 - vehicle.getAngle(name))

    def _report(self, i: int, standing: bool) -> None:
        a, old = self._agvs[i], self._states[i]
        if a.reached != old.reached or a.left != old.left or standing != old.standing or a.soc != old.soc:
            self._states[i] = AgvState(i, a.reached, a.left, standing, a.soc)

    def _rest(self, i: int) -> None:
        """It has come to a stand at the end of its authority: no need to look at it until it is told something."""
        self._moving.discard(i)
        self._read_battery(i)
        self._report(i, self._agvs[i].acting is None)

    def _read_battery(self, i: int) -> None:
        charge = self._api.vehicle.getParameter(self._agvs[i].name, "device.battery.chargeLevel")
        self._agvs[i].soc = float(charge) / self.agv_type.battery_wh

    def _read_batteries(self) -> None:
        for i, state in enumerate(self._states):
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
        for vertex in command.vertices:
            last = a.edges[-1]
            edge = self.graph.edge_index.get((int(self.graph.head[last]), vertex), -1)
            if edge < 0:
                names = self.graph.names
                raise PlantError(f"no edge from {names[self.graph.head[last]]} to {names[vertex]} for AGV {i}")
            if edge == self.graph.reverse[last] and not (a.stopped and a.k == len(a.edges) - 1):
                raise PlantError(f"AGV {i} cannot reverse at {self.graph.names[self.graph.head[last]]} while it drives")
            a.edges.append(edge)
            a.at_m.append(a.at_m[-1] + self._pitch_m[edge])
        a.pending = True
        self._waiting.add(i)
        self._report(i, False)

    def _extend(self, i: int) -> None:
        """Extend route and stop to what is granted; on a junction or during an action it waits for a later step."""
        a = self._agvs[i]
        if a.on_junction or a.acting is not None:
            return
        vehicle = self._api.vehicle
        ahead = tuple(a.edges[a.k :])
        route = "_".join(map(str, ahead))
        if ahead not in self._routes:
            self._routes.add(ahead)
            self._api.route.add(route, [self._edge_names[e] for e in ahead])
        old, last = a.edges[a.applied], ahead[-1]
        vehicle.setRouteID(a.name, route)
        vehicle.setStop(a.name, self._edge_names[last], self._lane_m[last])
        if a.stopped:
            a.stopped = False
            vehicle.resume(a.name)
            self._moving.add(i)
        else:
            vehicle.setStop(a.name, self._edge_names[old], self._lane_m[old], duration=0.0)
        a.applied = len(a.edges) - 1
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
                self._customers.take(act.car)
            elif act is not None and act.action is Action.LOWER:
                self._load(i, False)
            self._read_battery(i)
            self._report(i, not a.pending)
        self._due = min(self._actions.values(), default=0)

    def _load(self, i: int, loaded: bool) -> None:
        self._loaded[i] = loaded
        self._api.vehicle.setType(self._agvs[i].name, LOADED if loaded else EMPTY)
        if self._agvs[i].share != 1.0:
            self._set_speed(i)

    def _set_speed(self, i: int) -> None:
        a = self._agvs[i]
        self._api.vehicle.setMaxSpeed(a.name, self.agv_type.speed_mps(bool(self._loaded[i])) * a.share)

    def _execute_customer(self, command: CallForward | HandOver | DriveOff) -> None:
        if isinstance(command, CallForward):
            self._customers.call_forward(command.car, command.bay)
        elif isinstance(command, HandOver):
            self._customers.hand_over(command.car, command.bay)
        else:
            self._customers.drive_off(command.car)


def _start_edges(graph: Graph, starts: Sequence[int]) -> list[int]:
    """An edge into each start vertex, no two of them the two directions of one lane."""
    edges: list[int] = []
    for vertex in starts:
        into = [int(e) for e in np.flatnonzero(graph.head == vertex) if graph.reverse[e] not in edges]
        if not into:
            raise PlantError(f"no edge leads to {graph.names[vertex]}: an AGV cannot start there")
        edges.append(into[0])
    return edges


def _half_turn(angle_deg: float) -> float:
    """The same direction between -180 (exclusive) and 180 degrees."""
    return angle_deg if angle_deg > -180.0 else angle_deg + 360.0


def _load_api(gui: bool) -> tuple[Any, str]:
    """The library to talk to SUMO, and the program it starts."""
    if not gui:
        with redirect_stdout(io.StringIO()):  # it prints hints about optional packages
            import libsumo
        return libsumo, "sumo"
    try:
        import traci
    except ImportError:
        raise PlantError("sumo-gui needs traci: install parking-sim with the extra 'nets'") from None
    return traci, _find_binary("sumo-gui")


def _find_binary(name: str) -> str:
    """A program of SUMO: the one in the package eclipse-sumo, or one on the search path."""
    try:
        from sumo import SUMO_HOME
    except ImportError:
        SUMO_HOME = ""
    found = shutil.which(name, path=os.path.join(SUMO_HOME, "bin")) or shutil.which(name)
    if found is None:
        raise PlantError(f"{name} is not installed: install parking-sim with the extra 'nets'")
    return found
