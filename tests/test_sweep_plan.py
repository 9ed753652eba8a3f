"""Sweep files: every variant with every seed, keys that change when a run would, one line for each mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from parking_sim import sweep_plan
from parking_sim.config import load_scenario
from parking_sim.sweep_plan import RunSpec, load_sweep, parse_seeds, run_key
from sumo_nets.errors import InputError

BASE = "base: {garage: map1, agvs: 2, plant: discrete, workload: {kind: park_exit, cars: 3}}\n"


def load(tmp_path: Path, text: str) -> tuple[RunSpec, ...]:
    (tmp_path / "sweep.yaml").write_text(text, encoding="utf-8")
    return load_sweep(tmp_path / "sweep.yaml")


def test_every_point_of_the_grid_with_every_entry_of_the_list_and_every_seed(tmp_path: Path) -> None:
    text = "grid: {agvs: [1, 2], control.period_s: [5, 6, 7]}\nlist: [{dispatch: nearest}, {dispatch: nearest-task}]\n"
    specs = load(tmp_path, BASE + text + "seeds: 1..3\n")
    assert len(specs) == 2 * 2 * 3 * 3
    assert {spec.scenario.seed for spec in specs} == {1, 2, 3}
    assert {(s.scenario.agvs, s.scenario.control.period_s) for s in specs} == {
        (a, p) for a in (1, 2) for p in (5, 6, 7)
    }
    assert [spec.scenario.seed for spec in specs[:12]] == [1] * 12  # all variants of the first seed first
    assert specs[0].variant.name == "dispatch=nearest, agvs=1, control.period_s=5"
    assert len({spec.key for spec in specs}) == len(specs)


def test_all_variants_have_the_same_seeds(tmp_path: Path) -> None:
    specs = load(tmp_path, BASE + "grid: {agvs: [1, 2, 4]}\nseeds: 5, 7..9\n")
    seeds = [{s.scenario.seed for s in specs if s.scenario.agvs == agvs} for agvs in (1, 2, 4)]
    assert seeds == [{5, 7, 8, 9}] * 3


def test_the_base_may_be_a_garage_a_file_or_keys(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("garage: map2\nagvs: 3\n")
    assert load(tmp_path, "base: s.yaml\n")[0].scenario.agvs == 3
    assert load(tmp_path, "base: map3\n")[0].scenario.agvs == 8
    assert load(tmp_path, BASE)[0].scenario.agvs == 2


def test_relative_paths_count_from_the_base(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,kind,car\n0,park,a\n")
    (spec,) = load(tmp_path, "base: {garage: map1, agvs: 1, workload: {kind: csv, path: log.csv}}\n")
    assert spec.scenario.base_dir == tmp_path.resolve()


def test_a_value_may_be_a_group_of_keys(tmp_path: Path) -> None:
    text = BASE + "list:\n- workload: {kind: poisson, arrivals_per_h: 9}\n- workload: {kind: park_exit}\n"
    assert [spec.scenario.workload.kind for spec in load(tmp_path, text)] == ["poisson", "park_exit"]


class TestKey:
    def test_depends_on_every_key_and_the_seed(self) -> None:
        base = load_scenario("map1")
        others = [base.model_copy(update=change) for change in ({}, {"seed": 1}, {"agvs": 3}, {"step_s": 0.25})]
        assert len({run_key(scenario) for scenario in others}) == 4
        assert run_key(load_scenario("map1")) == run_key(base)

    def test_depends_on_the_files_that_are_read(self, tmp_path: Path) -> None:
        log, scenario = tmp_path / "log.csv", tmp_path / "s.yaml"
        log.write_text("time_s,kind,car\n0,park,a\n")
        scenario.write_text("garage: map1\nagvs: 1\nworkload: {kind: csv, path: log.csv}\n")
        before = run_key(load_scenario(scenario))
        log.write_text("time_s,kind,car\n1,park,a\n")
        assert run_key(load_scenario(scenario)) != before
        log.unlink()
        with pytest.raises(InputError, match=r"log\.csv: can't be read"):
            run_key(load_scenario(scenario))

    def test_depends_on_the_code(self, monkeypatch: pytest.MonkeyPatch) -> None:
        before = run_key(load_scenario("map1"))
        monkeypatch.setattr(sweep_plan, "code_version", lambda: "other")
        assert run_key(load_scenario("map1")) != before


@pytest.mark.parametrize(
    ("value", "seeds"),
    [("1..3", (1, 2, 3)), (7, (7,)), ([1, 5], (1, 5)), ("1..2, 2..3", (1, 2, 3)), (["1..2", 9], (1, 2, 9))],
)
def test_seeds(value: object, seeds: tuple[int, ...]) -> None:
    assert parse_seeds(value) == seeds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("grid: {agvs: [1]}\n", "base: missing"),
        (BASE + "grit: {}\n", "grit: unknown key; valid keys are base, grid, list, seeds"),
        ("base: 3\n", "base: 3: give a shipped garage"),
        ("base: map9\n", "map9"),
        (BASE + "grid: {agvs: 1}\n", "grid.agvs: 1: give a list"),
        (BASE + "grid: [agvs]\n", "grid: .* give a mapping"),
        (BASE + "grid: {agvs: [1, 0]}\n", r"agvs=0: agvs: 0: must be greater"),
        (BASE + "grid: {agvz: [1]}\n", "agvz: unknown key; did you mean agv"),
        (BASE + "grid: {agvs.x: [1]}\n", "agvs has no keys below it"),
        (BASE + "grid: {control.periods: [1]}\n", "control.periods: unknown key"),
        (BASE + "grid: {agvs: [1]}\nlist: [{agvs: 2}]\n", "agvs: is in grid and in list"),
        (BASE + "list: []\n", "list: give at least one variant"),
        (BASE + "list: [{name: a, agvs: 2}, {name: a, agvs: 3}]\n", "'a': two variants have this name"),
        (BASE + "list: [{name: a}, {name: b, agvs: 2}]\n", "'a' and 'b' are the same scenario; remove one"),
        (BASE + "grid: {agvs: [1, 2, 1]}\n", "'agvs=1' and 'agvs=1' are the same scenario"),
        (BASE + "list: [{name: 3}]\n", r"list\[0\].name: 3: give a name of one line"),
        (BASE + "grid: {agvs: {' ': 2}}\n", "grid.agvs: ' ': give a name of one line"),
        (BASE + "list: {agvs: 2}\n", "list: give a list"),
        (BASE + "grid: {seed: [1]}\n", "seed: give the seeds"),
        (BASE + "seeds: 3..1\n", "seeds: '3..1': give seeds such as"),
        (BASE + "seeds: some\n", "seeds: 'some': give seeds such as"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        load(tmp_path, text)
    assert "\n" not in str(caught.value)
