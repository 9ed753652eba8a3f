"""A run's folder may have any name: its tables are its own, and many runs are counted once each."""

from __future__ import annotations

from pathlib import Path

import duckdb
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analysis.parquet import parquet_rows, quoted
from analysis.record import Recorder
from analysis.runs import load_runs
from analysis.tables import load_run

#: Patterns that match others, and a column.
NAMES = ("run[1]", "run1", "run*", "run?", "it's", "time_s=7", "a, b:c")


def write_run(folder: Path, mark: float) -> None:
    recorder = Recorder()
    recorder.timeline(mark, 0, 0, 0, 0, 0)
    recorder.write(folder, {"status": "finished", "scenario": {"seed": 1}})


def test_each_folder_has_its_own_rows(tmp_path: Path) -> None:
    for number, name in enumerate(NAMES):
        write_run(tmp_path / name, float(number))
    for number, name in enumerate(NAMES):
        assert load_run(tmp_path / name).timeline["time_s"].tolist() == [number]
    rows = load_runs(tmp_path).table("timeline")
    assert dict(zip(rows["run"], rows["time_s"], strict=True)) == {name: k for k, name in enumerate(NAMES)}
    assert len(rows) == len(NAMES)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.text("a1[]*?!'=,:^-{}", min_size=1, max_size=6), min_size=2, max_size=4, unique=True))
def test_names_of_any_letters(tmp_path_factory: pytest.TempPathFactory, names: list[str]) -> None:
    base = tmp_path_factory.mktemp("files")
    with duckdb.connect(config={"threads": 1}) as connection:
        for number, name in enumerate(names):
            (base / name).mkdir()
            connection.execute(f"COPY (SELECT {number} AS k) TO {quoted(str(base / name / 't.parquet'))}")
        for number, name in enumerate(names):
            rows = connection.execute(f"SELECT * FROM {parquet_rows([base / name / 't.parquet'])}").fetchall()
            assert rows == [(number, str(base / name / "t.parquet"))]


def test_a_folder_reached_by_a_link(tmp_path: Path) -> None:
    write_run(tmp_path / "there" / "a", 3.0)
    (tmp_path / "here").symlink_to(tmp_path / "there")
    assert load_runs(tmp_path / "here").table("timeline")["time_s"].tolist() == [3.0]
