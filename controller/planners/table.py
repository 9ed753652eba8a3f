"""The table of planners: a new one is a file and a line here. Modules are imported only when their planner is used."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from controller.types import Motion, Planner
from sumo_nets.graph import Graph

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
    "binary_tree": ("controller.planners.binary_tree", "make_binary_tree", "BinaryTreeOptions"),
    "ga_single": ("controller.planners.genetic", "make_ga_single", "GeneticOptions"),
    "ga_two_stage": ("controller.planners.genetic", "make_ga_two_stage", "GeneticOptions"),
}


def load_planner(name: str, graph: Graph, motion: Motion, options: Mapping[str, object]) -> Planner:
    """Make a planner for a garage.

    Args:
        name: a name of ``PLANNERS``, or ``file.py:function`` for one of your own: a function from
            ``PlanningProblem`` to ``PlanResult``.
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
        raise ValueError(f"{name!r}: no such planner; give one of {', '.join(PLANNERS)}, or file.py:function")
    module_name, factory, options_name = PLANNERS[name]
    module = importlib.import_module(module_name)
    made: Planner = getattr(module, factory)(graph, motion, _options(name, module, options_name, options))
    return made


def _options(name: str, module: Any, options_name: str, options: Mapping[str, object]) -> object:
    known = {f.name: f for f in fields(getattr(module, options_name))} if options_name else {}
    for key, value in options.items():
        if key not in known:
            raise ValueError(f"planner_options.{key}: {name} has no such option; it has {', '.join(known) or 'none'}")
        default = known[key].default
        if type(value) is not type(default) and not (type(value) is int and type(default) is float):
            raise ValueError(f"planner_options.{key}: {value!r}: give a value like {default!r}")
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
    except Exception as error:
        raise ValueError(f"{name!r}: {path} can't be imported: {type(error).__name__}: {error}") from None
    if not callable(getattr(module, function, None)):
        raise ValueError(f"{name!r}: {path} has no function {function}")
    planner: Planner = getattr(module, function)
    return planner
