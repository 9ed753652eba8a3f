"""Metrics against numbers worked out by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from test_analysis_runs import synthetic_meta, synthetic_recorder

from analysis.metrics import METRICS, run_metrics, share_within
from analysis.record import AgvRow, PlanningRow, Recorder, TaskRow
from analysis.tables import load_run, recorded_run
from analysis.turned_away import TurnedAway, turned_away, turned_away_words

META = {
    "simulated_s": 1000.0,
    "step_s": 0.5,
    "tasks_wanted": 7,
    "cars_initial": 3,
    "cars_arrived": 2,
    "cars_parked": 1,
    "cars_left": 3,
    "cars_in_transit": 1,
    "least_clearance_m": 0.4,
    "sumo_collisions": 0,
    "footprint_overlaps": 2,
    "wall_s": {"total": 4.0},
}


def by_hand() -> Recorder:
    recorder = Recorder()
    for request in range(13):
        recorder.event(0.0, "request_made", request=request)
    # two parks: queue 10 and 30, wait 70 and 90, total 200 and 300
    first = TaskRow(
        0, "park", "a", "served", agv=0, origin="bay", destination="s1", requested_s=0, at_bay_s=10, ready_s=60,
        assigned_s=60, lifted_s=80, delivered_s=200, done_s=200,
    )  # fmt: skip
    second = TaskRow(
        1, "park", "b", "served", agv=1, origin="bay", destination="s2", requested_s=100, at_bay_s=130, ready_s=190,
        assigned_s=190, lifted_s=220, delivered_s=400, done_s=400,
    )  # fmt: skip
    recorder.task(first)
    recorder.task(second)
    # retrievals: waits 100, 200, 400; one more delivered but not driven off: 300
    for request, wait in ((2, 100.0), (3, 200.0), (4, 400.0)):
        row = TaskRow(
            request,
            "retrieve",
            "c",
            "served",
            agv=0,
            origin="s1",
            destination="bay",
            requested_s=0.0,
            ready_s=0.0,
            assigned_s=1.0,
            lifted_s=2.0,
            delivered_s=wait,
            done_s=wait + 50,
        )
        recorder.task(row)
    recorder.task(
        TaskRow(5, "retrieve", "d", "waiting", reason="customer at the bay", requested_s=600.0, delivered_s=900.0)
    )
    # still waiting for 250 s (over 180, not over 300); void, because its car was turned away
    recorder.task(TaskRow(6, "retrieve", "e", "waiting", reason="no AGV yet", requested_s=750.0))
    recorder.task(TaskRow(7, "retrieve", "zz", "void", reason="car was turned away", requested_s=5.0))
    # four customers turned away; one more was inside already, who did not come
    for request, (state, reason) in enumerate(
        [("turned_away", f"queue too long: {n} cars") for n in (12, 13)]
        + [("turned_away", "every slot is taken or promised: 4 parked, 2 in the queue, 1 on their way in")] * 2
        + [("void", "car is in the garage already")]
    ):
        recorder.task(TaskRow(8 + request, "park", f"z{request}", state, reason=reason, requested_s=4.0))
    for time_s, queue, spilled in ((0.0, 0, 0), (100.0, 4, 1), (300.0, 1, 0), (960.0, 9, 3)):
        recorder.timeline(time_s, queue, spilled, 5, 0, 1)
    for time_s, wall_ms, status in ((0.0, 1.0, "solved"), (0.0, 2.0, "partial"), (0.5, 6.0, "solved")):
        row = PlanningRow(
            time_s=time_s, agents=2, status=status, window_steps=64, expanded=10, heap_moves=100, generated=40, valid=8,
            slot_choice=5, wall_ms=wall_ms,
        )  # fmt: skip
        recorder.planning(row)
    for k, cost in enumerate((2.0, 6.0)):
        recorder.event(10.0, "deadlock_found", deadlock=k, members=[0, 1], cause="head-on")
        recorder.event(
            10.0 + cost, "deadlock_resolved", deadlock=k, members=[0, 1], cause="head-on", stage="leader", cost_s=cost
        )
    recorder.event(99.0, "deadlock_found", deadlock=2, members=[0, 1], cause="head-on")
    recorder.agv(AgvRow(0, 30, 150.0, 3, 100, 200, 50, 50, 50, 150, 100, 300, 80.0))
    recorder.agv(AgvRow(1, 10, 50.0, 2, 200, 0, 0, 0, 0, 0, 0, 790, 20.0))
    return recorder


EXPECTED = {
    "simulated_s": 1000.0,
    "tasks_wanted": 7,
    "tasks_done": 5,
    "requests": 13,
    "requests_waiting": 2,
    "requests_void": 2,
    "customers_came": 6,
    "customers_turned_away": 4,
    "turned_away_share": 4 / 6,
    "requests_conserved": 1,
    "cars_conserved": 1,
    "parks_done": 2,
    "retrievals_done": 3,
    "cars_in_per_hour": 7.2,
    "cars_out_per_hour": 10.8,
    "retrieval_wait_mean_s": 250.0,
    "retrieval_wait_p50_s": 250.0,
    "retrieval_wait_p90_s": 360.0,
    "retrieval_wait_p95_s": 380.0,
    "retrieval_wait_p99_s": 396.0,
    "retrieval_wait_max_s": 400.0,
    "retrieval_total_mean_s": (850 + 400 + 250) / 5,
    "retrieval_within_180_s_share": 1 / (5 + 4),
    "retrieval_within_300_s_share": 3 / (4 + 4),
    "park_queue_mean_s": 20.0,
    "park_wait_p50_s": 80.0,
    "park_total_max_s": 300.0,
    "queue_mean": (4 * 200 + 660 + 9 * 40) / 1000,
    "queue_p95": 4.0,
    "queue_max": 9,
    "spill_back_s": 240.0,
    "spill_back_max": 3,
    "parked_max": 5,
    "agv_empty_share": 300 / 1990,
    "agv_loaded_share": 200 / 1990,
    "agv_idle_share": 1090 / 1990,
    "agv_busy_share": 800 / 1990,
    "empty_travel_share": 0.6,
    "agv_time_error_s": 10.0,
    "distance_m": 200.0,
    "energy_wh": 100.0,
    "deadlocks_found": 3,
    "deadlocks_resolved": 2,
    "deadlocks_unresolved": 1,
    "deadlock_p50_s": 4.0,
    "deadlock_max_s": 6.0,
    "sumo_collisions": 0,
    "footprint_overlaps": 2,
    "least_clearance_m": 0.4,
    "steps": 2000,
    "throughput": 5 / 2000,
    "movement_cost": 40,
    "nodes_expanded": 30,
    "heap_moves": 300,
    "nodes_generated": 120,
    "valid_expansions": 24,
    "valid_ratio": 0.2,
    "slot_choice_expanded": 15,
    "planning_calls": 3,
    "planning_unsolved_share": 1 / 3,
    "wall_planning_call_p50_ms": 2.0,
    "wall_planning_call_max_ms": 6.0,
    "wall_planning_step_p50_ms": 0.0,
    "wall_total_s": 4.0,
    "wall_speed": 250.0,
}


def test_metrics_by_hand() -> None:
    metrics = run_metrics(recorded_run(by_hand(), META))
    assert {key: metrics[key] for key in EXPECTED} == pytest.approx(EXPECTED)
    assert list(metrics) == list(METRICS)


def test_planning_time_of_a_step_adds_its_calls() -> None:
    metrics = run_metrics(recorded_run(by_hand(), {"simulated_s": 1.0, "step_s": 0.5}))
    assert metrics["wall_planning_step_p50_ms"] == pytest.approx((3.0 + 6.0) / 2)


def test_cars_that_vanish_are_noticed() -> None:
    metrics = run_metrics(recorded_run(by_hand(), {**META, "cars_left": 2}))
    assert metrics["cars_conserved"] == 0


def test_requests_that_vanish_are_noticed() -> None:
    recorder = by_hand()
    recorder.event(5.0, "request_made", request=13)
    assert run_metrics(recorded_run(recorder, META))["requests_conserved"] == 0


def test_share_counts_a_locked_garage_as_missed() -> None:
    recorder = Recorder()
    for request in range(4):
        recorder.task(TaskRow(request, "retrieve", "a", "waiting", requested_s=0.0))
    assert share_within(recorded_run(recorder, {}).tasks, 180.0, 1000.0) == 0.0
    assert math.isnan(share_within(recorded_run(recorder, {}).tasks, 180.0, 100.0))


def test_turned_away_in_words() -> None:
    away = turned_away(recorded_run(by_hand(), META).tasks)
    assert (away.number, away.came) == (4, 6)
    assert away.reasons == {"every slot is taken or promised": 2, "queue too long": 2}
    assert turned_away_words(away) == (
        "4 of 6 customers were turned away (67 %): every slot is taken or promised 2, queue too long 2"
    )
    assert turned_away_words(TurnedAway(1, 4000)) == "1 of 4,000 customers was turned away (0.025 %)"
    assert turned_away_words(TurnedAway(0, 7)) == "none of 7 customers was turned away"
    assert turned_away_words(turned_away(recorded_run(Recorder(), {}).tasks)) == "no customer came with a car"


def test_empty_record_has_all_keys_and_writes_null(tmp_path: Path) -> None:
    metrics = run_metrics(recorded_run(Recorder(), {}))
    Recorder().write(tmp_path, {}, metrics)
    assert list(metrics) == list(METRICS)
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert written["retrieval_wait_p95_s"] is None
    assert written["tasks_done"] == 0
    assert list(written) == sorted(METRICS)


def test_metrics_of_a_written_run_equal_those_of_its_recorder(tmp_path: Path) -> None:
    recorder, meta = synthetic_recorder(hours=0.3), synthetic_meta(0.3)
    metrics = run_metrics(recorded_run(recorder, meta))
    recorder.write(tmp_path, meta, metrics)
    assert run_metrics(load_run(tmp_path)) == pytest.approx(metrics, nan_ok=True)
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert {k: math.nan if v is None else v for k, v in written.items()} == pytest.approx(metrics, nan_ok=True)


def test_every_metric_says_its_unit_and_meaning() -> None:
    for key, (unit, meaning) in METRICS.items():
        assert meaning, key
        assert unit or not key.endswith(("_s", "_ms", "_m")), key
