"""A number that is shown in several places is the same in all of them, read from each by its own means.

One recorded run with deadlocks (eight AGVs under WHCA* on a Saturday afternoon) and a breakdown is looked at: tables by
DuckDB, ``metrics.json``, ``load_runs``, the report's HTML by regular expressions, the replay's data by ``unpack``, the
text of ``explain``, and the sweep's measures. The metrics are worked out anew with plain loops over the tables.
"""

from __future__ import annotations

import json
import math
import re
import statistics
from pathlib import Path
from typing import Any

import duckdb
import pytest
from test_replay import unpack

from analysis.explain import explain
from analysis.measures import MEASURES, measure_runs
from analysis.metrics import METRICS
from analysis.record import COLUMNS, EVENTS
from analysis.replay import write_replay
from analysis.report import write_index, write_report
from analysis.runs import load_runs
from analysis.tables import load_run
from parking_sim.cli import main
from parking_sim.columns import run_columns
from parking_sim.config import check_scenario
from parking_sim.simulation import simulate

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one_number") / "run"
    scenario = {
        "garage": "map1", "agvs": 8, "planner": "whca", "seed": 3, "duration_s": 1500.0,
        "control": {"window_cells": 5, "window_min": 5, "window_max": 5},  # so short that AGVs get into deadlocks
        "workload": {"kind": "profile", "name": "mall-saturday", "start_h": 14.0, "hours": 1.0, "scale": 1.5},
        "faults": {"script": [{"at_s": 1000.0, "kind": "breakdown", "agv": 2, "for_s": 300.0}]},
    }  # fmt: skip
    simulate(check_scenario(scenario, "test", Path()), folder)
    write_replay(folder, report=True)
    write_report(folder)
    return folder


@pytest.fixture(scope="module")
def tables(folder: Path) -> dict[str, Rows]:
    def rows(table: str) -> Rows:
        found = duckdb.execute("SELECT * FROM read_parquet(?)", [str(folder / f"{table}.parquet")])
        names = [column[0] for column in found.description]
        return [dict(zip(names, row, strict=True)) for row in found.fetchall()]

    return {table: rows(table) for table in COLUMNS}


@pytest.fixture(scope="module")
def metrics(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


@pytest.fixture(scope="module")
def report(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def replay(folder: Path) -> tuple[dict[str, Any], dict[str, list[int]]]:
    return unpack((folder / "replay.html").read_text(encoding="utf-8"))


def shown(report: str, key: str) -> str:
    """The value of a metric in the report's table of all metrics."""
    row = re.search(rf'<tr><td><code>{key}</code></td><td class="n">([^<]*)</td>', report)
    assert row, key
    return row[1]


def test_every_column_listed_exists_and_every_column_is_listed(folder, tables, capsys):
    with pytest.raises(SystemExit):
        main(["columns"])
    listed: dict[str, list[str]] = {}
    for line in capsys.readouterr().out.splitlines():
        table, name, _, meaning = line.split("\t")
        assert meaning
        listed.setdefault(table, []).append(name)
    assert set(listed) == {*COLUMNS, "kinds", "metrics", "runs"}
    for table in COLUMNS:
        assert listed[table] == list(tables[table][0]), table
    assert listed["kinds"] == list(EVENTS)
    assert listed["metrics"] == list(METRICS)
    assert {*json.loads((folder / "metrics.json").read_text())} == {*METRICS}
    free = ("workload.", "planner_options.", "faults.")
    columns = [name for name in load_runs(folder.parent).runs.columns if not name.startswith(free)]
    assert {*columns} <= {*listed["runs"]} == {*run_columns()}


def quantile(values: list[float], q: float) -> float:
    """Linear between order statistics."""
    at = q * (len(values) - 1)
    low = math.floor(at)
    high = min(low + 1, len(values) - 1)
    return sorted(values)[low] + (at - low) * (sorted(values)[high] - sorted(values)[low])


def test_metrics_are_what_plain_loops_find(tables, metrics):
    tasks, timeline, agvs, events = (tables[name] for name in ("tasks", "timeline", "agvs", "events"))
    end_s = metrics["simulated_s"]
    assert end_s == 1500.0
    served = [t for t in tasks if t["state"] == "served"]
    assert metrics["tasks_done"] == len(served)
    assert metrics["cars_out_per_hour"] * end_s / 3600 == pytest.approx(sum(t["kind"] == "retrieve" for t in served))
    for wait, kind, begin, end in (
        ("retrieval_wait", "retrieve", "requested_s", "delivered_s"),
        ("retrieval_total", "retrieve", "requested_s", "done_s"),
        ("park_queue", "park", "requested_s", "at_bay_s"),
        ("park_wait", "park", "at_bay_s", "lifted_s"),
        ("park_total", "park", "requested_s", "delivered_s"),
    ):
        values = [
            (end_s if t[end] is None else t[end]) - t[begin]
            for t in tasks if t["kind"] == kind and t["state"] in ("served", "waiting") and t[begin] is not None
        ]  # fmt: skip
        assert metrics[f"{wait}_mean_s"] == pytest.approx(statistics.fmean(values)), wait
        assert metrics[f"{wait}_max_s"] == max(values)
        for percent in (50, 90, 95, 99):
            assert metrics[f"{wait}_p{percent}_s"] == pytest.approx(quantile(values, percent / 100)), wait
    held: dict[int, float] = {}
    spilled_s = 0.0
    for now, after in zip(timeline, [*timeline[1:], {"time_s": end_s}], strict=True):
        held[now["queue"]] = held.get(now["queue"], 0.0) + after["time_s"] - now["time_s"]
        spilled_s += (after["time_s"] - now["time_s"]) * (now["spilled"] > 0)
        assert now["spilled"] <= now["queue"]
    assert metrics["queue_mean"] == pytest.approx(sum(n * s for n, s in held.items()) / end_s)
    assert metrics["queue_max"] == max(held)
    assert metrics["spill_back_s"] == pytest.approx(spilled_s)
    assert metrics["spill_back_max"] <= metrics["queue_max"]
    p95 = metrics["queue_p95"]
    assert sum(s for n, s in held.items() if n <= p95) >= 0.95 * end_s - 1e-6
    assert sum(s for n, s in held.items() if n < p95) < 0.95 * end_s
    shares = {key: sum(a[f"{key}_s"] for a in agvs) / (end_s * len(agvs)) for key in ("idle", "charging", "loaded")}
    for key, share in shares.items():
        assert metrics[f"agv_{key}_share"] == pytest.approx(share)
    assert metrics["agv_busy_share"] == pytest.approx(1 - shares["idle"] - shares["charging"])
    assert metrics["distance_m"] == pytest.approx(sum(a["distance_m"] for a in agvs))
    costs = [json.loads(e["detail"])["cost_s"] for e in events if e["kind"] == "deadlock_resolved"]
    found = sum(e["kind"] == "deadlock_found" for e in events)
    assert (metrics["deadlocks_found"], metrics["deadlocks_resolved"]) == (found, len(costs))
    assert found > 0, "the run shows no deadlock"
    assert metrics["deadlock_max_s"] == max(costs)
    assert metrics["deadlock_p50_s"] == pytest.approx(quantile(costs, 0.5))
    planning = tables["planning"]
    assert metrics["nodes_expanded"] == sum(row["expanded"] for row in planning)
    assert metrics["steps"] * 0.5 == end_s
    assert metrics["throughput"] == pytest.approx(len(served) / (end_s / 0.5))


def test_the_same_numbers_in_metrics_load_runs_and_measures(folder, metrics):
    runs = load_runs(folder.parent)
    (row,) = runs.runs.to_dict("records")
    for key, value in metrics.items():
        assert row[key] == value or (value is None and math.isnan(row[key])), key
    (measured,) = measure_runs(runs).to_dict("records")
    both = METRICS.keys() & MEASURES.keys()
    assert {"retrieval_wait_p95_s", "park_total_mean_s", "queue_mean"} <= both
    for key in both:
        assert measured[key] == pytest.approx(metrics[key]), key
    assert measured["tasks_per_hour"] == pytest.approx(metrics["tasks_done"] / metrics["simulated_s"] * 3600)


def test_the_report_and_the_index_say_what_the_metrics_say(folder, metrics, report):
    for key in ("tasks_done", "queue_max", "spill_back_max", "deadlocks_found", "deadlocks_unresolved"):
        assert shown(report, key).replace(",", "") == str(metrics[key])
    p50 = re.search(r"<b>(\d+):(\d\d)</b><span>retrieval wait, median", report)
    row = re.search(r"Retrieval: request to car at the bay</th>(.*?)</tr>", report)
    assert p50
    assert row
    cells = re.findall(r'<td class="n">(\d+):(\d\d)</td>', row[1])
    assert cells[1] == p50.groups()
    assert abs(60 * int(p50[1]) + int(p50[2]) - metrics["retrieval_wait_p50_s"]) <= 0.5
    assert f"<b>{metrics['tasks_done']}</b><span>tasks done" in report
    index = write_index([folder], folder.parent / "index.html").read_text()
    assert f"{metrics['deadlocks_found']} / {metrics['deadlocks_unresolved']}" in index
    assert f"{p50[1]}:{p50[2]}</td>" in index


def of_day(seconds: float) -> str:
    """A moment of a run that starts at 14:00."""
    whole = int(seconds) + 14 * 3600
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def test_a_deadlock_has_the_same_seconds_and_times_everywhere(folder, tables, report, replay):
    ends = {
        detail["deadlock"]: (event["time_s"], detail["cost_s"])
        for event in tables["events"] if event["kind"] == "deadlock_resolved"
        for detail in [json.loads(event["detail"])]
    }  # fmt: skip
    found = [e for e in tables["events"] if e["kind"] == "deadlock_found"]
    told = explain(folder, None, None)
    rows = re.findall(r"<tr><td>([\d:]+)</td><td>([\d, ]+)</td>.*?<td>(resolved by[^<]*|not resolved)</td></tr>",
                      report, flags=re.S)  # fmt: skip
    assert len(found) == len(rows) == len(replay[0]["deadlocks"])
    for event, row, lock in zip(found, rows, replay[0]["deadlocks"], strict=True):
        number = json.loads(event["detail"])["deadlock"]
        assert row[0] == of_day(event["time_s"])
        assert lock["found"] == round(1000 * event["time_s"])
        assert f"deadlock {number}, found at {of_day(event['time_s'])}:" in told
        if number in ends:
            over_s, cost_s = ends[number]
            assert row[2].endswith(f", {cost_s:g} s after the wait began")
            assert (lock["cost_s"], lock["to"] - lock["from"], lock["to"]) == (cost_s, 1000 * cost_s, 1000 * over_s)
            assert lock["end"] == row[2]
            assert f"  {row[2]}\n" in f"{told}\n"


def test_the_replay_ends_as_the_record_does(tables, metrics, replay):
    head, columns = replay
    end = json.loads(json.dumps(metrics))
    assert head["end"] == 1000 * end["simulated_s"]
    assert columns["line_parked"][-1] == end["cars_parked"] == tables["timeline"][-1]["parked"]
    assert len(columns["done"]) == end["tasks_done"]
    assert max(columns["line_queue"]) == end["queue_max"]
    assert max(columns["line_spilled"]) == end["spill_back_max"]
    assert head["tasks"] == end["tasks_wanted"]


def test_clocks_show_the_time_of_day_on_every_page(folder, report, replay):
    assert replay[0]["clock"] == {"name": "time of day", "offset": 14 * 3600 * 1000}
    assert "clocks show the time of day" in report
    assert ">14:00</text>" in report
    assert ">0:00</text>" not in report
    assert explain(folder, None, None).startswith("times are time of day")


@pytest.mark.parametrize("garage", ["map1", "map2"])
def test_bays_have_the_numbers_of_the_layout(garage, tmp_path):
    """``bays: 2`` are the bays that the replay calls B1 and B2."""
    from sumo_nets.read import read_net

    scenario = {
        "garage": garage, "agvs": 1, "plant": "discrete", "duration_s": 5.0, "bays": 2,
        "workload": {"kind": "poisson", "arrivals_per_h": 1.0, "duration_min": 1.0},
    }  # fmt: skip
    simulate(check_scenario(scenario, "test", Path()), tmp_path / "run")
    head = unpack(write_replay(tmp_path / "run").read_text())[0]
    graph = read_net(garage).graph
    labels = {head["floor"]["names"][place[1]]: place[6] for place in head["floor"]["places"] if place[0] == "bay"}
    assert labels == {graph.names[v]: k for k, v in enumerate([*graph.bays][:2], start=1)}
    assert load_run(tmp_path / "run").meta["day_start_h"] is None
