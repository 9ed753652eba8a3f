"""The record beside SUMO's own outputs: they agree in every garage, and a broken seam is seen."""

from __future__ import annotations

import csv
import html
import json
import random
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from whole_runs import check_all_done, run

import parking_sim.assembly
import sumo_nets.build
from analysis.checks import failed_checks, run_checks
from analysis.metrics import run_metrics
from analysis.report import write_report
from analysis.tables import Run, load_run
from analysis.witness import WITNESSES, witnesses
from parking_sim.config import check_scenario
from parking_sim.simulation import simulate
from sumo_nets.build import build_net
from sumo_nets.generate import generate_layout
from sumo_nets.layout import parse_layout
from sumo_nets.plan import GaragePlan, plan_garage
from sumo_nets.read import read_net

DOCS = Path(__file__).parent.parent / "docs"
BRISK = {"handling_median_s": 5.0}
#: Aisles and bays on both sides of row 10, where "c2_10" sorts before "c2_9".
TALL = """
name: tall
pitch_m: 7.0
handover: bay
aisles:
  - {from: [2, 16], to: [2, 8], way: one}
  - {from: [3, 8], to: [3, 16], way: one}
  - {from: [9, 16], to: [9, 8], way: one}
  - {from: [10, 8], to: [10, 16], way: one}
  - {from: [2, 8], to: [10, 8], way: two}
  - {from: [2, 16], to: [10, 16], way: two}
slots:
  - {from: [5, 8], to: [7, 8], side: north, per_cell: 2}
  - {from: [5, 16], to: [7, 16], side: north, per_cell: 2}
bays:
  - {at: [2, 9], side: west}
  - {at: [2, 12], side: west}
  - {at: [2, 15], side: west}
homes:
  - {at: [3, 9], side: east, per_cell: 2}
  - {at: [3, 12], side: east, per_cell: 2}
chargers:
  - {at: [2, 16], side: west}
street: {from: [0, 17], to: [0, 6]}
"""
NAMES = ("agv0", "customer1", "a b", "<&\"'>", "!x", "Ä-Ö 12 ☂", "n" * 300)


def park_and_exit(folder: Path, garage: str, cars: int = 8, **keys: object) -> Run:
    workload = {"kind": "park_exit", "cars": cars}
    return run(folder, **{"garage": garage, "agvs": 3, "customers": BRISK, "workload": workload, **keys})


def facts(record: Run) -> dict[str, int]:
    """Facts that each witness compared, all of them right."""
    assert [words for t in record.meta["witnesses"].values() for words in t["words"]] == []
    assert all(t["wrong"] == 0 for t in record.meta["witnesses"].values())
    return {name: t["facts"] for name, t in record.meta["witnesses"].items()}


@pytest.fixture(scope="module")
def tall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_net(parse_layout(TALL), tmp_path_factory.mktemp("nets"))[0]


@pytest.fixture(scope="module")
def tall_run(tall: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return park_and_exit(tmp_path_factory.mktemp("runs") / "tall", str(tall))


def test_a_garage_whose_names_sort_unlike_its_layout(tall: Path, tall_run: Run) -> None:
    graph = read_net(tall).graph
    assert [graph.names[bay] for bay in graph.bays] == ["bay2_9w", "bay2_12w", "bay2_15w"]
    assert list(graph.bays) != sorted(graph.bays)
    check_all_done(tall_run, 8)
    assert len(set(tall_run.tasks.origin) & {graph.names[bay] for bay in graph.bays}) == 3
    assert facts(tall_run)["customers"] == 16
    assert facts(tall_run)["agvs"] == 32


def test_fewer_bays_are_the_ones_of_the_layout(tmp_path: Path, tall: Path) -> None:
    record = park_and_exit(tmp_path / "run", str(tall), bays=1)
    assert facts(record)["customers"] == 16
    assert set(record.tasks[record.tasks.kind == "park"].origin) == {"bay2_9w"}


@pytest.mark.parametrize("step_s", [0.5, 0.1])
def test_the_script_of_the_docs_finds_the_same(step_s: float, tall_run: Run, tmp_path: Path, tall: Path) -> None:
    script = re.search(r"```python\n(.*?)```", (DOCS / "witnesses.md").read_text(encoding="utf-8"), re.DOTALL)[1]
    assert len(script.splitlines()) == 10
    (tmp_path / "stays.py").write_text(script, encoding="utf-8")
    record = park_and_exit(tmp_path / "run", str(tall), step_s=step_s)
    told = subprocess.run(
        [sys.executable, "stays.py", "run"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    assert told.splitlines()[-1] == "16 of 16 stays as in tasks"
    assert (record.meta["digest"] == tall_run.meta["digest"]) == (step_s == tall_run.meta["step_s"])


def swap_sites(net, first: int = 0, second: int = 1):
    """The same garage, in which customers are sent to each other's bays."""
    bays = list(net.bay_sites)
    one, two = bays[first], bays[second]
    return replace(net, bay_sites={**net.bay_sites, one: net.bay_sites[two], two: net.bay_sites[one]})


def test_a_broken_seam_between_controller_and_plant_is_seen(
    tmp_path: Path, tall: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parking_sim.assembly, "read_net", lambda source: swap_sites(read_net(source)))
    scenario = {"garage": str(tall), "agvs": 3, "customers": BRISK, "workload": {"kind": "park_exit", "cars": 4}}
    summary = simulate(check_scenario(scenario, "test", Path()), tmp_path / "run")
    record = load_run(tmp_path / "run")
    exchanged = {"bay2_9w", "bay2_12w"}
    stood = record.tasks.origin.isin(exchanged).sum() + record.tasks.destination.isin(exchanged).sum()
    customers = record.meta["witnesses"]["customers"]
    assert (customers["facts"], customers["wrong"]) == (8, stood)
    assert summary.metrics["customers_witnessed_share"] == 1 - stood / 8
    (failed,) = summary.failed
    assert "SUMO saw customers at bays" in failed
    assert customers["words"][0] in failed
    assert "tasks say bay2_9w (in)" in failed
    assert "SUMO says bay2_12w_in" in failed
    page = write_report(tmp_path / "run").read_text(encoding="utf-8")
    assert all(html.escape(line) in page for line in customers["words"])


@pytest.mark.parametrize(
    ("table", "column", "change", "witness", "needed"),
    [
        ("tasks", "at_bay_s", 5.0, "customers", "tasks say bay2_9w (in) from"),
        ("tasks", "lifted_s", 5.0, "customers", "SUMO says bay2_9w_in from"),
        ("tasks", "request", 1000, "customers", "SUMO saw 0 stays"),
        ("tasks", "request", 1000, "customers", "no task is its own"),
        ("tasks", "agv", 1, "agvs", "tasks say the car of request"),
        ("tasks", "destination", "slot5_8n1", "agvs", "was lowered at slot5_8n1"),
        ("tasks", "delivered_s", -40.0, "agvs", "was lowered at"),
        ("agvs", "distance_m", 100.0, "distance", "m, SUMO's trip"),
        ("agvs", "energy_wh", 30.0, "battery", "Wh drawn, SUMO's AGV used"),
        ("trajectory", "soc", -0.05, "battery", "Wh left by the record"),
        ("timeline", "queue", 1, "street", "s in the street by the record"),
    ],
)
def test_a_record_that_says_otherwise_is_contradicted(
    tall_run: Run, table: str, column: str, change: float | str, witness: str, needed: str
) -> None:
    wrong = tall_run.read(table).copy()
    rows = wrong.index[:1] if table in ("tasks", "agvs") else wrong.index
    wrong.loc[rows, column] = change if isinstance(change, str) else wrong.loc[rows, column] + change
    lying = replace(tall_run, read=lambda name: wrong if name == table else tall_run.read(name))
    seen = witnesses(lying, tall_run.folder)
    assert [line for line in seen[witness]["words"] if needed in line]
    assert seen[witness]["wrong"] >= len(seen[witness]["words"]) > 0


@pytest.mark.parametrize(("key", "change"), [("simulated_s", 2.0), ("sumo_collisions", 1)])
def test_totals_that_say_otherwise_are_contradicted(tall_run: Run, key: str, change: float) -> None:
    lying = replace(tall_run, meta={**tall_run.meta, key: tall_run.meta[key] + change})
    assert witnesses(lying, tall_run.folder)["totals"]["wrong"] == 1


def test_outputs_that_cannot_be_read_confirm_nothing(tall_run: Run, tmp_path: Path) -> None:
    for text in (None, "<stops><stopinfo"):
        if text is not None:
            shutil.copytree(tall_run.folder, tmp_path / "run")
            (tmp_path / "run" / "stops.xml").write_text(text)
        (seen,) = witnesses(tall_run, tmp_path / "run").values()
        assert (seen["facts"], seen["wrong"]) == (1, 1)
        assert "can't be read" in seen["words"][0]


def test_nothing_is_confirmed_without_outputs(tmp_path: Path) -> None:
    scenario = {"garage": "map1", "agvs": 2, "customers": BRISK, "workload": {"kind": "park_exit", "cars": 1}}
    summary = simulate(check_scenario(scenario, "test", Path()), None)
    assert [summary.metrics[f"{name}_witnessed_share"] for name in WITNESSES] == pytest.approx(
        [float("nan")] * len(WITNESSES), nan_ok=True
    )
    discrete = run(tmp_path / "run", **{**scenario, "plant": "discrete"})
    assert discrete.meta["witnesses"] == {}
    told = {check.text: check for check in run_checks(discrete.meta, run_metrics(discrete))}
    check = told["SUMO saw customers at bays where and when the record says"]
    assert check.passed is None
    assert check.figures.startswith("not witnessed")
    assert failed_checks(list(told.values())) == ()


def test_customers_who_still_stand_at_the_end(tmp_path: Path, tall: Path) -> None:
    """At any end of a run: on the street, at a bay, on an AGV, in a slot, in the customer's hands."""
    for duration_s in (60.0, 85.0, 120.0, 185.0):
        folder = tmp_path / f"{duration_s}"
        facts(park_and_exit(folder, str(tall), duration_s=duration_s))
    facts(park_and_exit(tmp_path / "slow", str(tall), duration_s=600.0, cars=2, customers={"handling_median_s": 200.0}))


def test_a_car_may_have_any_name_and_come_back_at_once(tmp_path: Path, tall: Path) -> None:
    with (tmp_path / "cars.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", "kind", "car"])
        rows.writerows([0, "park", name] for name in NAMES)
        rows.writerows([1, "retrieve", name] for name in NAMES)
        rows.writerows([2000 + 2 * n, "park", name] for n, name in enumerate(NAMES))
    record = run(
        tmp_path / "run", garage=str(tall), agvs=4, customers=BRISK,
        workload={"kind": "csv", "path": str(tmp_path / "cars.csv")},
    )  # fmt: skip
    assert list(record.tasks.state) == ["served"] * 3 * len(NAMES)
    assert facts(record)["customers"] == 3 * len(NAMES)
    assert set(record.tasks.car) == set(NAMES)


def renamed(plan: GaragePlan, seed: int) -> GaragePlan:
    """The same garage with names drawn anew, so that their order says nothing."""
    rng = random.Random(seed)
    names = [f"{rng.choice('abcxyz')}{number}" for number in rng.sample(range(1000), len(plan.vertices))]
    new = dict(zip(plan.vertices, names, strict=True))
    lanes = [replace(lane, tail=new[lane.tail], head=new[lane.head]) for lane in plan.lanes.values()]
    return replace(
        plan,
        vertices={new[name]: point for name, point in plan.vertices.items()},
        lanes={(lane.tail, lane.head): lane for lane in lanes},
        roles={role: [new[name] for name in has] for role, has in plan.roles.items()},
        places=tuple(replace(places, bay=new[places.bay]) for places in plan.places),
    )


@settings(max_examples=4, deadline=None, derandomize=True, phases=[Phase.generate])
@given(slots=st.integers(4, 20), aisles=st.integers(3, 5), homes=st.integers(2, 5), seed=st.integers(0, 2**16))
def test_any_small_garage_with_any_names(
    tmp_path_factory: pytest.TempPathFactory, slots: int, aisles: int, homes: int, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("any")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sumo_nets.build, "plan_garage", lambda layout, source: renamed(plan_garage(layout, source), seed))
        net, _ = build_net(generate_layout("any", slots, aisles - 1, homes, 1, aisles), folder)
    record = run(
        folder / "run", garage=str(net), agvs=2, duration_s=900.0, seed=seed, customers=BRISK,
        workload={"kind": "poisson", "arrivals_per_h": 60.0, "dwell_median_min": 4.0},
    )  # fmt: skip
    compared = facts(record)
    assert compared["customers"] > 0
    assert compared["agvs"] > compared["customers"]
    assert json.loads((folder / "run" / "metrics.json").read_text())["footprint_overlaps"] == 0
