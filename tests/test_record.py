"""The record: what is written can be read back, equal runs give equal bytes, the column dictionary is complete."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import get_args

import duckdb
import numpy as np
import pytest

from analysis.record import COLUMNS, META, NAN, AgvRow, AgvSample, PlanningRow, Recorder, TaskRow, write_json
from controller.events import KINDS, EventKind
from controller.types import AgvMode
from sumo_nets.graph import make_graph


def filled(wall_ms: float = 1.5) -> Recorder:
    recorder = Recorder()
    recorder.event(0.0, "request_made", car="c1", request=0, what="park")
    recorder.event(3.5, "deadlock_found", vertex="a1", members=[np.int32(2), 1], cause="head-on", deadlock=0)
    recorder.event(4.0, "fault_end", agv=1)
    recorder.task(TaskRow(0, "park", "c1", "served", agv=1, requested_s=0.0, delivered_s=50.0, done_s=50.0))
    recorder.task(TaskRow(1, "retrieve", "c'é", "waiting", requested_s=60.0))
    two = [AgvSample(0, 1.0, 2.0, 90.0, 0.0), AgvSample(1, 3.0, 2.0, 0.0, 1.5)]
    recorder.sample(0.0, two, [AgvMode.IDLE, AgvMode.GOING_TO_PARK], ["", "c1"], [1.0, 0.5])
    recorder.timeline(0.0, 1, 0, 0, 1, 1)
    recorder.planning(
        PlanningRow(
            time_s=0.0, agents=2, status="solved", window_steps=64, expanded=10, heap_moves=40, generated=20, valid=9,
            wall_ms=wall_ms,
        )
    )  # fmt: skip
    recorder.floor(
        make_graph(
            "tiny",
            [("a", 0.0, 0.0), ("b", 5.0, 0.0)],
            [("ab", "a", "b", 5.0), ("ba", "b", "a", 5.0)],
            {"bay": ["a"], "home": ["a"]},
        )
    )
    recorder.agv(AgvRow(0, moves=3, distance_m=7.5, idle_s=60.0))
    return recorder


def read(path: Path) -> list[tuple[object, ...]]:
    return duckdb.sql(f"SELECT * FROM '{path}'").fetchall()


def test_round_trip(tmp_path: Path) -> None:
    recorder = filled()
    recorder.write(tmp_path, {"seed": 7})
    for table in COLUMNS:
        expected = [
            tuple(None if isinstance(x, float) and math.isnan(x) else x for x in row) for row in recorder.rows(table)
        ]
        assert read(tmp_path / f"{table}.parquet") == expected
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 7
    assert not list(tmp_path.glob("*.tmp"))


def test_detail_is_compact_json_with_sorted_keys() -> None:
    details = [row[-1] for row in filled().rows("events")]
    assert details == [
        '{"request":0,"what":"park"}',
        '{"cause":"head-on","deadlock":0,"members":[2,1]}',
        "",
    ]


@pytest.mark.parametrize("recorder", [Recorder(), filled()])
def test_column_dictionary_matches_the_files(recorder: Recorder, tmp_path: Path) -> None:
    recorder.write(tmp_path, {})
    assert sorted(path.stem for path in tmp_path.glob("*.parquet")) == sorted(COLUMNS)
    types = {}
    for table, columns in COLUMNS.items():
        described = duckdb.sql(f"DESCRIBE SELECT * FROM '{tmp_path / table}.parquet'").fetchall()
        assert [row[0] for row in described] == list(columns)
        types[table] = [row[1] for row in described]
        for name, (unit, meaning) in columns.items():
            assert meaning
            assert unit or not name.endswith(("_s", "_m", "_deg", "_mps", "_ms", "_wh")), name
    assert types["events"] == ["DOUBLE", "VARCHAR", "INTEGER", "VARCHAR", "VARCHAR", "VARCHAR"]


def test_the_floor_is_in_the_record() -> None:
    recorder = filled()
    assert recorder.rows("vertices") == [("a", 0.0, 0.0, "bay,home", "1,1"), ("b", 5.0, 0.0, "", "")]
    assert recorder.rows("edges") == [(0, 1, 5.0), (1, 0, 5.0)]


def test_rows_have_the_fields_of_their_table() -> None:
    assert [f.name for f in fields(TaskRow)] == list(COLUMNS["tasks"])
    assert [f.name for f in fields(AgvRow)] == list(COLUMNS["agvs"])
    assert [f.name for f in fields(PlanningRow)] == list(COLUMNS["planning"])


def test_every_kind_of_event_is_explained() -> None:
    assert set(KINDS) == set(get_args(EventKind))
    assert all(kind.meaning and all(kind.keys.values()) and kind.one_of <= set(kind.keys) for kind in KINDS.values())


def test_equal_runs_give_equal_bytes_but_for_wall_clock(tmp_path: Path) -> None:
    for name, wall_ms in (("a", 1.5), ("b", 1.5), ("c", 99.0)):
        filled(wall_ms).write(tmp_path / name, {"seed": 1})
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    for file in files:
        first, second, other = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert first == second
        assert (first == other) == (file != "planning.parquet")


def test_digest_sees_every_value_and_text_boundary(tmp_path: Path) -> None:
    digests = set()
    for k, (car, vertex) in enumerate([("a", "b"), ("ab", ""), ("", "ab")]):
        recorder = Recorder()
        recorder.event(0.0, "lift", car=car, vertex=vertex)
        recorder.write(tmp_path / str(k), {})
        digests.add(json.loads((tmp_path / str(k) / "run.json").read_text())["digest"]["events"])
    assert len(digests) == 3


def test_folder_with_a_quote_in_its_name(tmp_path: Path) -> None:
    filled().write(tmp_path / "driver's run", {})
    assert (tmp_path / "driver's run" / "tasks.parquet").exists()


def test_samples_of_unequal_length_are_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        Recorder().sample(0.0, [AgvSample(0, 0.0, 0.0, 0.0, 0.0)], [], [""], [1.0])


def test_json_holds_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_json(path, {"b": NAN, "a": [np.float64(math.inf), np.int64(3), {2, 1}], "p": tmp_path, "m": AgvMode.IDLE})
    assert json.loads(path.read_text()) == {"a": [None, 3, [1, 2]], "b": None, "p": str(tmp_path), "m": "idle"}


def test_meta_is_documented() -> None:
    assert all(meaning for _, meaning in META.values())
