"""Demand: seeded, complete, with the rates it promises, and clear about bad files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from controller.types import RequestKind
from demand.bursts import Burst, Bursts
from demand.csv_file import Csv
from demand.park_exit import ParkExit
from demand.poisson import Poisson
from demand.types import Demand, Workload, car_names, stream
from demand.workloads import WORKLOADS, make_demand
from demand.zones import Zones
from sumo_nets.errors import InputError

SLOTS = 200
PROFILES: list[Workload] = [
    ParkExit(),
    ParkExit(order="random"),
    Poisson(arrivals_share_per_h=0.3),
    Bursts(arrivals_per_h=20, bursts=(Burst(at_min=10, cars=30), Burst(at_min=60, cars=50, wish="retrieve"))),
    Zones(arrivals_per_h=60, zones={"a": 1, "": 2}),
]


def draw(workload: Workload, seed: int = 0) -> Demand:
    return make_demand(workload, SLOTS, seed, Path())


def counts(demand: Demand) -> dict[RequestKind, int]:
    made = [request.kind for phase in demand.phases for request in phase]
    return {kind: made.count(kind) for kind in RequestKind}


def check_order(demand: Demand) -> None:
    inside = set(demand.initial_cars)
    assert len(inside) == len(demand.initial_cars)
    for phase in demand.phases:
        times = [request.time_s for request in phase]
        assert times == sorted(times)
        for request in phase:
            if request.kind is RequestKind.PARK:
                assert request.car not in inside
                inside.add(request.car)
            else:
                inside.remove(request.car)


def test_every_kind_is_in_the_table_under_its_own_name() -> None:
    assert set(WORKLOADS) == {"park_exit", "poisson", "bursts", "zones", "csv", "profile"}
    assert all(model.model_fields["kind"].default == kind for kind, model in WORKLOADS.items())


@pytest.mark.parametrize("workload", PROFILES, ids=lambda w: w.kind)
class TestEveryProfile:
    def test_same_seed_same_demand(self, workload: Workload) -> None:
        assert draw(workload, 7) == draw(workload, 7)

    def test_another_seed_differs_where_chance_plays(self, workload: Workload) -> None:
        chance = workload != ParkExit()
        assert (draw(workload, 7) != draw(workload, 8)) == chance

    @pytest.mark.parametrize("seed", range(5))
    def test_a_car_is_parked_before_it_is_asked_for(self, workload: Workload, seed: int) -> None:
        check_order(draw(workload, seed))

    def test_options_survive_being_written_down(self, workload: Workload) -> None:
        assert type(workload).model_validate_json(workload.model_dump_json()) == workload


def test_park_exit_parks_all_then_retrieves_all() -> None:
    demand = draw(ParkExit())
    assert [len(phase) for phase in demand.phases] == [SLOTS, SLOTS]
    assert {r.kind for r in demand.phases[0]} == {RequestKind.PARK}
    assert [r.car for r in demand.phases[1]] == [r.car for r in demand.phases[0]]
    assert {r.time_s for phase in demand.phases for r in phase} == {0.0}
    assert demand.total == 2 * SLOTS


def test_park_exit_at_random_is_a_permutation() -> None:
    demand = draw(ParkExit(order="random"))
    parked, wanted = ([r.car for r in phase] for phase in demand.phases)
    assert parked != wanted
    assert sorted(parked) == sorted(wanted)


def test_park_only_has_one_phase() -> None:
    assert [len(phase) for phase in draw(ParkExit(cars=9, park_only=True)).phases] == [9]


def test_park_exit_refuses_more_cars_than_slots() -> None:
    with pytest.raises(InputError, match=r"workload\.cars: 201: the garage has 200 slots"):
        draw(ParkExit(cars=SLOTS + 1))


def test_poisson_arrivals_have_the_rate_and_the_spread_of_a_poisson_process() -> None:
    workload = Poisson(arrivals_per_h=50, duration_min=120, initial_occupancy=0)
    seen = np.array([counts(draw(workload, seed))[RequestKind.PARK] for seed in range(300)])
    mean = 100.0
    assert abs(seen.mean() - mean) < 4 * math.sqrt(mean / len(seen))
    # the variance of a Poisson count is its mean; the sample variance's own spread is about mean * sqrt(2 / n)
    assert abs(seen.var(ddof=1) - mean) < 4 * mean * math.sqrt(2 / len(seen))


def test_share_of_capacity_is_a_rate() -> None:
    assert Poisson(arrivals_share_per_h=0.25).rate_per_s(400) == pytest.approx(100 / 3600)


def test_dwell_times_have_the_median_and_sigma_asked_for() -> None:
    workload = Poisson(arrivals_per_h=1, dwell_median_min=40, dwell_sigma=0.6)
    logs = np.log(workload.dwell_s(stream(0, "dwell"), 20_000))
    assert logs.mean() == pytest.approx(math.log(2400), abs=4 * 0.6 / math.sqrt(20_000))
    assert logs.std() == pytest.approx(0.6, rel=0.03)


def test_a_garage_that_starts_at_the_mean_occupancy_stays_there() -> None:
    """M/G/inf: mean occupancy = rate * mean dwell, at any time, if the first cars' remaining stays are drawn right."""
    mean_dwell_h = 1.0 * math.exp(0.8**2 / 2)
    workload = Poisson(arrivals_per_h=100 / mean_dwell_h, dwell_sigma=0.8, initial_occupancy=0.5, duration_min=60)
    left = []
    for seed in range(200):
        made = counts(draw(workload, seed))
        left.append(100 + made[RequestKind.PARK] - made[RequestKind.RETRIEVE])
    # the number inside is at most Poisson with mean 100
    assert abs(np.mean(left) - 100) < 4 * math.sqrt(100 / len(left))


def test_equal_stays_without_spread() -> None:
    workload = Poisson(arrivals_per_h=60, dwell_median_min=10, dwell_sigma=0, initial_occupancy=0)
    requests = draw(workload).phases[0]
    parked = {r.car: r.time_s for r in requests if r.kind is RequestKind.PARK}
    stays = [r.time_s - parked[r.car] for r in requests if r.kind is RequestKind.RETRIEVE]
    assert stays == pytest.approx([600] * len(stays), abs=0.002)


def test_initial_cars_are_the_occupancy_and_ask_to_leave() -> None:
    demand = draw(Poisson(arrivals_per_h=0, initial_occupancy=0.25, duration_min=1e5))
    assert len(demand.initial_cars) == 50
    assert {r.car for r in demand.phases[0]} == set(demand.initial_cars)


def test_nothing_is_asked_after_the_end() -> None:
    demand = draw(Poisson(arrivals_per_h=200, duration_min=30))
    assert max(r.time_s for r in demand.phases[0]) <= 1800
    made = counts(demand)
    assert made[RequestKind.RETRIEVE] < made[RequestKind.PARK] + len(demand.initial_cars)


def test_streams_are_independent_of_each_other() -> None:
    """Other stays or another occupancy leave the arrivals as they were."""

    def arrivals(workload: Poisson) -> list[float]:
        return [r.time_s for r in draw(workload).phases[0] if r.kind is RequestKind.PARK]

    base = Poisson(arrivals_per_h=40)
    assert arrivals(base) == arrivals(base.model_copy(update={"dwell_sigma": 0.1}))
    assert arrivals(base) == arrivals(base.model_copy(update={"initial_occupancy": 0.9}))
    assert not np.array_equal(stream(0, "arrivals").random(9), stream(0, "dwell").random(9))
    assert not np.array_equal(stream(0, "dwell").random(9), stream(1, "dwell").random(9))


def test_bursts_add_cars_when_they_say() -> None:
    base = {"arrivals_per_h": 10.0, "dwell_median_min": 600.0}
    quiet = draw(Poisson(**base)).phases[0]
    burst = draw(Bursts(**base, bursts=(Burst(at_min=30, cars=40, spread_min=2),))).phases[0]
    extra = {r.time_s for r in burst if r.kind is RequestKind.PARK} - {r.time_s for r in quiet}
    assert len(extra) == 40
    assert all(1800 <= time_s <= 1920 for time_s in extra)


def test_a_retrieve_burst_calls_cars_that_are_there() -> None:
    workload = Bursts(
        arrivals_per_h=0,
        dwell_median_min=1e6,
        dwell_sigma=0,
        bursts=(Burst(at_min=20, cars=150, spread_min=0, wish="retrieve"),),
    )
    requests = draw(workload).phases[0]
    at_once = [r for r in requests if r.time_s == 1200]
    assert len(at_once) == 100  # half of the slots are occupied, fewer than asked for
    assert {r.kind for r in at_once} == {RequestKind.RETRIEVE}


def test_zones_are_preferred_as_often_as_their_weights_say() -> None:
    demand = draw(Zones(arrivals_per_h=3000, zones={"a": 3, "b": 1}, initial_occupancy=0))
    zones = [r.zone for r in demand.phases[0] if r.kind is RequestKind.PARK]
    share = zones.count("a") / len(zones)
    assert set(zones) == {"a", "b"}
    assert abs(share - 0.75) < 4 * math.sqrt(0.75 * 0.25 / len(zones))


def test_a_rate_is_needed_once() -> None:
    for options in ({}, {"arrivals_per_h": 1.0, "arrivals_share_per_h": 0.1}):
        with pytest.raises(ValidationError, match="give either"):
            Poisson(**options)


def test_names_sort_as_their_numbers() -> None:
    names = car_names("c", 1200)
    assert names[0] == "c0001"
    assert list(names) == sorted(names)


GOOD = """time_s,kind,car,zone
30,park,b,north
0,park,a,

60.5,retrieve,a,
70,park,a,
80,retrieve,old,
"""


def read(tmp_path: Path, text: str, **options: object) -> Demand:
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    return make_demand(Csv(path="log.csv", **options), SLOTS, 0, tmp_path)  # type: ignore[arg-type]


def test_csv_is_read_in_order_of_time(tmp_path: Path) -> None:
    demand = read(tmp_path, GOOD, initial_cars=("old",))
    assert demand.initial_cars == ("old",)
    (phase,) = demand.phases
    assert [(r.time_s, r.kind.value, r.car, r.zone) for r in phase] == [
        (0, "park", "a", ""),
        (30, "park", "b", "north"),
        (60.5, "retrieve", "a", ""),
        (70, "park", "a", ""),
        (80, "retrieve", "old", ""),
    ]


HEAD = "time_s,kind,car\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (HEAD + "0,park,a\nsoon,park,b\n", "row 3: time_s: 'soon': give seconds"),
        (HEAD + "-1,park,a\n", "row 2: time_s: '-1'"),
        (HEAD + "nan,park,a\n", "row 2: time_s: 'nan'"),
        (HEAD + "inf,park,a\n", "row 2: time_s: 'inf'"),
        (HEAD + "0,parking,a\n", "row 2: kind: 'parking': give park or retrieve"),
        (HEAD + "0,park,\n", "row 2: car: ''"),
        (HEAD + "0,park,my\tcar\n", r"row 2: car: 'my\tcar'"),
        (HEAD + "\n0,park\n", "row 3: 2 cells: give 3"),
        (HEAD + "0,park,a,b\n", "row 2: 4 cells: give 3"),
        (HEAD + "0,park,a\n5,retrieve,b\n", "row 3: car: 'b': never came"),
        (HEAD + "9,park,a\n5,retrieve,a\n", "row 3: car: 'a': never came"),
        (HEAD + "0,park,a\n5,retrieve,a\n6,retrieve,a\n", "row 4: car: 'a': never came, or was retrieved"),
        (HEAD + "0,park,a\n5,park,a\n", "row 3: car: 'a': is parked already"),
        ("time,kind,car\n", "row 1: 'time,kind,car': the columns are"),
        ("time_s,kind,car,colour\n", "row 1:"),
        ("", "row 1: '': the columns are"),
    ],
)
def test_a_bad_row_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert f"log.csv: {complaint}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_absent_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.csv: can't be read as a CSV file: No such file"):
        make_demand(Csv(path="nowhere.csv"), SLOTS, 0, tmp_path)
    (tmp_path / "log.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="can't be read as a CSV file"):
        make_demand(Csv(path="log.csv"), SLOTS, 0, tmp_path)


@pytest.mark.parametrize("cars", [("a", "a"), ("my\tcar",), (" ",), tuple(car_names("x", SLOTS + 1))])
def test_bad_initial_cars(tmp_path: Path, cars: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=r"workload\.initial_cars: "):
        read(tmp_path, HEAD, initial_cars=cars)
