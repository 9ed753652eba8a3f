"""One run: the loop that joins demand, controller and plant, and writes the record."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from parking_sim.shadowing import require_own_packages

require_own_packages()  # before a file of the user's own can be taken for one of the packages below

from analysis.journal import FLUSH_S, Journal
from analysis.record import AgvRow, Recorder, TaskRow
from controller.faults import REPORTED, FaultReport
from controller.garage import Task
from controller.types import NO_AGV, Action, Advance, AgvMode, AgvNumber, Request, whole_steps
from parking_sim.assembly import World, assemble
from parking_sim.config import Scenario
from parking_sim.folders import clear_run
from parking_sim.inputs import Inputs, kept_net, read_inputs, write_inputs
from parking_sim.plants import CarAtBay
from parking_sim.plants.faulty import FaultyPlant
from parking_sim.versions import code_version, versions
from sumo_nets.numbering import NO_VERTEX, Numbered, NumberedList, Vertex, numbered
from sumo_nets.under_cars import cramped_slots

if TYPE_CHECKING:
    from parking_sim.footprint import FootprintCheck

#: Simulated seconds without any task done or vertex granted, with work to do, after which a run is given up, unless a
#: fault is the reason and will end.
STALLED_S = 7200.0

#: Simulated seconds between two looks at whether a run in which nothing moves can go on.
LOOK_S = 10.0

#: Wall-clock seconds between two calls of ``progress``.
PROGRESS_S = 0.2

_ACTIVITY_OF = {Action.TURN: "turning", Action.LIFT: "lifting", Action.LOWER: "lowering", Action.CHARGE: "charging"}


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is: simulated seconds, requests that ended (served or not) of how many, wall-clock seconds.

    Example:
        >>> import parking_sim as ps
        >>> def tell(now: ps.Progress) -> None:
        ...     print(f"{now.time_s:.0f} s: {now.done} of {now.total}")
        >>> tell(ps.Progress(120.0, 7, 122, 0.8))
        120 s: 7 of 122
    """

    time_s: float
    done: int
    total: int
    wall_s: float


@dataclass(frozen=True, slots=True, repr=False)
class Summary:
    """How a run ended.

    Attributes:
        status: finished, time_limit (its duration or limit is over), stalled or interrupted.
        metrics: see ``analysis.metrics.METRICS``.
        folder: where the record is, None if none was written.
        failed: checks that failed, one line each; see ``analysis.checks``.
        held: what holds the work that is still open, one sentence for each cause.

    Example:
        >>> import parking_sim as ps
        >>> summary = ps.simulate(ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0}))
        >>> summary
        <Summary: time_limit after 60 s, 4 of 122 tasks done, no check failed>
        >>> summary.metrics["deadlocks_found"]
        0
    """

    status: str
    metrics: Mapping[str, Any]
    folder: Path | None
    failed: tuple[str, ...] = ()
    held: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """The status, how far the work got, and how many checks failed."""
        m, failed = self.metrics, len(self.failed)
        done = f"{m['tasks_done']} of {m['tasks_wanted']} tasks done"
        checks = f"{failed or 'no'} check{'s' * (failed > 1)} failed"
        return f"<Summary: {self.status} after {m['simulated_s']:g} s, {done}, {checks}>"


def simulate(
    scenario: Scenario,
    out: Path | str | None = None,
    *,
    gui: bool = False,
    fcd: bool = False,
    progress: Callable[[Progress], None] | None = None,
    resumed: bool = False,
    shared: Path | None = None,
) -> Summary:
    """Run a scenario.

    Args:
        scenario: what to run.
        out: folder for the record, made if need be; None writes nothing.
        gui: show it in sumo-gui.
        fcd: write SUMO's floating car data as well.
        progress: called a few times a second.
        resumed: ``out`` holds the journal of this run, which was killed; see ``analysis.journal``.
        shared: folder for files that many runs read, see ``parking_sim.inputs``.

    Returns:
        How it ended. Ctrl-C ends the run early with the record so far.

    Raises:
        InputError: the scenario does not fit its garage, or a file of yours hides a package of the program; nothing
            has been written then. Or a resumed run differs from its journal.
        PlantError: SUMO failed.

    Example:
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
        >>> ps.simulate(scenario).status
        'time_limit'
    """
    run = prepare(scenario, None if out is None else Path(out), progress, resumed, shared)
    with run.started(gui, fcd):
        status = run.loop()
    return run.finish(status)


def prepare(
    scenario: Scenario,
    out: Path | None,
    progress: Callable[[Progress], None] | None = None,
    resumed: bool = False,
    shared: Path | None = None,
) -> RunLoop:
    """Check a scenario against its garage, and write what its record begins with.

    Args:
        scenario, out, progress, resumed, shared: as for :func:`simulate`.

    Returns:
        The run, not yet started.

    Raises:
        InputError: as for :func:`simulate`.
    """
    require_own_packages()
    _load_what_the_end_needs()
    world = assemble(scenario)
    run = RunLoop(world, out, progress)
    if out is not None:
        run.inputs = read_inputs(scenario)
        if not resumed:
            clear_run(out)
        out.mkdir(parents=True, exist_ok=True)
        write_inputs(run.inputs, out, shared)
        net_file, additional_file = kept_net(scenario, out)
        run.world = replace(world, net=replace(world.net, net_file=net_file, additional_file=additional_file))
        run.journal = Journal(out, resumed)
    return run


def _load_what_the_end_needs() -> None:
    """Import what the record and its metrics are made with, so that nothing is missing after hours of simulation."""
    for name in ("pandas", "duckdb", "analysis.checks", "analysis.metrics", "analysis.tables", "analysis.witness"):
        importlib.import_module(name)


class RunLoop:
    """The state of one run: started, stepped to its end, finished."""

    def __init__(self, world: World, out: Path | None, progress: Callable[[Progress], None] | None) -> None:
        self.world = world
        self.out = out
        self.recorder = Recorder()
        self.recorder.floor(world.net.graph)
        self.recorder.shapes(world.net)
        self.garage = world.garage()
        self.acs = world.acs(self.garage, self._log)
        self.step = 0
        self.step_s = world.motion.step_s
        self.names = world.net.graph.names
        self.journal: Journal | None = None
        self.inputs: Inputs | None = None
        self._progress = progress
        self._told = 0.0
        self._phase = -1
        self._pending: list[Request] = []
        self._phase_start_s = 0.0
        self._activity: Numbered[AgvNumber, dict[str, int]] = [dict.fromkeys(_ACTIVITIES, 0) for _ in self.acs.agvs]
        self._wall = dict.fromkeys(("plant", "control", "planning", "check", "record"), 0.0)
        self._last_task = -1
        self._moved = (0, 0, 0)
        self._moved_s = 0.0
        self._ready: list[Task] = []
        no_plan: tuple[int, tuple[Vertex, ...]] = (0, ())
        self._plans: NumberedList[AgvNumber, tuple[int, tuple[Vertex, ...]]] = [no_plan] * len(self.acs.agvs)
        self._overlaps = self._turns = 0
        self._look_every = max(1, round(LOOK_S / self.step_s))
        self._end_s = world.scenario.duration_s or world.scenario.max_time_s
        self._sample_every = whole_steps(world.scenario.record.sample_s, self.step_s)
        self._flush_every = whole_steps(FLUSH_S, self.step_s)
        self._log_grants = world.scenario.record.grants
        self._soc: NumberedList[AgvNumber, float] = [1.0] * len(self.acs.agvs)
        self._drawn: NumberedList[AgvNumber, float] = [0.0] * len(self.acs.agvs)
        self._footprint: FootprintCheck | None = None
        self._cramped = cramped_slots(world.net.graph, world.scenario.agv.length_m)
        for car, slot in self.garage.parked.items():
            self._log("car_initial", NO_AGV, car, slot, {})

    @property
    def now_s(self) -> float:
        """Simulated seconds since the loop began."""
        return self.world.motion.seconds(self.step)

    @contextmanager
    def started(self, gui: bool, fcd: bool) -> Iterator[None]:
        """The plant, closed at the end whatever happens."""
        self._start = perf_counter()
        plant = self.world.plant(self.out, gui, fcd or self.world.scenario.record.fcd)
        self._plant_start_s = plant.time_s
        self.plant = self.world.with_faults(plant)
        self._faults = self.plant if isinstance(self.plant, FaultyPlant) else None
        if plant.bodies() is not None:
            from parking_sim.footprint import FootprintCheck

            self._footprint = FootprintCheck()
            self._park_initial(self._footprint)
        try:
            yield
        finally:
            self.plant.close()

    # --- the loop -------------------------------------------------------------------------------------------------

    def loop(self) -> str:
        """Step until everything is done or time is up; returns the status."""
        try:
            while not (status := self.advance()):
                pass
        except KeyboardInterrupt:
            return "interrupted"
        return status

    def advance(self) -> str:
        """Take one step; returns how the run has ended, "" while it goes on."""
        self._customers()
        if status := self._status(self._end_s):
            self._sample()
            return status
        self._control()
        if self.step % self._sample_every == 0:
            self._sample()
        t = perf_counter()
        self.plant.step()
        self._wall["plant"] += perf_counter() - t
        self.step += 1
        self._check()
        if self.journal is not None and self.step % self._flush_every == 0:
            self.journal.flush(self.recorder, self.now_s)
        if self.step % 256 == 0:
            self._tell()
        return ""

    def _status(self, end_s: float) -> str:
        """How the run has ended, "" while it goes on."""
        if self._finished():
            return "finished"
        if self.now_s >= end_s:
            return "time_limit"
        return "stalled" if self._stalled(end_s) else ""

    def _control(self) -> None:
        t = perf_counter()
        commands = self.acs.step(self.step, self.plant.states())
        for command in commands:
            self.plant.execute(command)
            if self._log_grants and isinstance(command, Advance):
                granted = [self.names[v] for v in command.vertices]
                self._log("grant", command.agv, "", command.vertices[-1], {"vertices": granted})
        self._wall["control"] += perf_counter() - t
        t = perf_counter()
        for call in self.acs.planning.take_calls():
            c = call.counters
            self._wall["planning"] += call.wall_s
            self.recorder.planning(
                self.now_s, call.agents, call.status, call.window_steps, c.expanded, c.heap_moves, c.generated,
                c.valid, call.wall_s * 1000.0, c.slot_choice, call.window_cells, call.score, call.wait_edges,
                call.rings,
            )  # fmt: skip
        self._account()
        self._wall["record"] += perf_counter() - t

    def _account(self) -> None:
        """Count what each AGV does in this step."""
        for agv, a, row in zip(self.acs.agvs, self.acs.executor.agvs, self._activity, strict=True):
            if a.acting is not None:
                row[_ACTIVITY_OF[a.acting]] += 1
            elif not a.standing:
                row["loaded" if a.loaded else "empty"] += 1
            else:
                row["idle" if agv.mode is AgvMode.IDLE else "waiting"] += 1

    # --- customers ------------------------------------------------------------------------------------------------

    def _customers(self) -> None:
        """Take over what happened in the street, then the requests that are due."""
        for event in self.plant.events():
            if isinstance(event, CarAtBay):
                task = self.garage.car_at_bay(event.request, event.bay, self.now_s)
                self._ready.append(task)
                self._log("car_at_bay", NO_AGV, task.car, event.bay, {"request": task.number})
            elif isinstance(event, FaultReport):
                self._fault(event)
            else:
                task = self.garage.car_left(event.request, event.bay, self.now_s)
                self._log("car_left", NO_AGV, task.car, event.bay, {"request": task.number})
                self._log("task_done", task.agv, task.car, event.bay, {"request": task.number})
        for task in [j for j in self._ready if j.ready_s <= self.now_s]:
            self._ready.remove(task)
            self._log("car_ready", NO_AGV, task.car, task.origin, {"request": task.number})
        if not self._pending and self.garage.unfinished == 0:
            self._next_phase()
        while self._pending and self._pending[-1].time_s + self._phase_start_s <= self.now_s:
            self._request(self._pending.pop())

    def _fault(self, fault: FaultReport) -> None:
        """Write a fault down, and tell the controller if it would learn of it."""
        detail: dict[str, object] = {"fault": fault.number, "cause": fault.kind}
        if fault.started:
            detail |= {"agvs": fault.agvs, "vertices": fault.vertices}
        agv, vertex = (*fault.agvs, NO_AGV)[0], (*fault.vertices, NO_VERTEX)[0]
        self._log("fault_start" if fault.started else "fault_end", agv, "", vertex, detail)
        if fault.kind in REPORTED:
            if not fault.started and any(fault.number in hold.faults for hold in self.acs.holds.of_all()):
                self._moved_s = self.now_s  # what the fault held needs its time now
            self.acs.report(fault)

    def _next_phase(self) -> None:
        if self._phase + 1 < len(self.world.demand.phases):
            self._phase += 1
            self._pending = list(reversed(self.world.demand.phases[self._phase]))
            self._phase_start_s = self.now_s

    def _request(self, request: Request) -> None:
        task = self.garage.request(request, self.now_s)
        self._log("request_made", NO_AGV, task.car, NO_VERTEX, {"request": task.number, "what": request.kind.value})
        if task.reason:
            kind = "turned_away" if task.state == "turned_away" else "request_void"
            self._log(kind, NO_AGV, task.car, NO_VERTEX, {"request": task.number, "reason": task.reason})
        elif task.is_park and self.garage.handover == "bay":
            self.plant.arrive(task.number)

    def _finished(self) -> bool:
        no_more = not self._pending and self._phase + 1 >= len(self.world.demand.phases)
        if self.world.scenario.duration_s is not None:
            return False
        if not no_more or self.garage.unfinished or self.acs.planning.resolving:
            return False
        if self._last_task < 0:
            self._last_task = self.step
        idle = all(agv.mode is AgvMode.IDLE for agv in self.acs.agvs)
        return idle or self.step - self._last_task >= self.world.rules.run_on_steps

    def _stalled(self, end_s: float) -> bool:
        """No request is to come, and nothing has moved for very long or can happen any more before the end."""
        mark = (sum(self.acs.executor.moves), self.garage.unfinished, sum(a.acted for a in self.acs.executor.agvs))
        if mark != self._moved or self.garage.unfinished == 0:
            self._moved, self._moved_s = mark, self.now_s
        quiet_s = self.now_s - self._moved_s
        # with a duration the hours asked for are simulated whole: waits and rates count to their end
        if self._pending or self.world.scenario.duration_s is not None or self.step % self._look_every:
            return False
        if quiet_s < self.world.scenario.control.stuck_s + 2 * LOOK_S:
            return False
        return not self._something_ends(end_s) if quiet_s >= STALLED_S else self._held_for_ever(end_s)

    def _something_ends(self, end_s: float) -> bool:
        """An action under way, or a fault that holds an AGV or a request, will end before the run does."""
        acting = any(a.acting_until > self.step for a in self.acs.executor.agvs)
        ending = self._faults.ending(end_s) if self._faults is not None else frozenset[int]()
        return acting or any(ending.intersection(hold.faults) for hold in self.acs.holds.of_all())

    def _held_for_ever(self, end_s: float) -> bool:
        still = self._faults.still(end_s) if self._faults is not None else frozenset[AgvNumber]()
        return still is not None and self.acs.holds.for_ever(still)

    # --- watching -------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        bodies = self.plant.bodies()
        if self._footprint is None or bodies is None:
            return
        t = perf_counter()
        self._footprint.step(self.now_s, bodies)
        for near in self._footprint.events[self._overlaps :]:
            self._log("overlap", near.agv, "", NO_VERTEX, {"others": [near.other], "clearance_m": near.clear_m})
        for near in self._footprint.turns[self._turns :]:
            self._log("turn_under_car", near.agv, str(near.other), NO_VERTEX, {})
        self._overlaps, self._turns = len(self._footprint.events), len(self._footprint.turns)
        self._wall["check"] += perf_counter() - t

    def _park_initial(self, check: FootprintCheck) -> None:
        """Tell the footprint check of the cars that are parked before the run starts."""
        net, agv = self.world.net, self.world.scenario.agv
        into = {v: e for e, (_, v) in numbered(net.graph.ends)}
        ends = np.array([net.shapes[into[slot]][-2:] for slot in self.garage.parked.values()]).reshape(-1, 2, 2)
        (x, y), (dx, dy) = ends[:, 1].T, (ends[:, 1] - ends[:, 0]).T
        from parking_sim.footprint import Bodies

        many = np.ones(len(x))
        bodies = Bodies(x, y, np.arctan2(dy, dx), many * agv.length_m, many * agv.width_m, many > 0)
        check.standing(
            list(self.garage.parked), bodies, [slot in self._cramped for slot in self.garage.parked.values()]
        )

    def _sample(self) -> None:
        t = perf_counter()
        agvs = self.acs.agvs
        cars = [
            agv.task.car if a.loaded and agv.task else "" for agv, a in zip(agvs, self.acs.executor.agvs, strict=True)
        ]
        self.recorder.sample(
            self.now_s, self.plant.samples(), [a.mode.value for a in agvs], cars, [a.soc for a in agvs]
        )
        if self.world.scenario.record.plans:
            self._sample_plans()
        for i, agv in numbered(agvs):
            self._drawn[i] += max(0.0, self._soc[i] - agv.soc)
            self._soc[i] = agv.soc
        street = self.plant.street()
        queue, spilled = (street.queued, street.spilled) if street else (len(self.garage.queue), 0)
        active = sum(1 for a in agvs if a.task is not None)
        parked, waiting = len(self.garage.parked), len(self.garage.open)
        self.recorder.timeline(self.now_s, queue + spilled, spilled, parked, waiting, active)
        self._wall["record"] += perf_counter() - t

    def _sample_plans(self) -> None:
        """Record the plans that have changed: from the vertex reached last, through those granted, to the end."""
        for i, a in numbered(self.acs.executor.agvs):
            ahead = list(a.trail)[max(0, a.reached - a.first) :]
            plan = (len(ahead), (*ahead, *a.pending))
            if plan != self._plans[i]:
                self._plans[i] = plan
                self.recorder.plan(self.now_s, i, *plan)

    def _log(self, kind: str, agv: AgvNumber, car: str, vertex: Vertex, detail: dict[str, object]) -> None:
        if self._footprint is not None and kind == "lift":
            self._footprint.lifted(car)
        elif self._footprint is not None and kind == "lower" and vertex in self.garage.slot_of:
            self._footprint.lowered(car, agv, vertex in self._cramped)
        self.recorder.event(self.now_s, kind, agv, car, self.names[vertex] if vertex >= 0 else "", **detail)

    def _tell(self) -> None:
        if self._progress is None or perf_counter() - self._told < PROGRESS_S:
            return
        self._told = perf_counter()
        done = len(self.garage.tasks) - self.garage.unfinished
        self._progress(Progress(self.now_s, done, self.world.demand.total, self._told - self._start))

    # --- the end --------------------------------------------------------------------------------------------------

    def finish(self, status: str) -> Summary:
        """Write the record and work out the metrics."""
        out = self.out
        for task in self.garage.tasks:
            self.recorder.task(self._task_row(task))
        for i, agv in numbered(self.acs.agvs):
            self.recorder.agv(self._agv_row(i, agv.tasks_done))
        held = self._open_work(status)
        meta = {**self._meta(status), "held": held}
        from analysis.checks import failed_checks, run_checks
        from analysis.metrics import run_metrics, write_metrics
        from analysis.tables import recorded_run
        from analysis.witness import witnesses

        if out is None:
            metrics = run_metrics(recorded_run(self.recorder, meta))
        else:
            meta["witnesses"] = witnesses(recorded_run(self.recorder, meta), out)
            self.recorder.write(out, meta)
            if self.journal is not None:
                self.journal.close(finished=True)
            metrics = write_metrics(out)
        return Summary(status, metrics, out, failed_checks(run_checks(meta, metrics)), held)

    def _open_work(self, status: str) -> tuple[str, ...]:
        """What holds the work that is open at the end, in words; of a run that goes on no further than its time what is
        wrong only."""
        if status == "finished" or not self.garage.unfinished:
            return ()
        from analysis.faults import fault_spans
        from analysis.holds import Held, ending
        from analysis.tables import recorded_run

        tasks, names = self.garage.tasks, self.names
        holds = [
            Held(
                hold.agv, hold.request, tasks[hold.request].car if hold.request >= 0 else "", hold.cause.value,
                hold.chain, hold.faults, names[hold.vertex] if hold.vertex >= 0 else "",
            )
            for hold in self.acs.holds.of_all()
        ]  # fmt: skip
        shown = [held for held in holds if status == "stalled" or not held.is_ordinary]
        return tuple(ending(shown, fault_spans(recorded_run(self.recorder, {})), self.now_s))

    def _task_row(self, task: Task) -> TaskRow:
        def name(vertex: Vertex) -> str:
            return self.names[vertex] if vertex >= 0 else ""

        return TaskRow(
            task.number, task.request.kind.value, task.car, task.state, task.reason, task.agv, name(task.origin),
            name(task.destination), task.requested_s, task.at_bay_s, task.ready_s, task.assigned_s, task.lifted_s,
            task.delivered_s, task.done_s,
        )  # fmt: skip

    def _agv_row(self, i: AgvNumber, tasks: int) -> AgvRow:
        ex = self.acs.executor
        seconds = {f"{k}_s": self.world.motion.seconds(n) for k, n in self._activity[i].items()}
        battery_wh = self.plant.battery_wh
        return AgvRow(i, ex.moves[i], ex.distance_m[i], tasks, **seconds, energy_wh=self._drawn[i] * battery_wh)

    def _meta(self, status: str) -> dict[str, object]:
        scenario, garage = self.world.scenario, self.garage
        clearance = self._footprint.result() if self._footprint is not None else None
        problems = garage.audit()
        return {
            "status": status,
            "command": "parking-sim run scenario.yaml",
            "scenario": self.inputs.scenario if self.inputs else scenario.model_dump(mode="json"),
            "inputs": self.inputs.digests if self.inputs else {},
            "seed": scenario.seed,
            "versions": versions(),
            "code": code_version(),
            "map": self.world.net.name,
            "step_s": self.step_s,
            "sumo_start_s": self._plant_start_s if scenario.plant == "sumo" else None,
            "day_start_h": scenario.workload.day_start_h(scenario.base_dir),
            "simulated_s": self.now_s,
            "tasks_wanted": self.world.demand.total,
            "sumo_collisions": self.plant.collisions,
            "footprint_overlaps": clearance.overlaps if clearance else 0,
            "turns_under_cars": clearance.turns_under_cars if clearance else 0,
            "least_clearance_m": clearance.least_m if clearance else None,
            "cars_initial": garage.initial,
            "cars_arrived": garage.arrived,
            "cars_parked": len(garage.parked),
            "cars_left": garage.left,
            "cars_in_transit": garage.in_transit(),
            "audit": problems,
            "wall_s": self._wall_split(),
        }

    def _wall_split(self) -> dict[str, float]:
        """Wall-clock seconds: SUMO's own steps, the rest of the plant, planning, the rest of the controller, ..."""
        wall, sumo = self._wall, self.plant.sumo_s
        return {
            "total": perf_counter() - self._start,
            "sumo": sumo,
            "plant": wall["plant"] - sumo,
            "planning": wall["planning"],
            "execution": wall["control"] - wall["planning"],
            "record": wall["record"],
            "check": wall["check"],
        }


_ACTIVITIES = ("empty", "loaded", "turning", "lifting", "lowering", "waiting", "charging", "idle")
