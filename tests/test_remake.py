"""The docs' tables are those of the committed results, and a remake that was killed goes on where it stopped."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent


def _load() -> Any:
    spec = importlib.util.spec_from_file_location("remake", ROOT / "benchmarks" / "remake.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["remake"] = module
    spec.loader.exec_module(module)
    return module


remake = _load()


@pytest.mark.parametrize("path", remake.DOCUMENTS, ids=lambda path: path.name)
def test_tables_of_the_docs_are_those_of_the_results(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert remake.with_tables(text, remake.RESULTS) == text, "run: python benchmarks/remake.py --docs"


def test_every_table_stands_somewhere_and_every_mark_is_a_table() -> None:
    marks = {mark for path in remake.DOCUMENTS for mark in re.findall(r"<!-- table: (.*?) -->", path.read_text())}
    assert marks == set(remake.TABLES)
    ends = sum(len(re.findall("<!-- /?table", path.read_text())) for path in remake.DOCUMENTS)
    begins = sum(len(re.findall("<!-- table: ", path.read_text())) for path in remake.DOCUMENTS)
    assert ends == 2 * begins


@pytest.mark.parametrize("name", remake.SETS)
def test_results_are_of_the_cases_of_their_set(name: str) -> None:
    cases = remake.SETS[name].cases
    keys = [remake._key(case) for case in cases]
    assert len(set(keys)) == len(keys)
    for row in remake.read_results(remake.RESULTS / f"{name}.csv"):
        assert remake._key({key: row[key] for key in cases[0]}) in keys
        assert re.fullmatch(r"[0-9a-f]{7}", row["commit"])
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", row["date"])


class KilledError(Exception):
    """The process ends."""


def test_a_killed_remake_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def run(case: dict[str, Any]) -> dict[str, Any]:
        if len(made) == 2:
            made.append(-1)
            raise KilledError
        made.append(case["agvs"])
        return {"square": case["agvs"] ** 2}

    sets = {"squares": remake.RunSet("x", tuple({"garage": "g", "agvs": n, "rate": 0.0} for n in (3, 1, 2, 4)), run)}
    with pytest.raises(KilledError):
        list(remake.remake("squares", tmp_path, 1, sets))
    assert [row["square"] for row in remake.read_results(tmp_path / "squares.csv")] == [9, 1]
    assert [row["square"] for row in remake.remake("squares", tmp_path, 1, sets)] == [4, 16]
    rows = remake.read_results(tmp_path / "squares.csv")
    assert [row["square"] for row in rows] == [9, 1, 4, 16]
    assert not list(remake.remake("squares", tmp_path, 1, sets))
    monkeypatch.setattr(remake, "code_version", lambda: "another")
    assert len(list(remake.remake("squares", tmp_path, 1, sets))) == 4
    assert {row["code"] for row in remake.read_results(tmp_path / "squares.csv")} == {"another"}


@pytest.mark.parametrize("name", remake.TABLES)
def test_a_table_without_results_is_empty(tmp_path: Path, name: str) -> None:
    assert remake.table_text(name, tmp_path) == ""


def test_a_table_is_filled_in_with_what_made_it(tmp_path: Path) -> None:
    (tmp_path / "speed.csv").write_text(
        "garage,agvs,planner,repeat,sumo_s,plant_s,planning_s,execution_s,record_s,check_s,simulated_s,version,commit,date,code\n"
        "map3,8,token,1,2,1,0.5,0.5,0,0,1000,0.1.0,1234567,2026-11-27,c\n"
    )
    text = remake.with_tables("a\n<!-- table: speed -->\nold\n<!-- /table -->\nb\n", tmp_path)
    assert "old" not in text
    assert "| **all but SUMO** | **1.00** |" in text
    assert "beside other work | 250 |" in text
    assert "*Made with 0.1.0, commit 1234567, 2026-11-27: `python benchmarks/remake.py speed`*" in text
    assert remake.with_tables(text, tmp_path) == text
