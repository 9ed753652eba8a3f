"""Sweeps: every executor gives the same table, what is done is kept, what fails is tried again, reported and left."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from pathlib import Path

import pandas as pd
import pytest

from analysis.runs import Runs, load_runs
from analysis.sweep_report import write_sweep_report
from parking_sim.cli import main
from parking_sim.columns import run_columns
from parking_sim.errors import RunFailedError
from parking_sim.many_runs import SweepProgress, do_run, open_folder, run_missing, sweep
from parking_sim.plants.sumo_api import PlantError
from parking_sim.progress import progress_words
from parking_sim.sweep_plan import RunSpec, load_sweep
from parking_sim.workers import SpawnedWorkers, open_executor
from sumo_nets.errors import InputError

SWEEP = """
base: {garage: map1, agvs: 2, plant: discrete, planner: whca, workload: {kind: park_exit, cars: 4}}
grid: {agvs: [1, 2]}
seeds: 1..3
"""
PLANNER = "def plan(problem):\n    raise RuntimeError('no plan today')\n"


def specs_of(folder: Path, text: str = SWEEP) -> tuple[RunSpec, ...]:
    (folder / "plan.yaml").write_text(text, encoding="utf-8")
    return load_sweep(folder / "plan.yaml")


def table_of(folder: Path) -> pd.DataFrame:
    """Everything about the runs but wall-clock times and the hash, which changes with a source edited meanwhile."""
    frame = load_runs(folder).runs.drop(columns="run")
    return frame[[column for column in frame if not column.startswith("wall_")]]


class Here(Executor):
    """Runs in this process, and remembers what it did."""

    def __init__(self) -> None:
        self.done: list[Path] = []

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        future: Future[object] = Future()
        self.done.append(args[-1])
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep."""
    folder = tmp_path_factory.mktemp("sweep")
    assert sweep(specs_of(folder), folder / "out", Here()) == []
    return folder / "out"


def test_a_run_is_done_once(done: Path) -> None:
    again = Here()
    assert sweep(specs_of(done.parent), done, again) == []
    assert again.done == []


def test_more_seeds_are_only_the_new_runs(tmp_path: Path, done: Path) -> None:
    more = Here()
    specs = specs_of(tmp_path, SWEEP.replace("1..3", "1..4"))
    assert sweep(specs, done, more) == []
    assert len(more.done) == 2
    sweep(specs_of(tmp_path), done, more)
    assert len(load_runs(done).folders) == 6


def test_progress_counts_up_and_estimates(tmp_path: Path) -> None:
    told: list[SweepProgress] = []
    sweep(specs_of(tmp_path), tmp_path / "out", Here(), told.append)
    assert [p.done for p in told] == sorted(p.done for p in told)
    assert told[-1] == SweepProgress(6, 6, 0, 0.0)
    assert progress_words(SweepProgress(200, 37, 1, 240.0)) == "37 of 200 runs, 1 failed, about 4 min left"
    assert progress_words(SweepProgress(200, 0, 0, None)) == "0 of 200 runs"
    assert "2 h 05 min left" in progress_words(SweepProgress(9, 1, 0, 7500.0))


def test_a_run_that_always_fails_is_reported_and_the_rest_goes_on(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(PLANNER)
    text = SWEEP.replace("grid: {agvs: [1, 2]}", "grid: {planner: [whca, 'broken.py:plan'], agvs: [2, 99]}")
    here = Here()
    failures = sweep(specs_of(tmp_path, text), tmp_path / "out", here)
    errors = {f.error for f in failures}
    assert len(failures) == 9
    assert len(errors) == 2
    assert "agvs: 99: map1 has homes for 1 to 8" in errors
    assert any("broken.py:plan raises RuntimeError: no plan today (broken.py, line 2)" in error for error in errors)
    assert len(here.done) == 3 + 6 + 3  # bad input is not tried again, a planner that raises included
    runs = load_runs(tmp_path / "out")
    assert len(runs.folders) == 3
    assert len(runs.failures) == 9
    assert "no plan today" in write_sweep_report(tmp_path / "out").read_text(encoding="utf-8")


def test_a_failed_run_is_tried_again_with_the_next_sweep(tmp_path: Path) -> None:
    specs = specs_of(tmp_path, SWEEP.replace("[1, 2]", "[99]"))
    assert len(sweep(specs, tmp_path / "out", Here())) == 3
    again = Here()
    assert len(sweep(specs, tmp_path / "out", again)) == 3
    assert len(again.done) == 3


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files that are not a sweep's"):
        open_folder(tmp_path)


def test_a_folder_that_sumo_cannot_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give a folder without one"):
        open_folder(tmp_path / "a, b")


def test_an_error_travels_without_what_caused_it(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(PLANNER)
    (spec,) = specs_of(tmp_path, "base: {garage: map1, agvs: 1, plant: discrete, planner: 'broken.py:plan'}\n")
    with pytest.raises(InputError) as caught:
        do_run(spec.scenario, tmp_path / "run")
    assert caught.value.__context__ is None
    assert list(tmp_path.glob("run*")) == []


def test_what_sumo_says_is_a_failure_in_plain_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(gui: bool) -> None:
        raise PlantError("SUMO did not start: no licence today")

    monkeypatch.setattr("parking_sim.plants.sumo.load_api", refused)
    (spec,) = specs_of(tmp_path, "base: {garage: map1, agvs: 1}\n")
    with pytest.raises(RunFailedError) as caught:
        do_run(spec.scenario, tmp_path / "run")
    assert (type(caught.value), str(caught.value)) == (RunFailedError, "SUMO did not start: no licence today")


def test_a_partial_record_is_no_record(tmp_path: Path, done: Path) -> None:
    specs = specs_of(tmp_path)
    open_folder(tmp_path / "out").release()
    (tmp_path / "out" / "sweep.json").write_text("{}")
    part = tmp_path / "out" / "runs" / f"{specs[0].key}.part-host-1"
    part.mkdir()
    (part / "events.parquet").write_text("half")
    open_folder(tmp_path / "out").release()
    assert not part.exists()


def _crash_once(scenario: object, out: Path) -> None:
    """Dies like a killed worker the first time, for one seed."""
    mark = out.with_suffix(".crashed")
    if scenario.seed == 2 and not mark.exists():  # type: ignore[attr-defined]
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    do_run(scenario, out)  # type: ignore[arg-type]


def _always_crash(scenario: object, out: Path) -> None:
    if scenario.seed == 2:  # type: ignore[attr-defined]
        os.kill(os.getpid(), signal.SIGKILL)
    do_run(scenario, out)  # type: ignore[arg-type]


def test_a_killed_worker_loses_its_own_run_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: Path) -> None:
    monkeypatch.setattr("parking_sim.many_runs.do_run", _crash_once)
    specs = specs_of(tmp_path)
    with open_executor(2) as executor:
        assert sweep(specs, tmp_path / "out", executor) == []
    pd.testing.assert_frame_equal(table_of(tmp_path / "out"), table_of(done))
    monkeypatch.setattr("parking_sim.many_runs.do_run", _always_crash)
    with SpawnedWorkers(2) as executor:
        failures = sweep(specs, tmp_path / "out2", executor)
    assert {(f.spec.scenario.seed, f.error) for f in failures} == {(2, "the worker was killed or crashed")}
    assert len(load_runs(tmp_path / "out2").folders) == 4


def test_a_dask_cluster_gives_the_same_table(tmp_path: Path, done: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster,
        open_executor(scheduler=cluster.scheduler_address) as executor,
    ):
        assert sweep(specs_of(tmp_path), tmp_path / "out", executor) == []
    pd.testing.assert_frame_equal(table_of(tmp_path / "out"), table_of(done))


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("parking_sim.workers._CONNECT_S", 1)
    with pytest.raises(InputError, match="no dask scheduler answers"), open_executor(scheduler="tcp://127.0.0.1:9"):
        pass
    with pytest.raises(InputError, match="--workers: 0"), open_executor(0):
        pass


# --- killed at any moment -------------------------------------------------------------------------------------------


def children(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False).stdout
    direct = [int(line) for line in found.split()]
    return direct + [grandchild for child in direct for grandchild in children(child)]


def finished(out: Path) -> dict[str, int]:
    """Runs that are done, and when their record was written."""
    return {path.parent.name: path.stat().st_mtime_ns for path in (out / "runs").glob("*/metrics.json")}


def killed(arguments: list[str], after_s: float) -> None:
    """Start a sweep, then kill -9 its workers, then itself."""
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(after_s)
    for pid in [*children(process.pid), process.pid]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


def test_a_sweep_killed_at_random_moments_ends_with_the_same_table(tmp_path: Path) -> None:
    text = SWEEP.replace("1..3", "1..6").replace("cars: 4", "cars: 8")
    specs = specs_of(tmp_path, text)
    out, chance = tmp_path / "out", random.Random(3)
    command = [sys.executable, "-m", "parking_sim", "sweep", str(tmp_path / "plan.yaml"), "--workers", "2", "--out"]
    kept: dict[str, int] = {}
    for _ in range(5):
        killed([*command, str(out), "--quiet"], chance.uniform(2.0, 4.5))
        now = finished(out)
        assert {run: now.get(run) for run in kept} == kept  # what was done is not done again
        kept = now
    assert subprocess.run([*command, str(out), "--quiet"], check=False, capture_output=True).returncode == 0
    last = finished(out)
    assert {run: last[run] for run in kept} == kept
    assert not list((out / "runs").glob("*.part-*"))
    straight = Here()
    sweep(specs, tmp_path / "straight", straight)
    assert len(straight.done) == 12
    pd.testing.assert_frame_equal(table_of(out), table_of(tmp_path / "straight"))


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    specs_of(tmp_path, SWEEP.replace("cars: 4", "cars: 61").replace("1..3", "1..50"))
    command = [sys.executable, "-m", "parking_sim", "sweep", str(tmp_path / "plan.yaml"), "--workers", "1"]
    process = subprocess.Popen([*command, "--out", str(tmp_path / "out"), "-q"], stderr=subprocess.DEVNULL)
    workers: list[int] = []
    while not workers or not list((tmp_path / "out" / "runs").glob("*.part-*")):
        workers = children(process.pid)
        time.sleep(0.1)
        assert process.poll() is None
    process.kill()
    process.wait()
    deadline = time.monotonic() + 10
    while any(_lives(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not [pid for pid in workers if _lives(pid)]


def _lives(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


# --- results --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(done: Path) -> Runs:
    return load_runs(done)


def test_three_tidy_tables(runs: Runs) -> None:
    frame, tasks, events = runs.runs, runs.tasks, runs.events
    assert len(frame) == 6
    assert runs.varied == ("agvs",)
    assert set(frame["seed"]) == {1, 2, 3}
    assert len(tasks) == frame["requests"].sum() == 6 * 8
    assert set(tasks["run"]) == set(events["run"]) == set(frame["run"])
    assert (events["kind"] == "request_made").sum() == len(tasks)


def test_the_tables_can_be_asked_in_sql(runs: Runs) -> None:
    query = (
        "SELECT agvs, count(*) AS n FROM tasks JOIN runs USING (run) WHERE kind = 'park' GROUP BY agvs ORDER BY agvs"
    )
    assert runs.sql(query).fetchall() == [(1, 12), (2, 12)]
    assert runs.relation("tasks").filter("kind = 'retrieve'").aggregate("count(*)").fetchall() == [(24,)]
    assert len(runs.table("planning")) > 0


def test_every_column_of_the_runs_is_explained(runs: Runs) -> None:
    explained = run_columns()
    assert [column for column in runs.runs.columns if column not in explained] == []
    assert all(meaning for _, meaning in explained.values())


def test_any_folder_of_runs_can_be_loaded(done: Path, tmp_path: Path) -> None:
    loose = load_runs(done / "runs")
    assert len(loose.runs) >= 6
    with pytest.raises(FileNotFoundError, match="no run in"):
        load_runs(tmp_path)


def test_the_report_is_one_offline_page(done: Path) -> None:
    page = write_sweep_report(done).read_text(encoding="utf-8")
    assert "6 runs of 2 variants have finished; 0 failed." in page
    assert "<svg" in page
    assert "src=" not in page
    assert "http://" not in page.replace("http://www.w3.org", "")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    specs_of(tmp_path)
    return tmp_path


def test_the_command(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["sweep", "plan.yaml", "--workers", "2"])
    assert caught.value.code == 0
    said = capfd.readouterr().out
    assert "6 of 6 runs: runs/plan" in said
    assert (folder / "runs" / "plan" / "report.html").is_file()
    plan = json.loads((folder / "runs" / "plan" / "sweep.json").read_text())
    assert len(plan["runs"]) == 6


def test_run_missing_says_which_failed(tmp_path: Path) -> None:
    open_folder(tmp_path / "out").release()
    specs = specs_of(tmp_path, SWEEP.replace("[1, 2]", "[99]"))
    assert [f.spec for f in run_missing(specs, tmp_path / "out", Here())] == list(specs)
