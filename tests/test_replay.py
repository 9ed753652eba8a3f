"""The replay's page: its data are the record's, it fits its limit, and it says what it leaves out."""

from __future__ import annotations

import base64
import json
import re
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.record import AgvSample, Recorder, TaskRow
from analysis.replay import pack, replay_page, write_replay
from analysis.report import write_report
from analysis.tables import Run, load_run, recorded_run
from parking_sim.cli import main
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.errors import InputError
from sumo_nets.graph import make_graph

NEVER = 2**30


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of twenty minutes of map1 in SUMO, with its pages."""
    folder = tmp_path_factory.mktemp("replay") / "map1"
    simulate(load_scenario("map1", {"duration_s": 1200.0}), folder)
    write_replay(folder, report=True)
    write_report(folder)
    return folder


def little_run() -> Run:
    """Two AGVs on a line of four vertices: one reverses with a car, then both lock up for two minutes."""
    recorder = Recorder()
    vertices = [(name, 10.0 * k, 0.0) for k, name in enumerate("abcd")]
    edges = [(u + v, u, v, 10.0) for u, v in ("ab", "ba", "bc", "cb", "cd", "dc")]
    recorder.floor(make_graph("little", vertices, edges, {"bay": ["a"], "home": ["b"], "slot": ["d"]}))
    recorder.event(0.0, "car_initial", car="p1", vertex="d")
    recorder.event(100.0, "deadlock_found", vertex="c", members=[0, 1], cause="head_on", deadlock=0, waits={"0": 1})
    recorder.event(160.0, "stage_failed", deadlock=0, stage="leader", reason="no_way")
    recorder.event(
        220.0, "deadlock_resolved", deadlock=0, members=[0, 1], cause="head_on", stage="pull_over", cost_s=140
    )
    recorder.event(230.0, "fault_start", vertex="b", fault=0, cause="blocked", agvs=[], vertices=[1])
    recorder.event(240.0, "fault_end", vertex="b", fault=0, cause="blocked")
    recorder.task(
        TaskRow(0, "retrieve", "p1", "served", agv=0, origin="d", destination="a", requested_s=5.0, ready_s=5.0,
                assigned_s=10.0, lifted_s=20.0, delivered_s=250.0, done_s=260.0)
    )  # fmt: skip
    for k in range(151):
        first = AgvSample(0, 30.0 - 0.1 * k, 0.0, 0.0 if k < 10 else 180.0, 0.05)
        second = AgvSample(1, 5.0, 0.0, (179.0, -179.0)[k % 2], 0.0)
        modes = ["going_to_collect" if k < 10 else "returning_with_car", "idle"]
        recorder.sample(2.0 * k, [first, second], modes, ["" if k < 10 else "p1", ""], [1.0, 0.5])
        recorder.timeline(2.0 * k, 3, 0, 1, 0, 1)
    recorder.plan(0.0, 0, 2, (3, 2, 1, 0))
    recorder.plan(150.0, 0, 1, (2, 1, 0))
    return recorded_run(recorder, {"status": "finished", "scenario": {"garage": "little", "agvs": 2}}, "little")


def unpack(page: str) -> tuple[dict[str, Any], dict[str, list[int]]]:
    """The page's data, read by another program than the page's own."""
    text = re.search(r'id="data">([^<]*)<', page)
    assert text
    raw = zlib.decompress(base64.b64decode(text[1]))
    length = int.from_bytes(raw[:4], "little")
    head, at, columns = json.loads(raw[4 : 4 + length]), 4 + length, {}
    for name, count in head["columns"]:
        values, value = [], 0
        for _ in range(count):
            coded = shift = 0
            while True:
                byte = raw[at]
                at += 1
                coded |= (byte & 127) << shift
                shift += 7
                if byte < 128:
                    break
            value += (coded >> 1) ^ -(coded & 1)
            values.append(value)
        columns[name] = values
    assert at == len(raw)
    return head, columns


def test_numbers_survive_packing() -> None:
    rng = np.random.default_rng(1)
    columns = {
        "empty": np.array([], dtype=np.int64),
        "small": rng.integers(-3, 4, 1000),
        "wide": rng.integers(-(2**30), 2**30, 1000) // 2,
        "ends": np.array([0, NEVER, 0, 63, 64, -64, -65, 8191, 8192, NEVER]),
    }
    head, found = unpack(f'<script id="data">{pack({"a": "é<"}, columns)}<')
    assert head["a"] == "é<"
    assert found == {name: values.tolist() for name, values in columns.items()}


def test_trajectory_is_the_records(folder: Path) -> None:
    head, columns = unpack((folder / "replay.html").read_text())
    run = load_run(folder).trajectory
    agvs = head["agvs"]
    for name, column, scale in (("x", "x_m", 100), ("y", "y_m", 100), ("angle", "angle_deg", 10)):
        wanted = run[column].to_numpy().reshape(-1, agvs).T.ravel()
        assert np.abs(np.array(columns[name]) / scale - wanted).max() <= 0.5 / scale + 1e-9
    assert columns["time"] == (np.unique(run["time_s"]) * 1000).astype(int).tolist()


def test_cars_stand_from_when_they_are_lowered_until_they_are_lifted(folder: Path) -> None:
    head, columns = unpack((folder / "replay.html").read_text())
    tasks = load_run(folder).tasks
    parked = tasks[(tasks["kind"] == "park") & tasks["delivered_s"].notna()]
    stays = {
        head["cars"][car]: (begin, head["floor"]["names"][vertex])
        for place, car, begin, vertex in zip(
            *(columns[f"stay_{name}"] for name in ("place", "car", "from", "vertex")), strict=True
        )
        if place == 0
    }
    assert len(parked) >= 5
    assert stays == {
        row["car"]: (round(row["delivered_s"] * 1000), row["destination"]) for row in parked.to_dict("records")
    }


def test_parked_cars_stand_in_their_slots(folder: Path) -> None:
    head, columns = unpack((folder / "replay.html").read_text())
    places = {vertex: (x, y) for role, vertex, x, y, *_ in head["floor"]["places"] if role == "slot"}
    for place, vertex, x, y in zip(*(columns[f"stay_{name}"] for name in ("place", "vertex", "x", "y")), strict=True):
        if place == 0:
            assert np.hypot(x - places[vertex][0], y - places[vertex][1]) < 30, "centimetres from the slot's middle"


def test_plans_start_where_the_agv_is_and_end_at_its_task(folder: Path) -> None:
    run = load_run(folder)
    index = {name: v for v, name in enumerate(run.vertices["vertex"])}
    lanes = set(zip(run.edges["tail"], run.edges["head"], strict=True))
    xy = run.vertices[["x_m", "y_m"]].to_numpy()
    where = {(row["time_s"], row["agv"]): (row["x_m"], row["y_m"]) for row in run.trajectory.to_dict("records")}
    ends = set()
    for row in run.plans.to_dict("records"):
        path = [int(vertex) for vertex in row["path"].split()]
        assert 1 <= row["granted"] <= len(path)
        assert all(step in lanes for step in pairwise(path))
        reach = 8.0 + (np.hypot(*(xy[path[1]] - xy[path[0]])) if len(path) > 1 else 0.0)
        assert np.hypot(*(xy[path[0]] - where[row["time_s"], row["agv"]])) < reach
        ends.add(path[-1])
    assert {index[slot] for slot in run.tasks["destination"] if slot.startswith("slot")} & ends


def test_initial_cars_deadlocks_and_tasks() -> None:
    head, columns = unpack(replay_page(little_run()))
    assert columns["stay_from"][columns["stay_place"].index(0)] == 0
    assert columns["stay_to"][columns["stay_place"].index(0)] == 20_000
    (lock,) = head["deadlocks"]
    assert (lock["from"], lock["found"], lock["to"], lock["members"]) == (80_000, 100_000, 220_000, [0, 1])
    assert (lock["cause"], lock["tried"]) == ("head on", ["leader: no way"])
    assert (lock["end"], lock["cost_s"]) == ("resolved by pull over, 140 s after the wait began", 140.0)
    assert (columns["task_lifted"], columns["task_delivered"], columns["done"]) == ([20_000], [250_000], [260_000])
    assert columns["plan_path"] == [3, 2, 1, 0, 2, 1, 0]


def test_faults_are_told_by_the_names_of_places() -> None:
    head, _ = unpack(replay_page(little_run()))
    told = [(row["time"], row["kind"], row["what"]) for row in head["incidents"]]
    assert told == [
        (230_000, "fault start", "b is blocked (fault 0)"),
        (240_000, "fault end", "b is blocked (fault 0)"),
    ]


def test_window_holds_what_lies_in_it(folder: Path) -> None:
    head, columns = unpack(replay_page(load_run(folder), 300.0, 600.0))
    assert (head["start"], head["end"]) == (300_000, 600_000)
    assert (columns["time"][0], columns["time"][-1]) == (300_000, 600_000)
    assert min(columns["stay_to"]) >= 300_000
    assert max(columns["stay_from"]) <= 600_000
    assert head["note"].startswith("0:05:00 to 0:10:00 of a run to 0:")


def test_long_runs_are_thinned_to_the_limit(folder: Path) -> None:
    run = load_run(folder)
    whole, thin = replay_page(run), replay_page(run, limit_bytes=len(replay_page(run)) - 1)
    assert len(thin) < len(whole)
    assert unpack(whole)[0]["note"] == "Whole run, a position every 2 s"
    assert "thinned to a position every 4 s" in unpack(thin)[0]["note"]
    assert unpack(thin)[1]["time"] == unpack(whole)[1]["time"][::2]


def test_size(folder: Path) -> None:
    assert (folder / "replay.html").stat().st_size < 200_000


def test_page_names_nothing_from_elsewhere(folder: Path) -> None:
    page = (folder / "replay.html").read_text()
    assert not re.search(r"https?:|\bsrc=|@import|url\(|fetch\(|XMLHttp|import\(", page)
    assert set(re.findall(r'href="([^"]*)"', page)) == {"data:,", "report.html"}
    assert 'href="replay.html"' in (folder / "report.html").read_text()


def test_same_record_same_page(folder: Path) -> None:
    assert replay_page(load_run(folder)) == replay_page(load_run(folder))


def test_nothing_to_replay(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match=r"run\.json is missing"):
        write_replay(tmp_path)
    Recorder().write(tmp_path, {})
    with pytest.raises(InputError, match="nothing to replay"):
        write_replay(tmp_path)
    (tmp_path / "plans.parquet").unlink()
    with pytest.raises(InputError, match="no table 'plans'"):
        write_replay(tmp_path)
    with pytest.raises(InputError, match="no sample from 1:00:00"):
        write_replay(folder, 3600.0)


@pytest.mark.parametrize("times", [["--from", "5:00", "--to", "600"], ["--from", "0:05:00", "--to", "0:10:00"]])
def test_command(times: list[str], folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(SystemExit) as end:
        main(["replay", str(tmp_path), *times])
    assert end.value.code == 0
    page = Path(capsys.readouterr().out.strip())
    head, _ = unpack(page.read_text())
    assert (head["start"], head["end"]) == (300_000, 600_000)


@pytest.mark.parametrize("wrong", ["soon", "1:2:3:4", "-5", "nan", ""])
def test_wrong_times(wrong: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["replay", str(folder), f"--from={wrong}"])
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith("error: --from: ")
