"""A run's folder holds what the run read: it is repeated anywhere, and whatever came out differently is named."""

from __future__ import annotations

import gzip
import json
import os
import shutil
from pathlib import Path

import pytest
import yaml

from parking_sim.cli import main
from parking_sim.many_runs import do_run
from parking_sim.sweep_plan import load_sweep
from sumo_nets.read import net_files

PLANNER = Path(__file__).parent.parent / "parking_sim" / "examples" / "own_planner.py"
PROFILE = """
words: mine
source: mine
hours: [8, 9]
arrivals: [0.5]
leaving: [1.0]
occupancy: 0.2
"""

BARE = ("--no-report", "--no-replay", "-q")


def command(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)


def make_files(folder: Path) -> None:
    """A net, requests, a profile and a scenario for each, all of one's own."""
    folder.mkdir(parents=True)
    for file in net_files("map1"):
        shutil.copy(file, folder / file.name.replace("map1", "my net [1]"))
    rows = ["time_s,kind,car", "0,park,a", "40,park,b", "80,park,c", "300,retrieve,a", "310,retrieve,b"]
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    (folder / "day.yaml").write_text(PROFILE)
    common = {"garage": "my net [1].net.xml.gz", "agvs": 2, "step_s": 0.5, "record": {"sample_s": 10.0}}
    csv = {"workload": {"kind": "csv", "path": "log.csv"}}
    profile = {"workload": {"kind": "profile", "name": "day.yaml", "hours": 0.2}, "plant": "discrete"}
    (folder / "sumo.yaml").write_text(yaml.safe_dump({**common, **csv, "duration_s": 420.0}))
    (folder / "profile.yaml").write_text(yaml.safe_dump({**common, **profile}))


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs on files of one's own; their folder is elsewhere now, and the files are gone."""
    base = tmp_path_factory.mktemp("rerun")
    make_files(base / "here")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(base)
        for name in ("sumo", "profile"):
            assert command("run", f"here/{name}.yaml", "--out", f"out [{name}]", *BARE) == 0
    shutil.rmtree(base / "here")
    (base / "far" / "away").mkdir(parents=True)
    for name in ("sumo", "profile"):
        (base / f"out [{name}]").rename(base / "far" / "away" / f"{name}=1")
    return base / "far" / "away"


@pytest.mark.parametrize("name", ["sumo", "profile"])
def test_a_folder_that_was_moved_is_repeated(
    moved: Path, name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert command("rerun", moved / f"{name}=1", "--out", tmp_path / "again") == 0
    assert capfd.readouterr().out == "the same record came out\n"
    before, after = (json.loads((p / "run.json").read_text()) for p in (moved / f"{name}=1", tmp_path / "again"))
    assert before["digest"] == after["digest"]
    assert before["inputs"] == after["inputs"]


def test_the_folder_names_nothing_outside(moved: Path) -> None:
    folder = moved / "sumo=1"
    scenario = yaml.safe_load((folder / "scenario.yaml").read_text())
    assert scenario["garage"] == "inputs/my net [1].net.xml.gz"
    assert scenario["workload"]["path"] == "inputs/log.csv"
    config = (folder / "run.sumocfg").read_text()
    assert '"inputs/my net [1].net.xml.gz"' in config
    assert '"inputs/my net [1].add.xml"' in config
    meta = json.loads((folder / "run.json").read_text())
    assert set(meta["inputs"]) == {
        f"inputs/{name}" for name in ("my net [1].net.xml.gz", "my net [1].add.xml", "log.csv")
    }
    assert not any(str(moved.parent.parent) in str(value) for value in meta["scenario"].values())


def test_what_changed_is_named(moved: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    shutil.copytree(moved / "sumo=1", folder)
    log = folder / "inputs" / "log.csv"
    log.write_text(log.read_text().replace("40,park,b", "44,park,b"))
    meta = json.loads((folder / "run.json").read_text())
    meta["versions"]["numpy"], meta["code"] = "1.0", "other"
    (folder / "run.json").write_text(json.dumps(meta))
    scenario = folder / "scenario.yaml"
    scenario.write_text(scenario.read_text().replace("duration_s: 420.0", "duration_s: 400.0"))
    assert command("rerun", folder, "-q") == 1
    said = capfd.readouterr().out.splitlines()
    assert said[0].startswith("the record was made with numpy 1.0; this is numpy ")
    assert said[1].startswith("the record was made by code other; this is ")
    assert "scenario.yaml: duration_s: 400.0: was 420.0 when the record was made" in said
    assert "inputs/log.csv: is not the file with which the record was made" in said
    (tasks,) = (line for line in said if line.startswith("tasks: "))
    assert "requested_s in row 1 is 44.0, was 40.0" in tasks
    assert any(line.startswith("timeline: 41 rows, were 43; ") for line in said)


def test_a_shipped_net_that_changed_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.yaml").write_text("{garage: map1, agvs: 1, plant: discrete, workload: {kind: park_exit, cars: 1}}")
    assert command("run", tmp_path / "s.yaml", "--out", tmp_path / "out", *BARE) == 0
    assert not (tmp_path / "out" / "inputs").exists()
    meta = json.loads((tmp_path / "out" / "run.json").read_text())
    assert set(meta["inputs"]) == {file.name for file in net_files("map1")}
    meta["inputs"]["map1.net.xml.gz"] = "0" * 64
    (tmp_path / "out" / "run.json").write_text(json.dumps(meta))
    assert command("rerun", tmp_path / "out") == 0
    said = capfd.readouterr().out.splitlines()
    assert said == ["map1.net.xml.gz: is not the file with which the record was made", "the same record came out"]


def test_records_that_cannot_be_repeated(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"status": "interrupted", "simulated_s": 7}))
    (tmp_path / "killed").mkdir()
    (tmp_path / "killed" / "journal.jsonl").write_text("")
    for folder, complaint in (
        (tmp_path, "was stopped by hand at 7 s: give a run that ended by itself"),
        (tmp_path / "killed", "go on with it: parking-sim resume"),
        (tmp_path / "nowhere", "no record of a run in"),
        (tmp_path / "run.json", "no record of a run in"),
    ):
        assert command("rerun", folder) == 2
        said = capfd.readouterr().err
        assert complaint in said
        assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["rerun"], ["replay"], ["compare", "FOLDER"]])
def test_a_killed_run_is_to_be_finished_first(
    words: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "journal.jsonl").write_text("")
    assert command(*(str(tmp_path) if word == "FOLDER" else word for word in words), tmp_path) == 2
    said = capfd.readouterr().err
    assert said == f"error: {tmp_path}: holds a run that did not end; go on with it: parking-sim resume {tmp_path}\n"


def test_a_killed_run_goes_on_from_its_own_files(moved: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(moved / "sumo=1", folder)
    digest = json.loads((folder / "run.json").read_text())["digest"]
    for file in [*folder.glob("*.parquet"), folder / "run.json", folder / "metrics.json"]:
        file.unlink()
    (folder / "journal.jsonl").write_text("")
    assert command("resume", folder, "--no-report", "-q") == 0
    assert json.loads((folder / "run.json").read_text())["digest"] == digest


def test_an_earlier_runs_files_go_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    make_files(tmp_path / "here")
    words = ["--out", "out", *BARE]
    net = {"my net [1].net.xml.gz", "my net [1].add.xml"}
    shutil.copy(PLANNER, "own.py")
    assert command("run", "here/profile.yaml", "--planner", "own.py:plan", *words) in (0, 1)
    assert {p.name for p in Path("out/inputs").iterdir()} == {
        "my net [1].net.xml.gz",
        "my net [1].add.xml",
        "day.yaml",
        "own.py",
    }
    assert command("run", "out/scenario.yaml", "--planner", "whca", *words, "--force") == 0  # from its own files
    assert {p.name for p in Path("out/inputs").iterdir()} == {*net, "day.yaml"}


def test_a_planner_in_a_folder_is_run_only_when_it_is_trusted(tmp_path, capfd) -> None:
    """The file tells whether it was run; a record from elsewhere must not run it unasked, killed or whole."""
    told = tmp_path / "told"
    (tmp_path / "own.py").write_text(f"open({str(told)!r}, 'w').close()\n{PLANNER.read_text()}")
    keys = f"{{garage: map1, agvs: 1, plant: discrete, duration_s: 60, planner: {tmp_path}/own.py:plan}}"
    (tmp_path / "s.yaml").write_text(keys)
    folder = tmp_path / "out"
    assert command("run", tmp_path / "s.yaml", "--out", folder, *BARE) == 0
    told.unlink()
    capfd.readouterr()
    assert command("rerun", folder) == 2
    says = "scenario.yaml: planner: 'inputs/own.py:plan' is code that would run; read inputs/own.py, then give --trust"
    assert capfd.readouterr().err == f"error: {folder}/{says}\n"
    assert not told.exists()
    assert command("rerun", folder, "--trust", "-q") == 0
    assert told.exists()
    told.unlink()
    (folder / "run.json").unlink()
    (folder / "journal.jsonl").write_text("")
    assert command("resume", folder, "-q") == 2
    assert not told.exists()
    assert command("resume", folder, "-q", "--trust", "--no-report") == 0
    assert told.exists()


def test_runs_of_a_sweep_share_their_files(tmp_path: Path) -> None:
    make_files(tmp_path / "here")
    (tmp_path / "sweep.yaml").write_text("base: here/profile.yaml\ngrid: {agvs: [1, 2]}\n")
    specs = load_sweep(tmp_path / "sweep.yaml")
    for spec in specs:
        do_run(spec.scenario, tmp_path / "out" / "runs" / spec.key)
    nets = [tmp_path / "out" / "runs" / spec.key / "inputs" / "my net [1].net.xml.gz" for spec in specs]
    assert os.path.samefile(*nets)
    assert len(list((tmp_path / "out" / "inputs").iterdir())) == 3
    shutil.copytree(nets[0].parent.parent, tmp_path / "copy")
    shutil.rmtree(tmp_path / "out")
    shutil.rmtree(tmp_path / "here")
    assert command("rerun", tmp_path / "copy", "-q") == 0


def test_a_variant_is_its_files_content(tmp_path: Path) -> None:
    for folder in ("a", "b", "c"):
        make_files(tmp_path / folder)
    net = tmp_path / "b" / "my net [1].net.xml.gz"
    net.write_bytes(gzip.compress(gzip.decompress(net.read_bytes()) + b"\n"))
    nets = [f"{folder}/my net [1].net.xml.gz" for folder in "ab"]
    sweep = {"base": {"agvs": 1, "plant": "discrete"}, "grid": {"garage": nets}}
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    assert len({spec.key for spec in load_sweep(tmp_path / "sweep.yaml")}) == 2
    sweep["grid"]["garage"].append("c/my net [1].net.xml.gz")
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    with pytest.raises(ValueError, match="are the same scenario"):
        load_sweep(tmp_path / "sweep.yaml")
