"""The wheel stands alone: installed away from the repository, it has all that its commands need."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("parking_sim", "sumo_nets", "controller", "demand", "analysis")
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input")
OFFLINE = ("--no-deps", "--no-index")
SCRIPT = """
import matplotlib.pyplot as plt

import parking_sim as ps

summary = ps.simulate(ps.load_scenario("map1", {"duration_s": 120.0}), "runs/first")
run = ps.load_run("runs/first")
figure, axes = plt.subplots()
axes.plot(run.timeline["time_s"], run.timeline["parked"])
figure.savefig("parked.svg")
print(ps.__file__, summary)
"""
QUICK = "{garage: map1, agvs: 2, plant: discrete, workload: {kind: park_exit, cars: 2}}"
TARGET = "--target 'turned away < 1 %' --max-agvs 1 --max-seeds 3 --workers 1 --no-report --out sized"
#: Command -> what it says. A wheel without its nets, profiles, templates, scenarios or examples fails at one of these.
COMMANDS = {
    "--version": "parking-sim 0.",
    "doctor": "extra tune",
    "examples --out .": "corner.yaml",
    "check-net map1": "; ok",
    "profiles mall-saturday": "source:",
    "run quick.yaml --out run": "replay: run/replay.html",
    f"size quick.yaml {TARGET}": "1 AGV meets 'turned away < 1 %'",
    "demo --cars 1 --quiet --out demo": "replay: demo/map3/replay.html",
}
#: Makes a package of an extra look as if it were not installed.
WITHOUT_EXTRAS = """
import importlib.metadata, sys
sys.modules.update(dict.fromkeys(("sumo", "distributed", "optuna")))
found = importlib.metadata.version
def version(name):
    if name in ("eclipse-sumo", "distributed", "optuna"):
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)
importlib.metadata.version = version
from parking_sim.cli import main
main(sys.argv[1:])
"""


def build(folder: Path) -> Path:
    """Build the wheel of a copy of the repository."""
    source = folder / "source"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    subprocess.run([*PIP, "wheel", *OFFLINE, "--no-build-isolation", "--wheel-dir", folder, source], check=True)
    (wheel,) = folder.glob("parking_sim-*.whl")
    return wheel


def take_compiled(site: Path) -> None:
    """Copy the kernels that the tests have compiled already; they count for sources of the very same age."""
    for file in (path for package in PACKAGES for path in (ROOT / package).rglob("*")):
        target = site / file.relative_to(ROOT)
        if file.suffix in (".nbi", ".nbc") or file.name == "kernels.json":
            target.parent.mkdir(exist_ok=True)
            shutil.copy(file, target)
        elif file.suffix == ".py":
            shutil.copystat(file, target)


def test_a_wheel_alone_runs_loads_plots_and_answers(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    site = tmp_path / "site"
    subprocess.run([*PIP, "install", *OFFLINE, "--target", site, build(tmp_path)], check=True)
    for package in PACKAGES:
        kept = {path.relative_to(ROOT) for path in (ROOT / package).rglob("*") if "__pycache__" not in path.parts}
        assert all((site / path).exists() for path in kept)
    take_compiled(site)
    home = tmp_path / "home"
    home.mkdir()
    (home / "quick.yaml").write_text(QUICK, encoding="utf-8")

    environment = {**os.environ, "PYTHONPATH": str(site), "MPLBACKEND": "agg"}

    def call(*words: str, code: int = 0) -> str:
        done = subprocess.run(
            [sys.executable, *words], cwd=home, env=environment, capture_output=True, text=True, check=False
        )  # fmt: skip
        assert done.returncode == code, (words, done.stdout + done.stderr)
        return done.stdout + done.stderr

    said = call("-c", SCRIPT)
    assert said.startswith(str(site))
    assert "<Summary: time_limit after 120 s" in said
    assert "<svg" in (home / "parked.svg").read_text(encoding="utf-8")
    for command, told in COMMANDS.items():
        assert told in call("-m", "parking_sim", *shlex.split(command))

    environment["PATH"] = ""  # no netconvert there either
    said = call("-c", WITHOUT_EXTRAS, "build-net", "corner.yaml", code=2)
    assert said == 'error: netconvert is not installed: pip install "parking-sim[nets]"\n'
    said = call("-c", WITHOUT_EXTRAS, "doctor")
    for extra, adds in (("nets", "netconvert"), ("cluster", "sweeps on a dask cluster"), ("tune", "tuning")):
        assert f"absent  extra {extra}: pip install 'parking-sim[{extra}]' adds {adds}" in said
