"""Comparison: pairs by seed, intervals that hold what they promise, a warm-up that is cut, words that say so."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis import compare as module
from analysis.compare import Comparison, compare, in_words, select_runs, table_rows, variant_names
from analysis.measures import interval, measure_runs, statistic
from analysis.record import Recorder, TaskRow
from analysis.runs import Runs, load_runs
from parking_sim.cli import main
from sumo_nets.errors import InputError

END_S = 3600.0


def write_run(folder: Path, seed: int, waits: list[float], agvs: int = 2, unfinished: float | None = None) -> None:
    """A run in which a car is asked for every ten minutes and comes after these waits."""
    recorder = Recorder()
    for number, wait in enumerate(waits):
        start = 600.0 * number
        recorder.task(
            TaskRow(
                number,
                "retrieve",
                f"c{number}",
                "served",
                requested_s=start,
                delivered_s=start + wait,
                done_s=start + wait,
            )
        )
        recorder.event(start, "request_made", request=number, what="retrieve")
    if unfinished is not None:
        recorder.task(TaskRow(99, "retrieve", "last", "waiting", requested_s=END_S - unfinished))
    for time_s in range(0, int(END_S), 600):
        recorder.timeline(float(time_s), 2, 0, 0, 0, 0)
    scenario = {"garage": "map1", "agvs": agvs, "seed": seed, "workload": {"kind": "poisson"}}
    folder.mkdir(parents=True)
    (folder / "metrics.json").write_text(json.dumps({"simulated_s": END_S}))
    recorder.write(folder, {"status": "finished", "scenario": scenario, "seed": seed, "simulated_s": END_S})


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seeds with 2 and with 4 AGVs: hard and easy days, on each of which 4 are 20 s faster, give or take 2 s."""
    tmp_path, chance = tmp_path_factory.mktemp("pairs"), np.random.default_rng(1)
    for seed in range(1, 11):
        day, off = chance.normal(200, 40), chance.normal(0, 2)
        write_run(tmp_path / "runs" / f"two-{seed}", seed, [day, day + 10, day + 20], agvs=2)
        write_run(tmp_path / "runs" / f"four-{seed}", seed, [day - 20 + off, day - 10 + off, day + off], agvs=4)
    return tmp_path / "runs"


def chosen(folder: Path, agvs: int) -> Runs:
    return select_runs(f"{folder}:agvs={agvs}")


def test_pairs_show_what_separate_intervals_hide(pairs: Path) -> None:
    found = compare(chosen(pairs, 2), chosen(pairs, 4), ("2 AGVs", "4 AGVs"), keys=["retrieval_wait_mean_s"])
    (difference,) = found.differences
    assert found.seeds == tuple(range(1, 11))
    assert difference.change.mean == pytest.approx(-20, abs=2)
    assert difference.is_clear
    assert difference.change.half < 3
    assert difference.a.low < difference.b.high  # separately they overlap
    said = in_words(found)
    assert "4 AGVs is better, by -" in said[0]
    assert said[-1].startswith("10 seeds are enough")


def test_too_few_seeds_are_said_to_be_too_few(tmp_path: Path) -> None:
    chance = np.random.default_rng(2)
    for seed in range(4):
        write_run(tmp_path / "a" / str(seed), seed, chance.normal(200, 80, 3).tolist())
        write_run(tmp_path / "b" / str(seed), seed, chance.normal(200, 80, 3).tolist())
    found = compare(load_runs(tmp_path / "a"), load_runs(tmp_path / "b"), keys=["retrieval_wait_mean_s"])
    assert "no clear difference" in in_words(found)[0]
    assert in_words(found)[-1].startswith("4 seeds are not enough for: retrieval wait, mean. About ")
    assert found.differences[0].needed > 20


def test_the_warm_up_is_cut(tmp_path: Path) -> None:
    write_run(tmp_path / "a", 1, [500, 400, 100, 100])
    runs = load_runs(tmp_path)
    assert measure_runs(runs)["retrieval_wait_mean_s"].tolist() == [275]
    cut = measure_runs(runs, 1200.0).iloc[0]
    assert cut["retrieval_wait_mean_s"] == 100
    assert cut["tasks_per_hour"] == pytest.approx(2 / (2400 / 3600))
    assert cut["queue_mean"] == 2


def test_a_wait_without_end_counts_so_far(tmp_path: Path) -> None:
    write_run(tmp_path / "a", 1, [100, 100], unfinished=1000)
    assert measure_runs(load_runs(tmp_path))["retrieval_wait_max_s"].tolist() == [1000]


def test_measures_that_nobody_has_are_nan(tmp_path: Path) -> None:
    write_run(tmp_path / "a", 1, [100])
    row = measure_runs(load_runs(tmp_path)).iloc[0]
    assert math.isnan(row["park_total_mean_s"])
    assert row["deadlocks_per_hour"] == 0


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    chance = np.random.default_rng(3)
    covered = sum(abs((i := interval(chance.normal(5, 2, 6).tolist())).mean - 5) <= i.half for _ in range(2000))
    assert covered / 2000 == pytest.approx(0.95, abs=0.015)


def test_intervals_of_few_values() -> None:
    assert interval([]).runs == 0
    assert interval([3.0, math.nan]).high == math.inf
    three = interval([1.0, 2.0, 3.0])  # t(0.975, 2) = 4.303
    assert (three.mean, three.half) == (2.0, pytest.approx(4.303 / math.sqrt(3), abs=1e-3))


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ("nowhere", "no run in nowhere"),
        ("{}", "has several variants: pick one, such as .*:agvs="),
        ("{}:agvs=3", "agvs: '3': no such run; there are .*2"),
        ("{}:agv=3", "agv: no such key; these vary: agvs"),
    ],
)
def test_choices_that_are_none(pairs: Path, choice: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        select_runs(choice.format(pairs))


def test_nothing_in_common(tmp_path: Path) -> None:
    write_run(tmp_path / "a" / "1", 1, [100])
    write_run(tmp_path / "b" / "1", 2, [100])
    with pytest.raises(InputError, match="share 0 seeds"):
        compare(load_runs(tmp_path / "a"), load_runs(tmp_path / "b"))


def test_a_warm_up_that_leaves_nothing(pairs: Path) -> None:
    with pytest.raises(InputError, match="--warmup: 60 minutes: B has a run of 60 minutes"):
        compare(load_runs(pairs), load_runs(pairs), ("B", "C"), warmup_s=END_S)


def test_names() -> None:
    assert variant_names("runs/x:agvs=2", "runs/x:agvs=4") == ("agvs=2", "agvs=4")
    assert variant_names("runs/x", "runs/y") == ("x", "y")
    assert variant_names("a/x", "b/x") == ("a/x", "b/x")


def test_the_command(pairs: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    words = ["compare", f"{pairs}:agvs=2", f"{pairs}:agvs=4", "--warmup", "10", "--figure", str(tmp_path / "c.svg")]
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 0
    said = capfd.readouterr().out
    assert "agvs=4 is better" in said
    assert (tmp_path / "c.svg").read_text(encoding="utf-8").count("<svg") == 1


def test_rows_have_the_numbers(pairs: Path) -> None:
    found: Comparison = module.compare(chosen(pairs, 2), chosen(pairs, 4), ("a", "b"))
    rows = table_rows(found)
    assert [set(row) for row in rows] == [{"measure", "a", "b", "difference", "95 % interval", "seeds needed"}] * len(
        rows
    )


def test_customers_turned_away_are_a_measure_and_no_served_task(tmp_path: Path) -> None:
    """Ten cars come in an hour: four are served, six turned away; two requests to fetch those are void."""
    recorder = Recorder()
    rows = [TaskRow(k, "park", f"c{k}", "served", requested_s=60.0 * k, done_s=60.0 * k + 9, delivered_s=60.0 * k + 9)
            for k in range(4)]  # fmt: skip
    rows += [
        TaskRow(k, "park", f"c{k}", "turned_away", reason="queue too long: 3 cars", requested_s=1800.0)
        for k in range(4, 10)
    ]
    rows += [
        TaskRow(k, "retrieve", f"c{k - 6}", "void", reason="car was turned away", requested_s=1900.0) for k in (10, 11)
    ]
    for row in rows:
        recorder.task(row)
    recorder.write(tmp_path / "run", {"seed": 1, "simulated_s": END_S, "scenario": {"seed": 1}})
    runs = load_runs(tmp_path)
    plain, endless = (measure_runs(runs, endless=counted).iloc[0] for counted in (False, True))
    for measured in (plain, endless):
        assert measured["turned_away_share"] == 0.6 == runs.runs["turned_away_share"][0]
        assert measured["tasks_per_hour"] == 4
    assert plain["park_total_max_s"] == 9
    assert math.isnan(plain["retrieval_wait_p50_s"])
    assert [endless[f"{wait}_p95_s"] for wait in ("park_total", "retrieval_wait", "retrieval_total")] == [math.inf] * 3
    assert measure_runs(runs, warmup_s=61.0)["turned_away_share"][0] == 6 / 8


@given(
    st.lists(st.floats(0, 1e4), max_size=40), st.integers(0, 20), st.sampled_from(["mean", "p50", "p90", "p95", "max"])
)
def test_a_wait_without_end_counts_as_any_that_is_very_long(waits: list[float], endless: int, name: str) -> None:
    """Against numpy: with 1e12 s in the place of each wait without end, whatever they touch is beyond all others."""
    found = statistic(name, sorted(waits), endless)
    if not waits and not endless:
        assert math.isnan(found)
        return
    long = np.array([*waits, *[1e12] * endless])
    expected = {"mean": np.mean, "max": np.max}.get(name, lambda v: np.quantile(v, int(name[1:]) / 100))(long)
    if expected > 1e6:
        assert found == math.inf
    else:
        assert found == pytest.approx(expected, abs=1e-6)
