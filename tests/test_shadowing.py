"""A file of a user's own that has the name of one of our packages is told of in one line, before anything is run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPT = """
import parking_sim as ps

ps.simulate(ps.load_scenario("map1", {"plant": "discrete", "duration_s": 5.0}), "run")
"""
BY_MODULE = """
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate

simulate(load_scenario("map1", {"plant": "discrete", "duration_s": 5.0}), "run")
"""


def start(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def write(folder: Path, name: str) -> Path:
    file = folder / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("answer = 42\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("name", ["analysis.py", "controller.py", "demand/__init__.py", "sumo_nets.py"])
@pytest.mark.parametrize("words", [("run", "map1", "--plant", "discrete", "--out", "run"), ("nets",)])
def test_the_command_line_names_the_file_in_one_line(tmp_path: Path, name: str, words: tuple[str, ...]) -> None:
    file = write(tmp_path, name)
    done = start(tmp_path, "-m", "parking_sim", *words)
    package = name.removesuffix(".py").partition("/")[0]
    said = f"error: {file}: hides the package '{package}' of parking-sim from Python: give it another name\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["analysis.py", "controller.py", "demand/__init__.py", "sumo_nets.py"])
def test_a_script_ends_with_that_line(tmp_path: Path, name: str) -> None:
    file = write(tmp_path, name)
    (tmp_path / "mine.py").write_text(SCRIPT, encoding="utf-8")
    done = start(tmp_path, "mine.py")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: " if "sumo_nets" in name else "sumo_nets.errors.InputError: ")
    assert f"{file}: hides the package" in last
    assert not (tmp_path / "run").exists()


def test_a_script_that_takes_the_simulation_from_its_module(tmp_path: Path) -> None:
    write(tmp_path, "analysis.py")
    (tmp_path / "mine.py").write_text(BY_MODULE, encoding="utf-8")
    done = start(tmp_path, "mine.py")
    assert "hides the package 'analysis'" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "run").exists()


def test_the_doctor_tells_of_it(tmp_path: Path) -> None:
    file = write(tmp_path, "analysis.py")
    done = start(tmp_path, "-m", "parking_sim", "doctor")
    assert done.returncode == 1
    assert f"MISSING package analysis: {file}: hides the package 'analysis'" in done.stdout


def test_a_plain_folder_of_that_name_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "demand").mkdir()
    (tmp_path / "demand" / "april.csv").touch()
    done = start(tmp_path, "-m", "parking_sim", "nets")
    assert (done.returncode, done.stderr) == (0, "")
