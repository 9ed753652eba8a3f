"""A record that is damaged, foreign or cut off is told in one line, whatever command reads it."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path

import pytest

import parking_sim as ps
from analysis.damage import damage
from analysis.tables import load_run
from parking_sim.cli import main

KEYS = {"plant": "discrete", "agvs": 2, "duration_s": 200.0, "record": {"replay": False}}
#: What stands in a JSON file instead of what belongs there.
FOREIGN = (
    b"",
    b"\x00" * 64,
    b"{",
    b"[]",
    b"7",
    b"null",
    b'"text"',
    b"{}",
    b"[[[[" * 30_000,
    b'{"status": NaN}',
    b"\xff",
)
ODD = (None, [], {}, "x" * 10_000, True, -1, 1e999, [1], {"a": 1})


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    ps.simulate(ps.load_scenario("map1", KEYS), folder)
    return folder


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep") / "out"
    ps.sweep([ps.load_scenario("map1", {**KEYS, "seed": seed}) for seed in (1, 2)], folder, workers=1)
    return folder


def said(capfd: pytest.CaptureFixture[str], *words: object) -> str:
    """What a command complains of; it may also find nothing wrong. A traceback fails the test."""
    capfd.readouterr()
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    err = capfd.readouterr().err
    assert end.value.code in (0, 1, 2), words
    assert err.count("\n") <= 1, err
    assert len(err) < 700, err
    assert (end.value.code == 2) == err.startswith("error: "), err
    return err


def readers(folder: Path) -> tuple[tuple[object, ...], ...]:
    return ("explain", folder), ("replay", folder), ("compare", folder, folder), ("rerun", folder)


def test_a_whole_record_is_not_damaged(record: Path) -> None:
    assert damage(record) == ""


@pytest.mark.parametrize("table", ["events", "trajectory", "vertices", "tasks"])
def test_a_table_that_is_missing_cut_off_or_changed_is_named(record, tmp_path, capfd, table) -> None:
    for change in (
        lambda data: b"",
        lambda data: data[:-9],
        lambda data: data[: len(data) // 2],
        lambda _: b"PAR1" * 9,
    ):
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(record, folder)
        path = folder / f"{table}.parquet"
        path.write_bytes(change(path.read_bytes()))
        assert f"{table}.parquet" in damage(folder)
        assert any(f"{table}.parquet" in said(capfd, *words) for words in readers(folder)[:3])
    path.unlink()
    assert damage(folder).endswith("it is missing")
    shutil.copy(record / "agvs.parquet", path)
    assert "has no column" in damage(folder)


def test_bytes_changed_anywhere_never_end_in_a_traceback(record, tmp_path, capfd) -> None:
    rng = random.Random(1)
    for _ in range(12):
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(record, folder)
        path = rng.choice(sorted(folder.glob("*.*")))
        data = bytearray(path.read_bytes())
        for _ in range(rng.choice((1, 1, 5, 50))):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(data)
        said(capfd, *rng.choice(readers(folder)[:3]))


def test_a_foreign_run_json_is_told(record, tmp_path, capfd) -> None:
    shutil.copytree(record, tmp_path / "run")
    path, rng = tmp_path / "run" / "run.json", random.Random(2)
    for text in FOREIGN:
        path.write_bytes(text)
        said(capfd, *rng.choice(readers(tmp_path / "run")[:3]))
    meta = json.loads((record / "run.json").read_text())
    for key in list(meta)[::2]:
        path.write_text(json.dumps({**meta, key: rng.choice(ODD)}))
        said(capfd, *rng.choice(readers(tmp_path / "run")[:3]))
    path.write_text(json.dumps({**meta, "simulated_s": "long"}))
    says = f"error: {path}: simulated_s: 'long': a run writes a number\n"
    assert said(capfd, "explain", tmp_path / "run") == says


@pytest.mark.parametrize("name", ["sweep.json", "failures.json"])
def test_a_foreign_file_of_a_sweep_is_told(sweep, tmp_path, capfd, name) -> None:
    shutil.copytree(sweep, tmp_path / "out")
    for text in (*FOREIGN, b'{"runs": 7, "failures": [7]}', b'{"runs": [{"run": 1}], "failures": [{}]}'):
        (tmp_path / "out" / name).write_bytes(text)
        assert said(capfd, "compare", tmp_path / "out", tmp_path / "out").startswith("error: ")


@pytest.mark.parametrize(
    "line", [b"{}", b"[1]", b'["events"]', b'["events", [1]]', b'["nothing", []]', b"\xff\xff", b"nan,"]
)
def test_a_foreign_line_in_a_journal_is_told(tmp_path, capfd, line) -> None:
    (tmp_path / "journal.jsonl").write_bytes(b"0.0\n" + line + b"\n60.0\n")
    assert said(capfd, "explain", tmp_path).startswith(f"error: {tmp_path}/journal.jsonl: line 2: is damaged")
    with pytest.raises(ps.InputError):
        load_run(tmp_path)
