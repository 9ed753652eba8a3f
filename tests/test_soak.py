"""The soak benchmark in small: every fault on at once in SUMO, nothing meets, locks up or gets lost."""

from __future__ import annotations

import importlib.util
import sys
from itertools import islice
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture(scope="module")
def soak():
    spec = importlib.util.spec_from_file_location("soak", BENCHMARKS / "soak.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["soak"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("planner", ["whca", "token"])
def test_small(soak, planner, capsys):
    case = ("map1", 8, "bursts", 12.0)
    row = soak.run(case, 0, planner, 12.0)
    assert soak.is_good(row), row
    assert row["tasks_done"] > 5
    assert set(row["faults"]) >= {"stop", "slow", "stale", "blocked", "late", "lost"}
    assert all(seconds > 0 for times in row["faults"].values() for seconds in times)
    soak.print_tables([row, {**row, "faulty": False, "tasks_per_h": 2 * row["tasks_per_h"], "faults": {}}])
    assert "| 50% |" in capsys.readouterr().out


@pytest.mark.parametrize(
    "wrong", [{"lost": 1}, {"footprint_overlaps": 1}, {"sumo_collisions": 1}, {"deadlocks_unresolved": 1},
              {"tasks_done": 9}, {"status": "stalled"}]
)  # fmt: skip
def test_a_run_that_is_not_good_is_seen(soak, wrong):
    row = {"status": "finished", "tasks_done": 10, "tasks_wanted": 10, "lost": 0, **dict.fromkeys(soak.MUST_BE_ZERO, 0)}
    assert soak.is_good(row)
    assert not soak.is_good({**row, **wrong})


def test_the_full_form_covers_all_garages_and_makes_enough_steps(soak):
    runs = list(islice(soak.plan_runs(True, 10e6, ["whca", "token"]), 1000))
    hard = [run for run in runs if run[3]]
    assert sum(case[1] * case[3] * 120 for case, *_ in hard) >= 10e6
    assert {case[0] for case, *_ in hard} == {"map1", "map2", "map3"}
    assert {case[1] for case, *_ in hard} == {8, 16, 32}
    calm = [run for run in runs if not run[3]]
    assert {(case, seed, planner) for case, seed, planner, _ in calm} <= {(c, s, p) for c, s, p, _ in hard}
