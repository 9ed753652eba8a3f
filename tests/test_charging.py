"""Who charges when and who gets tasks, judged from the events of whole records; drive-through slots by brute force."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from whole_runs import check_whole, run

from analysis.holds import long_waits
from analysis.metrics import run_metrics
from analysis.tables import Run
from controller.charging import AGE_SOC
from controller.types import AgvMode
from parking_sim.rulesets import RULE_SETS
from sumo_nets.graph import Graph
from sumo_nets.movingai import grid_graph
from sumo_nets.ways import shut_in

CHARGE_BELOW = 0.3  # in SUMO
TICKS_BELOW = 0.5  # in ticks
PLENTY = 0.8  # enough for any task on map1 in these tests


def events(record: Run, *kinds: str) -> list[dict[str, Any]]:
    """Events of these kinds in the order in which they were written, with their details."""
    rows = record.events[record.events.kind.isin(kinds)].to_dict("records")
    return [{**row, **(json.loads(row["detail"]) if row["detail"] else {})} for row in rows]


FREE = (AgvMode.IDLE, AgvMode.RETURNING_HOME_EMPTY)


def discrete(folder: Path, rules: dict[str, int], **keys: Any) -> Run:
    """A run in ticks with changed rules and grants recorded."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(RULE_SETS, "fair", replace(RULE_SETS["fair"], **rules))
        return run(
            folder,
            garage="map1",
            plant="discrete",
            max_time_s=30_000.0,
            record={"grants": True, "replay": False},
            **keys,
        )


def traffic(per_h: float, minutes: float) -> dict[str, Any]:
    return {
        "kind": "poisson", "arrivals_per_h": per_h, "dwell_median_min": 5, "duration_min": minutes,
        "initial_occupancy": 0.3,
    }  # fmt: skip


class Told:
    """What a record in ticks tells about charging, worked out from cells granted, charges ended and changes of mode.

    Attributes:
        soc: by tick and AGV the state of charge.
        free: by tick and AGV whether it had no task and was not charging, at the end of the tick.
        idle: the same, and it was at home, where tasks are given out in ticks.
    """

    def __init__(self, record: Run, cells: int) -> None:
        ticks, agvs = int(record.meta["simulated_s"]) + 2, len(record.agvs)
        lost, charged = np.zeros((ticks, agvs)), np.zeros((ticks, agvs), dtype=bool)
        self.free, self.idle = np.ones((ticks, agvs), dtype=bool), np.ones((ticks, agvs), dtype=bool)
        for event in events(record, "grant", "charge_end", "agv_mode"):
            at, agv = int(event["time_s"]), event["agv"]
            if event["kind"] == "grant":
                lost[at + 1, agv] = (1.0 - TICKS_BELOW) / cells
            elif event["kind"] == "charge_end":
                charged[at, agv] = True
            else:
                self.free[at:, agv] = event["to"] in FREE
                self.idle[at:, agv] = event["to"] == AgvMode.IDLE
        self.soc = np.ones((ticks, agvs))
        for at in range(1, ticks):
            self.soc[at] = np.where(charged[at], 1.0, self.soc[at - 1]) - lost[at]


def check_charging(record: Run, told: Told, charge: int) -> None:
    """Nobody runs flat, the emptiest goes first, who is due works only if no full one is free, none waits long."""
    assert told.soc.min() >= 0.0, "it ran flat"
    agvs = len(record.agvs)
    waiting: dict[int, int] = {}
    for event in events(record, "charge_wait", "agv_mode", "charge_start", "task_assigned"):
        at, agv = int(event["time_s"]), event["agv"]
        if event["kind"] == "charge_wait":
            waiting[agv] = at
        elif event["kind"] == "charge_start":
            assert event["soc"] == pytest.approx(told.soc[at, agv], abs=1e-3)
            since = waiting.pop(agv, at)
            assert at - since <= (agvs + 3) * (charge + 150), f"AGV {agv} waited {at - since} ticks"
        elif event["kind"] == "task_assigned" and told.soc[at, agv] <= TICKS_BELOW:
            others = (n for n in range(agvs) if told.soc[at, n] > PLENTY)
            assert not any(told.idle[at, n] and told.idle[at - 1, n] for n in others), "a fuller one was free"
        elif event["kind"] == "agv_mode" and event["to"] == AgvMode.GOING_TO_CHARGE:
            for n in (n for n in waiting if n != agv and told.free[at, n]):
                allowed = AGE_SOC * (at - waiting.get(agv, at)) / charge
                assert told.soc[at, agv] <= told.soc[at, n] + allowed + 1e-9, f"AGV {n} was emptier"
    end = int(record.meta["simulated_s"])
    assert all(end - since <= (agvs + 3) * (charge + 150) for since in waiting.values())


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    agvs=st.integers(2, 6), charge=st.integers(20, 120), cells=st.integers(300, 600), per_h=st.integers(60, 200),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_whatever_the_fleet_and_its_batteries_one_charger_serves_all_in_turn(
    tmp_path_factory, agvs, charge, cells, per_h, seed
):
    record = discrete(
        tmp_path_factory.mktemp("run"), {"charge": charge, "charge_after_cells": cells}, agvs=agvs, chargers=1,
        seed=seed, workload=traffic(per_h, 20),
    )  # fmt: skip
    assert record.meta["status"] == "finished"
    assert set(record.tasks.state) <= {"served", "turned_away", "void"}
    check_charging(record, Told(record, cells), charge)


@pytest.fixture(scope="module")
def crowded(tmp_path_factory) -> Run:
    """Six AGVs, one slow charger."""
    return discrete(
        tmp_path_factory.mktemp("crowded"), {"charge": 300, "charge_after_cells": 300}, agvs=6, chargers=1, seed=2,
        workload=traffic(240, 60),
    )  # fmt: skip


def test_agvs_queue_for_the_only_charger_and_the_emptiest_goes_first(crowded):
    check_charging(crowded, Told(crowded, 300), 300)
    started = events(crowded, "charge_start")
    assert {event["agv"] for event in started} == set(range(6))
    assert len({event["agv"] for event in events(crowded, "charge_wait")}) >= 3
    spans = [(e["kind"], e["agv"]) for e in events(crowded, "charge_start", "charge_end")]
    assert all(kind == "charge_end" for (kind, _), (after, _) in pairwise(spans) if after == "charge_start")


def test_a_wait_for_a_charger_is_named_and_counted(crowded):
    causes = [event["cause"] for event in events(crowded, "held")]
    assert "no_charger" in causes
    assert any("no charger is free" in reason for wait in long_waits(crowded) for reason in wait.reasons)
    waits: dict[int, float] = {}
    waited = 0.0
    for event in events(crowded, "charge_wait", "charge_start"):
        if event["kind"] == "charge_wait":
            waits[event["agv"]] = event["time_s"]
        else:
            waited += event["time_s"] - waits.pop(event["agv"], event["time_s"])
    waited += sum(crowded.meta["simulated_s"] - since for since in waits.values())
    metrics = run_metrics(crowded)
    assert metrics["charger_wait_s"] == pytest.approx(waited)
    assert metrics["charges"] == len(events(crowded, "charge_start"))
    assert metrics["charger_busy_share"] == pytest.approx(crowded.agvs.charging_s.sum() / crowded.meta["simulated_s"])


def test_a_fleet_that_is_low_altogether_charges_in_turn_and_then_serves_everybody(tmp_path):
    script = [{"at_s": 1.0, "kind": "battery", "agv": n, "for_s": 20.0} for n in range(4)]
    record = discrete(
        tmp_path / "run", {"charge": 200}, agvs=4, chargers=1, seed=3, workload=traffic(120, 20),
        faults={"script": script, "battery": {"per_h": 0, "brings": 0.15}},
    )  # fmt: skip
    assert record.meta["status"] == "finished"
    assert set(record.tasks.state) == {"served"}
    first = [event["agv"] for event in events(record, "charge_start")][:4]
    assert sorted(first) == [0, 1, 2, 3]
    assert len(events(record, "fault_start")) == 4, "an AGV has run flat again"


def test_one_charger_for_six_agvs_is_enough_where_the_energy_is(tmp_path):
    """In SUMO. Where charge was not looked at, AGVs of this fleet ran flat six times, and had tasks at under 5 %."""
    record = run(
        tmp_path / "run", garage="map1", agvs=6, chargers=1, seed=2, duration_s=10_800.0,
        record={"replay": False, "plans": False, "sample_s": 30.0}, agv={"battery_wh": 300.0, "charge_w": 700.0},
        workload={
            "kind": "poisson", "arrivals_per_h": 12, "dwell_median_min": 60, "duration_min": 150,
            "initial_occupancy": 0.4,
        },
    )  # fmt: skip
    check_whole(record)
    assert not events(record, "fault_start")
    assert record.trajectory.soc.min() > 0.0
    assert {event["agv"] for event in events(record, "charge_start")} >= {2, 3, 4, 5}
    assert set(record.tasks.state) == {"served"}
    for event in events(record, "task_assigned"):
        before = record.trajectory[record.trajectory.time_s <= event["time_s"]].groupby("agv").last()
        idle = before[before["mode"] == AgvMode.IDLE]
        assert before.soc[event["agv"]] > 0.05 or not (idle.soc > CHARGE_BELOW).any()


# --- drive-through slots ----------------------------------------------------------------------------------------------


@st.composite
def small_garages(draw: st.DrawFn) -> Graph:
    """A grid with a bay, a home and some slots; slots may have lanes at several sides."""
    width, height = draw(st.integers(3, 5)), draw(st.integers(2, 4))
    cells = [[draw(st.sampled_from("...eee@")) for _ in range(width)] for _ in range(height)]
    cells[0][0], cells[0][1] = "b", "r"
    return grid_graph("small", ["".join(row) for row in cells])


def reached(graph: Graph, parked: set[int]) -> set[int]:
    """Where one can get from the bay round parked cars; a car's own slot may be the end of a way."""
    model = graph.to_networkx()
    (bay,) = graph.bays
    open_floor = nx.descendants(model.subgraph(set(model) - parked), bay) | {bay}
    return open_floor | {v for u in open_floor for v in model.successors(u)}


@settings(max_examples=150, deadline=None)
@given(small_garages())
def test_in_a_garage_that_is_accepted_no_parked_cars_shut_in_a_place(graph):
    """Whatever the order in which slots were filled and emptied, some of them are taken: all such sets are tried."""
    slots = list(graph.slots)[:8]
    places = {*graph.slots, *graph.bays, *graph.homes}
    fillings = [set(itertools.compress(slots, taken)) for taken in product((0, 1), repeat=len(slots))]
    shut = [parked for parked in [*fillings, set(graph.slots)] if not places <= reached(graph, parked)]
    assert not shut or list(shut_in(graph)) or not places <= reached(graph, set())


def test_a_slot_between_the_bay_and_most_of_the_garage_is_refused_whichever_side_is_the_larger():
    """Behind the first slot are as many places as before it, and more aisles."""
    graph = grid_graph("far", ["br@..", ".@...", "e...e", "..ee."])
    assert list(shut_in(graph)) == ["no way to 0,0, 1,0 but through slots: cars parked in 0,2 would shut them in"]


def test_of_two_slots_between_two_aisles_each_is_left_at_its_own_end_and_a_third_between_them_is_refused():
    assert not list(shut_in(grid_graph("two", ["br.ee.", ".@@@@.", "......"])))
    line = grid_graph("line", ["br.eee.", ".@@@@@.", "......."])
    assert list(shut_in(line)) == ["no way to 4,0 but through slots: cars parked in 3,0, 5,0 would shut them in"]
    cars_beside = {v for v in line.slots if line.names[v] != "4,0"}
    (between,) = set(line.slots) - cars_beside
    assert between not in reached(line, cars_beside)
