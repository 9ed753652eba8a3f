"""Faults: each kind begins and ends, nothing meets, nobody and nothing gets lost, and the service goes on."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from typing import Any

import duckdb
import pytest
from whole_runs import coming_next

from analysis.tables import load_run
from controller.events import KINDS
from parking_sim.config import check_scenario
from parking_sim.fault_config import DRAWN_FAULTS, FaultConfig
from parking_sim.faults import fault_stream
from parking_sim.simulation import Summary, simulate
from sumo_nets.errors import InputError
from sumo_nets.read import read_net

#: Every kind at once, far more often than in any garage.
ALL = {
    "travel_noise": 0.2,
    "commands": {"late": 0.03, "lost": 0.02},
    "stop": {"per_h": 12},
    "slow": {"per_h": 6},
    "stale": {"per_h": 6},
    "breakdown": {"per_h": 0.5, "least_s": 60, "most_s": 120, "repair_s": 60},
    "battery": {"per_h": 0.3, "least_s": 60, "most_s": 120},
    "blocked": {"per_h": 12},
    "bay": {"per_h": 3},
    "charger": {"per_h": 3},
    "zone_stop": {"per_h": 3},
    "all_stop": {"per_h": 2},
}
SCRIPT = {
    "stop": {"agv": 0},
    "slow": {"agv": 0},
    "stale": {"agv": 0},
    "breakdown": {"agv": 0},
    "battery": {"agv": 0},
    "blocked": {"place": "c7_5"},
    "bay": {"place": "bay2_3w"},
    "charger": {"place": "charger2_2w"},
    "zone_stop": {"place": "c3_5"},
    "all_stop": {},
}


def run(out: Path, faults: dict[str, Any], **keys: Any) -> tuple[Summary, list[dict[str, Any]]]:
    """A run and its events, the detail's keys among them; these are the keys that each kind has to have."""
    workload = {"kind": "poisson", "arrivals_per_h": 20, "dwell_median_min": 10, "duration_min": 15}
    scenario = {"garage": "map1", "agvs": 4, "workload": {**workload, "initial_occupancy": 0.3}, "faults": faults}
    summary = simulate(check_scenario({**scenario, **keys}, "test", Path()), out)
    rows = duckdb.sql(f"select time_s, kind, agv, car, vertex, detail from '{out}/events.parquet'").fetchall()
    names = ("time_s", "kind", "agv", "car", "vertex")
    assert [row for row in rows if not KINDS[row[1]].fits(json.loads(row[5] or "{}"))] == []
    events = [{**dict(zip(names, row[:5], strict=True)), **json.loads(row[5] or "{}")} for row in rows]
    return summary, events


def nothing_lost(summary: Summary) -> None:
    metrics = summary.metrics
    assert summary.status == "finished"
    assert summary.failed == ()
    assert metrics["tasks_done"] == metrics["tasks_wanted"] > 0
    assert metrics["requests_conserved"]
    assert metrics["cars_conserved"]
    assert metrics["deadlocks_unresolved"] == 0
    assert metrics["sumo_collisions"] == metrics["footprint_overlaps"] == 0


@pytest.mark.parametrize("planner", ["whca", "token"])
def test_all_faults_at_once_in_sumo(tmp_path, planner):
    summary, events = run(tmp_path / "run", ALL, planner=planner)
    nothing_lost(summary)
    seen = {e["cause"] for e in events if e["kind"] == "fault_start"}
    assert seen >= {"stop", "slow", "stale", "blocked", "late", "lost"}


def test_all_faults_at_once_in_ticks_and_the_same_twice(tmp_path):
    keys = {"garage": "map1_thesis", "plant": "discrete"}
    summary, events = run(tmp_path / "one", ALL, **keys)
    nothing_lost(summary)
    assert {e["cause"] for e in events if e["kind"] == "fault_start"} >= {"stop", "breakdown", "blocked", "tow"}
    run(tmp_path / "two", ALL, **keys)
    digests = [json.loads((tmp_path / name / "run.json").read_text())["digest"] for name in ("one", "two")]
    assert digests[0] == digests[1]


def test_each_kind_begins_and_ends(tmp_path):
    script = [{"at_s": 100.0 + 60 * k, "kind": kind, "for_s": 40.0, **SCRIPT[kind]} for k, kind in enumerate(SCRIPT)]
    assert set(SCRIPT) == set(DRAWN_FAULTS)
    summary, events = run(tmp_path / "run", {"script": script, "breakdown": {"per_h": 0, "repair_s": 30}})
    nothing_lost(summary)
    for kind in (*SCRIPT, "tow", "repair"):
        (begin,) = (e for e in events if e["kind"] == "fault_start" and e["cause"] == kind)
        (end,) = (e for e in events if e["kind"] == "fault_end" and e["cause"] == kind)
        assert begin["fault"] == end["fault"]
        assert end["time_s"] - begin["time_s"] >= (30 if kind == "repair" else 1 if kind == "tow" else 40)


@pytest.fixture(scope="module")
def calm(tmp_path_factory) -> list[dict[str, Any]]:
    return run(tmp_path_factory.mktemp("calm") / "run", {})[1]


def test_a_broken_agv_gives_its_task_back_and_another_does_it(tmp_path, calm):
    task = next(e for e in calm if e["kind"] == "task_assigned")
    script = [{"at_s": task["time_s"] + 2, "kind": "breakdown", "for_s": 400.0, "agv": task["agv"]}]
    summary, events = run(tmp_path / "run", {"script": script})
    nothing_lost(summary)
    (back,) = (e for e in events if e["kind"] == "task_returned")
    assert (back["agv"], back["request"]) == (task["agv"], task["request"])
    assert next(e for e in events if e["kind"] == "lift" and e["request"] == back["request"])["agv"] != task["agv"]
    repaired = next(e["time_s"] for e in events if e["kind"] == "fault_end" and e["cause"] == "repair")
    again = [e["time_s"] for e in events if e["kind"] == "task_assigned" and e["agv"] == task["agv"]]
    assert all(t <= task["time_s"] or t >= repaired for t in again)


def test_the_car_on_a_broken_agv_is_saved(tmp_path, calm):
    lift = next(e for e in calm if e["kind"] == "lift")
    script = [{"at_s": lift["time_s"] + 5, "kind": "breakdown", "for_s": 120.0, "agv": lift["agv"]}]
    summary, events = run(tmp_path / "run", {"script": script})
    nothing_lost(summary)
    tow = next(e["time_s"] for e in events if e["kind"] == "fault_start" and e["cause"] == "tow")
    home = next(e["time_s"] for e in events if e["kind"] == "fault_end" and e["cause"] == "tow")
    lower = next(e for e in events if e["kind"] == "lower" and e["car"] == lift["car"])
    assert lower["agv"] == lift["agv"]
    assert tow < lower["time_s"] < home


CROWD: dict[str, Any] = {
    "agvs": 8,
    "workload": {
        "kind": "poisson", "arrivals_share_per_h": 2.0, "dwell_median_min": 5, "duration_min": 10,
        "initial_occupancy": 0.5,
    },
    "record": {"sample_s": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def moment(tmp_path_factory) -> tuple[float, int, int, str]:
    """The first of ``coming_next`` in a crowded garage without faults."""
    out = tmp_path_factory.mktemp("crowd") / "run"
    run(out, {}, **CROWD)
    return coming_next(load_run(out), read_net("map1").graph.names)[0]


def test_when_an_agv_breaks_down_at_a_bay_the_one_that_comes_next_goes_elsewhere(tmp_path, moment):
    time_s, at_work, comes, bay = moment
    script = [{"at_s": time_s + 1, "kind": "breakdown", "for_s": 120.0, "agv": at_work}]
    summary, events = run(tmp_path / "run", {"script": script}, **CROWD)
    nothing_lost(summary)
    brought = next(e for e in events if e["kind"] == "lower" and e["agv"] == comes and e["time_s"] > time_s)
    tow = next(e["time_s"] for e in events if e["kind"] == "fault_start" and e["cause"] == "tow")
    assert brought["vertex"] != bay
    assert brought["time_s"] < tow


def test_when_the_way_out_of_a_bay_is_blocked_the_one_that_comes_next_does_not_stand_in_it(tmp_path, moment):
    time_s, _, _, bay = moment
    assert bay == "bay2_3w", "c2_2 is on the way out of it, and not on the way there"
    script = [{"at_s": time_s + 1, "kind": "blocked", "for_s": 90.0, "place": "c2_2"}]
    summary, _ = run(tmp_path / "run", {"script": script}, **CROWD)
    nothing_lost(summary)
    assert summary.metrics["deadlocks_found"] == 0


def test_nobody_enters_what_is_blocked(tmp_path):
    """A place in the middle of a two-way aisle is blocked; whoever was on the way there stops before it."""
    script = [{"at_s": t, "kind": "blocked", "for_s": 60.0, "place": place}
              for t, place in ((60.0, "c3_5"), (150.0, "c2_5"), (300.0, "c3_8"), (400.0, "c5_5"))]  # fmt: skip
    summary, events = run(tmp_path / "run", {"script": script}, record={"grants": True, "sample_s": 0.5})
    nothing_lost(summary)
    for begin in (e for e in events if e["kind"] == "fault_start"):
        end = next(e for e in events if e["kind"] == "fault_end" and e["fault"] == begin["fault"])
        place = begin["vertex"]
        during = [e for e in events if e["kind"] == "grant" and begin["time_s"] < e["time_s"] < end["time_s"]]
        assert not any(place in e["vertices"] for e in during)
        near = duckdb.sql(
            f"""select count(*) from '{tmp_path}/run/trajectory.parquet' t, '{tmp_path}/run/vertices.parquet' v
            where v.vertex = '{place}' and pow(t.x_m - v.x_m, 2) + pow(t.y_m - v.y_m, 2) < 1.0
            and t.time_s between {begin["time_s"] + 1} and {end["time_s"]}"""
        ).fetchall()
        assert near == [(0,)]


def test_a_car_whose_slot_is_closed_before_it_is_lifted_goes_to_another_one(tmp_path, calm):
    task = next(e for e in calm if e["kind"] == "task_assigned" and e["destination"])
    script = [{"at_s": task["time_s"] + 2, "kind": "blocked", "for_s": 600.0, "place": task["destination"]}]
    summary, events = run(tmp_path / "run", {"script": script})
    nothing_lost(summary)
    lift, lower = (
        next(e for e in events if e["kind"] == kind and e["car"] == task["car"]) for kind in ("lift", "lower")
    )
    assert task["time_s"] + 2 < lift["time_s"] < lower["time_s"] < task["time_s"] + 600
    assert lower["vertex"] != task["destination"]


def test_a_bay_out_of_order_gets_no_customers(tmp_path):
    script = [{"at_s": 1.0, "kind": "bay", "for_s": 900.0, "place": "bay2_3w"}]
    summary, events = run(tmp_path / "run", {"script": script})
    nothing_lost(summary)
    assert not any(e["kind"] == "car_at_bay" and e["vertex"] == "bay2_3w" and 60 < e["time_s"] < 900 for e in events)
    assert any(e["kind"] == "car_at_bay" and e["vertex"] == "bay2_6w" and 60 < e["time_s"] < 900 for e in events)


def test_an_agv_with_a_flat_battery_stands_until_service_has_come(tmp_path):
    """Without any fault asked for: charging is never due, and the battery lasts for a few minutes."""
    agv = {"battery_wh": 60.0, "charge_below": 0.0}
    summary, events = run(tmp_path / "run", {}, agv=agv, agvs=2, record={"sample_s": 1.0})
    nothing_lost(summary)
    begin = next(e for e in events if e["kind"] == "fault_start")
    end = next(e for e in events if e["kind"] == "fault_end" and e["fault"] == begin["fault"])
    assert (begin["cause"], end["time_s"] - begin["time_s"]) == ("battery", 600.0)
    places = duckdb.sql(
        f"""select distinct x_m, y_m from '{tmp_path}/run/trajectory.parquet' where agv = {begin["agv"]}
        and time_s between {begin["time_s"] + 5} and {end["time_s"]}"""
    ).fetchall()
    assert len(places) == 1


def test_faults_do_not_depend_on_each_other_or_on_the_controller():
    graph = read_net("map1").graph

    def first(kind: str, **faults: Any) -> list[Any]:
        stream = fault_stream(FaultConfig.model_validate(faults), graph, 4, seed=3)
        return list(islice((fault for fault in stream if fault.kind == kind), 20))

    alone = first("blocked", blocked={"per_h": 4})
    assert alone == first("blocked", blocked={"per_h": 4}, stop={"per_h": 9}, bay={"per_h": 1})
    assert [f.start_s for f in alone] == sorted(f.start_s for f in alone)
    assert alone != list(islice(fault_stream(FaultConfig.model_validate({"blocked": {"per_h": 4}}), graph, 4, 4), 20))


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"stop": {"per_h": -1}}, "faults.stop.per_h"),
        ({"stop": {"per_h": 1, "least_s": 9, "most_s": 3}}, "least_s <= most_s"),
        ({"fire": {}}, "faults.fire: unknown key"),
        ({"script": [{"at_s": 1, "kind": "stop", "for_s": 1}]}, "stop needs agv"),
        ({"script": [{"at_s": 1, "kind": "bay", "for_s": 1}]}, "bay needs place"),
        ({"script": [{"at_s": 1, "kind": "stop", "for_s": 1, "agv": 4}]}, "0 to 3"),
        (
            {"script": [{"at_s": 1, "kind": "blocked", "for_s": 1, "place": "c7_55"}]},
            "no such vertex; give one of .* c7_5",
        ),
        (
            {"script": [{"at_s": 1, "kind": "bay", "for_s": 1, "place": "c7_5"}]},
            "map1 has no such bay; give one of bay2_3w, bay2_6w",
        ),
    ],
)
def test_what_cannot_go_wrong_is_said_in_one_line(tmp_path, faults, words):
    with pytest.raises(InputError, match=words) as error:
        run(tmp_path / "run", faults)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()
