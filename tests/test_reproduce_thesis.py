"""``parking-sim reproduce thesis``: the quick form as it is, and parts of it."""

import csv

import pandas as pd
import pytest

from parking_sim.cli import main
from parking_sim.reproduce.thesis_paper import cause, contradictions, printed, program, published, slips
from parking_sim.reproduce.thesis_runs import CONTENDERS, DEFAULT, METRICS, PLANNERS, ROWS, table_cases
from parking_sim.reproduce.thesis_tables import metric_table, program_table, slips_table


def test_the_quick_form_runs_and_says_what_holds(tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "thesis", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    for planner in PLANNERS:
        assert f"\n{planner}: " in f"\n{said}" or f"`{planner}`" in said.split("\n\n")[0]
    assert said.index(METRICS["completion"]) < said.index(METRICS["conflicts"]) < said.index(METRICS["throughput"])
    assert "MAP1 x 4" in said
    assert "MAP2 x 4, 40 cars" in said
    runs = pd.read_csv(tmp_path / "thesis-runs.csv")
    assert len(runs) == (5 + 2) * len(PLANNERS) + len(CONTENDERS)
    assert (runs["completion"] == 1).all()
    assert (runs["conflicts"] == 0).all()
    assert runs["bound_share"].dropna().between(0, 1).all()
    assert {path.name for path in tmp_path.glob("*.svg")} == {f"thesis-{metric}.svg" for metric in METRICS}
    ticks = runs[runs["rules"] != "sumo"].set_index(["garage", "agvs", "rules", "planner"]).sort_index()
    first = ticks.loc["map1", 1, "thesis"]
    assert first.loc["astar", ["steps", "movement_cost"]].tolist() == [8490, 6260]
    assert first.loc["dstar_lite", ["steps", "movement_cost"]].tolist() == [8490, 6260]
    assert first.loc["pipeline", ["steps", "movement_cost"]].tolist() == [9176, 6260]
    assert first.loc["pipeline", "nodes_expanded"] == first.loc["dstar_lite", "nodes_expanded"]
    for work in ("nodes_expanded", "heap_moves"):
        by_planner = ticks[work].unstack("planner")
        assert (by_planner[DEFAULT] < by_planner["dstar_lite"]).all()
        assert (by_planner["dstar_lite"] < by_planner["astar"]).all()
    fair = ticks["throughput"].unstack("planner").xs("fair", level="rules")
    assert (fair[DEFAULT] > fair[["astar", "dstar_lite"]].max(axis=1)).all()
    with (tmp_path / "thesis.csv").open(encoding="utf-8") as file:
        verdicts = {row["figure"]: row["claim holds"] for row in csv.DictReader(file)}
    for planner in CONTENDERS:
        assert verdicts[f"thesis rules: low density: A* or D* Lite has a higher throughput than `{planner}`"] in (
            "yes", "no",
        )  # fmt: skip
        open_claim = verdicts[f"fair rules: high density: `{planner}` has the highest throughput"]
        assert open_claim == "too few to tell: run --full"  # 40 of 390 cars


def test_the_table_has_all_combinations_and_the_paper_a_figure_for_each_of_its_18():
    cells = {(case.garage, case.agvs, case.planner) for case in table_cases(ROWS)}
    assert len(cells) == 6 * len(PLANNERS)
    assert printed("throughput", "dstar_lite", "map1", 4) == 0.0502
    assert program("steps", "astar", "map2", 4) == 17824
    assert all(printed("nodes_expanded", p, g, n) for g, n, *_ in ROWS for p in ("pipeline", "astar", "dstar_lite"))
    assert printed("nodes_expanded", DEFAULT, "map1", 4) is None


def test_two_cells_of_the_thesis_contradict_its_ratio_column():
    by_hand = set()
    for planner, table in published()["printed"].items():
        columns = zip(table["valid_expansions"], table["nodes_generated"], table["valid_ratio"], strict=True)
        for row, (valid, generated, ratio) in zip(published()["rows"], columns, strict=True):
            if f"{valid / generated:.4f}" != f"{ratio:.4f}":
                by_hand.add((planner, *row))
    assert by_hand == {("astar", "map1", 1), ("pipeline", "map1", 2)}
    assert contradictions() == by_hand
    evidence = {(slip.planner, slip.metric, slip.printed): slip.evidence for slip in slips()}
    assert len(evidence) == 8
    for figure in (("astar", 430873), ("pipeline", 34386)):
        assert "contradicts the printed figure" in evidence[figure[0], "nodes_generated", figure[1]]
        assert "fits the likely one" in evidence[figure[0], "nodes_generated", figure[1]]
    assert evidence["astar", "nodes_generated", 430874] == "none: the printed ratio 0.4139 fits the printed figure"
    assert evidence["astar", "nodes_generated", 624886] == "none: the printed ratio 0.4770 fits both"
    assert "run again" in evidence["pipeline", "movement_cost", 6269]
    assert slips_table().count("\n") == 2 + 8


RUNS = pd.DataFrame(
    {
        "garage": garage, "agvs": agvs, "planner": planner, "rules": rules, "cars": float("nan"),
        "steps": 2 * program("steps", planner, garage, agvs) if (planner, agvs) == ("astar", 2) else 8490,
        "movement_cost": program("movement_cost", planner, garage, agvs), "nodes_generated": 5,
    }
    for garage, agvs in (("map1", 1), ("map1", 2))
    for planner in ("astar", "dstar_lite")
    for rules in ("thesis", "fair")
)  # fmt: skip


def test_rows_far_from_the_program_are_flagged_and_want_a_cause(monkeypatch):
    lines = [line.split("|") for line in program_table(RUNS).splitlines()[2:]]
    cells = {(line[1].strip(), line[2].strip()): [cell.strip() for cell in line[3:-1]] for line in lines}
    assert len(cells) == 4
    assert cells["MAP1 x 1", "A*"] == ["8,490", "8,490", "0", "6,260", "6,260", "0", ""]
    assert cells["MAP1 x 2", "A*"][2] == "**+100.0 %**"
    assert cells["MAP1 x 2", "A*"][1] == "4,296 (print)"
    assert cells["MAP1 x 2", "A*"][-1] == "not known"
    monkeypatch.setitem(published()["causes"], "astar", {"map1 x 2": "AGVs overlap there"})
    assert cause("astar", "map1", 2) == "AGVs overlap there"
    assert "AGVs overlap there" in program_table(RUNS)


def test_causes_are_of_rows_that_the_thesis_has():
    rows = {f"{garage} x {agvs}" for garage, agvs in published()["rows"]}
    assert all(set(of) <= rows for of in published()["causes"].values())


def test_missing_runs_are_left_out_and_contradicted_cells_marked():
    table = metric_table(RUNS[RUNS["rules"] == "thesis"], "nodes_generated")
    assert "fair rules" not in table
    assert "430,873 (!)" in table
    assert "430,874 (!)" not in table
