"""Whole runs from a few keys, and what must hold at the end of each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from analysis.tables import Run, load_run
from parking_sim.config import check_scenario
from parking_sim.simulation import simulate

MAPS = ("map1", "map2", "map3", "map1_thesis", "map2_thesis", "map3_thesis")


def run(folder: Path, **keys: Any) -> Run:
    """Run a scenario given by its keys and read its record."""
    simulate(check_scenario(keys, "test", Path()), folder)
    return load_run(folder)


def check_whole(record: Run) -> None:
    """Nobody met, nothing and nobody got lost: by the run's own figures, its tables, and SUMO's outputs."""
    meta, tasks = record.meta, record.tasks
    assert meta["audit"] == []
    assert (meta["sumo_collisions"], meta["footprint_overlaps"]) == (0, 0)
    assert [words for testimony in meta["witnesses"].values() for words in testimony["words"]] == []
    arrived = tasks[(tasks.kind == "park") & ~tasks.state.isin(("turned_away", "void"))]
    parked = arrived[arrived.state == "served"]
    gone = tasks[(tasks.kind == "retrieve") & (tasks.state == "served")]
    assert meta["cars_arrived"] == len(arrived)
    assert meta["cars_left"] == len(gone)
    lifted = tasks[(tasks.kind == "retrieve") & tasks.lifted_s.notna()]
    assert meta["cars_parked"] == meta["cars_initial"] + len(parked) - len(lifted)
    assert meta["cars_in_transit"] == len(arrived) - len(parked) + len(lifted) - len(gone)
    made = record.events[record.events.kind == "request_made"]
    assert len(made) == len(tasks)
    assert set(tasks.state) <= {"served", "waiting", "turned_away", "void"}


def check_all_done(record: Run, cars: int) -> None:
    """Every car was parked and brought back, and every deadlock is over."""
    check_whole(record)
    assert record.meta["status"] == "finished"
    assert list(record.tasks.state) == ["served"] * 2 * cars
    assert (record.meta["cars_parked"], record.meta["cars_left"], record.meta["cars_in_transit"]) == (0, cars, 0)
    found, resolved = (set(deadlocks(record, kind)) for kind in ("deadlock_found", "deadlock_resolved"))
    assert found == resolved


def deadlocks(record: Run, kind: str) -> list[int]:
    """Numbers of the deadlocks that events of a kind tell of."""
    return [json.loads(detail)["deadlock"] for detail in record.events[record.events.kind == kind].detail]


def coming_next(record: Run, names: Sequence[str]) -> list[tuple[float, int, int, str]]:
    """When an AGV is at work at a bay while another one has a plan to it: the time, these two, and the bay."""
    works = record.events[record.events.kind.isin(("lift", "lower"))].sort_values("time_s")
    ways: dict[int, list[str]] = {}
    found = []
    for time_s, agv, path in record.plans.sort_values("time_s")[["time_s", "agv", "path"]].itertuples(index=False):
        ways[agv] = [names[int(v)] for v in path.split()]
        bay = ways[agv][-1]
        if bay.startswith("bay") and len(ways[agv]) > 1:
            for n in (n for n, way in ways.items() if way[0] == bay):
                if works[(works.agv == n) & (works.time_s > time_s)].vertex.iloc[:1].eq(bay).any():
                    found.append((time_s, n, agv, bay))
    return found
