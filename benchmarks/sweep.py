"""The same sweep with one worker, with two, and on a dask cluster of two: how much faster, and is the table the same.

    python benchmarks/sweep.py [--planners whca,cbs,...] [--agvs 1,2,3,4,6] [--seeds 1..10] [--minutes 20] [--no-dask]

Full size is 4 planners x 5 fleets x 10 seeds on map1: 200 runs of 20 simulated minutes, each time from nothing.
Planners default to the first four of the table. The tables are compared to the last digit but for columns of
wall-clock time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import perf_counter

import pandas as pd
import yaml

from analysis.runs import load_runs
from controller.planners.table import PLANNERS
from parking_sim.many_runs import do_run, sweep
from parking_sim.sweep_plan import RunSpec, load_sweep
from parking_sim.workers import open_executor


def main() -> None:
    """Print seconds, runs a second and the ratio to one worker; say whether the tables are equal."""
    given = arguments()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        specs = plan(folder / "plan.yaml", given)
        for scenario in {spec.scenario.planner: spec.scenario for spec in specs}.values():
            do_run(scenario, folder / "warm" / scenario.planner)  # compiles its kernels, which are then in their cache
        print(f"{len(specs)} runs of {given.minutes:g} simulated minutes")
        seconds: dict[str, float] = {}
        tables: dict[str, pd.DataFrame] = {}
        ways = {"1 process": (1, False), "2 processes": (2, False), "2 dask workers": (2, True)}
        for way, (workers, dask) in ways.items():
            if not (dask and given.no_dask):
                seconds[way], tables[way] = timed(specs, folder / way, workers, dask)
                ratio = seconds["1 process"] / seconds[way]
                print(f"{way:16}{seconds[way]:9.1f} s{len(specs) / seconds[way]:8.2f} runs/s   ratio {ratio:.2f}")
        first = tables["1 process"]
        for way, table in tables.items():
            pd.testing.assert_frame_equal(table, first)
            print(f"{way:16}{len(table)} rows, {len(table.columns)} columns: the same table")


def arguments() -> argparse.Namespace:
    """Those of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--planners", default=",".join(list(PLANNERS)[:4]))
    parser.add_argument("--agvs", default="1,2,3,4,6")
    parser.add_argument("--seeds", default="1..10")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--no-dask", action="store_true")
    return parser.parse_args()


def plan(path: Path, given: argparse.Namespace) -> tuple[RunSpec, ...]:
    """Write the sweep file and read it."""
    base = {
        "garage": "map1",
        "agvs": 1,
        "duration_s": 60 * given.minutes,
        "workload": {"kind": "poisson", "arrivals_per_h": 20, "dwell_median_min": 45, "initial_occupancy": 0.4},
    }
    grid = {"planner": given.planners.split(","), "agvs": [int(agvs) for agvs in given.agvs.split(",")]}
    path.write_text(yaml.safe_dump({"base": base, "grid": grid, "seeds": given.seeds}))
    return load_sweep(path)


def timed(specs: tuple[RunSpec, ...], folder: Path, workers: int, dask: bool) -> tuple[float, pd.DataFrame]:
    """Seconds from the first submission to the last record, workers' start included, and the table of runs."""
    with ExitStack() as stack:
        scheduler = stack.enter_context(local_cluster(workers)) if dask else None
        begin = perf_counter()
        with open_executor(workers, scheduler) as executor:
            failures = sweep(specs, folder, executor)
        seconds = perf_counter() - begin
    for failure in failures:
        print(f"failed: {failure.spec.variant.name} seed={failure.spec.scenario.seed}: {failure.error}")
    frame = load_runs(folder).runs
    return seconds, frame.loc[:, ~frame.columns.str.startswith("wall_")]


@contextmanager
def local_cluster(workers: int) -> Iterator[str]:
    """A dask cluster of worker processes on this machine; yields its scheduler's address.

    Neither profiled ten times a second nor made to give back memory at once, see docs/sweeps.md.
    """
    import dask
    from distributed import LocalCluster

    dask.config.set(
        {"distributed.worker.profile.enabled": False, "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": "1"}}
    )

    with LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


if __name__ == "__main__":
    main()
