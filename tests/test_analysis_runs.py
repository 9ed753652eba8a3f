"""Records made by hand for the tests of the analysis, and that they load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.record import NAN, AgvRow, AgvSample, PlanningRow, Recorder, TaskRow
from analysis.tables import COLUMNS, load_run, recorded_run
from sumo_nets.graph import Graph, make_graph


def grid(width: int = 20, aisles: int = 3) -> Graph:
    """Aisles of 5 m cells with slots on both sides, a bay at the left and a link at the right."""
    vertices: list[tuple[str, float, float]] = []
    edges: list[tuple[str, str, str, float]] = []
    slots = []

    def both(u: str, v: str) -> None:
        edges.extend([(f"{u}_{v}", u, v, 5.0), (f"{v}_{u}", v, u, 5.0)])

    for a in range(aisles):
        y = a * 15.0
        for x in range(width):
            vertices.append((f"a{a}_{x}", x * 5.0, y))
            if x:
                both(f"a{a}_{x - 1}", f"a{a}_{x}")
            for side in (-1, 1):
                if 0 < x < width - 1:
                    slot = f"s{a}_{x}{'n' if side > 0 else 's'}"
                    vertices.append((slot, x * 5.0, y + side * 5.0))
                    slots.append(slot)
                    both(f"a{a}_{x}", slot)
        if a:
            both(f"a{a - 1}_{width - 1}", f"a{a}_{width - 1}")
            both(f"a{a - 1}_0", f"a{a}_0")
    bays = [f"a{a}_0" for a in range(aisles)]
    return make_graph("grid", vertices, edges, {"slot": slots, "bay": bays, "charger": ["a0_19"], "home": ["a2_19"]})


def synthetic_recorder(seed: int = 0, hours: float = 2.0, agvs: int = 6) -> Recorder:
    """A made-up run that looks like one: waits with a tail, a peak, a few deadlocks, AGVs that wander."""
    rng = np.random.default_rng(seed)
    recorder, graph, end = Recorder(), grid(), hours * 3600.0
    recorder.floor(graph)
    _add_tasks(recorder, rng, graph, end, agvs)
    _add_deadlocks(recorder, rng, end, agvs)
    _add_samples(recorder, rng, graph, end, agvs)
    for agv in range(agvs):
        share = rng.dirichlet([8.0, 6.0, 2.0, 3.0, 2.0, 3.0 + agv, 1.0, 4.0]) * end
        driven = float(share[0] * 1.4 + share[1] * 0.9)
        recorder.agv(AgvRow(agv, int(driven / 5), driven, 20 + agv, *map(float, share), energy_wh=driven * 0.4))
    return recorder


def synthetic_meta(hours: float = 2.0) -> dict[str, Any]:
    return {
        "status": "finished",
        "command": "parking-sim run map1 --agvs 6 --seed 7 --out runs/example",
        "map": "map1",
        "seed": 7,
        "scenario": {
            "garage": "map1",
            "agvs": 6,
            "planner": "whca",
            "workload": {"kind": "poisson", "per_hour": 60},
            "faults": {"commands": {"late": 0.0, "late_s": 3.0}, "script": []},
        },
        "versions": {"parking-sim": "0.1.0", "python": "3.11.2", "libsumo": "1.28.0", "numpy": "2.4.6"},
        "step_s": 0.5,
        "simulated_s": hours * 3600.0,
        "tasks_wanted": 120,
        "sumo_collisions": 0,
        "footprint_overlaps": 0,
        "least_clearance_m": 0.42,
        "cars_initial": 0,
        "cars_arrived": 63,
        "cars_parked": 5,
        "cars_left": 56,
        "cars_in_transit": 2,
        "wall_s": {"total": 12.5, "sumo": 6.0, "planning": 4.0, "execution": 1.5, "recording": 0.4},
    }


def _add_tasks(recorder: Recorder, rng: np.random.Generator, graph: Graph, end: float, agvs: int) -> None:
    times = np.sort(np.concatenate([rng.uniform(0, end, 80), rng.normal(end / 2, 400, 40).clip(0, end)]))
    parked: list[str] = []
    for k, t in enumerate(times):
        slot = graph.names[graph.slots[int(rng.integers(len(graph.slots)))]]
        retrieve = bool(parked) and rng.random() < 0.5
        car = parked.pop(int(rng.integers(len(parked)))) if retrieve else f"car{k}"
        agv = int(rng.integers(agvs))
        at_bay = float(t + rng.exponential(40)) if not retrieve else NAN
        ready = at_bay + 60.0 if not retrieve else float(t)
        assigned = ready + float(rng.exponential(30))
        lifted = assigned + float(rng.lognormal(4.2, 0.4))
        delivered = lifted + float(rng.lognormal(4.3, 0.3))
        done = delivered + (float(rng.lognormal(4.0, 0.3)) if retrieve else 0.0)
        kind, served = ("retrieve" if retrieve else "park"), done <= end
        recorder.event(float(t), "request_made", car=car, request=k, what=kind)
        ends = ("a0_0", slot)[::-1] if retrieve else ("a0_0", slot)
        if served:
            parked.extend([car] * (not retrieve))
            row = TaskRow(
                k,
                kind,
                car,
                "served",
                agv=agv,
                origin=ends[0],
                destination=ends[1],
                requested_s=float(t),
                at_bay_s=at_bay,
                ready_s=ready,
                assigned_s=assigned,
                lifted_s=lifted,
                delivered_s=delivered,
                done_s=done,
            )
        else:
            row = TaskRow(k, kind, car, "waiting", reason="end of run", requested_s=float(t))
        recorder.task(row)


def _add_deadlocks(recorder: Recorder, rng: np.random.Generator, end: float, agvs: int) -> None:
    for k, t in enumerate(np.sort(rng.uniform(0, end - 200, 9))):
        members = sorted(rng.choice(agvs, size=int(rng.integers(2, 4)), replace=False).tolist())
        cause = str(rng.choice(["head-on in a two-way lane", "idle AGV in the way", "ring of waits"]))
        recorder.event(float(t), "deadlock_found", vertex="a1_5", deadlock=k, members=members, cause=cause)
        if k == 4:
            recorder.event(float(t) + 1.0, "stage_failed", deadlock=k, stage="partial_cbs", reason="no solution")
        if k < 8:
            cost = round(float(rng.lognormal(2.0, 0.7)), 1)
            stage = str(rng.choice(["partial_cbs", "leader", "pull_over"]))
            recorder.event(
                float(t) + cost, "deadlock_resolved", deadlock=k, members=members, cause=cause, stage=stage, cost_s=cost
            )


def _add_samples(recorder: Recorder, rng: np.random.Generator, graph: Graph, end: float, agvs: int) -> None:
    at = [int(v) for v in rng.integers(len(graph.names), size=agvs)]
    for t in np.arange(0.0, end, 5.0):
        speeds = [1.4 if rng.random() < 0.6 else 0.0 for _ in at]
        at = [int(rng.choice(graph.successors[v])) if s else v for v, s in zip(at, speeds, strict=True)]
        samples = [AgvSample(k, *map(float, graph.xy[v]), 0.0, speeds[k]) for k, v in enumerate(at)]
        recorder.sample(float(t), samples, ["going_to_park"] * agvs, [""] * agvs, [0.8] * agvs)
        peak = 8.0 * np.exp(-(((t - end / 2) / 900) ** 2))
        queue = int(rng.poisson(0.5 + peak))
        recorder.timeline(
            float(t), queue, max(0, queue - 6), int(20 + 30 * t / end), queue // 2, int(rng.integers(agvs))
        )
        expanded, generated = (int(x) for x in rng.poisson([300, 700]))
        recorder.planning(
            PlanningRow(
                time_s=float(t),
                agents=agvs,
                status="solved",
                window_steps=64,
                expanded=expanded,
                heap_moves=3 * generated,
                generated=generated,
                valid=expanded - 5,
                wall_ms=float(rng.lognormal(0.5, 0.8)),
            )
        )


def test_loads_what_was_recorded(tmp_path: Path) -> None:
    import pandas as pd

    recorder = synthetic_recorder(hours=0.2)
    recorder.write(tmp_path, synthetic_meta(0.2))
    run, unwritten = load_run(tmp_path), recorded_run(recorder, synthetic_meta(0.2))
    assert run.meta["seed"] == 7
    for table in COLUMNS:
        loaded, direct = getattr(run, table), getattr(unwritten, table)
        assert list(loaded.columns) == list(COLUMNS[table])
        pd.testing.assert_frame_equal(loaded, direct)


def test_details_become_columns(tmp_path: Path) -> None:
    run = recorded_run(synthetic_recorder(), {})
    found = run.details("deadlock_found")
    assert list(found["deadlock"]) == list(range(9))
    assert set(found["members"].map(len)) <= {2, 3}
    assert run.details("grant").empty


def test_folder_without_a_record(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no record of a run in .*run\.json is missing"):
        load_run(tmp_path)
