"""Every scenario key under ``control`` acts: with another value the garage's run takes another course."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from whole_runs import run

from parking_sim.config import ControlConfig

Keys = dict[str, Any]

CARS = {"workload": {"kind": "park_exit", "cars": 12}}
LATE = {"faults": {"travel_noise": 0.5}}

#: A crowded garage: many AGVs wait for each other under A*, which looks one move ahead.
ASTAR: Keys = {"garage": "map1", "agvs": 8, "plant": "discrete", "planner": "astar", **CARS}
WHCA: Keys = ASTAR | {"planner": "whca"}
PIPELINE: Keys = ASTAR | {"garage": "map1_thesis", "agvs": 4, "rules": "thesis", "planner": "pipeline"}
#: Seconds count in SUMO alone.
SUMO: Keys = ASTAR | {"plant": "sumo", "duration_s": 300.0}


@dataclass(frozen=True)
class Case:
    """A value other than the default, the scenario in which it acts, and the further keys of ``control`` there."""

    value: object
    scenario: Keys
    control: Keys = field(default_factory=dict)


CASES = {
    "period_s": Case(15.0, SUMO),
    "replanning": Case("events", ASTAR),
    "look_ahead_s": Case(60.0, SUMO | LATE | {"planner": "token", "duration_s": 900.0}, {"replanning": "events"}),
    "timeout_s": Case(60.0, SUMO, {"replanning": "events"}),
    "reorder": Case(True, WHCA | LATE),
    "window_cells": Case(3, WHCA, {"window_min": 3}),
    "window_min": Case(3, WHCA),
    "window_max": Case(13, WHCA),
    "window_step": Case(5, WHCA),
    "score_keep": Case(0.1, WHCA),
    "score_scc": Case(0, PIPELINE),
    "score_up": Case(12, PIPELINE, {"window_max": 31}),
    "score_down": Case(0, PIPELINE),
    "boost_step": Case(200, ASTAR),
    "boost_after": Case(1, ASTAR),
    "boost_max": Case(0, ASTAR),
    "adapt_boost": Case(4.0, ASTAR),
    "stuck_s": Case(20.0, SUMO),
    "cbs_group": Case(2, ASTAR),
    "cbs_expansions": Case(1, ASTAR),
    "cbs_nodes": Case(1, ASTAR),
    "cbs_constraints": Case(1, ASTAR),
    "adapt_cbs": Case(100.0, ASTAR, {"cbs_expansions": 1}),
}


#: Keys that act on nothing but a planner of one's own that takes too long; see ``tests/test_guests.py``.
FOR_GUESTS = {"planner_limit_s"}


@cache
def events(scenario: str) -> str:
    """Digest of the events of a run: what the AGVs did. The planner's own figures would differ sooner."""
    with tempfile.TemporaryDirectory() as folder:
        record = run(Path(folder), **json.loads(scenario))
    return str(record.meta["digest"]["events"])


@pytest.mark.parametrize("key", sorted((ControlConfig.model_fields.keys() | CASES.keys()) - FOR_GUESTS))
def test_a_key_acts(key: str) -> None:
    assert key in CASES, f"give control.{key} a case"
    case = CASES[key]
    keys = (case.control, case.control | {key: case.value})
    before, after = (events(json.dumps(case.scenario | {"control": control})) for control in keys)
    assert before != after
