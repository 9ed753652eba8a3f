"""The demonstration: three garages park every car and bring every car back, side by side; two under WHCA* as well."""

from __future__ import annotations

import math
import multiprocessing
import os
import queue
import signal
import sys
from collections.abc import Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parking_sim.config import DEFAULT_AGVS, DEFAULT_PLANNER, load_scenario
from parking_sim.folders import check_folder
from parking_sim.progress import RunBars
from parking_sim.terminal import table

if TYPE_CHECKING:
    from parking_sim.simulation import RunProgress, Summary

#: Run -> garage and planner, longest first. The two smaller garages are run under WHCA* too, as a comparison; on map3
#: that would take longer than all others together.
RUNS: Mapping[str, tuple[str, str]] = {
    "map3": ("map3", DEFAULT_PLANNER),
    "map2-whca": ("map2", "whca"),
    "map2": ("map2", DEFAULT_PLANNER),
    "map1": ("map1", DEFAULT_PLANNER),
    "map1-whca": ("map1", "whca"),
}

_POLL_S = 0.2
_progress_queue: Any = None


def run_demo(out: Path, force: bool, quiet: bool, cars: int | None = None) -> int:
    """Run the shipped garages in parallel and print what came of it.

    Args:
        out: folder; each garage's record goes into a folder of its name, the overview to ``index.html``.
        force: earlier runs there may be replaced.
        quiet: no progress, only the table.
        cars: cars in each garage; default: as many as it has slots.

    Returns:
        Exit code: 0 if every task of every garage was done safely, 130 after Ctrl-C, else 1.

    Raises:
        InputError: the folder can't be used.
    """
    folders = {name: out / name for name in RUNS}
    for folder in folders.values():
        check_folder(folder, force)
    if not quiet:
        print(f"{', '.join(sorted(RUNS))} in SUMO, side by side; this takes some minutes", file=sys.stderr)
    summaries = _run_all(folders, quiet or not sys.stderr.isatty(), cars)
    names = sorted(summaries)
    print(results_table({name: summaries[name] for name in names}))
    if any(summary.status == "interrupted" for summary in summaries.values()):
        return 130
    for line in comparison(summaries):
        print(line)
    from analysis.report import write_index

    print(f"report: {write_index([folders[name] for name in names], out / 'index.html')}")
    for name in names:
        print(f"replay: {folders[name] / 'replay.html'}")
    complaints = [f"{name}: {line}" for name in names for line in complaints_of(summaries[name])]
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


def comparison(summaries: Mapping[str, Summary]) -> list[str]:
    """Which planner was faster where a garage was run under two, one line a garage."""
    lines = []
    for name, other in (("map1", "map1-whca"), ("map2", "map2-whca")):
        planners = [RUNS[run][1] for run in (name, other)]
        hours = [summaries[run].metrics["simulated_s"] / 3600 for run in (name, other)]
        won = planners[hours[1] < hours[0]]
        lines.append(
            f"{name}: {won} won, {planners[0]} took {hours[0]:.2f} h and {planners[1]} {hours[1]:.2f} h"
            f" ({hours[0] / hours[1] - 1:+.1%})"
        )
    return lines


def complaints_of(summary: Summary) -> list[str]:
    """What was incomplete or unsafe in a run, one line each; empty if all was well."""
    return [*([] if summary.status == "finished" else [f"ended with status {summary.status!r}"]), *summary.failed]


def results_table(summaries: Mapping[str, Summary]) -> str:
    """The figures of some runs as a table for the terminal.

    Args:
        summaries: a run's name, a key of ``RUNS`` -> its outcome.

    Returns:
        One column a run.
    """
    columns = {name: _figures(name, summary.metrics) for name, summary in summaries.items()}
    headings = next(iter(columns.values()), {})
    rows = [{"": heading, **{name: figures[heading] for name, figures in columns.items()}} for heading in headings]
    return table(rows, "every car parked, then every car brought back")


def _figures(name: str, metrics: Mapping[str, Any]) -> dict[str, str]:
    garage, planner = RUNS[name]
    hours = metrics["simulated_s"] / 3600
    return {
        "planner": planner,
        "AGVs": str(DEFAULT_AGVS[garage]),
        "tasks done": f"{metrics['tasks_done']} / {metrics['tasks_wanted']}",
        "SUMO collisions": str(metrics["sumo_collisions"]),
        "footprint overlaps": str(metrics["footprint_overlaps"]),
        "least clearance, m": _known(metrics["least_clearance_m"], 2),
        "deadlocks found / resolved": f"{metrics['deadlocks_found']} / {metrics['deadlocks_resolved']}",
        "throughput, tasks/h": _known(metrics["tasks_done"] / hours if hours else math.nan, 1),
        "retrieval wait p95, s": _known(metrics["retrieval_wait_p95_s"], 0),
        "simulated hours": f"{hours:.1f}",
        "speed, simulated s/s": f"{metrics['wall_speed']:.0f}",
    }


def _known(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _run_all(folders: Mapping[str, Path], quiet: bool, cars: int | None) -> dict[str, Summary]:
    context = multiprocessing.get_context("spawn")
    reports = context.Queue()
    workers = min(len(folders), os.cpu_count() or 1)
    bars = nullcontext() if quiet else RunBars(list(folders))
    with ProcessPoolExecutor(workers, context, _start_worker, (reports,)) as pool, bars as shown:
        futures = {pool.submit(_run_one, name, folder, cars): name for name, folder in folders.items()}
        try:
            _watch(futures, reports, shown)
        except KeyboardInterrupt:
            # the workers got it too: those that run write what they have, the others are not started
            for future in futures:
                future.cancel()
            wait(futures)
    return {name: future.result() for future, name in futures.items() if not future.cancelled()}


def _watch(futures: Mapping[Future[Summary], str], reports: Any, shown: RunBars | None) -> None:
    while not all(future.done() for future in futures):
        try:
            name, progress = reports.get(timeout=_POLL_S)
        except queue.Empty:
            continue
        if shown is not None:
            shown.update(name, progress)


def _start_worker(reports: Any) -> None:
    """An idle worker leaves Ctrl-C to its parent; a running one writes its record."""
    global _progress_queue
    _progress_queue = reports
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_one(name: str, folder: Path, cars: int | None) -> Summary:
    from analysis.replay import write_replay
    from analysis.report import write_report
    from parking_sim.simulation import simulate

    def tell(progress: RunProgress) -> None:
        _progress_queue.put((name, progress))

    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        garage, planner = RUNS[name]
        given = {"planner": planner, "workload": {"kind": "park_exit", "cars": cars}}
        summary = simulate(load_scenario(garage, given), folder, progress=tell)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    write_replay(folder, report=True)
    write_report(folder)
    return summary
