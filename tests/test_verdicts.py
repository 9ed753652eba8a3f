"""Each claim of the papers can come out either way: planted samples for it, against it, and too small to tell."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import pandas as pd
import pytest

from analysis.measures import interval
from parking_sim.reproduce import binary_tree, lg, rrt_grid, two_stage_ga
from parking_sim.reproduce.findings import Finding, Verdict, findings_table
from parking_sim.reproduce.one_line_robots import Setting
from parking_sim.reproduce.statistics import is_below, is_less, is_most
from parking_sim.reproduce.thesis_claims import best_planners, claims
from parking_sim.reproduce.thesis_runs import CONTENDERS, DEFAULT, PLANNERS, ROWS

YES, NO, TOO_FEW = Verdict.YES, Verdict.NO, Verdict.TOO_FEW


def judged(findings: Sequence[Finding]) -> dict[str, Verdict]:
    return {finding.what: finding.holds for finding in findings if finding.holds is not Verdict.NO_CLAIM}


# --- paper 004 --------------------------------------------------------------------------------------------------------

#: Collisions, work, stop and seconds of each method as the paper ranks them.
RANKS = {"two-stage": (0.0, 2.0, 0.0, 0.01), "single": (1.0, 3.0, 1.0, 0.01), "CBS": (2.0, 1.0, 0.0, 0.01)}


def ga_runs(instances: int, sign: int) -> pd.DataFrame:
    rows = [
        (n, k, method, *(5 + sign * value for value in values[:3]), 1.0 if sign > 0 else 100.0, False, 0)
        for n in (5, 10, 15, 20, 25)
        for k in range(instances)
        for method, values in RANKS.items()
    ]
    return pd.DataFrame(rows, columns=two_stage_ga._COLUMNS)


@pytest.mark.parametrize(("instances", "sign", "said"), [(5, 1, YES), (5, -1, NO), (4, 1, TOO_FEW), (4, -1, TOO_FEW)])
def test_paired_claims_of_the_genetic_algorithms(instances, sign, said):
    found = judged([*two_stage_ga.compare(ga_runs(instances, sign), 1.0)])
    tests = {what: holds for what, holds in found.items() if "Wilcoxon" in what}
    assert len(tests) == 4 + 4 + 4 + 3 + 5
    assert set(tests.values()) == {said}
    (time,) = set(found) - set(tests)
    assert found[time] is (YES if sign > 0 else NO)


# --- paper 000 --------------------------------------------------------------------------------------------------------


def lg_runs(without: Sequence[bool], with_: Sequence[bool]) -> pd.DataFrame:
    rows = [
        {"form": form, "noise": Setting().noise, "seed": seed, "deadlock": deadlock, "ended_s": 1.0, "predicted": 1}
        | {f"a{n}": 1 for n in range(10)}
        for form, deadlocks in ((lg.WITHOUT, without), (lg.WITH, with_))
        for seed, deadlock in enumerate(deadlocks)
    ]
    return pd.DataFrame(rows)


@pytest.mark.parametrize(("seeds", "said"), [(30, YES), (30, NO), (3, TOO_FEW), (2, TOO_FEW)])
@pytest.mark.parametrize("locked_without", [True, False])
def test_claims_about_deadlocks(seeds, said, locked_without):
    locked = locked_without if said is TOO_FEW else said is YES
    found = judged([*lg.compare(lg_runs([locked] * seeds, [not locked] * seeds), Setting())])
    assert len(found) == 3
    assert set(found.values()) == {said}


def test_runs_too_short_to_lock_up_show_no_difference():
    found = judged([*lg.compare(lg_runs([False] * 30, [False] * 30), Setting())])
    assert list(found.values()) == [NO, YES, TOO_FEW]


# --- paper 001 --------------------------------------------------------------------------------------------------------


def rrt_runs(runs: int, holds: bool) -> pd.DataFrame:
    # length and seconds of RRT, RRT* and RRT-GRID in each category, in the paper's ranks or against them all
    figures = {"RRT": (3.0, 2.0), "RRT*": (2.0, 3.0), "RRT-GRID": (1.0, 1.0)}
    if not holds:
        figures = {"RRT": (1.0, 2.0), "RRT*": (2.0, 1.0), "RRT-GRID": (3.0, 3.0)}
    rows = [
        (c, layout, run, planner, length + 0.01 * (run % 3), seconds + 0.01 * (run % 2), 10)
        for c, layout, run in itertools.product(range(1, 6), (1, 2), range(runs))
        for planner, (length, seconds) in {**figures, rrt_grid.VISIBILITY: (1.0, 1.0)}.items()
    ]
    return pd.DataFrame(rows, columns=["category", "layout", "run", "planner", "length_px", "cpu_s", "samples"])


@pytest.mark.parametrize(("runs", "holds", "said"), [(8, True, YES), (8, False, NO), (1, True, TOO_FEW)])
def test_claims_about_lengths_and_times(runs, holds, said):
    found = judged([*rrt_grid.compare(rrt_runs(runs, holds))])
    of_rrt_star = {what: v for what, v in found.items() if "length in %, RRT-GRID to RRT*, C1" in what}
    assert len(found) == 4 * 6
    # the paper prints RRT-GRID longer than RRT* in category 1
    assert set(of_rrt_star.values()) == {{YES: NO, NO: YES, TOO_FEW: TOO_FEW}[said]}
    assert {v for what, v in found.items() if what not in of_rrt_star} == {said}


# --- paper 003 --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("longer", "ms", "said"), [(1.0, 0.1, YES), (1.5, 3.0, NO)])
def test_claims_about_routes(longer, ms, said):
    graphs = binary_tree.floors()
    rows = [(name, "a", "b", 5, 7, 10.0 * longer, 10.0, ms) for name in graphs for _ in range(12)]
    columns = ["floor", "start", "goal", "left_nodes", "right_nodes", "route_m", "shortest_m", "ms"]
    found = judged([*binary_tree.compare(pd.DataFrame(rows, columns=columns), graphs)])
    assert len(found) == 2 + 2 * len(graphs)
    assert set(found.values()) == {said}


# --- paper 002 --------------------------------------------------------------------------------------------------------


def thesis_runs(holds: bool, rows: Sequence[tuple[str, int, bool, int | None]] = ROWS) -> pd.DataFrame:
    figures = []
    for (garage, agvs, park_only, cars), rules in itertools.product(rows, ("thesis", "fair", "sumo")):
        for planner in PLANNERS:
            low = (garage == "map1") == holds  # A* and D* Lite are to be ahead
            ours = planner in CONTENDERS
            work = {"astar": 3, "dstar_lite": 2}.get(planner, 1) if holds else 1
            figures.append(
                {
                    "garage": garage, "agvs": agvs, "planner": planner, "rules": rules, "park_only": park_only,
                    "cars": float("nan") if cars is None else cars, "throughput": 1.0 if ours != low else 0.5,
                    "nodes_expanded": work, "completion": 1.0 if holds else 0.5, "conflicts": 0,
                }
            )  # fmt: skip
    return pd.DataFrame(figures)


@pytest.mark.parametrize(("holds", "said"), [(True, YES), (False, NO)])
def test_each_claim_of_the_thesis_is_judged_for_each_planner_under_all_rules(holds, said):
    found = judged([*claims(thesis_runs(holds))])
    assert len(found) == 3 * 3 * len(CONTENDERS) + len(PLANNERS)
    assert set(found.values()) == {said}


def test_a_tie_holds_neither_way():
    runs = thesis_runs(True).assign(throughput=1.0)
    found = judged([*claims(runs)])
    assert {holds for what, holds in found.items() if "density" in what} == {NO}


@pytest.mark.parametrize("holds", [True, False])
def test_claims_about_rows_that_are_not_there_are_left_open(holds):
    quick = judged([*claims(thesis_runs(holds, [*ROWS[:4], ("map2", 4, True, 40)]))])
    for what, said in quick.items():
        if "high density" in what or "expansions" in what:
            assert said is TOO_FEW
        else:
            assert said is (YES if holds else NO)


@pytest.mark.parametrize(
    ("lead", "seeds", "said"), [(0.001, 10, YES), (-0.001, 10, NO), (0.0, 10, TOO_FEW), (0.001, 1, TOO_FEW)]
)
def test_the_default_planner_is_best_if_the_whole_interval_says_so(lead, seeds, said):
    rows = [
        {"garage": "map1", "agvs": 2, "planner": p, "seed": s, "throughput": 0.03 + lead * (p == DEFAULT)}
        for p in PLANNERS
        for s in range(seeds)
    ]
    for row in rows[:: len(PLANNERS) + 1]:
        row["throughput"] += 1e-5
    (finding,) = best_planners(pd.DataFrame(rows))
    assert finding.holds is said


# --- what samples say -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("says", [is_less, lambda a, b: is_below(interval(a), 0.0)])
@pytest.mark.parametrize("n", [1, 2, 4, 5, 9])
def test_a_test_says_yes_and_no_of_the_same_sizes(says: Callable[[list[float], list[float]], Verdict], n):
    low, high = [-1.0 - 0.01 * k for k in range(n)], [1.0 + 0.01 * k for k in range(n)]
    assert {says(low, high), says(high, low)} in ({YES, NO}, {TOO_FEW})
    assert says([0.0, 1.0, -1.0], [0.0, 0.0, 0.0]) is TOO_FEW


def test_four_pairs_never_tell_and_five_can():
    assert is_less([0.0] * 4, [1.0] * 4) is TOO_FEW
    assert is_less([0.0] * 5, [1.0] * 5) is YES
    assert is_less([1.0] * 5, [0.0] * 5) is NO


@pytest.mark.parametrize("n", [*range(1, 12), 30])
def test_shares_tell_from_four_on(n):
    assert is_most(n, n) is (YES if n >= 4 else TOO_FEW)
    assert is_most(0, n) is (NO if n >= 4 else TOO_FEW)
    assert is_most(n // 2, 2 * (n // 2) or 1) is TOO_FEW


def test_the_quick_form_names_the_full_one():
    findings = [Finding("a", "1", "2", "", TOO_FEW), Finding("b", "1", "2", "", YES)]
    assert "| too few to tell: run --full |" in findings_table(findings, full=False)
    assert "run --full" not in findings_table(findings, full=True)
    assert "| too few to tell |" in findings_table(findings, full=True)
