"""``parking-sim reproduce thesis``: the quick form as it is, and parts of it."""

import pandas as pd
import pytest

from parking_sim.cli import main
from parking_sim.reproduce.thesis import METRICS, PLANNERS, ROWS, best_planners, paper_value, table_cases


def test_the_quick_form_runs_and_says_what_holds(tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "thesis", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.index(METRICS["completion"]) < said.index(METRICS["conflicts"]) < said.index(METRICS["throughput"])
    assert "MAP1 x 4" in said
    assert "MAP2 x 4, 40 cars" in said
    runs = pd.read_csv(tmp_path / "thesis-runs.csv")
    assert len(runs) == 5 * 3 * 2 + 1
    assert (runs["completion"] == 1).all()
    assert (runs["conflicts"] == 0).all()
    assert runs["bound_share"].dropna().between(0, 1).all()
    assert {path.name for path in tmp_path.glob("*.svg")} == {f"thesis-{metric}.svg" for metric in METRICS}
    ticks = runs[runs["rules"] != "sumo"].set_index(["garage", "agvs", "rules", "planner"]).sort_index()
    first = ticks.loc["map1", 1, "thesis"]
    assert first.loc["astar", ["steps", "movement_cost"]].tolist() == [8490, 6260]
    assert first.loc["dstar_lite", ["steps", "movement_cost"]].tolist() == [8490, 6260]
    for work in ("nodes_expanded", "heap_moves"):
        by_planner = ticks[work].unstack("planner")
        assert (by_planner["pipeline"] < by_planner["dstar_lite"]).all()
        assert (by_planner["dstar_lite"] < by_planner["astar"]).all()
    fair = ticks["throughput"].unstack("planner").xs("fair", level="rules")
    assert (fair["pipeline"] > fair[["astar", "dstar_lite"]].max(axis=1)).all()


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
