"""What moves on the replay: AGVs by time, what they were told to do, and where cars stood."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from analysis.replay_data import Floats, Ints, Pose, Window, cm, ms
from analysis.replay_floor import INBOUND, OUTBOUND, SLOT, Floor
from analysis.tables import Run
from controller.types import NO_AGV, AgvMode, AgvNumber
from sumo_nets.numbering import Vertex

if TYPE_CHECKING:
    import pandas as pd

#: Modes by number.
MODES: Final = tuple(mode.value for mode in AgvMode)
#: Place, car, from, ready, to (seconds), vertex, pose.
_Stay = tuple[int, str, float, float, float, Vertex, Pose]


@dataclass(frozen=True)
class Track:
    """The trajectory as arrays of shape (samples, AGVs): x and y (cm), angle (0.1 degrees), mode, soc (percent)."""

    time_s: Floats
    columns: Mapping[str, Ints]

    def pose(self, agv: AgvNumber, time_s: float) -> tuple[int, int, int]:
        """Where an AGV was at the last sample before a time."""
        k = max(0, int(np.searchsorted(self.time_s, time_s, side="right")) - 1)
        x, y, angle = (int(self.columns[name][k, agv]) for name in ("x", "y", "angle"))
        return x, y, angle


def read_track(trajectory: pd.DataFrame) -> Track:
    """The table with its rows, ordered by time and AGV, as arrays."""
    agvs = int(trajectory["agv"].max()) + 1
    modes = trajectory["mode"].map({mode: k for k, mode in enumerate(MODES)}).fillna(0)
    columns = {
        "x": cm(trajectory["x_m"]),
        "y": cm(trajectory["y_m"]),
        "angle": np.rint(trajectory["angle_deg"].to_numpy() * 10.0).astype(np.int64),
        "mode": modes.to_numpy().astype(np.int64),
        "soc": np.rint(trajectory["soc"].to_numpy() * 100.0).astype(np.int64),
    }
    times = trajectory["time_s"].to_numpy(dtype=np.float64)[::agvs]
    return Track(times, {name: values.reshape(-1, agvs) for name, values in columns.items()})


def plans_shown(plans: pd.DataFrame, window: Window, step_s: float) -> dict[str, Ints]:
    """The plans by AGV and time; of those within one step of the page's samples only the last."""
    rows = plans[plans["time_s"] <= window.end_s]
    slot = np.floor(np.maximum(rows["time_s"] - window.start_s, -1.0) / step_s)
    rows = rows[~rows.assign(slot=slot).duplicated(["agv", "slot"], keep="last")]
    rows = rows.sort_values(["agv", "time_s"], kind="stable")
    paths = [text.split() for text in rows["path"]]
    return {
        "plan_agv": rows["agv"].to_numpy().astype(np.int64),
        "plan_time": ms(rows["time_s"]),
        "plan_granted": rows["granted"].to_numpy().astype(np.int64),
        "plan_length": np.array([len(path) for path in paths], dtype=np.int64),
        "plan_path": np.array([int(vertex) for path in paths for vertex in path], dtype=np.int64),
    }


def tasks_shown(run: Run, floor: Floor, number: Mapping[str, int], window: Window) -> dict[str, Ints]:
    """What AGVs were told to do in the window, by AGV and time; and when each task of the run was done."""
    tasks = run.tasks
    seen = tasks[(tasks["agv"] >= 0) & (tasks["assigned_s"] <= window.end_s)]
    seen = seen[~(seen["done_s"] < window.start_s)].sort_values(["agv", "assigned_s"], kind="stable")
    return {
        "task_agv": seen["agv"].to_numpy().astype(np.int64),
        "task_parks": (seen["kind"] == "park").to_numpy().astype(np.int64),
        "task_car": _numbers(seen["car"], number),
        "task_from": _numbers(seen["origin"], floor.index),
        "task_to": _numbers(seen["destination"], floor.index),
        "task_assigned": ms(seen["assigned_s"]),
        "task_lifted": ms(seen["lifted_s"]),
        "task_delivered": ms(seen["delivered_s"]),
        "done": np.sort(ms(tasks.loc[tasks["state"] == "served", "done_s"])),
    }


def _numbers(names: Iterable[str], number: Mapping[str, int]) -> Ints:
    return np.array([number.get(name, -1) for name in names], dtype=np.int64)


def stays_shown(run: Run, floor: Floor, track: Track, number: Mapping[str, int], window: Window) -> dict[str, Ints]:
    """Where cars stood: in slots as the AGV set them down, and at the bays' places in the street.

    ``ready`` is when the customer has left an arriving car; for other stays it is when the stay began.
    """
    rows = [*_street_stays(run, floor), *_slot_stays(run, floor, track)]
    shown = [row for row in rows if row[4] >= window.start_s and row[2] <= window.end_s]
    shown.sort(key=lambda row: (row[2], row[1]))
    return {
        "stay_place": np.array([row[0] for row in shown], dtype=np.int64),
        "stay_car": _numbers((row[1] for row in shown), number),
        "stay_from": ms([row[2] for row in shown]),
        "stay_ready": ms([row[3] for row in shown]),
        "stay_to": ms([row[4] for row in shown]),
        "stay_vertex": np.array([row[5] for row in shown], dtype=np.int64),
        **{f"stay_{axis}": np.array([row[6][k] for row in shown], dtype=np.int64)
           for k, axis in enumerate(("x", "y", "angle"))},
    }  # fmt: skip


def _street_stays(run: Run, floor: Floor) -> list[_Stay]:
    stays: list[_Stay] = []
    for task in run.tasks.to_dict("records"):
        parks = task["kind"] == "park"
        begin, end = (task["at_bay_s"], task["lifted_s"]) if parks else (task["delivered_s"], task["done_s"])
        bay = task["origin"] if parks else task["destination"]
        place = INBOUND if parks else OUTBOUND
        if math.isfinite(begin) and (pose := floor.street_place(bay, place)):
            ready = task["ready_s"] if parks else begin
            stays.append((place, task["car"], begin, ready, _or_never(end), floor.index[bay], pose))
    return stays


def _slot_stays(run: Run, floor: Floor, track: Track) -> list[_Stay]:
    """Pair each car's arrivals in a slot with its departures, both in order of time."""
    begins: dict[str, list[tuple[float, str, AgvNumber]]] = {}
    ends: dict[str, list[tuple[float, AgvNumber]]] = {}
    for event in run.events[run.events["kind"] == "car_initial"].to_dict("records"):
        begins.setdefault(event["car"], []).append((0.0, event["vertex"], NO_AGV))
    for task in run.tasks.sort_values("requested_s", kind="stable").to_dict("records"):
        if task["kind"] == "park" and math.isfinite(task["delivered_s"]):
            begins.setdefault(task["car"], []).append((task["delivered_s"], task["destination"], task["agv"]))
        elif task["kind"] == "retrieve" and math.isfinite(task["lifted_s"]):
            ends.setdefault(task["car"], []).append((task["lifted_s"], task["agv"]))
    stays: list[_Stay] = []
    for car, arrivals in begins.items():
        departures = ends.get(car, [])
        for k, (begin, slot, agv) in enumerate(arrivals):
            end, lifter = departures[k] if k < len(departures) else (math.inf, NO_AGV)
            pose = floor.standing(slot)
            if agv >= 0 or lifter >= 0:
                pose = track.pose(agv, begin) if agv >= 0 else track.pose(lifter, end)
            stays.append((SLOT, car, begin, begin, end, floor.index[slot], pose))
    return stays


def _or_never(time_s: float) -> float:
    return time_s if math.isfinite(time_s) else math.inf
