"""Paper 000's experiment: ten robots on a one-line grid."""

from __future__ import annotations

import csv
from dataclasses import replace

import pytest

from parking_sim.cli import main
from parking_sim.reproduce.one_line_robots import Setting, drive, one_line_graph
from parking_sim.reproduce.published import published
from sumo_nets.one_line import OneLine


def test_quick(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "lg", "--out", str(tmp_path)])
    assert ended.value.code == 0
    with (tmp_path / "lg.csv").open(encoding="utf-8") as file:
        rows = {row["figure"]: row for row in csv.DictReader(file)}
    assert rows["no run in deadlock, with replanning"]["claim holds"] == "too few to tell: run --full"
    assert rows["most runs in deadlock, without replanning"]["paper"] == "3 of 3"
    assert rows["all robots: arrivals of 2, with replanning"]["ours"] == "2.0"
    assert "| claim holds " in capsys.readouterr().out
    assert (tmp_path / "lg.svg").stat().st_size > 10_000


def test_the_published_means_are_those_of_the_papers_text():
    paper = published("lg")
    assert sum(paper["without"]) / 10 == pytest.approx(13.3, abs=0.05)
    assert sum(paper["with"]) / 10 == pytest.approx(19.3, abs=0.05)


def test_two_robots_that_would_meet_lock_up_only_without_replanning():
    """No bay to give way but those at the ends, and moves of very different length: some seeds lock up, none with."""
    line = OneLine(robots=4, unloading=2, narrow=6, passing=1, picking=1)
    setting = replace(Setting(), line=line, noise=0.6, round_trips=5)
    without, with_ = ([drive(setting, replanning, seed) for seed in range(6)] for replanning in (False, True))
    assert any(o.deadlock for o in without)
    assert not any(o.deadlock for o in with_)
    assert all(o.arrivals == (10,) * 4 for o in with_)
    assert all(sum(o.arrivals) < 40 for o in without if o.deadlock)
    assert all(o.predicted == 0 for o in without)


def test_runs_repeat():
    setting = Setting(round_trips=1, end_s=120.0)
    assert drive(setting, True, 5) == drive(setting, True, 5)


def test_the_grid_is_one_line_with_bays():
    graph = one_line_graph(Setting().line)
    assert len(graph.homes) == 10
    assert len(graph.slots) == 6
    ends = [v for v, ways in enumerate(graph.successors) if len(ways) == 1]
    assert set(ends) >= {*graph.slots, *graph.roles["refuge"]}
    assert max(len(ways) for ways in graph.successors) == 4
