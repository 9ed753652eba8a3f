"""A run that a program takes step by step, and looks into between two steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from controller.types import AgvNumber
from parking_sim.config import Scenario
from parking_sim.simulation import Ended, RunProgress, Summary, prepare

if TYPE_CHECKING:
    from types import TracebackType


@dataclass(frozen=True, slots=True)
class AgvNow:
    """One AGV at a moment.

    Attributes:
        agv: its number.
        mode: one of the eight states, see ``controller.types.AgvMode``.
        at: name of the last vertex that its front has reached.
        goal: name of the vertex where it goes.
        car: name of the car on it, "" without one.
        x_m, y_m: position of its middle, metres.
        angle_deg: where its front points, degrees anticlockwise from the x axis.
        speed_mps: speed, metres a second.
        soc: state of charge of its battery, 0 to 1.
    """

    agv: AgvNumber
    mode: str
    at: str
    goal: str
    car: str
    x_m: float
    y_m: float
    angle_deg: float
    speed_mps: float
    soc: float


@dataclass(frozen=True, slots=True)
class State:
    """A garage at a moment.

    Attributes:
        time_s: simulated seconds.
        step: steps taken.
        agvs: the fleet, by number.
        parked: car -> name of the slot that it is in.
        open: requests that have been made and have not ended.
        ended: requests that have ended, served or not.
    """

    time_s: float
    step: int
    agvs: tuple[AgvNow, ...]
    parked: Mapping[str, str]
    open: int
    ended: int

    def __repr__(self) -> str:
        """The moment in a line."""
        counts = f"{len(self.agvs)} AGVs, {len(self.parked)} parked, {self.open} requests open, {self.ended} ended"
        return f"<State at {self.time_s:g} s: {counts}>"


class Simulation:
    """A run as a context manager; leaving it closes the plant and, with a folder, writes the record.

    A run that is left before its end has the status "interrupted". When an exception leaves it, no summary is made,
    and what had been recorded so far stays in the folder, as after a kill.

    Example:
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 5.0})
        >>> with ps.Simulation(scenario) as sim:
        ...     while sim.step():
        ...         pass
        ...     sim.state
        <State at 5 s: 4 AGVs, 0 parked, 61 requests open, 0 ended>
        >>> sim.summary.status
        'time_limit'
    """

    def __init__(
        self,
        scenario: Scenario,
        out: Path | str | None = None,
        *,
        gui: bool = False,
        fcd: bool = False,
        progress: Callable[[RunProgress], None] | None = None,
    ) -> None:
        """Keep what to run; nothing is checked or started before the ``with``.

        Args:
            scenario: what to run.
            out: folder for the record, made if need be; None writes nothing.
            gui: show it in sumo-gui.
            fcd: write SUMO's floating car data as well.
            progress: called a few times a second.
        """
        self.scenario = scenario
        self._out = None if out is None else Path(out)
        self._gui, self._fcd, self._progress = gui, fcd, progress
        self._status: Ended | None = None
        self._summary: Summary | None = None

    def __enter__(self) -> Self:
        """Start the plant.

        Raises:
            InputError: the scenario does not fit its garage.
            PlantError: SUMO did not start; nothing is left in the folder.
        """
        self._run = prepare(self.scenario, self._out, self._progress)
        self._plant = ExitStack()
        try:
            self._plant.enter_context(self._run.started(self._gui, self._fcd))
        except BaseException:
            self._run.leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the plant, then write the record and work out the metrics, unless an exception leaves the run."""
        try:
            self._plant.close()
            if kind is None:
                self._summary = self._run.finish(self._status or "interrupted")
        finally:
            self._run.leave()

    def step(self) -> bool:
        """Take one step of the scenario's ``step_s``.

        Returns:
            Whether the run goes on; once it has ended, nothing happens any more.

        Raises:
            PlantError: SUMO failed.
        """
        if not self._status:
            self._status = self._run.advance()
        return not self._status

    @property
    def state(self) -> State:
        """The garage now."""
        run, names = self._run, self._run.names
        garage, executor = run.garage, run.acs.executor
        agvs = []
        for agv, authority, place in zip(run.acs.agvs, executor.agvs, run.plant.samples(), strict=True):
            car = agv.task.car if authority.loaded and agv.task else ""
            at = names[authority.trail[max(0, authority.reached - authority.first)]]
            agvs.append(
                AgvNow(
                    agv.number, agv.mode.value, at, names[agv.goal], car, place.x_m, place.y_m, place.angle_deg,
                    place.speed_mps, agv.soc,
                )
            )  # fmt: skip
        parked = {car: names[slot] for car, slot in garage.parked.items()}
        ended = len(garage.tasks) - garage.unfinished
        return State(run.now_s, run.step, tuple(agvs), parked, garage.unfinished, ended)

    @property
    def summary(self) -> Summary:
        """How the run ended.

        Raises:
            RuntimeError: it has not ended.
        """
        if self._summary is None:
            raise RuntimeError("the run has no summary before the end of its with block")
        return self._summary
