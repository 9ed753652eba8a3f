"""Sizing: the smallest fleet, in few runs; an impossible target is said to be so; tuning finds the better setting."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.measures import interval
from analysis.size_curve import Target
from analysis.tables import load_run
from analysis.turned_away import TurnedAway
from demand.park_exit import ParkExit
from parking_sim.assembly import assemble
from parking_sim.cli import main
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from parking_sim.sizing import LAST_CONFIDENCE, Measure, answer, find_least, parse_target, size_garage
from parking_sim.tuning import parse_ranges, tune_scenario
from parking_sim.workers import open_executor
from sumo_nets.errors import InputError, NetError
from sumo_nets.in_use import chosen_homes, first_places
from sumo_nets.read import net_files, read_net

GARAGES: dict[str, tuple[Callable[[int], float], int]] = {
    "more is better": (lambda n: 900 / n + 120, 12),
    "crowded beyond five": (lambda n: 700 / n + 90 + 15 * max(0, n - 5), 10),
    "bays are the limit": (lambda n: max(240.0, 1000 / n), 32),
}
SPREAD_S = 40.0


def plant(curve: Callable[[int], float], asked: list[tuple[int, int]] | None = None) -> Measure:
    """A garage whose measure is a curve with what makes a day hard (the same for all fleets) and chance."""

    def measure(agvs: int, seeds: Sequence[int]) -> list[float]:
        if asked is not None:
            asked.extend((agvs, seed) for seed in seeds)
        days = [np.random.default_rng(seed).normal(0, SPREAD_S) for seed in seeds]
        return [
            curve(agvs) + d + np.random.default_rng([s, agvs]).normal(0, 10) for d, s in zip(days, seeds, strict=True)
        ]

    return measure


def brute_force(measure: Measure, limit_s: float, most: int) -> int | None:
    """All sizes with all seeds."""
    for agvs in range(1, most + 1):
        if interval(measure(agvs, range(1, 31)), 2 * LAST_CONFIDENCE - 1).high < limit_s:
            return agvs
    return None


@pytest.mark.parametrize("name", GARAGES)
@pytest.mark.parametrize("limit_s", [205, 260, 330, 500, 2000])
def test_agrees_with_brute_force_in_a_third_of_its_runs(name: str, limit_s: float) -> None:
    curve, most = GARAGES[name]
    asked: list[tuple[int, int]] = []
    found = find_least(Target("", "", limit_s), most, plant(curve, asked))
    assert found.number == brute_force(plant(curve), limit_s, most)
    assert found.runs == len(asked) == len(set(asked)) <= 30 * most / 3
    if found.number:
        meets = {tried.number: tried.meets for tried in found.tried}
        assert meets[found.number]
        assert found.number == 1 or not meets[found.number - 1]


def test_an_impossible_target_is_said_to_be_so() -> None:
    found = find_least(Target("retrieval p95 < 100 s", "", 100), 8, plant(lambda n: 300 + 10 * abs(n - 5)))
    assert found.number is None
    said = answer(found, "map1")
    assert said.startswith("No fleet of 1 to 8 AGVs meets 'retrieval p95 < 100 s' in map1: the best tried, 5, has 3")


def test_a_fleet_between_two_doublings_is_not_missed() -> None:
    """Only 5 to 7 AGVs meet it: 4 are too few and 8 too many."""
    found = find_least(Target("", "", 200), 8, plant(lambda n: 100 if 5 <= n <= 7 else 400 + 5 * abs(n - 6)))
    assert found.number == 5


def test_wrong_answers_are_rare() -> None:
    """A fleet that just misses the target is called good in at most 5 % of 200 sizings."""

    def measure_of(trial: int) -> Measure:
        return lambda agvs, seeds: [np.random.default_rng([trial, s]).normal(300, SPREAD_S) for s in seeds]

    wrong = sum(find_least(Target("", "", 300), 1, measure_of(trial)).number is not None for trial in range(200))
    assert wrong <= 10 + 2 * math.sqrt(10)


def test_the_answer_is_one_sentence() -> None:
    found = find_least(parse_target("retrieval p95 < 5 min"), 8, plant(lambda n: 900 / n))
    assert found.number == 4
    said = answer(found, "map1")
    assert said.startswith("4 AGVs meet 'retrieval p95 < 5 min' in map1 with 95 % confidence: ")
    assert "; 3 do not, with " in said
    assert said.count("\n") == 0


def test_runs_with_nothing_to_measure_meet_nothing() -> None:
    found = find_least(Target("", "", 300), 2, lambda agvs, seeds: [math.nan for _ in seeds], (3, 5))
    assert found.number is None
    assert "nothing to measure" in answer(found, "map1")


def test_a_day_whose_customers_are_turned_away_meets_no_limit() -> None:
    """One day in nine on which the quantile falls among customers turned away: the mean over days is infinite."""

    def measure(agvs: int, seeds: Sequence[int]) -> list[float]:
        return [math.inf if agvs < 4 and seed % 9 == 0 else 100.0 + seed / 10 for seed in seeds]

    found = find_least(parse_target("retrieval p95 < 101 s"), 8, measure, (9, 12))
    assert found.number == 4
    assert [(tried.number, tried.meets, tried.mean.mean) for tried in found.tried][:3] == [
        (1, False, math.inf), (2, False, math.inf), (3, False, math.inf),
    ]  # fmt: skip
    assert "; 3 do not, with waits without end (9 seeds)" in answer(found, "map1")


def test_an_answer_says_how_many_were_turned_away() -> None:
    away = {1: TurnedAway(42, 48, {"queue too long": 42}), 2: TurnedAway(0, 48)}
    for most, said in (
        (1, "No fleet of 1 to 1 AGVs meets 'retrieval p95 < 5 min' in map1: the best tried, 1, has waits without end"
            " (3 seeds) (3 runs). With 1 AGV, 42 of 48 customers were turned away (88 %): queue too long 42;"
            " each counts as one who waits without end."),
        (2, " (6 runs). With 2 AGVs, none of 48 customers was turned away."),
    ):  # fmt: skip
        found = find_least(
            parse_target("retrieval p95 < 5 min"), most,
            lambda agvs, seeds: [math.inf if agvs == 1 else 100.0 for _ in seeds], (3,),
        )  # fmt: skip
        assert answer(replace(found, away=away), "map1").endswith(said)


def test_the_share_turned_away_may_be_the_target() -> None:
    found = find_least(parse_target("turned away < 1 %"), 8, lambda agvs, seeds: [0.08 / agvs - 0.01] * len(seeds))
    assert found.number == 5
    assert "5 AGVs meet 'turned away < 1 %' in map1 with 95 % confidence: 0.6 % (95 %: 0.6 to 0.6, 3 seeds)" in answer(
        found, "map1"
    )


@pytest.mark.parametrize(
    ("text", "key", "limit", "goes_on_s"),
    [
        ("retrieval p95 < 5 min", "retrieval_wait_p95_s", 300, 300),
        ("retrieval total mean < 200 s", "retrieval_total_mean_s", 200, 200),
        ("queue max <  1.5min", "park_queue_max_s", 90, 90),
        ("parking p50 < 400s", "park_total_p50_s", 400, 400),
        ("turned away < 2.5 %", "turned_away_share", 0.025, 0),
    ],
)
def test_targets(text: str, key: str, limit: float, goes_on_s: float) -> None:
    target = parse_target(text)
    assert (target.key, target.limit, target.goes_on_s) == (key, limit, goes_on_s)


@pytest.mark.parametrize(
    "text",
    ["", "p95 < 5 min", "retrieval p95 > 5 min", "retrieval p97 < 5 min", "queue max < 0 s", "turned away < 0 %"],
)
def test_targets_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match=r"--target: .*give such as 'retrieval p95 < 5 min'"):
        parse_target(text)


SCENARIO = """
garage: map1
agvs: 1
plant: discrete
planner: whca
duration_s: 900
workload: {kind: poisson, arrivals_per_h: 120, dwell_median_min: 10, initial_occupancy: 0.3, duration_min: 10}
record: {sample_s: 60}
"""


def test_the_command(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(SCENARIO)
    with pytest.raises(SystemExit) as caught:
        main(
            [
                "size",
                "s.yaml",
                "--target",
                "retrieval p95 < 1 s",
                "--max-agvs",
                "2",
                "--max-seeds",
                "3",
                "--workers",
                "1",
                "-q",
            ]
        )
    assert caught.value.code == 1
    said = capfd.readouterr().out
    assert "No fleet of 1 to 2 AGVs meets 'retrieval p95 < 1 s'" in said
    folder = tmp_path / "runs" / "size-s-own"
    (sized,) = json.loads((folder / "sizing.json").read_text())["sized"]
    assert (sized["what"], sized["number"]) == ("agvs", None)
    assert (folder / "curve-agvs.svg").is_file()
    assert "No fleet of 1 to 2 AGVs" in (folder / "report.html").read_text(encoding="utf-8")


def test_bays_and_chargers_are_sized_after_the_fleet(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(SCENARIO)
    words = [
        "size",
        "s.yaml",
        "--target",
        "queue mean < 100 s",
        "--max-agvs",
        "4",
        "--max-seeds",
        "3",
        "--workers",
        "1",
    ]
    with pytest.raises(SystemExit) as caught:
        main([*words, "--also", "bays,chargers"])
    said = capfd.readouterr().out
    assert caught.value.code == 0
    written = json.loads((tmp_path / "runs" / "size-s-own" / "sizing.json").read_text())["sized"]
    assert [sized["what"] for sized in written] == ["agvs", "bays", "chargers"]
    fleet, bays, chargers = (sized["number"] for sized in written)
    assert (bays, chargers) == (2, 1), "120 customers an hour are too many for one bay; no battery is ever empty"
    assert f"With {fleet} AGVs, 2 bays meet 'queue mean < 100 s'" in said
    # with all bays it is the fleet's own runs, which are not done again
    values = {sized["what"]: {tried["number"]: tried["values"] for tried in sized["tried"]} for sized in written}
    assert values["bays"][2] == values["agvs"][fleet]
    assert all(one > two for one, two in zip(values["bays"][1], values["bays"][2], strict=True))
    runs = list((tmp_path / "runs" / "size-s-own" / "runs").iterdir())
    assert len(runs) == sum(len(v) for numbers in values.values() for v in numbers.values()) - 3


class Failing(ThreadPoolExecutor):
    """Does runs in this process, but for those with one bay."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call the function, or raise."""
        if args[0].bays == 1:
            return super().submit(int, "no such run")
        return super().submit(fn, *args, **kwargs)


def test_an_answer_outlives_what_fails_after_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("parking_sim.workers.open_executor", lambda *_: Failing(1))
    (tmp_path / "s.yaml").write_text(SCENARIO)
    with pytest.raises(SystemExit) as caught:
        main(shlex.split("size s.yaml --target 'queue mean < 60 min' --max-seeds 3 -q --also bays"))
    said = capfd.readouterr()
    assert caught.value.code == 1
    assert "1 AGV meets 'queue mean < 60 min'" in said.out
    assert said.err.count("\n") == 1
    assert "bays=1, seed 1: ValueError: invalid literal" in said.err
    (sized,) = json.loads((tmp_path / "runs" / "size-s-own" / "sizing.json").read_text())["sized"]
    assert sized["what"] == "agvs"
    assert sized["answer"] in said.out
    assert (tmp_path / "runs" / "size-s-own" / "report.html").is_file()


@pytest.fixture(scope="module")
def own_net(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A net of one's own."""
    folder = tmp_path_factory.mktemp("own")
    for file in net_files("map1"):
        shutil.copy(file, folder / file.name.replace("map1", "mine"))
    return folder / net_files("map1")[0].name.replace("map1", "mine")


def test_a_net_file_is_sized(own_net: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with open_executor(1) as executor:
        scenario = load_scenario(own_net, {"agvs": 1, "plant": "discrete", "workload": ParkExit(cars=2)})
        (found,) = size_garage(
            scenario, parse_target("queue max < 60 min"), {"agvs": 2}, tmp_path / "out", executor, (3,)
        )
    assert found.number == 1
    net = os.path.relpath(own_net)
    with pytest.raises(SystemExit) as caught:  # the number of AGVs need not be given
        main(["size", net, *shlex.split(SATURDAY), "--scale", "11"])
    assert caught.value.code == 2
    with pytest.raises(SystemExit) as caught:
        main(["tune", net, "--vary", "agvs=1..99", "--out", "tuned"])
    assert caught.value.code == 2
    assert not (tmp_path / "tuned").exists()


def test_places_that_are_not_there(tmp_path: Path) -> None:
    for keys, message in (
        ("garage: map1, bays: 3", "bays: 3: map1 has 2"),
        ("garage: map1, chargers: 4", "chargers: 4: map1 has 3"),
        ("garage: map1_thesis, bays: 1", "bays: 1: map1_thesis has none: it hands cars over at the AGVs' homes"),
        ("garage: map1_thesis, homes: [c0_9]", "homes: c0_9: map1_thesis has no such home; give one of c0_2, c0_3"),
        ("garage: map1_thesis, homes: [c0_1, c0_1]", "homes: c0_1: is there 2 times"),
    ):
        (tmp_path / "s.yaml").write_text(f"{{{keys}, agvs: 1, plant: discrete}}")
        with pytest.raises(NetError, match=message):
            assemble(load_scenario(tmp_path / "s.yaml"))
    net = read_net("map1")
    fewer = first_places(net, 1, 0)
    assert (fewer.graph.bays, fewer.graph.chargers) == (net.graph.bays[:1], ())
    assert list(fewer.bay_sites) == list(fewer.graph.bays)
    assert fewer.graph.slots == net.graph.slots
    assert first_places(net) is net
    assert chosen_homes(net) is net


def test_agvs_start_at_the_homes_that_are_named(tmp_path: Path) -> None:
    keys = {"agvs": 2, "plant": "discrete", "homes": ["c0_1", "c0_4", "c0_2"], "duration_s": 1.0}
    simulate(load_scenario("map1_thesis", keys), tmp_path / "run")
    run = load_run(tmp_path / "run")
    places = run.vertices.set_index("vertex").loc[["c0_1", "c0_4"], ["x_m", "y_m"]].to_numpy()
    at_start = run.trajectory[run.trajectory.time_s == 0].sort_values("agv")[["x_m", "y_m"]].to_numpy()
    assert (places == at_start).all()
    with pytest.raises(InputError, match="agvs: 4: map1_thesis has homes for 1 to 3"):
        assemble(load_scenario("map1_thesis", {**keys, "agvs": 4}))


SATURDAY = "--target 'retrieval p95 < 5 min' --profile mall-saturday"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--target 'queue max < 9 s' --also doors", "--also: 'doors': give one of bays, chargers"),
        ("--target x", "--target: 'x'"),
        ("--target 'retrieval p95 < 5 min' --profile mal", "profile: 'mal': give one of"),
        ("--target 'retrieval p95 < 5 min' --max-agvs 99", "--max-agvs: 99: map1 has homes for 1 to 8"),
        (f"{SATURDAY} --scale 11", "command line: workload.scale: 11.0: must be less than or equal to 10"),
        (f"{SATURDAY} --start 25", "command line: workload.start_h: 25.0: must be less than 24"),
        (f"{SATURDAY} --start -3", "command line: workload.start_h: -3.0: must be greater than or equal to 0"),
        (f"{SATURDAY} --start 20 --hours 3", "workload: 20 h to 23 h: mall-saturday covers 8 h to 22 h"),
        (f"{SATURDAY} --start nan", "--start: nan: give a finite number"),
    ],
)
def test_mistakes(words: str, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["size", "map1", *shlex.split(words)])
    assert caught.value.code == 2
    assert message in capfd.readouterr().err


def test_tuning_tries_settings_and_sorts_them(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    (tmp_path / "s.yaml").write_text(SCENARIO)
    ranges = parse_ranges(["control.period_s=2.0..60", "agvs=1..4"])
    with open_executor(1) as executor:
        found = tune_scenario(
            str(tmp_path / "s.yaml"), ranges, "retrieval_wait_mean_s", 4, (1, 2), tmp_path / "out", executor
        )
    assert len(found) == 4
    assert [s.mean.mean for s in found] == sorted(s.mean.mean for s in found)
    assert all(2 <= s.values["control.period_s"] <= 60 and s.values["agvs"] in (1, 2, 3, 4) for s in found)


@pytest.mark.parametrize("text", ["agvs", "agvs=3", "agvs=4..2", "agvs=a..b", "step_s=0.1..inf", "seed=1..9"])
def test_ranges_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="--vary"):
        parse_ranges([text])
