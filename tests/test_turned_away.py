"""Customers turned away: random overload in the discrete plant, every request recounted from the record's times."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from whole_runs import check_whole, run

from analysis.measures import measure_runs, statistic
from analysis.metrics import run_metrics
from analysis.runs import Runs
from analysis.tables import Run
from parking_sim.cli import main

SLOTS, END_S = 61, 500.0


def overload(
    folder: Path, name: str, *, cars: int, seed: int, blocked: int, balk_cars: int | None = None, stay_s: float = 200.0
) -> Run:
    """Cars come evenly at random to map1, in which so many slots hold cars that never leave."""
    rng = np.random.default_rng(seed)
    come = np.sort(rng.uniform(0, END_S, cars)).round(1)
    rows = [(float(t), "park", f"c{k}") for k, t in enumerate(come)]
    rows += [
        (float(t + s), "retrieve", f"c{k}")
        for k, (t, s) in enumerate(zip(come, rng.exponential(stay_s, cars), strict=True))
    ]
    text = "\n".join(f"{time_s:.1f},{kind},{car}" for time_s, kind, car in sorted(rows))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.csv").write_text(f"time_s,kind,car\n{text}\n", encoding="utf-8")
    workload = {"kind": "csv", "path": str(folder / f"{name}.csv"), "initial_cars": [f"p{k}" for k in range(blocked)]}
    return run(
        folder / name, garage="map1", agvs=2, plant="discrete", planner="pibt", duration_s=END_S, workload=workload,
        customers={"balk_cars": balk_cars}, record={"sample_s": 60.0, "plans": False},
    )  # fmt: skip


def check_turned_away(record: Run, slots: int, balk_cars: int | None) -> None:
    """Each customer was turned away exactly when no slot was left, or the queue was too long, by the tasks' times."""
    parks, outs = (record.tasks[record.tasks.kind == kind] for kind in ("park", "retrieve"))
    came_in = parks[parks.state.isin(["served", "waiting"])]
    for row in parks.itertuples():
        t = row.requested_s
        before = came_in[came_in.request < row.request]
        parked = (before.delivered_s < t).sum() - (outs.lifted_s < t).sum()
        coming = (~(before.delivered_s < t)).sum()
        queue = (~(before.at_bay_s < t + 1)).sum()  # the plant brings a car to its bay one tick after it is called
        if parked + coming == slots:
            blocked = SLOTS - slots
            assert [int(n) for n in re.findall(r"\d+", row.reason)] == [parked + blocked, queue, coming - queue]
            assert row.reason.startswith("every slot is taken or promised: ")
        elif balk_cars is not None and queue >= balk_cars:
            assert row.reason == f"queue too long: {balk_cars} {'car' if balk_cars == 1 else 'cars'}"
        else:
            assert row.state in ("served", "waiting")
            continue
        assert row.state == "turned_away"
    away = set(parks[parks.state == "turned_away"].car)
    assert set(outs[outs.state == "void"].car) == away & set(outs.car)
    assert set(outs[outs.state == "void"].reason) <= {"car was turned away"}


@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    cars=st.integers(0, 150),
    seed=st.integers(0, 99),
    blocked=st.sampled_from([0, 40, 55, SLOTS]),
    balk_cars=st.sampled_from([None, 1, 4]),
)
def test_every_request_ends_in_one_state_and_all_add_up(
    cars: int, seed: int, blocked: int, balk_cars: int | None, tmp_path: Path
) -> None:
    record = overload(tmp_path, "run", cars=cars, seed=seed, blocked=blocked, balk_cars=balk_cars)
    check_whole(record)
    check_turned_away(record, SLOTS - blocked, balk_cars)
    m = run_metrics(record)
    ends = [m[key] for key in ("tasks_done", "requests_waiting", "customers_turned_away", "requests_void")]
    assert sum(ends) == m["requests"] == len(record.tasks)
    assert m["requests_conserved"] == m["cars_conserved"] == 1
    assert m["customers_came"] == (record.tasks.kind == "park").sum()
    assert m["customers_came"] == m["customers_turned_away"] + m["cars_arrived"]
    share = m["customers_turned_away"] / m["customers_came"] if m["customers_came"] else math.nan
    assert m["turned_away_share"] == pytest.approx(share, nan_ok=True)
    assert record.tasks.done_s.notna().sum() == m["tasks_done"], "who is not served is not done"


def test_a_small_garage_is_not_better_for_turning_customers_away(tmp_path: Path) -> None:
    """With 6 of its 61 slots the garage turns most customers away, and those let in have their cars sooner."""
    for name, blocked in (("whole", 0), ("small", 55)):
        overload(tmp_path, name, cars=40, seed=3, blocked=blocked, stay_s=60.0)
    runs = Runs({name: tmp_path / name for name in ("whole", "small")})
    plain, counted = (measure_runs(runs, endless=endless).set_index("run") for endless in (False, True))
    assert plain.turned_away_share["small"] > 0.2
    assert plain.turned_away_share["whole"] == 0
    for key in ("retrieval_wait_p95_s", "park_total_p95_s", "park_queue_mean_s"):
        assert plain[key]["small"] < plain[key]["whole"], "the trap: who was turned away does not wait"
        assert counted[key]["small"] == math.inf
        assert counted[key]["whole"] == plain[key]["whole"]


@given(st.lists(st.floats(0, 1e4), min_size=1, max_size=60), st.data(), st.sampled_from(["mean", "p50", "p95", "max"]))
def test_turning_customers_away_betters_no_measure(waits: list[float], data: st.DataObject, name: str) -> None:
    kept = [wait for wait in waits if data.draw(st.booleans())]
    assert statistic(name, sorted(kept), len(waits) - len(kept)) >= statistic(name, sorted(waits)) - 1e-6


def test_a_garage_without_a_queue_has_none_to_turn_away_from(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "s.yaml"
    scenario.write_text("{garage: map1_thesis, agvs: 1, plant: discrete, customers: {balk_cars: 3}}")
    with pytest.raises(SystemExit) as end:
        main(["run", str(scenario), "--out", str(tmp_path / "run")])
    assert end.value.code == 2
    said = capfd.readouterr().err
    assert said == "error: customers: balk_cars, balk_min: map1_thesis has no queue: cars are handed over at homes\n"
    assert not (tmp_path / "run").exists()
