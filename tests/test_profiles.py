"""Demand profiles: over 100 seeds customers match the source, and a profile fitted to a log gives its rates back."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import chi2

from controller.types import RequestKind
from demand.profile_traffic import ProfileTraffic
from demand.profiles import PROFILES, Profile, find_profile, from_occupancy, write_profile
from demand.types import Demand
from demand.workloads import make_demand
from sumo_nets.errors import InputError

SLOTS = 300
SEEDS = range(100)
#: A right profile fails a test with this probability; there are 7 + 5 of them, on fixed seeds.
ALPHA = 0.002

Floats = NDArray[np.float64]


@cache
def day(name: str, seed: int) -> Demand:
    return make_demand(ProfileTraffic(name=name), SLOTS, seed, Path())


def times(demand: Demand, kind: RequestKind, begin: float) -> Floats:
    return np.array([begin + r.time_s / 3600 for r in demand.phases[0] if r.kind is kind])


@pytest.mark.parametrize("name", PROFILES)
def test_arrivals_have_the_hourly_shares_of_the_profile(name: str) -> None:
    profile = PROFILES[name]
    edges = np.arange(math.ceil(profile.hours[0]), profile.hours[-1] + 1e-9)
    seen = sum(np.histogram(times(day(name, seed), RequestKind.PARK, profile.hours[0]), edges)[0] for seed in SEEDS)
    expected = len(SEEDS) * SLOTS * np.array([profile.arrivals_between(a, a + 1) for a in edges[:-1]])
    busy = expected > 5
    statistic = float((((seen - expected) ** 2)[busy] / expected[busy]).sum())
    assert chi2.sf(statistic, int(busy.sum())) > ALPHA
    assert np.asarray(seen)[expected == 0].sum() == 0


@pytest.mark.parametrize("name", [name for name, profile in PROFILES.items() if profile.observed])
def test_occupancy_at_each_hour_matches_the_source(name: str) -> None:
    """The cars inside at all hours of the source together: a chi-square test with the covariance of the model."""
    profile = PROFILES[name]
    hours = sorted(profile.observed)
    total = np.zeros(len(hours))
    for seed in SEEDS:
        demand = day(name, seed)
        came, left = (times(demand, kind, profile.hours[0]) for kind in (RequestKind.PARK, RequestKind.RETRIEVE))
        total += [len(demand.initial_cars) + (came <= hour).sum() - (left <= hour).sum() for hour in hours]
    expected = len(SEEDS) * SLOTS * np.array([profile.observed[hour] for hour in hours])
    off = total - expected
    covariance = len(SEEDS) * SLOTS * _covariance(profile, hours)
    statistic = float(off @ np.linalg.solve(covariance, off))
    assert chi2.sf(statistic, len(hours)) > ALPHA
    assert total == pytest.approx(expected, rel=0.05)


def _covariance(profile: Profile, hours: list[float]) -> Floats:
    """Of the shares inside: Poisson for those who came, binomial for those who were there at the start."""
    kept = np.exp(-profile.leaving_total(np.array(hours)))
    from_start = profile.occupancy * kept
    level = np.array([profile.occupancy_at(hour) for hour in hours])
    covariance = np.empty((len(hours), len(hours)))
    for i in range(len(hours)):
        for j in range(len(hours)):
            first, last = sorted((i, j))
            stay = kept[last] / kept[first]
            came = (level[first] - from_start[first]) * stay
            covariance[i, j] = came + from_start[first] * stay - from_start[i] * from_start[j]
    return covariance


def test_the_airport_gets_its_cars_a_day() -> None:
    """200 cars a day on 500 spaces: the published figure."""
    seen = sum(sum(r.kind is RequestKind.PARK for r in day("airport", seed).phases[0]) for seed in SEEDS)
    mean = len(SEEDS) * 0.4 * SLOTS
    assert abs(seen - mean) < 4 * math.sqrt(mean)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_says_where_it_is_from_and_fits_the_garage(name: str) -> None:
    profile = PROFILES[name]
    assert profile.source
    assert profile.licence
    assert max(profile.occupancy_at(hour) for hour in np.arange(profile.hours[0], profile.hours[-1], 0.25)) < 0.95
    for hour, level in profile.observed.items():
        assert profile.occupancy_at(hour) == pytest.approx(level)


def test_hours_of_a_day_start_with_the_cars_that_are_there() -> None:
    demand = make_demand(ProfileTraffic(name="mall-weekday", start_h=13, hours=2), SLOTS, 3, Path())
    assert len(demand.initial_cars) == pytest.approx(0.71 * SLOTS, abs=40)
    assert 0 <= demand.phases[0][0].time_s <= demand.phases[0][-1].time_s <= 7200


def test_scale_multiplies_the_cars() -> None:
    one, half = (make_demand(ProfileTraffic(name="office", scale=s), SLOTS, 1, Path()).total for s in (1, 0.5))
    assert half == pytest.approx(one / 2, rel=0.1)


def test_the_busiest_hours() -> None:
    assert PROFILES["office"].busiest(2) == pytest.approx(7, abs=1)
    assert 20 < PROFILES["event"].busiest(1) <= 22


def test_what_falls_faster_than_stays_allow_still_meets_the_occupancy() -> None:
    profile = from_occupancy("", "", "", {8: 0.9, 9: 0.1, 10: 0.5}, stay_h=10)
    assert [profile.occupancy_at(hour) for hour in (8, 9, 10)] == pytest.approx([0.9, 0.1, 0.5])
    assert profile.arrivals[0] == 0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"name": "mal"}, "give one of mall-weekday"),
        ({"name": "office", "start_h": 3}, "office covers 6 h to 20 h"),
        ({"name": "office", "start_h": 19, "hours": 5}, "office covers 6 h to 20 h"),
        ({"name": "nowhere.yaml"}, "can't be read"),
    ],
)
def test_mistakes(fields: dict[str, object], words: str) -> None:
    with pytest.raises((InputError, ValidationError), match=words):
        make_demand(ProfileTraffic.model_validate(fields), SLOTS, 1, Path())


def test_a_profile_file_is_checked(tmp_path: Path) -> None:
    write_profile(PROFILES["office"], tmp_path / "mine.yaml")
    assert find_profile("mine.yaml", tmp_path) == PROFILES["office"]
    (tmp_path / "bad.yaml").write_text(
        "words: x\nsource: y\nhours: [0, 24]\narrivals: [1, 2]\nleaving: [1]\noccupancy: 0\n"
    )
    with pytest.raises(InputError, match=r"bad\.yaml: give 1 arrivals"):
        find_profile("bad.yaml", tmp_path)
