"""Scenario files: what a run needs to know, checked before anything heavy starts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, field_validator, model_validator

from demand.park_exit import ParkExit
from demand.workloads import WorkloadConfig
from parking_sim.fault_config import LONGEST_S, FaultConfig
from sumo_nets.errors import InputError, in_lines
from sumo_nets.fields import all_errors
from sumo_nets.input_file import is_file
from sumo_nets.read import shipped_nets
from sumo_nets.wording import one_of, shown
from sumo_nets.yaml_file import YamlError, read_mapping

#: AGVs of the shipped garages when nothing else is said.
DEFAULT_AGVS = {"map1": 4, "map2": 4, "map3": 8, "map1_thesis": 4, "map2_thesis": 4, "map3_thesis": 8}

#: The planner when nothing else is said: best or equal by docs/planners.md.
DEFAULT_PLANNER = "token"

#: What moves the AGVs.
PlantKind = Literal["sumo", "discrete"]

#: Longest of the times that a scenario gives, so that planning steps can be counted in 32 bits.
DAY_S = 86_400.0
#: Shortest of them, so that no clock goes more often than it says anything.
SHORTEST_S = 0.001
#: Greatest weight or count that a scenario gives, and number of AGVs, bays or chargers.
MOST, MOST_PLACES = 10**6, 100_000

NET_SUFFIXES = (".net.xml", ".net.xml.gz")


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        """What differs from the defaults."""
        fields = type(self).model_fields
        for name, value in super().__repr_args__():
            if name not in fields or value != fields[name].get_default(call_default_factory=True):
                yield name, value


class ControlConfig(_Options):
    """The controller's clock, window and limits. Defaults are the thesis's where it gives a value.

    Times hold in SUMO; the discrete plant has the thesis's numbers of ticks instead.
    """

    period_s: float = Field(default=5.0, ge=SHORTEST_S, le=DAY_S, description="replanning period, seconds")
    replanning: Literal["periodic", "events", "both"] = Field(
        default="periodic",
        description="when to plan: every period and for new goals; at events (new goal, predicted collision, end of a"
        " plan, time-out); or both",
    )
    look_ahead_s: float = Field(
        default=8.0, ge=SHORTEST_S, le=DAY_S, description="events: collisions are predicted so far ahead, seconds"
    )
    timeout_s: float = Field(
        default=5.0,
        ge=SHORTEST_S,
        le=DAY_S,
        description="events: plan after this time while an AGV stands that has somewhere to go, seconds",
    )
    reorder: bool = Field(
        default=False, description="AGVs that wait behind a late one go first where that pays: orders are switched"
    )
    window_cells: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="planning window at the start, moves over an aisle cell; default: the planner's own (whca 11,"
        " others 5; planners of complete paths have none)",
    )
    window_min: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="least window, moves; default: the planner's own (whca 11, others 5), or what fits the other two",
    )
    window_max: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="greatest window, moves; default: the planner's own (whca 21, others 11), or what fits the other"
        " two",
    )
    window_step: int = Field(default=2, ge=1, le=10_000, description="the window changes in steps of this many moves")
    planner_limit_s: float = Field(
        default=60.0,
        ge=SHORTEST_S,
        le=DAY_S,
        description="wall-clock seconds that a planner of your own has for one answer; built-in ones have no limit",
    )
    score_keep: float = Field(
        default=0.6,
        ge=0,
        lt=1,
        description="share that is kept of the congestion score (score = floor(keep * old) + wait edges + score_scc *"
        " SCCs of the conflicts that pipeline meets while it plans) or, under other planners, of the level of traffic",
    )
    score_scc: int = Field(
        default=5, ge=0, le=MOST, description="pipeline: weight of a strongly connected component in the score"
    )
    score_up: int = Field(
        default=24, ge=0, le=MOST, description="pipeline: the window grows when the score is above this"
    )
    score_down: int = Field(
        default=10, ge=0, le=MOST, description="pipeline: the window shrinks when the score is below this"
    )
    boost_step: int = Field(
        default=10, ge=0, le=MOST, description="priority an AGV gains for each move it could have made while it waited"
    )
    boost_after: int = Field(
        default=5, ge=1, le=MOST, description="moves' time of waiting from which on it gains boost_max"
    )
    boost_max: int = Field(
        default=1000, ge=0, le=MOST, description="priority an AGV gains when it has waited for that long"
    )
    adapt_boost: float = Field(
        default=1.0,
        ge=1,
        le=100,
        description="times StuckBoost at the full level of traffic: boost_step so many times higher, boost_after so"
        " many times shorter; 1 is always the same",
    )
    stuck_s: float = Field(
        default=120.0, ge=SHORTEST_S, le=DAY_S, description="seconds without progress after which an AGV is stuck"
    )
    cbs_group: int = Field(default=5, ge=2, le=MOST, description="partial CBS: AGVs in a group at most")
    cbs_expansions: int = Field(
        default=64, ge=1, le=MOST, description="partial CBS: expansions of the constraint tree at most"
    )
    cbs_nodes: int = Field(default=128, ge=1, le=MOST, description="partial CBS: nodes of the constraint tree at most")
    cbs_constraints: int = Field(default=64, ge=1, le=MOST, description="partial CBS: constraints of a node at most")
    adapt_cbs: float = Field(
        default=1.0,
        ge=1,
        le=100,
        description="times cbs_group, cbs_expansions, cbs_nodes and cbs_constraints of the ladder at the full level of"
        " traffic; 1 is always the same",
    )

    @model_validator(mode="after")
    def _window_in_range(self) -> Self:
        given = [moves for moves in (self.window_min, self.window_cells, self.window_max) if moves is not None]
        if given != sorted(given):
            raise ValueError("give window_min <= window_cells <= window_max")
        if self.score_down > self.score_up:
            raise ValueError("give score_down <= score_up")
        return self


class AgvConfig(_Options):
    """One type of AGV, all alike. Defaults follow the parking robots on the market."""

    empty_mps: float = Field(default=1.5, ge=0.01, le=20, description="top speed without a car, m/s")
    loaded_mps: float = Field(default=1.0, ge=0.01, le=20, description="top speed with a car, m/s")
    empty_accel: float = Field(default=0.5, ge=0.01, le=10, description="acceleration without a car, m/s2")
    loaded_accel: float = Field(default=0.3, ge=0.01, le=10, description="acceleration with a car, m/s2")
    braking: float = Field(default=0.8, ge=0.01, le=10, description="deceleration, m/s2")
    empty_turn_dps: float = Field(
        default=30.0, ge=0.1, le=3600, description="turning in place without a car, degrees/s"
    )
    loaded_turn_dps: float = Field(default=20.0, ge=0.1, le=3600, description="turning in place with a car, degrees/s")
    lift_s: float = Field(default=20.0, ge=0, le=DAY_S, description="lifting a car, seconds")
    lower_s: float = Field(default=15.0, ge=0, le=DAY_S, description="lowering a car, seconds")
    length_m: float = Field(default=4.7, ge=0.1, le=20, description="length of the AGV, with or without a car, metres")
    width_m: float = Field(default=2.0, ge=0.1, le=5, description="width of the AGV, with or without a car, metres")
    empty_kg: float = Field(default=1500.0, ge=1, le=1e6, description="mass of the AGV, kg")
    car_kg: float = Field(default=1800.0, ge=0, le=1e6, description="mass of a car, kg")
    idle_w: float = Field(default=150.0, ge=0, le=1e6, description="power that electronics draw all the time, W")
    battery_wh: float = Field(
        default=6000.0, ge=1, le=50_000, description="battery capacity, Wh; the default lasts about 8 hours of driving"
    )
    charge_w: float = Field(default=5000.0, ge=100, le=1e6, description="charging power, W")
    charge_below: float = Field(default=0.3, ge=0, lt=1, description="state of charge that sends it to charge, 0 to 1")
    charge_to: float = Field(default=0.9, gt=0, le=1, description="state of charge at which charging ends, 0 to 1")

    @property
    def size_m(self) -> tuple[float, float]:
        """Length and width, metres."""
        return self.length_m, self.width_m

    @model_validator(mode="after")
    def _charging_in_order(self) -> Self:
        if self.charge_below >= self.charge_to:
            raise ValueError("give charge_below < charge_to")
        return self


class CustomerConfig(_Options):
    """Customers and their cars."""

    handling_median_s: float = Field(
        default=60.0,
        ge=SHORTEST_S,
        le=DAY_S,
        description="median time a customer takes at the bay to get in or out, seconds",
    )
    handling_sigma: float = Field(
        default=0.5, ge=0, le=3, description="sigma of the lognormal handling time; 0: always the median"
    )
    balk_cars: int | None = Field(
        default=None,
        ge=1,
        le=MOST,
        description="cars in the queue at which a customer who comes turns away; default: never",
    )
    balk_min: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="expected wait in the queue at which a customer who comes turns away, minutes: cars in the queue"
        " times the time that a car stands at its head of late; default: never",
    )


class RecordConfig(_Options):
    """What is written down besides events, tasks and metrics."""

    sample_s: float = Field(
        default=2.0, ge=SHORTEST_S, le=DAY_S, description="interval of the AGVs' sampled trajectory, seconds"
    )
    plans: bool = Field(default=True, description="write the AGVs' plans whenever a sample finds them changed")
    replay: bool = Field(default=True, description="write the replay of a single run beside its report")
    grants: bool = Field(default=False, description="write one event for each vertex granted to an AGV")
    fcd: bool = Field(default=False, description="write SUMO's floating car data: every vehicle in every step")


class Scenario(_Options):
    """One run: a garage, its AGVs, the controller and the customers.

    Example:
        >>> import parking_sim as ps
        >>> scenario = ps.Scenario(garage="map1", agvs=4)
        >>> scenario.model_copy(update={"agvs": 6})
        Scenario(garage='map1', agvs=6)
    """

    garage: str = Field(
        min_length=1,
        description="a shipped garage's name, or a net file; a relative path counts from this file's folder",
    )
    agvs: int = Field(ge=1, le=MOST_PLACES, description="number of AGVs")
    bays: int | None = Field(
        default=None, ge=1, le=MOST_PLACES, description="bays in use, the first ones; default: all"
    )
    chargers: int | None = Field(
        default=None, ge=0, le=MOST_PLACES, description="chargers in use, the first ones; default: all"
    )
    homes: list[str] | None = Field(
        default=None,
        min_length=1,
        description="homes of the AGVs by name, the first AGV's first; default: the first ones",
    )
    plant: PlantKind = Field(default="sumo", description="what moves the AGVs: SUMO, or ticks of one cell without SUMO")
    rules: str = Field(default="fair", min_length=1, description="rule set of the discrete plant")
    planner: str = Field(
        default=DEFAULT_PLANNER, min_length=1, description="a planner's name, or `file.py:function` for one of your own"
    )
    planner_options: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="options passed to the planner by name"
    )
    dispatch: str = Field(
        default="nearest-task", min_length=1, description="rule that assigns AGVs and slots to requests"
    )
    seed: int = Field(default=0, ge=0, lt=2**31, description="seed of every random stream of the run")
    workload: WorkloadConfig = Field(default_factory=ParkExit, description="what the customers want")
    duration_s: float | None = Field(
        default=None,
        gt=0,
        le=LONGEST_S,
        description="end of the run in simulated seconds; default: when every request is finished",
    )
    max_time_s: float = Field(
        default=2_592_000.0,
        gt=0,
        le=LONGEST_S,
        description="simulated seconds after which a run without an end is given up",
    )
    step_s: float = Field(default=0.5, gt=0, le=1, description="SUMO's step, seconds; whole milliseconds")
    control: ControlConfig = Field(default_factory=ControlConfig, description="clock, window and limits")
    agv: AgvConfig = Field(default_factory=AgvConfig, description="the AGVs' speeds, size and battery")
    customers: CustomerConfig = Field(default_factory=CustomerConfig, description="the customers and their cars")
    faults: FaultConfig = Field(default_factory=FaultConfig, description="what goes wrong")
    record: RecordConfig = Field(default_factory=RecordConfig, description="what is written down")

    _base_dir: Path = PrivateAttr(default=Path())

    @field_validator("step_s")
    @classmethod
    def _whole_milliseconds(cls, step_s: float) -> float:
        """SUMO cuts a step down to whole milliseconds, and its clock would drift away from the record's."""
        if step_s != round(step_s, 3):
            down, up = math.floor(step_s * 1000) / 1000, math.ceil(step_s * 1000) / 1000
            nearest = f"{down:g} or {up:g}" if down > 0 else f"{up:g}"
            raise ValueError(f"{step_s!r}: SUMO's step is whole milliseconds; give {nearest}")
        return step_s

    @property
    def base_dir(self) -> Path:
        """Folder from which relative paths in the scenario count: that of its file, or the working directory."""
        return self._base_dir

    @property
    def garage_source(self) -> str | Path:
        """Name of a shipped garage, or path of a net file."""
        return self.base_dir / self.garage if self.garage.endswith(NET_SUFFIXES) else self.garage

    @property
    def planner_source(self) -> str:
        """The planner's name, or ``file.py:function`` with the file's path from the working directory.

        A relative path counts from the scenario's folder, or else from the working directory.
        """
        beside = self.base_dir / self.planner
        return str(beside) if is_file(Path(str(beside).rpartition(":")[0])) else self.planner


def load_scenario(source: str | Path, overrides: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario.

    Args:
        source: a YAML file; or a shipped garage's name or a net file for its default: every car parked, then brought
            back.
        overrides: values for keys at the top level that go before the file's.

    Returns:
        The scenario; its garage, planner, dispatch rule and rule set exist.

    Raises:
        InputError: no such file or garage, bad YAML, or a value that isn't valid.

    Example:
        >>> import parking_sim as ps
        >>> ps.load_scenario("map1", {"agvs": 6, "seed": 7})
        Scenario(garage='map1', agvs=6, seed=7)
    """
    data, base_dir = scenario_keys(source)
    return _validate(data, overrides or {}, str(source), base_dir)


def scenario_keys(source: str | Path) -> tuple[dict[str, object], Path]:
    """Read the keys of a scenario without checking them.

    Args:
        source: as for :func:`load_scenario`.

    Returns:
        The keys as given, and the folder from which relative paths in them count.

    Raises:
        InputError: no such file or garage, or bad YAML.
    """
    name = str(source)
    if name in shipped_nets():
        return {"garage": name, "agvs": DEFAULT_AGVS.get(name, 1)}, Path()
    if name.endswith(NET_SUFFIXES):
        return {"garage": name}, Path()
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        shipped = ", ".join(shipped_nets())
        raise InputError(f"{source}: give a scenario (.yaml), a net (.net.xml.gz) or a shipped garage: {shipped}")
    return read_yaml(path), path.parent


def check_scenario(data: Mapping[str, object], source: str, base_dir: Path) -> Scenario:
    """Make a scenario of keys and values.

    Args:
        data: keys as in a scenario file.
        source: where they come from, the first words of a complaint.
        base_dir: folder from which relative paths in them count.

    Returns:
        The scenario; its garage, planner, dispatch rule and rule set exist.

    Raises:
        InputError: a value isn't valid.
    """
    return _validate(dict(data), {}, source, base_dir)


def read_yaml(path: Path) -> dict[str, object]:
    """Read a YAML file whose keys differ.

    Args:
        path: the file.

    Returns:
        Its mapping at the top level.

    Raises:
        InputError: it can't be read, or is something else.
    """
    try:
        return read_mapping(path, "garage: map1")
    except YamlError as error:
        raise InputError(f"{path}: {error}") from None


def _validate(data: dict[str, object], overrides: Mapping[str, object], source: str, base_dir: Path) -> Scenario:
    try:
        scenario = Scenario.model_validate({**data, **overrides})
    except ValidationError as error:
        told = [_from_where(wrong, overrides, source) for wrong in all_errors(error, Scenario)]
        raise InputError(in_lines(told)) from None
    scenario._base_dir = base_dir
    unknown = [_from_where(f"{key}: {what}", overrides, source) for key, what in unknown_names(scenario)]
    if unknown:
        raise InputError(in_lines(unknown))
    return scenario


def _from_where(wrong: str, overrides: Mapping[str, object], source: str) -> str:
    """A complaint with where its field was given."""
    given = re.split(r"[.:\[]", wrong, maxsplit=1)[0] in overrides
    return f"{'command line' if given else source}: {wrong}"


def unknown_names(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Names in a scenario that no table has.

    Args:
        scenario: the scenario.

    Yields:
        The key, and what is wrong with its value and what would be valid.
    """
    from controller.dispatch import DISPATCH
    from controller.planners.table import PLANNERS
    from parking_sim.rulesets import RULE_SETS

    if ":" in scenario.planner:
        path = Path(scenario.planner_source.rpartition(":")[0])
        if not is_file(path):
            yield "planner", f"{shown(scenario.planner)}: no such file; give file.py:function"
    elif scenario.planner not in PLANNERS:
        yield "planner", f"{shown(scenario.planner)}: {one_of(PLANNERS)}, or file.py:function"
    for key, value, table in (
        ("dispatch", scenario.dispatch, DISPATCH),
        ("rules", scenario.rules, RULE_SETS),
    ):
        if value not in table:
            yield key, f"{shown(value)}: {one_of(table)}"
    if not scenario.garage.endswith(NET_SUFFIXES):
        if scenario.garage not in shipped_nets():
            yield "garage", f"{shown(scenario.garage)}: {one_of(shipped_nets())}, or a file (.net.xml.gz)"
    elif not is_file(Path(scenario.garage_source)):
        yield "garage", f"{shown(scenario.garage)}: no such file"
