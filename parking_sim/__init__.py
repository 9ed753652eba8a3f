"""Robotic parking garages: AGVs under multi-agent path finding, in Eclipse SUMO or in ticks of one cell.

Three lines run a scenario::

    import parking_sim as ps

    summary = ps.simulate(ps.load_scenario("map1"), "runs/first")

Names are imported when they are first used, so that ``import parking_sim`` answers at once.

Example:
    >>> import parking_sim as ps
    >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
    >>> ps.simulate(scenario).status
    'time_limit'
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

    from analysis.runs import Runs as Runs
    from analysis.runs import load_runs as load_runs
    from analysis.tables import Run as Run
    from analysis.tables import load_run as load_run
    from controller.types import Path as Path
    from controller.types import PlanAgent as PlanAgent
    from controller.types import Planner as Planner
    from controller.types import PlanningProblem as PlanningProblem
    from controller.types import PlanResult as PlanResult
    from controller.types import Status as Status
    from parking_sim.config import Scenario as Scenario
    from parking_sim.config import load_scenario as load_scenario
    from parking_sim.errors import RunFailedError as RunFailedError
    from parking_sim.library import build as build
    from parking_sim.library import compare as compare
    from parking_sim.library import size as size
    from parking_sim.library import sweep as sweep
    from parking_sim.simulation import RunProgress as RunProgress
    from parking_sim.simulation import Summary as Summary
    from parking_sim.simulation import simulate as simulate
    from parking_sim.stepwise import Simulation as Simulation
    from sumo_nets.errors import InputError as InputError
    from sumo_nets.layout import Layout as Layout
    from sumo_nets.layout import load_layout as load_layout
    from sumo_nets.read import read_net as read_net

    __version__: str

#: Public name -> the module that defines it.
_PLACES = {
    "InputError": "sumo_nets.errors",
    "Layout": "sumo_nets.layout",
    "Path": "controller.types",
    "PlanAgent": "controller.types",
    "PlanResult": "controller.types",
    "Planner": "controller.types",
    "PlanningProblem": "controller.types",
    "RunProgress": "parking_sim.simulation",
    "Run": "analysis.tables",
    "RunFailedError": "parking_sim.errors",
    "Runs": "analysis.runs",
    "Scenario": "parking_sim.config",
    "Simulation": "parking_sim.stepwise",
    "Status": "controller.types",
    "Summary": "parking_sim.simulation",
    "build": "parking_sim.library",
    "compare": "parking_sim.library",
    "load_layout": "sumo_nets.layout",
    "load_run": "analysis.tables",
    "load_runs": "analysis.runs",
    "load_scenario": "parking_sim.config",
    "read_net": "sumo_nets.read",
    "simulate": "parking_sim.simulation",
    "size": "parking_sim.library",
    "sweep": "parking_sim.library",
}

__all__ = [
    "InputError", "Layout", "Path", "PlanAgent", "PlanResult", "Planner", "PlanningProblem", "Run",
    "RunFailedError", "RunProgress", "Runs", "Scenario", "Simulation", "Status", "Summary", "__version__", "build",
    "compare", "load_layout", "load_run", "load_runs", "load_scenario", "read_net", "simulate", "size", "sweep",
]  # fmt: skip

if not TYPE_CHECKING:  # a name that is not there is an error to mypy as well

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first used (PEP 562)."""
        import importlib

        if name == "__version__":
            from importlib.metadata import version

            value = version("parking-sim")
        elif name in _PLACES:
            from parking_sim.shadowing import require_own_packages

            require_own_packages()
            value = getattr(importlib.import_module(_PLACES[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """The public names."""
        return __all__
