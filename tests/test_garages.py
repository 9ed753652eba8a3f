"""Random small garages under four planners: whoever is let in is served, and the other garages are refused by name.

A part of what ``benchmarks/remake.py garages`` runs; that a refusal is right is looked at in ``test_passing.py``.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from sumo_nets.check import check_net
from sumo_nets.plan import plan_garage
from sumo_nets.read import read_net

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import garages

#: Garage 288 is a ring with homes on it: AGVs pass each other in empty slots, which are full later.
NUMBERS = (*range(2, 12), 288)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_garage_that_is_let_in_serves_everybody(number: int, ticks_watched: None) -> None:
    complaints = check_net(read_net(garages.net_of(number)))
    for planner in garages.PLANNERS:
        row = garages.run(number, planner, "discrete")
        assert garages.is_good(row), (planner, row)
        if row["status"] == "refused":
            named = set(re.findall(r"\w+", row["reason"]))
            assert named & {*plan_garage(garages.draw(number).layout).vertices}
        else:
            assert not complaints
            assert row["tasks_done"] > 0
        if complaints:
            assert row["reason"].startswith(complaints[0])


def test_every_kind_of_garage_is_drawn() -> None:
    layouts = [garages.draw(number).layout for number in range(60)]
    assert {layout.handover for layout in layouts} == {"bay", "home"}
    assert {way.way for layout in layouts for way in layout.aisles} == {"one", "two"}
    assert any(layout.picture for layout in layouts)
    for rows in ("slots", "homes", "chargers"):
        sides = {side for layout in layouts for row in getattr(layout, rows) for side in row.side}
        assert sides == {"north", "south", "east", "west", "here"}
    assert {garages.draw(number).keys["agvs"] for number in range(60)} == {1, 2, 3, 4, 5}


def test_a_run_that_left_somebody_waiting_is_not_good() -> None:
    row = {"status": "finished", "requests_waiting": 0, "deadlocks_unresolved": 0}
    assert garages.is_good(row)
    assert garages.is_good({**row, "status": "refused"})
    for wrong in ({"status": "stalled"}, {"requests_waiting": 1}, {"deadlocks_unresolved": 1}):
        assert not garages.is_good({**row, **wrong})
