"""Many runs, into one folder, by any executor: skipped if done, tried again if they fail, with the time that is left.

The folder of a sweep holds ``sweep.json`` (which runs belong to it), ``failures.json`` (which failed, and why) and
``runs/KEY/`` with the record of each run, whose key is a hash of its scenario, input files and code. A record appears
whole or not at all, so that a sweep can be stopped or killed at any moment and started again. Files of the user's own
are kept once, in ``inputs/``, and linked to by the runs that read them.
"""

from __future__ import annotations

import os
import queue
import shutil
import socket
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from analysis.run_files import INPUTS, RUN_FILE
from parking_sim.config import Scenario
from parking_sim.errors import RunFailedError
from parking_sim.folder_lock import FolderLock
from parking_sim.folders import check_path
from parking_sim.sweep_plan import RunSpec
from parking_sim.versions import code_version
from sumo_nets.errors import InputError
from sumo_nets.whole_file import PART

SWEEP_FILE, FAILURES_FILE, RUNS_FOLDER = "sweep.json", "failures.json", "runs"

_PART = ".part-"
_TELL_S = 0.5
_one_at_a_time = threading.Lock()


@dataclass(frozen=True, slots=True)
class SweepProgress:
    """How far a sweep is.

    Attributes:
        total, done, failed: runs in all, with a record, given up.
        left_s: estimate of the wall-clock seconds to go, None before the first run has ended.
    """

    total: int
    done: int
    failed: int
    left_s: float | None


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that was given up, and why.

    Attributes:
        spec: the run.
        error: what went wrong, in one line.
        is_input: the scenario does not fit its garage, so that trying again would not help.
    """

    spec: RunSpec
    error: str
    is_input: bool


Tell = Callable[[SweepProgress], None]


def sweep(specs: Sequence[RunSpec], folder: Path, executor: Executor, tell: Tell | None = None) -> list[Failure]:
    """Do the runs that a folder does not have yet.

    Args:
        specs: the runs.
        folder: folder of the sweep, made if need be; on a cluster, all workers see it under the same path.
        executor: what does them, see ``parking_sim.workers``.
        tell: called with the progress about twice a second.

    Returns:
        The runs that failed twice.

    Raises:
        InputError: the folder can't be used.
    """
    with open_folder(folder):
        write_plan(specs, folder)
        failures = run_missing(specs, folder, executor, tell)
        _write_failures(failures, folder)
    return failures


def open_folder(folder: Path) -> FolderLock:
    """Make the folder of a sweep, keep other processes out, and remove what runs that were killed have left there.

    Args:
        folder: absent, empty, or that of a sweep.

    Returns:
        The lock on the folder; release it at the end.

    Raises:
        InputError: it holds something else, another process writes to it, or it can't be written.
    """
    check_path(folder)
    try:
        (folder / RUNS_FOLDER).mkdir(parents=True, exist_ok=True)
        lock = FolderLock(folder)
        try:
            _tidy(folder)
        except BaseException:
            lock.release()
            raise
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None
    return lock


def _tidy(folder: Path) -> None:
    if not (folder / SWEEP_FILE).is_file() and _is_foreign(folder):
        raise InputError(f"--out: {folder}: holds files that are not a sweep's; give another folder")
    for path in (folder / RUNS_FOLDER).glob(f"*{_PART}*"):
        shutil.rmtree(path, ignore_errors=True)
    for path in folder.glob(f"{PART}*"):
        path.unlink()


def _is_foreign(folder: Path) -> bool:
    """Whether a folder without a sweep's file holds more than what a sweep leaves that was killed before it began."""
    own = (RUNS_FOLDER, INPUTS)
    return any(path.name not in own and not path.name.startswith(PART) for path in folder.iterdir()) or any(
        not (folder / name).is_dir() for name in own if (folder / name).exists()
    )


def write_plan(specs: Sequence[RunSpec], folder: Path) -> None:
    """Write down which runs belong to a sweep.

    Args:
        specs: the runs.
        folder: folder of the sweep.
    """
    from analysis.record import write_json

    runs = [{**_named(spec), "shown": list(spec.variant.shown.items())} for spec in specs]
    write_json(folder / SWEEP_FILE, {"code": code_version(), "runs": runs})


def run_missing(specs: Sequence[RunSpec], folder: Path, executor: Executor, tell: Tell | None = None) -> list[Failure]:
    """Do the runs that have no record. A run that fails is tried once more, on a fresh worker.

    Args:
        specs: the runs.
        folder: folder of the sweep, see :func:`open_folder`.
        executor: what does them.
        tell: called with the progress about twice a second.

    Returns:
        The runs that failed twice.
    """
    missing = [spec for spec in specs if not is_done(spec, folder)]
    ended: queue.SimpleQueue[Future[None]] = queue.SimpleQueue()
    running: dict[Future[None], tuple[RunSpec, int]] = {}

    def start(spec: RunSpec, attempt: int) -> None:
        future = executor.submit(do_run, spec.scenario, run_folder(spec, folder))
        running[future] = (spec, attempt)
        future.add_done_callback(ended.put)

    def tell_progress() -> None:
        if tell is not None:
            now_done = len(missing) - len(running) - len(failures)
            spent = perf_counter() - begin
            left = spent / (len(missing) - len(running)) * len(running) if len(running) < len(missing) else None
            tell(SweepProgress(len(specs), len(specs) - len(missing) + now_done, len(failures), left))

    failures: list[Failure] = []
    begin = perf_counter()
    for spec in missing:
        start(spec, 1)
    try:
        while running:
            tell_progress()
            try:
                future = ended.get(timeout=_TELL_S)
            except queue.Empty:
                continue
            spec, attempt = running.pop(future)
            error = _error_of(future)
            if error is not None and attempt == 1 and not isinstance(error, InputError):
                start(spec, 2)
            elif error is not None and not is_done(spec, folder):
                failures.append(Failure(spec, _one_line(error), isinstance(error, InputError)))
                _write_failures(failures, folder)
    finally:
        for future in running:
            future.cancel()
    tell_progress()
    return failures


def run_folder(spec: RunSpec, folder: Path) -> Path:
    """Where the record of a run is kept within the folder of a sweep."""
    return folder.resolve() / RUNS_FOLDER / spec.key


def is_done(spec: RunSpec, folder: Path) -> bool:
    """Whether a run has its record."""
    return (run_folder(spec, folder) / RUN_FILE).is_file()


def do_run(scenario: Scenario, out: Path) -> None:
    """Do one run: the task function of every executor.

    Args:
        scenario: what to run.
        out: folder of its record within that of the sweep, see :func:`run_folder`; it appears whole or not at all.

    Raises:
        InputError: the scenario does not fit its garage.
        RunFailedError: anything else went wrong.
    """
    part = out.with_name(f"{out.name}{_PART}{socket.gethostname()}-{os.getpid()}")
    try:
        with _one_at_a_time:
            error = _simulate(scenario, part, out.parent.parent / INPUTS)
        if error is not None:
            raise error
        if not out.exists():
            part.replace(out)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _simulate(scenario: Scenario, folder: Path, shared: Path) -> Exception | None:
    """Do a run; what went wrong is returned as text alone, for libsumo's exceptions don't travel between processes."""
    from parking_sim.simulation import simulate

    try:
        status = simulate(scenario, folder, shared=shared).status
    except InputError as error:
        return InputError(str(error))
    except RunFailedError as error:
        return RunFailedError(str(error))
    except Exception as error:
        return RunFailedError(f"{type(error).__name__}: {error} ({_place(error)})")
    return RunFailedError("interrupted") if status == "interrupted" else None


def _error_of(future: Future[None]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _one_line(error: BaseException) -> str:
    if isinstance(error, BrokenExecutor):
        return "the worker was killed or crashed"
    text = str(error) if isinstance(error, InputError | RunFailedError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def _place(error: BaseException) -> str:
    """Where an exception was raised: file and line."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}" if trace is not None else "?"


def _write_failures(failures: Sequence[Failure], folder: Path) -> None:
    from analysis.record import write_json

    rows = [{**_named(failure.spec), "error": failure.error} for failure in failures]
    write_json(folder / FAILURES_FILE, {"failures": rows})


def _named(spec: RunSpec) -> dict[str, object]:
    """A run in the words of the sweep's files."""
    return {"run": spec.key, "variant": spec.variant.name, "seed": spec.scenario.seed}
