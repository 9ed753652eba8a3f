"""Figures and reports: they say what the metrics say, need nothing from elsewhere, and cope with empty records."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from test_analysis_runs import synthetic_meta, synthetic_recorder

from analysis.checks import failed_checks, run_checks
from analysis.figures import FIGURES, figures
from analysis.metrics import run_metrics
from analysis.record import Recorder, TaskRow
from analysis.report import deadlock_stories, headlines, incidents, number, write_index, write_report
from analysis.tables import load_run, recorded_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "example"
    synthetic_recorder().write(folder, synthetic_meta())
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return write_report(folder).read_text(encoding="utf-8")


def test_report_holds_the_headline_numbers(folder: Path, page: str) -> None:
    run = load_run(folder)
    metrics = run_metrics(run)
    p95 = round(metrics["retrieval_wait_p95_s"])
    assert f"<b>{p95 // 60}:{p95 % 60:02d}</b>" in page
    assert f"{metrics['tasks_done']} of 120 tasks were done in 2 h 00 min" in page
    for line in headlines(run, metrics):
        assert line in page
    for needed in (
        "parking-sim run map1 --agvs 6 --seed 7",
        "Seed 7.",
        "1.28.0",
        "kind poisson, per_hour 60",
        "commands (late 0, late_s 3), script –",
        "tasks.parquet",
    ):
        assert needed in page
    for check in run_checks(run.meta, metrics):
        assert check.text in page
    assert "not resolved" in page
    assert "partial CBS: no solution" in page


def test_report_needs_nothing_from_elsewhere(page: str) -> None:
    names = set(re.findall(r'xmlns(?::\w+)?="([^"]*)"', page))
    rest = re.sub(r'xmlns(?::\w+)?="[^"]*"', "", page)
    assert all(name.startswith("http://www.w3.org/") for name in names)
    assert not re.search(
        r"https?:|//[a-z]|@import|<script|url\((?!#)", re.sub(r"data:image/png;base64,[\w+/=\s]*", "", rest)
    )
    targets = re.findall(r'\b(?:href|src)="([^"]*)"', rest)
    assert all(target.startswith(("#", "data:")) for target in targets)


def test_ids_of_the_page_are_unique_and_all_references_meet_one(page: str) -> None:
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="|url\()#([\w-]+)', page)) <= set(ids)


def test_report_twice_is_the_same(folder: Path, page: str) -> None:
    assert write_report(folder).read_text(encoding="utf-8") == page


def test_every_figure_is_drawn_as_valid_svg(folder: Path) -> None:
    drawings = figures(load_run(folder))
    assert [drawing.key for drawing in drawings] == [key for key in FIGURES if key != "window"]  # ``token`` has none
    for drawing in drawings:
        assert ElementTree.fromstring(drawing.svg).get("viewBox")
        assert len(drawing.svg) < 200_000


def test_empty_record_still_makes_a_report(tmp_path: Path) -> None:
    Recorder().write(tmp_path, {})
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "<svg" not in page
    assert "0 of 0 tasks" in page
    assert "nan" not in page.lower()


def test_names_are_escaped(tmp_path: Path) -> None:
    Recorder().write(tmp_path, {"command": "parking-sim run '<b>&.yaml'", "scenario": {"garage": "<script>"}})
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "<script>" not in page
    assert "&lt;b&gt;&amp;.yaml" in page


def test_deadlock_stories() -> None:
    recorder = Recorder()
    recorder.event(3661.0, "deadlock_found", vertex="x", deadlock=4, members=[1, 2], cause="idle_in_the_way")
    recorder.event(3662.0, "stage_failed", deadlock=4, stage="partial_cbs", reason="no solution")
    recorder.event(3663.0, "stage_failed", deadlock=4, stage="leader", reason="no way")
    recorder.event(3664.0, "stage_failed", deadlock=4, stage="leader", reason="no way")
    recorder.event(3671.0, "deadlock_resolved", deadlock=4, members=[1, 2], stage="pull_over", cost_s=10.0)
    recorder.event(3700.0, "deadlock_found", deadlock=5, members=[0], cause="head-on")
    first, second = deadlock_stories(recorded_run(recorder, {}))
    assert first == {
        "found": "1:01:01",
        "members": "1, 2",
        "where": "x",
        "cause": "idle in the way",
        "tried": "partial CBS: no solution; leader: no way × 2",
        "outcome": "resolved by pull over, 10 s after the wait began",
    }
    assert second["outcome"] == "not resolved"


def test_incidents_and_failed_checks_are_told() -> None:
    recorder = Recorder()
    recorder.event(5.0, "overlap", agv=3, vertex="a", others=[4])
    recorder.task(TaskRow(0, "park", "c", "waiting"))
    run = recorded_run(recorder, {"sumo_collisions": 0, "footprint_overlaps": 1, "tasks_wanted": 1})
    assert incidents(run) == [("0:00:05", "overlap", "AGV 3", 'a {"others":[4]}')]
    passed = {check.text: check.passed for check in run_checks(run.meta, run_metrics(run))}
    assert passed == {
        "No collision in SUMO": True,
        "No overlap seen by the independent check": False,
        "Every deadlock was resolved": True,
        "Every customer let in was served": False,
        "Every request is accounted for": False,
        "Every car is accounted for": None,
        "SUMO saw customers at bays where and when the record says": None,
        "SUMO saw AGVs lift and lower cars where and when the record says": None,
        "SUMO saw AGVs drive as far as the record says": None,
        "SUMO saw batteries as the record says": None,
        "SUMO saw cars wait in the street as long as the record says": None,
        "SUMO counted time, collisions and teleports as the record says": None,
    }
    assert failed_checks(run_checks(run.meta, run_metrics(run))) == (
        "No overlap seen by the independent check: no (1 overlaps)",
        "Every request is accounted for: no (1 requests)",
        "Every customer let in was served: no (0 of 1 tasks, 1 waiting, 0 turned away, 0 void)",
    )
    counted = {"cars_initial": 0, "cars_arrived": 1, "cars_parked": 1, "cars_left": 0, "cars_in_transit": 0}
    for audit, expected in (([], True), (["car c is in no slot"], False)):
        audited = recorded_run(recorder, {**run.meta, **counted, "audit": audit})
        passed = {check.text: check.passed for check in run_checks(audited.meta, run_metrics(audited))}
        assert passed["Every car is accounted for"] is expected
    timed = recorded_run(recorder, {**run.meta, "scenario": {"duration_s": 7200.0}})
    texts = {check.text for check in run_checks(timed.meta, run_metrics(timed))}
    assert "Every customer let in was served" not in texts


def test_index_links_to_reports_next_to_it(folder: Path, page: str) -> None:
    path = write_index([folder, folder], folder.parent / "index.html")
    text = path.read_text(encoding="utf-8")
    assert text.count('href="example/report.html"') == 2
    assert "map1 · 6 AGVs · whca · seed 7" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [(float("nan"), "–"), (0, "0"), (12345, "12,345"), (2.0, "2"), (0.0133, "0.0133"), (1234.5, "1,234")],
)
def test_number(value: float, text: str) -> None:
    assert number(value) == text
