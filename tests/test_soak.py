"""The soak benchmark in small: every fault on at once, nothing meets, locks up or gets lost; and its watchers see."""

from __future__ import annotations

import pytest
import soak

from controller.executor import Executor
from controller.visits import Barred
from parking_sim.config import check_scenario
from parking_sim.simulation import simulate


@pytest.mark.parametrize("planner", ["whca", "token"])
def test_small(planner):
    case = ("map1", 8, "bursts", 12.0)
    row = soak.run(case, 0, planner, 12.0)
    assert (row["status"], row["tasks_done"], row["lost"]) == ("finished", row["tasks_wanted"], 0)
    assert not any(row[key] for key in soak.MUST_BE_ZERO), row
    assert row["tasks_done"] > 5
    assert set(row["faults"]) >= {"stop", "slow", "stale", "blocked", "late", "lost"}
    assert all(seconds > 0 for times in row["faults"].values() for seconds in times)


def test_each_call_adds_pieces_to_the_ledger(tmp_path, monkeypatch):
    """A call goes on where the ledger ends; the same number is the same piece."""
    monkeypatch.setattr(soak, "DEMAND_S", {"discrete": 300.0})
    made = []
    monkeypatch.setattr(soak, "ProcessPoolExecutor", lambda *_args, **_keys: _Here(made))
    path = tmp_path / "ledger.csv"
    for _ in range(2):
        soak.add_pieces("discrete", 1.0, 1, path)
    ledger = soak.read_ledger(path)
    assert list(ledger.piece) == list(range(len(ledger)))
    assert len(ledger) >= 2
    assert (ledger.finds == "").all()
    assert ledger.agv_steps.sum() > 0
    again = soak.make("discrete", 0)
    assert (again["agv_steps"], again["tasks_done"]) == (ledger.agv_steps[0], ledger.tasks_done[0])
    assert soak.in_sum(ledger).pieces.sum() == len(ledger)


class _Here:
    """A pool without processes."""

    def __init__(self, made):
        self.made = made

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def submit(self, function, *words):
        from concurrent.futures import Future

        future = Future()
        future.set_result(function(*words))
        return future


def test_pieces_draw_all_planners_and_shapes():
    drawn = [soak.piece("discrete", number) for number in range(90)]
    assert len({p["planner"] for p in drawn} & set(soak.PLANNERS["discrete"])) > 5
    assert {p["garage"].split()[0] for p in drawn} == {"map1", "map2", "map3", "random"}
    assert {p["workload"]["kind"] for p in drawn} == {"poisson", "bursts"}


def test_the_watchers_see_what_a_broken_executor_does(monkeypatch):
    """Grants without an owner, and through parked cars: the ledger would say so."""
    monkeypatch.setattr(soak, "DEMAND_S", {"discrete": 300.0})
    monkeypatch.setattr(soak, "GIVE_UP_S", {"discrete": 400.0})

    def claim(self, agv, vertex):
        self.order[vertex].remove(agv)
        return True

    monkeypatch.setattr(Executor, "_claim", claim)
    monkeypatch.setattr(Barred, "on", lambda _self, _path: -1)
    finds = [soak.make("discrete", number)["finds"] for number in (0,)]
    assert any("two AGVs" in find for find in finds), finds


def test_an_agv_that_is_moved_out_of_a_slot_with_its_car_leaves_the_slot_to_others(tmp_path):
    """Piece 294: an AGV waited in a slot for a bay, and the resolution of a deadlock moved it away.

    No car could ever be parked in that slot again.
    """
    keys = soak.scenario_keys("discrete", 294)
    summary = simulate(check_scenario(keys | {"duration_s": 4800.0}, "piece", tmp_path))
    assert summary.metrics["cars_conserved"] == 1
    assert summary.metrics["deadlocks_resolved"] > 10
