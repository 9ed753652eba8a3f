"""``parking-sim reproduce thesis``: tables, claims and files, on a few cars."""

import sys

import pandas as pd
import pytest

from parking_sim.reproduce.thesis import METRICS, PLANNERS, ROWS, best_planners, paper_value, reproduce, table_cases


def test_the_tables_of_a_few_cars_are_printed_and_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys.modules["parking_sim.reproduce.thesis"], "QUICK_ROWS", (("map1", 2, 4, False),))
    reproduce(tmp_path, full=False)
    said = capsys.readouterr().out
    assert said.index(METRICS["completion"]) < said.index(METRICS["conflicts"]) < said.index(METRICS["throughput"])
    assert "| MAP1 x 2, 4 cars | - / 1 / 1 / -" in said
    runs = pd.read_csv(tmp_path / "thesis-runs.csv")
    assert len(runs) == 6
    assert (runs["completion"] == 1).all()
    assert (runs["conflicts"] == 0).all()
    assert runs["bound_share"].between(0, 1).all()
    assert {path.name for path in tmp_path.glob("*.svg")} == {f"thesis-{metric}.svg" for metric in METRICS}
    assert "every run under fair rules" in (tmp_path / "thesis.md").read_text(encoding="utf-8")


def test_the_table_has_18_combinations_and_the_paper_a_figure_for_each():
    cells = {(case.garage, case.agvs, case.planner) for case in table_cases(ROWS)}
    assert len(cells) == 18
    assert paper_value("throughput", "dstar_lite", "map1", 4, None) == 0.0502
    assert paper_value("steps", "astar", "map2", 4, None) == 17824
    assert paper_value("throughput", "astar", "map2", 4, 40) is None
    assert all(paper_value("nodes_expanded", p, g, n, None) for g, n, p in cells)


@pytest.mark.parametrize(("lead", "holds"), [(0.001, True), (0.0, True), (-0.001, False)])
def test_the_default_planner_may_be_beaten_by_no_more_than_the_interval(lead, holds):
    rows = [
        {"garage": "map1", "agvs": 2, "planner": p, "seed": s, "throughput": 0.03 + s * 1e-6 + lead * (p == "pipeline")}
        for p in PLANNERS
        for s in range(10)
    ]
    (finding,) = best_planners(pd.DataFrame(rows))
    assert finding.holds is holds
