"""Deadlocks explained from a record, on the command line and in the report."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import pytest

from analysis.clock import Clock
from analysis.deadlocks import deadlocks, draw, story, why
from analysis.record import Recorder
from analysis.report import write_report
from analysis.tables import load_run
from parking_sim.cli import main
from sumo_nets.graph import make_graph


@pytest.fixture
def folder(tmp_path):
    """A record of two AGVs that met in a lane while a place was blocked, and of one that was never helped."""
    places = [("a", 0.0, 0.0), ("b", 7.0, 0.0), ("c", 14.0, 0.0), ("d", 21.0, 0.0)]
    lanes = [(f"{u}{v}", u, v, 7.0) for u, v in ("ab", "ba", "bc", "cb", "cd", "dc")]
    r = Recorder()
    r.floor(make_graph("line", places, lanes))
    r.event(50.0, "fault_start", fault=0, cause="blocked", agvs=(), vertices=(3,), vertex="d")
    r.event(61.0, "plan_partial", failed=[1])
    met = {"deadlock": 0, "members": (0, 1), "cause": "ring", "waits": {0: 1, 1: 0}, "wants": {0: "c", 1: "b"}}
    r.event(70.0, "deadlock_found", 0, vertex="c", **met, holds={0: ["a", "b"], 1: ["c"]}, goals={0: "d", 1: "a"})
    for _ in range(2):
        r.event(70.0, "stage_failed", 0, deadlock=0, stage="leader", reason="no way for any leader")
    r.event(90.0, "deadlock_resolved", 0, deadlock=0, members=(0, 1), cause="ring", stage="pull_over", cost_s=30.0)
    r.event(95.0, "fault_end", fault=0, cause="blocked")
    r.event(200.0, "deadlock_found", 2, deadlock=1, members=(2,), cause="stuck", waits={}, wants={})
    r.write(tmp_path / "run", {"status": "finished", "seed": 0, "map": "line", "simulated_s": 300.0})
    return tmp_path / "run"


def test_who_held_what_why_and_at_what_cost(folder):
    first, second = deadlocks(load_run(folder))
    assert (first.holds[0], first.wants[0], first.waits[0]) == (("a", "b"), "c", 1)
    assert (first.stage, first.cost_s, first.plans_failed) == ("pull_over", 30.0, 1)
    assert first.faults == ("d is blocked (fault 0)",)
    assert second.stage == ""
    told = story(first, Clock())
    assert "AGV 0 held a, b, on the way to d, wanted c and waited for AGV 1" in told
    assert "tried in vain: leader: no way for any leader × 2" in told
    assert "found at 0:01:10" in told
    assert "resolved by pull over, 30 s after the wait began" in told
    assert "Out of order meanwhile: d is blocked (fault 0)" in why(first)
    assert "not resolved" in story(second, Clock())


def test_the_picture_shows_each_agv_and_an_arrow_to_what_it_wanted(folder):
    run = load_run(folder)
    first, second = deadlocks(run)
    svg = ElementTree.fromstring(draw(first, run.vertices, run.edges))
    assert len(svg.findall("circle")) == 2
    assert sum("marker-end" in path.attrib for path in svg.findall("path")) == 2
    assert draw(second, run.vertices, run.edges) == ""


def test_the_report_shows_it(folder):
    page = write_report(folder).read_text()
    assert page.count("Two AGVs met") >= 1


def test_the_command_line_explains_one_or_all(folder, capsys, tmp_path):
    with pytest.raises(SystemExit) as end:
        main(["explain", str(folder)])
    assert end.value.code == 0
    assert "deadlock 0" in (said := capsys.readouterr().out)
    assert "deadlock 1" in said
    with pytest.raises(SystemExit):
        main(["explain", str(folder), "0", "--svg", str(tmp_path / "d.svg")])
    assert ElementTree.parse(tmp_path / "d.svg").getroot().tag.endswith("svg")
    for words in ([str(folder), "7"], [str(tmp_path)], [str(folder), "--svg", "x.svg"]):
        with pytest.raises(SystemExit) as end:
            main(["explain", *words])
        assert end.value.code == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_real_ring_is_recorded_with_what_was_held(tmp_path):
    from pathlib import Path

    from parking_sim.config import check_scenario
    from parking_sim.simulation import simulate

    scenario = {"garage": "map1_thesis", "agvs": 4, "plant": "discrete"}
    simulate(check_scenario(scenario, "test", Path()), tmp_path / "run")
    run = load_run(tmp_path / "run")
    for deadlock in deadlocks(run):
        assert set(deadlock.holds) == set(deadlock.goals) == set(deadlock.members)
        assert all(deadlock.holds.values())
        assert story(deadlock)
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["deadlocks_found"] == len(deadlocks(run))
