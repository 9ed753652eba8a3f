"""The quick forms of the reproductions of papers 003 and 004, and the statistics below them."""

import csv
import itertools
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from parking_sim.cli import main
from parking_sim.reproduce.binary_tree import run_queries
from parking_sim.reproduce.published import published
from parking_sim.reproduce.statistics import fewer, wilson
from parking_sim.reproduce.two_stage_ga import Task, plan_instance
from sumo_nets.floors import ForkFloor, one_way_lattice


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return {row["figure"]: row for row in csv.DictReader(file)}


def call(*words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


def test_binary_tree_quick(tmp_path, capsys):
    assert call("reproduce", "binary-tree", "--out", str(tmp_path)) == 0
    rows = rows_of(tmp_path / "binary-tree.csv")
    assert rows["two-way nodes"]["paper"] == rows["two-way nodes"]["ours"] == "147"
    assert rows["one-way nodes"]["paper"] == rows["one-way nodes"]["ours"] == "69"
    assert rows["fork floor: optimal, % of 150"]["claim holds"] == "yes"
    assert rows["lattice 18 x 12: optimal, % of 150"]["claim holds"] == "no"
    assert float(rows["map1: route / shortest, mean"]["ours"]) > 1
    assert "| claim holds |" in capsys.readouterr().out
    assert (tmp_path / "binary-tree.svg").stat().st_size > 10_000


def test_two_stage_ga_quick(tmp_path):
    assert call("reproduce", "two-stage-ga", "--out", str(tmp_path)) == 0
    rows = rows_of(tmp_path / "two-stage-ga.csv")
    assert rows["20 robots: collisions, single"]["paper"] == "1.37"
    tests = [row["claim holds"] for what, row in rows.items() if "Wilcoxon p" in what]
    assert tests == ["too few to tell: run --full"] * (4 + 4 + 4 + 3 + 5)
    assert (tmp_path / "two-stage-ga.svg").stat().st_size > 10_000
    with (tmp_path / "two-stage-ga-runs.csv").open(encoding="utf-8") as file:
        runs = list(csv.DictReader(file))
    assert len(runs) == 4 * 5 * 3
    work = {(r["robots"], r["instance"], r["method"]): float(r["work"]) - float(r["stop"]) for r in runs}
    for n, k in itertools.product(("5", "10", "15", "20", "25"), "0123"):
        assert work[n, k, "single"] == pytest.approx(work[n, k, "two-stage"], abs=1e-3)


def test_twenty_robots_take_a_tenth_of_the_papers_time():
    rows, _ = plan_instance(Task(20, 0, 0.1, 1))
    seconds = {row[2]: row[6] for row in rows}
    assert seconds["two-stage"] <= 2.48


def test_queries_repeat_and_detours_are_no_short_cuts():
    graph = one_way_lattice(8, 6)
    first, again = (run_queries("lattice", graph, 40).drop(columns="ms") for _ in range(2))
    assert first.equals(again)
    assert (first["route_m"] >= first["shortest_m"] - 1e-9).all()
    assert (run_queries("fork", ForkFloor().graph(), 20)["left_nodes"] > 1).all()


def test_the_published_tables_are_whole():
    paper = published("two_stage_ga")
    for measure in ("collisions", "work", "stop", "seconds"):
        assert all(len(values) == len(paper["robots"]) for values in paper[measure].values())
    assert len(published("binary_tree")["queries"]) == 10


def test_wilson_against_its_definition():
    low, high = wilson(91, 989)
    for p in (low, high):
        assert abs(91 / 989 - p) == pytest.approx(1.959964 * np.sqrt(p * (1 - p) / 989), rel=1e-6)
    assert wilson(10, 10)[1] == pytest.approx(1.0)
    assert wilson(0, 10)[0] == pytest.approx(0.0)


@settings(deadline=None)
@given(st.lists(st.integers(-4, 4), min_size=1, max_size=7).filter(any))
def test_the_signed_rank_test_against_all_signs(differences):
    d = np.array([x for x in differences if x], dtype=float)
    size = np.abs(d)
    ranks = np.array([(size < s).sum() + ((size == s).sum() + 1) / 2 for s in size])
    sums = [ranks[np.array(signs)].sum() for signs in itertools.product([False, True], repeat=len(d))]
    exact = np.mean([s <= ranks[d > 0].sum() + 1e-9 for s in sums])
    found = fewer(d.tolist(), [0.0] * len(d))
    assert found == pytest.approx(exact)
    assert fewer([1.0, 2.0], [1.0, 2.0]) == 1.0


def test_route_and_turns(capsys):
    assert call("route", "map1", "bay2_3w", "slot8_5s1") == 0
    said = capsys.readouterr().out
    assert said.startswith("bay2_3w > ")
    assert "left child first" in said
    assert "shortest" in said
    assert call("route", "map1", "bay2_3w", "slot8_5s1", "--router", "shortest") == 0
    assert "left" not in capsys.readouterr().out
    assert call("route", "map1", "nowhere", "slot8_5s1") == 2
    assert "map1: 'nowhere': no such vertex" in capsys.readouterr().err
    assert call("turns", "map1") == 0
    assert "turns can be driven" in capsys.readouterr().out
    assert call("turns", "map1", "--wheelbase", "12", "--steer", "40") == 1


def test_only_the_first_instances(tmp_path, monkeypatch):
    class AskedError(Exception):
        pass

    def ask(instances, limit_s):
        raise AskedError((instances, limit_s))

    monkeypatch.setattr(sys.modules["parking_sim.reproduce.two_stage_ga"], "run_experiment", ask)
    for words, asked in ((["--full"], (100, 3.0)), (["--full", "--instances", "3"], (3, 3.0)), ([], (4, 0.5))):
        with pytest.raises(AskedError) as caught:
            main(["reproduce", "two-stage-ga", *words, "--out", str(tmp_path)])
        assert caught.value.args == (asked,)
