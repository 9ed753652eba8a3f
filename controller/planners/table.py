"""The table of planners: a new one is a file and a line here. Modules are imported only when their planner is used."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import fields
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from controller.planners.guest import LIMIT_S, Guest, PlannerError, guarded
from controller.types import Motion, Planner
from sumo_nets.graph import Graph
from sumo_nets.wording import cut, one_of, shown

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


def load_planner(
    name: str, graph: Graph, motion: Motion, options: Mapping[str, object], limit_s: float = LIMIT_S
) -> Planner:
    """Make a planner for a garage.

    Args:
        name: a name of ``PLANNERS``, ``file.py:function`` for one of your own (a function from ``PlanningProblem``
            to ``PlanResult``), or the name under which an installed package offers such a function.
        graph, motion: the garage and how long moves take.
        options: options of the planner by name.
        limit_s: wall-clock seconds that a planner of your own has for an answer.

    Returns:
        The planner; one of your own as a :class:`controller.planners.guest.Guest`.

    Raises:
        ValueError: no such planner, file, function or option; the message is one line.
        PlannerError: the file of a planner of your own takes longer than ``limit_s`` to load.
    """
    if ":" in name:
        return Guest(name, _own(name, limit_s), graph, motion, limit_s)
    if name not in PLANNERS:
        for entry in entry_points(group=ENTRY_POINTS, name=name):
            return Guest(name, guarded(name, entry.load, limit_s), graph, motion, limit_s)
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
            raise ValueError(f"planner_options.{key}: {shown(value)}: give a value like {default!r}")
        least = known[key].metadata.get("least", 0)
        if isinstance(value, int | float) and value < least:
            raise ValueError(f"planner_options.{key}: {shown(value)}: give {least} or more")
    return getattr(module, options_name)(**options) if options_name else None


def _own(name: str, limit_s: float) -> Planner:
    """The function of a user's file."""
    path, _, function = name.rpartition(":")
    if not Path(path).is_file():
        raise ValueError(f"{name!r}: no file {path}")
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{name!r}: {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    load = spec.loader.exec_module
    try:
        guarded(name, lambda: load(module), limit_s)
    except PlannerError as error:
        if error.__cause__ is None:
            raise
        why = f"{type(error.__cause__).__name__}: {cut(str(error.__cause__), 200)}"
        raise ValueError(f"{name!r}: {path} can't be imported: {why}") from None
    found = vars(module).get(function)
    if not callable(found):
        functions = [key for key, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        raise ValueError(f"{name!r}: {path} has no function {function!r}; {one_of(functions)}")
    made: Planner = found
    return made
