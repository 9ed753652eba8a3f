"""The table of planners: a new one is a file and a line here. Modules are imported only when their planner is used."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.metadata import entry_points
from pathlib import Path
from traceback import extract_tb
from typing import Any

from controller.flags import FLAGS, flags_of
from controller.types import Motion, Planner, PlanningProblem, PlanResult
from controller.types import Path as AgvPath
from sumo_nets.errors import InputError
from sumo_nets.graph import Graph
from sumo_nets.wording import one_of

#: Installed packages offer planners of their own as entry points of this group.
ENTRY_POINTS = "parking_sim.planners"

#: Name -> (module, factory, dataclass of its options or "").
PLANNERS: dict[str, tuple[str, str, str]] = {
    "whca": ("controller.planners.whca", "make_whca", "WhcaOptions"),
    "token": ("controller.planners.token", "make_token", "TokenOptions"),
    "online_mapf": ("controller.planners.online_mapf", "make_online_mapf", "OnlineMapfOptions"),
    "pbs": ("controller.planners.pbs", "make_pbs", "PbsOptions"),
    "pibt": ("controller.planners.pibt", "make_pibt", ""),
    "lacam": ("controller.planners.lacam", "make_lacam", "LacamOptions"),
    "cbs": ("controller.planners.cbs", "make_cbs", "CbsOptions"),
    "astar": ("controller.planners.astar", "make_astar", ""),
    "dstar_lite": ("controller.planners.dstar_lite", "make_dstar_lite", ""),
    "pipeline": ("controller.planners.pipeline", "make_pipeline", "PipelineOptions"),
    "binary_tree": ("controller.planners.binary_tree", "make_binary_tree", "BinaryTreeOptions"),
    "ga_single": ("controller.planners.genetic", "make_ga_single", "GeneticOptions"),
    "ga_two_stage": ("controller.planners.genetic", "make_ga_two_stage", "GeneticOptions"),
}


class PlannerError(InputError):
    """A planner of a user's own fails. The message is one line: the planner, its error and where it was raised."""


@dataclass(frozen=True, slots=True)
class OwnPlanner:
    """A planner of a user's own; what it does wrong is told as ``PlannerError``.

    Attributes:
        name: as it was asked for.
        function: from ``PlanningProblem`` to ``PlanResult``.
    """

    name: str
    function: Planner

    def __post_init__(self) -> None:
        """Check its flags.

        Raises:
            ValueError: see ``PlannerFlags``.
        """
        try:
            flags_of(self.function)
        except ValueError as error:
            raise ValueError(f"{self.name!r}: {error}") from None

    def __getattr__(self, name: str) -> object:
        """Its flags are those of the function."""
        if name in FLAGS:
            return getattr(self.function, name)
        raise AttributeError(name)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Have it plan.

        Raises:
            PlannerError: it raises, or what it returns is no plan.
        """
        try:
            result: object = self.function(problem)
        except Exception as error:
            where = extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}, line {where.lineno}"
            raise PlannerError(f"{self.name} raises {type(error).__name__}: {error} ({place})") from error
        if not isinstance(result, PlanResult):
            raise PlannerError(f"{self.name} returns {type(result).__name__} instead of PlanResult")
        for agv, path in result.paths.items():
            if not isinstance(path, AgvPath):
                raise PlannerError(f"{self.name} returns {type(path).__name__} instead of Path for AGV {agv}")
        return result


def load_planner(name: str, graph: Graph, motion: Motion, options: Mapping[str, object]) -> Planner:
    """Make a planner for a garage.

    Args:
        name: a name of ``PLANNERS``, ``file.py:function`` for one of your own (a function from ``PlanningProblem``
            to ``PlanResult``), or the name under which an installed package offers such a function.
        graph, motion: the garage and how long moves take.
        options: options of the planner by name.

    Returns:
        The planner.

    Raises:
        ValueError: no such planner, file, function or option; the message is one line.
    """
    if ":" in name:
        return _own(name)
    if name not in PLANNERS:
        for entry in entry_points(group=ENTRY_POINTS, name=name):
            return OwnPlanner(name, entry.load())
        raise ValueError(f"{name!r}: no such planner; {one_of(PLANNERS)}, or file.py:function")
    module_name, factory, options_name = PLANNERS[name]
    module = importlib.import_module(module_name)
    made: Planner = getattr(module, factory)(graph, motion, _options(name, module, options_name, options))
    return made


def _options(name: str, module: Any, options_name: str, options: Mapping[str, object]) -> object:
    known = {f.name: f for f in fields(getattr(module, options_name))} if options_name else {}
    for key, value in options.items():
        if key not in known:
            raise ValueError(f"planner_options.{key}: {name} has no such option; {one_of(known, key)}")
        default = known[key].default
        if type(value) is not type(default) and not (type(value) is int and type(default) is float):
            raise ValueError(f"planner_options.{key}: {value!r}: give a value like {default!r}")
        least = known[key].metadata.get("least", 0)
        if isinstance(value, int | float) and value < least:
            raise ValueError(f"planner_options.{key}: {value!r}: give {least} or more")
    return getattr(module, options_name)(**options) if options_name else None


def _own(name: str) -> Planner:
    path, _, function = name.rpartition(":")
    if not Path(path).is_file():
        raise ValueError(f"{name!r}: no file {path}")
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{name!r}: {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{name!r}: {path} can't be imported: {type(error).__name__}: {error}") from None
    if not callable(getattr(module, function, None)):
        functions = [
            key for key, value in vars(module).items() if callable(value) and value.__module__ == module.__name__
        ]
        raise ValueError(f"{name!r}: {path} has no function {function!r}; {one_of(functions)}")
    return OwnPlanner(name, getattr(module, function))
