"""The clock of pages and texts, against times worked out by hand."""

from __future__ import annotations

import pytest

from analysis.clock import Clock, hour_text
from parking_sim.config import load_scenario
from sumo_nets.errors import InputError


def test_simulated_time_and_time_of_day():
    assert [Clock().at(s) for s in (0.0, 59.9, 3661.0, 90_000.0)] == ["0:00:00", "0:00:59", "1:01:01", "25:00:00"]
    day = Clock(14.5)
    assert [day.at(s) for s in (0.0, 1800.5, 34_199.0)] == ["14:30:00", "15:00:00", "23:59:59"]
    assert day.at(34_200.0) == "day 2, 0:00:00"
    assert (hour_text(14.5), hour_text(9.999)) == ("14:30", "10:00")


def test_moments_are_read_as_they_are_shown():
    day = Clock(14.0)
    assert [day.seconds(text) for text in ("90", "1:30", "14:01:30")] == [90.0, 90.0, 90.0]
    assert Clock().seconds("0:01:30") == 90.0
    with pytest.raises(InputError, match="the run starts at 14:00:00"):
        day.seconds("13:59:59")
    with pytest.raises(InputError, match="give seconds or h:mm:ss"):
        day.seconds("noon")


def test_only_profiles_have_a_time_of_day(tmp_path):
    def start(workload: str) -> float | None:
        (tmp_path / "s.yaml").write_text(f"garage: map1\nagvs: 1\nworkload: {workload}\n")
        scenario = load_scenario(tmp_path / "s.yaml")
        return scenario.workload.day_start_h(scenario.base_dir)

    assert start("{kind: profile, name: mall-saturday, start_h: 14}") == 14.0
    assert start("{kind: park_exit}") is None
