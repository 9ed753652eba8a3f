"""A run that is killed: readable up to the last flush, and resumed to the record of an undisturbed run.

``KILLS`` in the environment sets how many moments are tried; the full form takes 20.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time

import pytest

from analysis.run_files import JOURNAL
from analysis.tables import load_run
from parking_sim.cli import main

KILLS = int(os.environ.get("KILLS", "1"))
SCENARIO = """
garage: map1_thesis
agvs: 4
plant: discrete
workload: {kind: poisson, arrivals_per_h: 20, dwell_median_min: 15, initial_occupancy: 0.4, duration_min: 60}
faults: {travel_noise: 0.1, stop: {per_h: 4}, blocked: {per_h: 4}}
"""


def command(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(words)
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "hour.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def undisturbed(scenario, tmp_path_factory):
    """Digests of the run, and the size of its journal just before the end."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    assert command("run", str(scenario), "--out", str(folder), "--no-report", "-q") == 0
    assert not (folder / JOURNAL).exists()
    return json.loads((folder / "run.json").read_text())["digest"]


def kill_at(scenario, folder, size: int) -> None:
    """Start the run in a process of its own and kill it when its journal has reached a size in bytes."""
    words = ["-m", "parking_sim", "run", str(scenario), "--out", str(folder), "--no-report", "-q"]
    process = subprocess.Popen([sys.executable, *words])
    journal = folder / JOURNAL
    while process.poll() is None and not (journal.is_file() and journal.stat().st_size >= size):
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert journal.is_file(), "it ended before it was killed"


@pytest.mark.parametrize("number", range(KILLS))
def test_a_killed_run_is_readable_and_resumes_to_the_same_record(scenario, undisturbed, tmp_path, number, capsys):
    folder = tmp_path / "run"
    kill_at(scenario, folder, random.Random(number).randrange(1, 400_000))
    left = load_run(folder)
    assert left.meta["status"] == "killed"
    assert (left.events["time_s"] <= left.meta["simulated_s"]).all()
    assert len(left.vertices) or left.meta["simulated_s"] == 0  # killed within its first write
    assert command("run", str(scenario), "--out", str(folder), "-q") == 2
    assert "resume" in capsys.readouterr().err
    assert command("resume", str(folder), "--no-report", "-q") == 0
    assert json.loads((folder / "run.json").read_text())["digest"] == undisturbed
    assert not (folder / JOURNAL).exists()


def test_a_journal_of_another_run_is_refused(scenario, tmp_path, capsys):
    folder = tmp_path / "run"
    kill_at(scenario, folder, 50_000)
    text = (folder / "scenario.yaml").read_text()
    (folder / "scenario.yaml").write_text(text.replace("seed: 0", "seed: 1"))
    assert command("resume", str(folder), "-q") == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert (folder / JOURNAL).is_file()


def test_there_must_be_something_to_resume(tmp_path, capsys):
    assert command("resume", str(tmp_path), "-q") == 2
    assert "nothing to resume" in capsys.readouterr().err
