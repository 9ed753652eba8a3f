"""The package's face: what `import parking_sim` offers, what it costs, and that the examples in its docstrings run."""

from __future__ import annotations

import doctest
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import parking_sim as ps

ROOT = Path(__file__).parent.parent
#: ``Planner`` is an alias, which holds no docstring: the example of ``PlanningProblem`` is a planner.
WITHOUT_EXAMPLE = {"Planner", "__version__"}
USER_FILE = """
import matplotlib.pyplot as plt

import parking_sim as ps


def longest_wait(folder: str) -> float:
    run: ps.Run = ps.load_run(folder)
    tasks = run.tasks
    return float((tasks["lifted_s"] - tasks["requested_s"]).max())


def tell(now: ps.RunProgress) -> None:
    print(now.time_s)


def stay(problem: ps.PlanningProblem) -> ps.PlanResult:
    return ps.PlanResult(ps.Status.PARTIAL, {})


layout: ps.Layout = ps.load_layout({
    "name": "row", "pitch_m": 7.0, "handover": "home",
    "aisles": [{"from": [0, 0], "to": [6, 0], "way": "two"}],
    "slots": [{"from": [1, 0], "to": [5, 0], "side": "north"}], "homes": [{"at": [0, 0], "side": "south"}],
})
print(ps.build(layout.changed(pitch_m=8.0), "nets").name)
scenario: ps.Scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 300.0})
planner: ps.Planner = stay
summary: ps.Summary = ps.simulate(scenario, "runs/first", progress=tell)
print(summary, longest_wait("runs/first"), ps.__version__)
figure, axes = plt.subplots()
axes.plot(ps.load_run("runs/first").timeline["time_s"])
print(ps.load_runs("runs").runs[["run", "status"]])
with ps.Simulation(scenario) as sim:
    while sim.step():
        print(sim.state.agvs[0].at)
"""


def python(code: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *options, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", sorted(set(ps.__all__) - WITHOUT_EXAMPLE))
def test_each_name_has_an_example_that_runs(name: str) -> None:
    thing = getattr(ps, name)
    module = importlib.import_module(thing.__module__)
    found = [test for test in doctest.DocTestFinder(recurse=False).find(thing, name, module) if test.examples]
    assert found, f"{name}: no example in its docstring"
    report: list[str] = []
    for test in found:
        result = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=report.append)
        assert not result.failed, "".join(report)


def test_the_example_of_the_package_runs() -> None:
    assert doctest.testmod(ps).failed == 0


def test_the_names_listed_are_those_that_are_there() -> None:
    assert sorted(ps.__all__) == ps.__all__ == sorted({*ps._PLACES, "__version__"}) == dir(ps)
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        getattr(ps, "simulat")  # noqa: B009


def test_importing_is_quick_and_loads_nothing_heavy(tmp_path: Path) -> None:
    done = python("import parking_sim, sys; print(*sys.modules)", tmp_path)
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "numba", "pandas", "pydantic", "libsumo", "typer", "controller", "analysis", "demand"}
    timed = python("import parking_sim", tmp_path, "-X", "importtime").stderr
    (line,) = (line for line in timed.splitlines() if line.endswith("| parking_sim"))
    assert int(line.split("|")[1]) < 300_000  # microseconds


def test_a_users_file_passes_mypy(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(USER_FILE, encoding="utf-8")
    assert mypy(tmp_path, "mine.py") == ""
    (tmp_path / "wrong.py").write_text("import parking_sim as ps\nps.simulate('map1').statu\n", encoding="utf-8")
    said = mypy(tmp_path, "wrong.py")
    assert "[arg-type]" in said
    assert "[attr-defined]" in said


def mypy(folder: Path, file: str) -> str:
    """What ``mypy --strict`` complains of."""
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--config-file", str(ROOT / "pyproject.toml"),
         "--cache-dir", str(ROOT / ".mypy_cache"), file],
        cwd=folder, env={**os.environ, "MYPYPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout + done.stderr
