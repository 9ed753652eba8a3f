"""From Python: a net from a layout, a sweep, a comparison of two variants, the smallest fleet for a target.

A script that calls :func:`sweep` or :func:`size` starts processes that import it anew, so that the calls belong below
``if __name__ == "__main__":``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.compare import HEADLINES, Comparison, select_runs
from analysis.compare import compare as compare_runs
from analysis.runs import Runs, load_runs
from analysis.size_curve import Sizing
from analysis.variants import by_scenario
from parking_sim.config import Scenario
from parking_sim.errors import RunFailedError
from parking_sim.many_runs import SweepProgress
from parking_sim.many_runs import sweep as run_sweep
from parking_sim.shadowing import require_own_packages
from parking_sim.sizing import LOOKS, parse_target, size_garage
from parking_sim.sweep_plan import RunSpec, load_sweep, make_runs
from parking_sim.workers import open_executor
from sumo_nets.build import build_net
from sumo_nets.errors import InputError
from sumo_nets.layout import Layout
from sumo_nets.read import read_net
from sumo_nets.wording import one_of

if TYPE_CHECKING:
    from sumo_nets.read import GarageNet

Progress = Callable[[SweepProgress], None]


def build(layout: Layout, folder: Path | str) -> Path:
    """Build the SUMO net of a layout; files of the same name are replaced.

    Args:
        layout: the garage.
        folder: where the net goes, made if need be.

    Returns:
        The net file, which a scenario takes as its garage.

    Raises:
        InputError: the layout's parts do not fit together, or netconvert refused them.
        OSError: the folder can't be written.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> layout = ps.load_layout({
        ...     "name": "row", "pitch_m": 7.0, "handover": "home",
        ...     "aisles": [{"from": [0, 0], "to": [6, 0], "way": "two"}],
        ...     "slots": [{"from": [1, 0], "to": [5, 0], "side": "north"}], "homes": [{"at": [0, 0], "side": "south"}],
        ... })
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     ps.build(layout, folder).name
        'row.net.xml.gz'
    """
    return build_net(layout, folder)[0]


def sweep(
    plan: Path | str | Sequence[Scenario],
    out: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Runs:
    """Run many scenarios side by side; runs that the folder holds already are not done again.

    Args:
        plan: a sweep file (.yaml), or the scenarios themselves, each with its seed.
        out: folder of the sweep, made if need be.
        workers: processes on this machine; default: one for each core that may be used.
        scheduler: address of a dask scheduler instead, such as ``tcp://host:8786``.
        progress: called about twice a second.

    Returns:
        The runs that have a record; ``failures`` of it tells of the others.

    Raises:
        InputError: a scenario is not valid, or the folder can't be used.
        RunFailedError: all runs failed.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> fleets = [
        ...     ps.load_scenario("map1", {"plant": "discrete", "agvs": agvs, "duration_s": 60.0}) for agvs in (2, 4)
        ... ]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     runs = ps.sweep(fleets, folder, workers=1)
        ...     sorted(runs.runs["agvs"])
        [2, 4]
    """
    require_own_packages()
    specs = load_sweep(Path(plan)) if isinstance(plan, Path | str) else _specs(plan)
    with open_executor(workers, scheduler) as executor:
        failures = run_sweep(specs, Path(out), executor, progress)
    if len(failures) == len(specs):
        raise RunFailedError(f"{out}: no run has a record{f'; the first: {failures[0].error}' if failures else ''}")
    return load_runs(Path(out))


def compare(
    a: Runs | Path | str,
    b: Runs | Path | str,
    *,
    names: tuple[str, str] = ("A", "B"),
    warmup_s: float = 0.0,
    measures: Sequence[str] = HEADLINES,
) -> Comparison:
    """Compare two variants by the seeds they share.

    Args:
        a: runs of one variant, or their folder; ``FOLDER:key=value,...`` picks a variant in a folder.
        b: runs of the other one, in the same words.
        names: what to call them.
        warmup_s: simulated seconds at the start that don't count.
        measures: keys of ``analysis.measures.MEASURES``.

    Returns:
        The differences with 95 % intervals; measures that either variant has nothing for are left out.

    Raises:
        InputError: no such runs, fewer than two seeds in common, or a warm-up that leaves nothing.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for agvs, seed in ((2, 1), (2, 2), (4, 1), (4, 2)):
        ...         given = {"plant": "discrete", "agvs": agvs, "seed": seed, "duration_s": 200.0}
        ...         _ = ps.simulate(ps.load_scenario("map1", given), f"{folder}/{agvs}-{seed}")
        ...     found = ps.compare(f"{folder}:agvs=2", f"{folder}:agvs=4", measures=["tasks_per_hour"])
        >>> found.differences[0].change.mean > 0
        True
    """
    first, second = (runs if isinstance(runs, Runs) else select_runs(str(runs)) for runs in (a, b))
    return compare_runs(first, second, names, warmup_s, measures)


def size(
    scenario: Scenario,
    target: str,
    out: Path | str,
    *,
    what: str = "agvs",
    most: int | None = None,
    max_seeds: int = LOOKS[-1],
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Sizing:
    """Find the smallest fleet that meets a target with 95 % confidence, or the fewest bays or chargers.

    Args:
        scenario: what to run; what is sized and the seed are replaced. Its ``duration_s`` should leave the last
            customers the time of the target.
        target: such as ``retrieval p95 < 5 min``, see ``parking_sim.sizing.parse_target``.
        out: folder for the runs, kept as those of a sweep.
        what: ``agvs``, ``bays`` or ``chargers``.
        most: greatest number to try; default: the homes, bays or chargers there are.
        max_seeds: most seeds for a number, 3 or more.
        workers: processes on this machine; default: one for each core that may be used.
        scheduler: address of a dask scheduler instead.
        progress: called about twice a second.

    Returns:
        The answer: ``number``, None if none meets the target, and all numbers ``tried``.

    Raises:
        InputError: the target or the scenario can't be used.
        RunFailedError: a run failed twice.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     ps.size(scenario, "turned away < 1 %", folder, most=2, max_seeds=3, workers=1).number
        1
    """
    require_own_packages()
    wanted = parse_target(target)
    there = {key: number for key, number in _there(read_net(scenario.garage_source)).items() if number}
    if what not in there:
        raise InputError(f"what: {what!r}: {one_of(there)}")
    looks = (*(look for look in LOOKS if look < max_seeds), max_seeds)
    with open_executor(workers, scheduler) as executor:
        return next(size_garage(scenario, wanted, {what: most or there[what]}, Path(out), executor, looks, progress))


def _specs(scenarios: Sequence[Scenario]) -> tuple[RunSpec, ...]:
    """The scenarios as runs of a sweep; those that differ in nothing but the seed are one variant."""
    keys = {str(n): {**scenario.model_dump(mode="json"), "seed": None} for n, scenario in enumerate(scenarios)}
    variants = by_scenario(keys)
    made = (make_runs([one], [variants[str(n)]], [one.seed]) for n, one in enumerate(scenarios))
    return tuple({spec.key: spec for specs in made for spec in specs}.values())


def _there(net: GarageNet) -> dict[str, int]:
    """How many AGVs, bays and chargers a garage has room for."""
    return {"agvs": len(net.graph.homes), "bays": len(net.bay_sites), "chargers": len(net.graph.chargers)}
