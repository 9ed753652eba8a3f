"""One run: the loop that joins demand, controller and plant, and writes the record."""

from __future__ import annotations

import errno
import importlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal

from parking_sim.shadowing import require_own_packages

require_own_packages()  # before a file of the user's own can be taken for one of the packages below

from analysis.journal import FLUSH_S, Journal
from analysis.record import AgvRow, PlanningRow, Recorder
from analysis.run_files import JOURNAL
from controller.events import Event, EventKind
from controller.faults import REPORTED, FaultReport
from controller.garage import Task
from controller.planners.guest import PlannerError
from controller.planning import PlanningCall
from controller.types import NO_AGV, Advance, AgvMode, AgvNumber, Request, whole_steps
from parking_sim.accounts import Accounts
from parking_sim.assembly import World, assemble
from parking_sim.closing import held_work, task_row
from parking_sim.config import Scenario
from parking_sim.errors import RunFailedError
from parking_sim.folder_lock import FolderLock
from parking_sim.folders import check_links, check_path, clear_run
from parking_sim.inputs import Inputs, kept_net, read_inputs, write_inputs
from parking_sim.plants import CarAtBay
from parking_sim.plants.sumo_api import PlantError
from parking_sim.standstill import Standstill
from parking_sim.versions import code_version, versions
from sumo_nets.interrupted import as_interrupts
from sumo_nets.numbering import NO_VERTEX, NumberedList, Vertex, numbered

if TYPE_CHECKING:
    from parking_sim.watch import FootprintWatch

#: Wall-clock seconds between two calls of ``progress``.
PROGRESS_S = 0.2

#: How a run ends. With "time_limit" its duration or limit is over.
Ended = Literal["finished", "time_limit", "stalled", "interrupted"]


@dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a run is: simulated seconds, requests that ended (served or not) of how many, wall-clock seconds.

    Example:
        >>> import parking_sim as ps
        >>> def tell(now: ps.RunProgress) -> None:
        ...     print(f"{now.time_s:.0f} s: {now.done} of {now.total}")
        >>> tell(ps.RunProgress(120.0, 7, 122, 0.8))
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

    status: Ended
    metrics: Mapping[str, float]
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
    progress: Callable[[RunProgress], None] | None = None,
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
        InputError: the scenario does not fit its garage, a file of yours hides a package of the program, or a planner
            of your own fails; nothing is left in the folder then. Or a resumed run differs from its journal.
        PlantError: SUMO failed; if it did not even start, nothing is left in the folder.
        RunFailedError: the record can't be written.

    Example:
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
        >>> ps.simulate(scenario).status
        'time_limit'
    """
    run = prepare(scenario, None if out is None else Path(out), progress, resumed, shared)
    try:
        with run.started(gui, fcd):
            status = run.loop()
        return run.finish(status)
    except PlannerError:
        run.discard()
        raise
    except OSError as error:
        raise RunFailedError(f"{_what_failed(error, out)}; what is recorded so far can be read") from error
    finally:
        run.leave()


def _what_failed(error: OSError, out: Path | str | None) -> str:
    """Which file can't be written or read, and why."""
    return f"{error.filename or out}: {error.strerror or error}"


def prepare(
    scenario: Scenario,
    out: Path | None,
    progress: Callable[[RunProgress], None] | None = None,
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
    if out is not None:
        check_path(out)
    _load_what_the_end_needs()
    world = assemble(scenario)
    run = RunLoop(world, out, progress)
    if out is not None:
        run.inputs = read_inputs(scenario)
        out.mkdir(parents=True, exist_ok=True)
        run.lock = FolderLock(out)
        try:
            run.begin(out, resumed, shared)
        except BaseException:
            run.leave()
            raise
    return run


def _load_what_the_end_needs() -> None:
    """Import what the record and its metrics are made with, so that nothing is missing after hours of simulation."""
    for name in ("pandas", "duckdb", "analysis.checks", "analysis.metrics", "analysis.tables", "analysis.witness"):
        importlib.import_module(name)


class RunLoop:
    """The state of one run: started, stepped to its end, finished."""

    def __init__(self, world: World, out: Path | None, progress: Callable[[RunProgress], None] | None) -> None:
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
        self.lock: FolderLock | None = None
        self.inputs: Inputs | None = None
        self._resumed = False
        self._progress = progress
        self._told = 0.0
        self._phase = -1
        self._pending: list[Request] = []
        self._phase_start_s = 0.0
        self._last_task = -1
        self._ready: list[Task] = []
        no_plan: tuple[int, tuple[Vertex, ...]] = (0, ())
        self._plans: NumberedList[AgvNumber, tuple[int, tuple[Vertex, ...]]] = [no_plan] * len(self.acs.agvs)
        self._end_s = world.scenario.duration_s or world.scenario.max_time_s
        self._sample_every = whole_steps(world.scenario.record.sample_s, self.step_s)
        self._flush_every = whole_steps(FLUSH_S, self.step_s)
        self._log_grants = world.scenario.record.grants
        self._watch: FootprintWatch | None = None
        self._accounts = Accounts(len(self.acs.agvs), world.motion)
        self._standstill = Standstill(self.acs, self.garage, world.scenario.control.stuck_s, self.step_s)
        for car, slot in self.garage.parked.items():
            self._log(Event("car_initial", car=car, vertex=slot))

    def begin(self, out: Path, resumed: bool, shared: Path | None) -> None:
        """Write what the record begins with; the journal first: a folder that has it holds a run, however it ends."""
        check_links(out)
        self._resumed = resumed
        if not resumed:
            clear_run(out)
        self.journal = Journal(out, resumed)
        if self.inputs is not None:
            write_inputs(self.inputs, out, shared)
        net_file, additional_file = kept_net(self.world.scenario, out)
        net = replace(self.world.net, net_file=net_file, additional_file=additional_file)
        self.world = replace(self.world, net=net)

    @property
    def now_s(self) -> float:
        """Simulated seconds since the loop began."""
        return self.world.motion.seconds(self.step)

    @contextmanager
    def started(self, gui: bool, fcd: bool) -> Iterator[None]:
        """The plant, closed at the end whatever happens."""
        self._accounts.begin()
        try:
            plant = self.world.plant(self.out, gui, fcd or self.world.scenario.record.fcd)
        except PlantError:
            self.discard()
            raise
        self._plant_start_s = plant.time_s
        self.plant = self.world.with_faults(plant)
        if plant.bodies() is not None:
            from parking_sim.watch import FootprintWatch

            agv = self.world.scenario.agv
            self._watch = FootprintWatch(self.world.net, self.garage, agv.length_m, agv.width_m)
        try:
            yield
        finally:
            self.plant.close()

    # --- the loop -------------------------------------------------------------------------------------------------

    def loop(self) -> Ended:
        """Step until everything is done or time is up; returns the status."""
        try:
            with as_interrupts():
                while not (status := self.advance()):
                    pass
        except KeyboardInterrupt:
            return "interrupted"
        return status

    def advance(self) -> Ended | None:
        """Take one step; returns how the run has ended, None while it goes on."""
        self._customers()
        if status := self._status():
            self._sample()
            return status
        self._control()
        if self.step % self._sample_every == 0:
            self._sample()
        with self._accounts.timed("plant"):
            self.plant.step()
        self.step += 1
        self._check()
        if self.journal is not None and self.step % self._flush_every == 0:
            self.journal.flush(self.recorder, self.now_s)
        if self.step % 256 == 0:
            self._tell()
        return None

    def _status(self) -> Ended | None:
        """How the run has ended, None while it goes on."""
        if self._finished():
            return "finished"
        if self.now_s >= self._end_s:
            return "time_limit"
        return "stalled" if self._stalled() else None

    def _control(self) -> None:
        with self._accounts.timed("control"):
            for command in self.acs.step(self.step, self.plant.states()):
                self.plant.execute(command)
                if self._log_grants and isinstance(command, Advance):
                    granted = [self.names[v] for v in command.vertices]
                    self._log(Event("grant", command.agv, vertex=command.vertices[-1], detail={"vertices": granted}))
        with self._accounts.timed("record"):
            for call in self.acs.planning.take_calls():
                self._accounts.planned(call.wall_s)
                self.recorder.planning(self._planning_row(call))
            self._accounts.count(self.acs)

    def _planning_row(self, call: PlanningCall) -> PlanningRow:
        work = call.counters
        return PlanningRow(
            time_s=self.now_s,
            agents=call.agents,
            status=call.status.value,
            window_steps=call.window_steps,
            expanded=work.expanded,
            heap_moves=work.heap_moves,
            generated=work.generated,
            valid=work.valid,
            slot_choice=work.slot_choice,
            wall_ms=call.wall_s * 1000.0,
            window_cells=call.window_cells,
            score=call.score,
            wait_edges=call.wait_edges,
            rings=call.rings,
        )

    # --- customers ------------------------------------------------------------------------------------------------

    def _customers(self) -> None:
        """Take over what happened in the street, then the requests that are due."""
        for event in self.plant.events():
            if isinstance(event, CarAtBay):
                task = self.garage.car_at_bay(event.request, event.bay, self.now_s)
                self._ready.append(task)
                self._log(Event("car_at_bay", NO_AGV, task.car, event.bay, {"request": task.number}))
            elif isinstance(event, FaultReport):
                self._fault(event)
            else:
                task = self.garage.car_left(event.request, event.bay, self.now_s)
                self._log(Event("car_left", NO_AGV, task.car, event.bay, {"request": task.number}))
                self._log(Event("task_done", task.agv, task.car, event.bay, {"request": task.number}))
        for task in [j for j in self._ready if j.ready_s <= self.now_s]:
            self._ready.remove(task)
            self._log(Event("car_ready", NO_AGV, task.car, task.origin, {"request": task.number}))
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
        self._log(Event("fault_start" if fault.started else "fault_end", agv, vertex=vertex, detail=detail))
        if fault.kind in REPORTED:
            if not fault.started and any(fault.number in hold.faults for hold in self.acs.holds.of_all()):
                self._standstill.moved(self.now_s)  # what the fault held needs its time now
            self.acs.report(fault)

    def _next_phase(self) -> None:
        if self._phase + 1 < len(self.world.demand.phases):
            self._phase += 1
            self._pending = list(reversed(self.world.demand.phases[self._phase]))
            self._phase_start_s = self.now_s

    def _request(self, request: Request) -> None:
        task = self.garage.request(request, self.now_s)
        self._log(Event("request_made", car=task.car, detail={"request": task.number, "what": request.kind.value}))
        if task.reason:
            detail = {"request": task.number, "reason": task.reason}
            kind: EventKind = "turned_away" if task.state == "turned_away" else "request_void"
            self._log(Event(kind, car=task.car, detail=detail))
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

    def _stalled(self) -> bool:
        """No request is to come, and nothing moves any more; hours asked for as a duration are simulated whole."""
        self._standstill.watch(self.now_s)
        if self._pending or self.world.scenario.duration_s is not None:
            return False
        return self._standstill.is_final(self.step, self.now_s, self._end_s, self.plant)

    # --- watching -------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        bodies = self.plant.bodies()
        if self._watch is None or bodies is None:
            return
        with self._accounts.timed("check"):
            for event in self._watch.step(self.now_s, bodies):
                self._log(event)

    def _sample(self) -> None:
        with self._accounts.timed("record"):
            self._sample_agvs()
            if self.world.scenario.record.plans:
                self._sample_plans()
            self._accounts.draw(self.acs.agvs)
            self._sample_counts()

    def _sample_agvs(self) -> None:
        """Record where all AGVs are."""
        agvs = self.acs.agvs
        cars = [
            agv.task.car if a.loaded and agv.task else "" for agv, a in zip(agvs, self.acs.executor.agvs, strict=True)
        ]
        self.recorder.sample(
            self.now_s, self.plant.samples(), [a.mode.value for a in agvs], cars, [a.soc for a in agvs]
        )

    def _sample_counts(self) -> None:
        """Record how many customers, cars and requests there are."""
        street = self.plant.street()
        queue, spilled = (street.queued, street.spilled) if street else (len(self.garage.queue), 0)
        self.recorder.timeline(
            self.now_s,
            queue=queue + spilled,
            spilled=spilled,
            parked=len(self.garage.parked),
            waiting_requests=len(self.garage.open),
            active_agvs=sum(1 for a in self.acs.agvs if a.task is not None),
        )

    def _sample_plans(self) -> None:
        """Record the plans that have changed: from the vertex reached last, through those granted, to the end."""
        for i, a in numbered(self.acs.executor.agvs):
            ahead = list(a.trail)[max(0, a.reached - a.first) :]
            plan = (len(ahead), (*ahead, *a.pending))
            if plan != self._plans[i]:
                self._plans[i] = plan
                self.recorder.plan(self.now_s, i, *plan)

    def _log(self, event: Event) -> None:
        if self._watch is not None:
            self._watch.note(event)
        place = self.names[event.vertex] if event.vertex >= 0 else ""
        self.recorder.event(self.now_s, event.kind, event.agv, event.car, place, **event.detail)

    def _tell(self) -> None:
        if self._progress is None or perf_counter() - self._told < PROGRESS_S:
            return
        self._told = perf_counter()
        done = len(self.garage.tasks) - self.garage.unfinished
        self._progress(RunProgress(self.now_s, done, self.world.demand.total, self._accounts.total_s))

    # --- the end --------------------------------------------------------------------------------------------------

    def leave(self) -> None:
        """Close the journal and let others have the folder, however the run has ended."""
        if self.journal is not None:
            self.journal.close(finished=False)
        if self.lock is not None:
            self.lock.release()

    def discard(self) -> None:
        """Remove what the run has written so far, and its folder if nothing else is in it; a resumed run stays."""
        if self.out is None or self.journal is None or self._resumed:
            return
        self.journal.close(finished=False)
        clear_run(self.out)
        with suppress(OSError):
            self.out.rmdir()

    def finish(self, status: Ended) -> Summary:
        """Write the record and work out the metrics."""
        out = self.out
        for task in self.garage.tasks:
            self.recorder.task(task_row(task, self.names))
        for i, agv in numbered(self.acs.agvs):
            self.recorder.agv(self._agv_row(i, agv.tasks_done))
        held = self._held(status)
        meta = {**self._meta(status), "held": held}
        from analysis.checks import failed_checks, run_checks
        from analysis.metrics import run_metrics
        from analysis.tables import recorded_run
        from analysis.witness import witnesses

        if out is not None:
            meta["witnesses"] = witnesses(recorded_run(self.recorder, meta), out)
        metrics = run_metrics(recorded_run(self.recorder, meta))
        if out is not None:
            if not (out / JOURNAL).is_file():
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(out / JOURNAL))
            self.recorder.write(out, meta, metrics)
            if self.journal is not None:
                self.journal.close(finished=True)
        return Summary(status, metrics, out, failed_checks(run_checks(meta, metrics)), held)

    def _held(self, status: Ended) -> tuple[str, ...]:
        """What holds the work that is open at the end, in words; of a run that goes on no further than its time what is
        wrong only."""
        if status == "finished" or not self.garage.unfinished:
            return ()
        from analysis.faults import fault_spans
        from analysis.holds import ending
        from analysis.tables import recorded_run

        holds = [held_work(hold, self.garage.tasks, self.names) for hold in self.acs.holds.of_all()]
        shown = [held for held in holds if status == "stalled" or not held.is_ordinary]
        return tuple(ending(shown, fault_spans(recorded_run(self.recorder, {})), self.now_s))

    def _agv_row(self, i: AgvNumber, tasks: int) -> AgvRow:
        ex, accounts = self.acs.executor, self._accounts
        return AgvRow(
            agv=i,
            moves=ex.moves[i],
            distance_m=ex.distance_m[i],
            tasks=tasks,
            **accounts.seconds(i),
            energy_wh=accounts.drawn(i) * self.plant.battery_wh,
        )

    def _meta(self, status: Ended) -> dict[str, object]:
        scenario, garage = self.world.scenario, self.garage
        clearance = self._watch.result() if self._watch is not None else None
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
            "wall_s": self._accounts.wall_split(self.plant.sumo_s),
        }
