"""Whole runs: all work gets done, nobody meets, nothing is lost, and the same run twice is the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from whole_runs import MAPS, check_all_done, check_whole, deadlocks, run

from controller.events import KINDS
from controller.types import AgvMode
from sumo_nets.read import read_net

BRISK = {"handling_median_s": 5.0}


@pytest.mark.usefixtures("ticks_watched")
@pytest.mark.parametrize("planner", ["whca", "token"])
@pytest.mark.parametrize("plant", ["sumo", "discrete"])
@pytest.mark.parametrize("garage", MAPS)
def test_every_car_is_parked_and_brought_back(tmp_path, garage, plant, planner):
    record = run(
        tmp_path / "run", garage=garage, agvs=4, plant=plant, planner=planner, customers=BRISK,
        workload={"kind": "park_exit", "cars": 6}, max_time_s=20_000.0,
    )  # fmt: skip
    check_all_done(record, 6)


@pytest.mark.usefixtures("ticks_watched")
@pytest.mark.parametrize(
    ("agvs", "plant", "planner"),
    [
        (16, "discrete", "whca"),
        (16, "discrete", "token"),
        (32, "discrete", "whca"),
        (32, "discrete", "token"),
        (16, "sumo", "whca"),
        (32, "sumo", "token"),
    ],
)
def test_a_crowd_of_agvs_gets_all_work_done(tmp_path, agvs, plant, planner):
    record = run(
        tmp_path / "run", garage="map3", agvs=agvs, plant=plant, planner=planner, customers=BRISK,
        workload={"kind": "park_exit", "cars": 64}, max_time_s=20_000.0,
    )  # fmt: skip
    check_all_done(record, 64)
    if planner == "token":
        assert deadlocks(record, "deadlock_found") == [], "complete paths leave nothing to resolve"


@pytest.mark.parametrize("garage", MAPS)
def test_open_traffic_with_named_retrievals_loses_nobody(tmp_path, garage):
    record = run(
        tmp_path / "run", garage=garage, agvs=4, duration_s=1500.0, customers=BRISK,
        workload={"kind": "poisson", "arrivals_per_h": 40.0, "dwell_median_min": 10.0, "initial_occupancy": 0.05,
                  "duration_min": 25.0},
    )  # fmt: skip
    check_whole(record)
    assert record.meta["status"] == "time_limit"
    served = record.tasks[record.tasks.state == "served"]
    assert set(served.kind) == {"park", "retrieve"}
    check_times(record.tasks)
    check_events(record.events)


def check_times(tasks):
    """What happened to a request happened in order."""
    order = ("requested_s", "at_bay_s", "ready_s", "assigned_s", "lifted_s", "delivered_s", "done_s")
    for row in tasks[tasks.state == "served"].itertuples():
        # an AGV may be sent before the customer is ready, but lifts only afterwards
        times = [getattr(row, name) for name in order if name != "assigned_s"]
        times = [t for t in times if t == t]
        assert times == sorted(times)
        assert row.requested_s <= row.assigned_s <= row.lifted_s


def check_events(events):
    """Each detail has the keys that its kind of event has to have."""
    for kind, detail in zip(events.kind, events.detail, strict=True):
        assert KINDS[kind].fits(json.loads(detail or "{}")), (kind, detail)


def test_a_car_may_come_again_when_it_has_left(tmp_path):
    """The same name twice, in SUMO; and requests that make no sense are void, each with its reason."""
    rows = ["0,park,a", "0,park,b", "5,retrieve,a", "1500,park,a", "1501,retrieve,b", "1502,retrieve,a"]
    (tmp_path / "gate.csv").write_text("time_s,kind,car\n" + "\n".join(rows) + "\n", encoding="utf-8")
    record = run(
        tmp_path / "run", garage="map1", agvs=2, customers=BRISK, max_time_s=9000.0,
        workload={"kind": "csv", "path": str(tmp_path / "gate.csv")},
    )  # fmt: skip
    check_whole(record)
    assert record.meta["status"] == "finished"
    assert list(record.tasks.state) == ["served"] * 6


def test_a_car_that_comes_again_before_it_has_left_is_void(tmp_path):
    rows = ["0,park,a", "1,retrieve,a", "2,park,a", "3,retrieve,a"]
    (tmp_path / "gate.csv").write_text("time_s,kind,car\n" + "\n".join(rows) + "\n", encoding="utf-8")
    record = run(
        tmp_path / "run", garage="map1", agvs=2, customers=BRISK, max_time_s=9000.0,
        workload={"kind": "csv", "path": str(tmp_path / "gate.csv")},
    )  # fmt: skip
    check_whole(record)
    assert record.meta["status"] == "finished"
    assert list(record.tasks.state) == ["served", "served", "void", "void"]
    assert list(record.tasks.reason)[2:] == ["car is in the garage already", "car is asked for already"]


# --- charging ---------------------------------------------------------------------------------------------------------


def charges(record):
    """For each charge: AGV, charger, when and at which state of charge it began and ended."""
    events = record.events
    begun, ended = (events[events.kind == kind].to_dict("records") for kind in ("charge_start", "charge_end"))
    rows = []
    for begin in begun:
        ends = [e for e in ended if e["agv"] == begin["agv"] and e["time_s"] > begin["time_s"]]
        if ends:
            low, high = (json.loads(e["detail"])["soc"] for e in (begin, ends[0]))
            rows.append((begin["agv"], begin["vertex"], begin["time_s"], ends[0]["time_s"], low, high))
    return rows


def modes(record, agv):
    events = record.events[(record.events.kind == "agv_mode") & (record.events.agv == agv)]
    return [json.loads(detail)["to"] for detail in events.detail]


def check_charging_rounds(record, agv):
    """To the charger, charging, home, and only then something else."""
    seen = modes(record, agv)
    at = [i for i, mode in enumerate(seen) if mode == AgvMode.GOING_TO_CHARGE]
    assert at
    whole = [AgvMode.GOING_TO_CHARGE, AgvMode.CHARGING, AgvMode.RETURNING_HOME_MAINTENANCE, AgvMode.IDLE]
    for i in at:
        assert seen[i : i + 4] == whole[: len(seen) - i]


def test_an_agv_with_a_low_battery_charges_and_works_on_in_sumo(tmp_path):
    """A battery for some minutes instead of eight hours."""
    record = run(
        tmp_path / "run", garage="map1", agvs=2, customers=BRISK, workload={"kind": "park_exit", "cars": 14},
        agv={"battery_wh": 250.0, "charge_w": 4000.0}, max_time_s=20_000.0,
    )  # fmt: skip
    check_all_done(record, 14)
    chargers = {record.vertices.vertex[v] for v in read_net("map1").graph.chargers}
    done = charges(record)
    assert done
    for _, vertex, _, _, low, high in done:
        assert vertex in chargers
        assert 0.0 < low <= 0.3
        assert 0.85 <= high <= 1.0
    assert record.trajectory.soc.min() > 0.0
    for agv in {row[0] for row in done}:
        check_charging_rounds(record, agv)
    lifts = record.events[record.events.kind == "lift"]
    agv, _, _, until_s, _, _ = done[0]
    assert (lifts[lifts.agv == agv].time_s > until_s).any(), "it never worked again"
    assert record.agvs.charging_s.sum() > 0


@pytest.mark.usefixtures("ticks_watched")
def test_an_agv_charges_after_300_cells_in_ticks(tmp_path):
    record = run(
        tmp_path / "run", garage="map2_thesis", agvs=3, plant="discrete", record={"grants": True},
        workload={"kind": "park_exit", "cars": 40}, max_time_s=20_000.0,
    )  # fmt: skip
    check_all_done(record, 40)
    done = charges(record)
    assert len({row[0] for row in done}) == 3
    grants = record.events[record.events.kind == "grant"]
    since = dict.fromkeys(range(3), -1.0)
    for agv, _, begun_s, ended_s, low, _ in done:
        cells = ((grants.agv == agv) & (grants.time_s > since[agv]) & (grants.time_s < begun_s)).sum()
        assert cells >= 300
        assert low == pytest.approx(1.0 - cells / 600, abs=1e-3)
        assert ended_s - begun_s == 20
        since[agv] = ended_s - 0.5
    for agv in range(3):
        check_charging_rounds(record, agv)


# --- the same run twice -----------------------------------------------------------------------------------------------

TWICE = """
garage: map1
agvs: 4
plant: {plant}
duration_s: 900
record: {{grants: true}}
customers: {{handling_median_s: 5.0}}
workload: {{kind: poisson, arrivals_per_h: 60.0, dwell_median_min: 5.0, initial_occupancy: 0.2, duration_min: 15.0}}
"""


def digest(folder: Path, name: str, hash_seed: int, seed: int) -> dict[str, str]:
    """What a run in a process of its own writes, wall-clock columns aside."""
    command = f"-m parking_sim run same.yaml --seed {seed} --out {name} -q --no-report"
    environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed)}
    subprocess.run([sys.executable, *command.split()], cwd=folder, env=environment, check=True, timeout=300)
    found: dict[str, str] = json.loads((folder / name / "run.json").read_text(encoding="utf-8"))["digest"]
    return found


@pytest.mark.parametrize("plant", ["sumo", "discrete"])
def test_the_same_scenario_and_seed_give_the_same_record_in_another_process(tmp_path, plant):
    (tmp_path / "same.yaml").write_text(TWICE.format(plant=plant), encoding="utf-8")
    first, again = digest(tmp_path, "first", 1, 7), digest(tmp_path, "again", 2, 7)
    other = digest(tmp_path, "other", 1, 8)
    assert {"events", "tasks", "trajectory", "timeline", "planning", "agvs"} <= first.keys()
    assert first == again
    assert {table for table in first if first[table] != other[table]} >= {"events", "tasks", "trajectory"}
