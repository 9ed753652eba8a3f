"""Waits have a reason: a run whose work is lost ends at once and says why, and no other run ends before its time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import networkx as nx
import pytest
from small_net import write_net

from analysis.explain import explain
from analysis.faults import FaultSpan
from analysis.holds import Held, ending, long_waits, reason
from analysis.tables import load_run
from controller.holds import Holds, reachable
from parking_sim import standstill
from parking_sim.config import check_scenario
from parking_sim.fault_config import LONGEST_S
from parking_sim.simulation import Summary, simulate
from sumo_nets.graph import make_graph
from sumo_nets.read import read_net

#: Runs are given up after this in these tests, instead of two hours.
STALLED_S = 420.0


def run(out: Path, script: list[dict[str, Any]], **keys: Any) -> Summary:
    """Every car in and out of map1 in ticks, with faults at fixed times."""
    scenario = {
        "garage": "map1",
        "agvs": 4,
        "seed": 3,
        "plant": "discrete",
        "workload": {
            "kind": "poisson",
            "arrivals_per_h": 240,
            "dwell_median_min": 3,
            "duration_min": 6,
            "initial_occupancy": 0.2,
        },
        "record": {"replay": False},
    }
    return simulate(check_scenario({**scenario, "faults": {"script": script}, **keys}, "test", Path()), out)


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standstill, "STALLED_S", STALLED_S)


def to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs go on whatever ``for_ever`` says."""
    monkeypatch.setattr(Holds, "for_ever", lambda holds, still: False)


BAYS = [read_net("map1").graph.names[v] for v in read_net("map1").graph.bays]
SLOTS = [read_net("map1").graph.names[v] for v in read_net("map1").graph.slots]
#: What stops map1 for ever -> the faults, and words that the reason must hold.
STOPS: dict[str, tuple[list[dict[str, Any]], tuple[str, ...]]] = {
    "zone": ([{"kind": "zone_stop", "place": "c2_5"}], ("zone stop 0 round c2_5 closes c2_5, ", "no bay is free")),
    "all": ([{"kind": "all_stop"}], ("cannot move", "all stop of AGV 0, 1, 2 and 3")),
    "bays": ([{"kind": "bay", "place": bay} for bay in BAYS], ("no bay is free", f"{BAYS[0]} (bay) is out of order")),
    "slots": ([{"kind": "blocked", "place": slot} for slot in SLOTS], ("no slot is free", f"{SLOTS[0]} is blocked")),
    "fleet": ([{"kind": "breakdown", "agv": n} for n in range(4)], ("no AGV is free", "breakdown of AGV 2")),
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in STOPS if name != "zone"])
def test_a_run_that_nothing_can_help_ends_at_once_and_says_why(tmp_path, monkeypatch, name):
    """No request would have been served later: the same run, told to go on, serves none."""
    script, told = STOPS[name]
    script = [{"at_s": 60.0, "for_s": LONGEST_S, **fault} for fault in script]
    early = run(tmp_path / "early", script)
    assert early.status == "stalled"
    assert early.metrics["simulated_s"] < 360.0 + 300.0, "the last request comes at 360 s"
    held = " ".join(early.held)
    for words in told:
        assert words in held
    assert "and has not ended" in held
    assert json.loads((tmp_path / "early" / "run.json").read_text())["held"] == [*early.held]
    assert f"held at the end: {early.held[0]}" in explain(tmp_path / "early", None, None)
    to_the_end(monkeypatch)
    late = run(tmp_path / "late", script)
    assert late.status == "stalled"
    assert late.metrics["simulated_s"] > early.metrics["simulated_s"]
    assert late.metrics["tasks_done"] == early.metrics["tasks_done"]
    assert {line.partition(". ")[0] for line in late.held} == {line.partition(". ")[0] for line in early.held}


def test_a_zone_stop_without_end_is_named_in_sumo(tmp_path):
    """In ticks an AGV that can't get home gets no task, and the proof does not know that rule."""
    script, told = STOPS["zone"]
    workload = {"kind": "park_exit"}
    summary = run(tmp_path / "run", [{"at_s": 100.0, "for_s": LONGEST_S, **script[0]}], plant="sumo", workload=workload)
    assert summary.status == "stalled"
    assert summary.metrics["simulated_s"] < 400.0
    for words in told:
        assert words in " ".join(summary.held)


@pytest.mark.parametrize("name", ["zone", "bays", "fleet"])
def test_a_stop_that_ends_stops_no_run(tmp_path, monkeypatch, name):
    """However long it lasts: the run is the one that it would be if nobody asked whether it can go on."""
    script = [{"at_s": 60.0, "for_s": 1.25 * STALLED_S, **fault} for fault in STOPS[name][0]]
    digests = []
    for out in (tmp_path / "asked", tmp_path / "not_asked"):
        summary = run(out, script)
        assert (summary.status, summary.held) == ("finished", ())
        assert summary.metrics["tasks_done"] == summary.metrics["tasks_wanted"]
        digests.append(json.loads((out / "run.json").read_text())["digest"])
        to_the_end(monkeypatch)
    assert digests[0] == digests[1]


def test_a_run_with_a_duration_is_simulated_whole(tmp_path):
    """Its rates and waits count to the end that was asked for."""
    script = [{"at_s": 60.0, "for_s": LONGEST_S, "kind": "all_stop"}]
    summary = run(tmp_path / "run", script, duration_s=400.0)
    assert (summary.status, summary.metrics["simulated_s"]) == ("time_limit", 400.0)
    assert "all stop" in summary.held[0]
    waits = long_waits(load_run(tmp_path / "run"))
    assert {wait.agv for wait in waits if wait.reasons[-1].startswith("cannot move: all stop")} == {0, 1, 2, 3}
    assert all(wait.start_s >= 30.0 for wait in waits)


def requests(folder: Path, *rows: str) -> dict[str, str]:
    """A workload of these requests."""
    path = folder / "requests.csv"
    path.write_text("\n".join(("time_s,kind,car", *rows)) + "\n", encoding="utf-8")
    return {"kind": "csv", "path": str(path)}


@pytest.fixture
def slot(tmp_path: Path) -> str:
    """The slot of a car that comes first."""
    run(tmp_path / "calm", [], workload=requests(tmp_path, "0,park,a"))
    return str(load_run(tmp_path / "calm").tasks["destination"].iloc[0])


@pytest.mark.parametrize("duration_s", [None, 3000.0])
def test_a_request_that_comes_late_is_served(tmp_path, slot, duration_s):
    """One car is lost long before the other one comes."""
    workload = requests(tmp_path, "0,park,a", "200,retrieve,a", "2000,park,b", "2100,retrieve,b")
    script = [{"at_s": 100.0, "kind": "blocked", "place": slot, "for_s": LONGEST_S}]
    summary = run(tmp_path / "run", script, workload=workload, duration_s=duration_s)
    assert list(load_run(tmp_path / "run").tasks["state"]) == ["served", "waiting", "served", "served"]
    assert summary.status == ("time_limit" if duration_s else "stalled")
    assert summary.metrics["simulated_s"] == (duration_s or pytest.approx(2200.0, abs=100.0))
    assert f"{slot} is blocked (fault 0), and has not ended" in summary.held[0]


@pytest.mark.parametrize("end_s", [980.0, 1000.0, 1005.0])
def test_what_a_fault_held_has_time_when_the_fault_ends(tmp_path, slot, end_s):
    """Whether or not it ends just when somebody asks."""
    workload = requests(tmp_path, "0,park,a", "200,retrieve,a")
    script = [{"at_s": 100.0, "kind": "blocked", "place": slot, "for_s": end_s - 100.0}]
    summary = run(tmp_path / "run", script, workload=workload)
    assert (summary.status, summary.held) == ("finished", ())


def test_a_fleet_with_low_batteries_works_on_while_every_charger_is_out_of_order(tmp_path):
    chargers = [read_net("map1").graph.names[v] for v in read_net("map1").graph.chargers]
    script = [{"at_s": 10.0, "kind": "charger", "place": place, "for_s": LONGEST_S} for place in chargers]
    script += [{"at_s": 60.0, "kind": "battery", "agv": n, "for_s": 200.0} for n in range(4)]
    summary = run(tmp_path / "run", script)
    assert summary.status == "finished"
    assert summary.metrics["tasks_done"] == summary.metrics["tasks_wanted"]
    assert not (load_run(tmp_path / "run").events["kind"] == "charge_start").any()


def test_a_breakdown_without_end_in_the_only_lane_is_named(tmp_path):
    """Every way of this garage leads round one loop."""
    net = str(write_net(tmp_path))
    workload = requests(tmp_path, "0,park,a", "10,park,b", "300,retrieve,a", "310,retrieve,b")
    keys = {"garage": net, "agvs": 2, "workload": workload}
    run(tmp_path / "calm", [], **keys)
    lift = load_run(tmp_path / "calm").events.query("kind == 'lift'").iloc[0]
    script = [{"at_s": float(lift["time_s"]) + 6.0, "kind": "breakdown", "agv": int(lift["agv"]), "for_s": LONGEST_S}]
    summary = run(tmp_path / "run", script, **keys)
    assert summary.status == "stalled"
    assert summary.metrics["simulated_s"] < 310.0 + 300.0
    assert f"breakdown of AGV {lift['agv']} (fault 0), and has not ended" in " ".join(summary.held)
    assert "no way leads round" in " ".join(summary.held)


def test_a_wait_is_told_with_its_chain_and_its_fault():
    fault = FaultSpan(4, "breakdown", (7,), (), 10.0, 500.0)
    behind = Held(2, 5, "car5", "fault", (3, 7), (4,), "x")
    itself = Held(7, -1, "", "fault", (), (4,), "x")
    assert reason(behind, {4: fault}, 60.0) == "waits for AGV 3 and 7: AGV 7 cannot move: breakdown of AGV 7 (fault 4)"
    assert reason(itself, {4: fault}, 60.0) == "cannot move: breakdown of AGV 7 (fault 4)"
    assert ending([behind, itself], {4: fault}, 60.0) == [
        "breakdown of AGV 7 (fault 4). AGV 2: AGV 7 cannot move; AGV 7: cannot move"
    ]
    stopped = FaultSpan(5, "stop", (1,), (), 10.0, 500.0)
    unknown = Held(1, -1, "", "not_moving", (), (), "y")
    assert reason(unknown, {5: stopped}, 60.0) == "AGV 1 may drive on from y and does not: stop of AGV 1 (fault 5)"
    assert reason(unknown, {5: stopped}, 600.0) == "AGV 1 may drive on from y and does not"


def test_what_can_be_reached_on_an_open_floor_of_many_equal_ways():
    n = 30
    names = [(f"{x},{y}", 5.0 * x, 5.0 * y) for x in range(n) for y in range(n)]
    steps = [((x, y), (x + dx, y + dy)) for x in range(n) for y in range(n) for dx, dy in ((0, 1), (1, 0))]
    pairs = [(f"{a},{b}", f"{c},{d}") for (a, b), (c, d) in steps if c < n and d < n]
    lanes = [(f"{u}>{v}", u, v, 5.0) for pair in pairs for u, v in (pair, pair[::-1])]
    graph = make_graph("open floor", names, lanes)
    walls = {v for v in graph.vertices if graph.names[v].endswith(",20") and graph.names[v] != "7,20"}
    there = nx.descendants(graph.to_networkx().subgraph(set(graph.vertices) - walls), graph.vertices[0])
    assert reachable(graph, graph.vertices[0], walls) == there | {graph.vertices[0]}
