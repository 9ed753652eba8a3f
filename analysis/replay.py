"""The replay of a run: one HTML file that shows the garage at work, offline and in any browser.

The page holds what it draws as columns of whole numbers (milliseconds, centimetres, tenths of degrees), delta-coded to
bytes of variable length and deflated together: about 0.1 MB for an hour with eight AGVs. A run that would need more
than the limit keeps every second, fourth, ... sample only, and the page says so.
"""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from analysis.figures import words
from analysis.report import clock, environment, page_title, write_page
from analysis.tables import Run, load_run
from controller.types import AgvMode
from parking_sim.errors import InputError
from parking_sim.record import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

#: Largest page, in bytes, unless told otherwise.
LIMIT_BYTES: Final = 10_000_000

#: A stay that did not end within the run.
_NEVER: Final = 2**30
_SCRIPTS: Final = ("replay_data.js", "replay_draw.js", "replay_page.js")
_MODES: Final = tuple(mode.value for mode in AgvMode)
#: Drawn in this order, so that a charger or home shows on top of a slot.
_ROLES: Final = ("slot", "refuge", "charger", "bay", "home")
_SLOT, _INBOUND, _OUTBOUND = range(3)
#: From a bay's nearest point of the street to where arriving and leaving cars stand: along it, and to the bay's side.
_ALONG_M, _BESIDE_M = 4.5, 2.4
_INCIDENTS: Final = ("collision", "overlap", "fault_start", "fault_end", "plan_rejected", "request_refused")

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """The part of a run that is shown.

    Attributes:
        start_s, end_s: simulated seconds.
    """

    start_s: float
    end_s: float


def write_replay(
    folder: Path,
    start_s: float | None = None,
    end_s: float | None = None,
    *,
    limit_bytes: int = LIMIT_BYTES,
    report: bool | None = None,
) -> Path:
    """Write ``replay.html`` into the folder of a run.

    Args:
        folder: what ``Recorder.write`` wrote.
        start_s, end_s: simulated seconds between which it is shown; None: from the start, to the end.
        limit_bytes: samples are left out, evenly, until the page is no larger.
        report: link to the report beside it; None: if it is there.

    Returns:
        Path of the page.

    Raises:
        InputError: there is no record, it holds no trajectory or floor, or nothing between the two times.
        OSError: if the folder can't be written.
    """
    run = _load(folder)
    linked = (folder / "report.html").is_file() if report is None else report
    return write_page(folder / "replay.html", replay_page(run, start_s, end_s, limit_bytes, linked))


def replay_page(
    run: Run,
    start_s: float | None = None,
    end_s: float | None = None,
    limit_bytes: int = LIMIT_BYTES,
    report: bool = False,
) -> str:
    """The page as text; see ``write_replay``."""
    if run.trajectory.empty or run.vertices.empty:
        raise InputError(f"{run.name}: the record holds no trajectory or no floor; nothing to replay")
    times = np.unique(run.trajectory["time_s"].to_numpy(dtype=np.float64))
    window = _window(run, times, start_s, end_s)
    template, style = environment().get_template("replay.html"), _source("replay.css")
    scripts = [_source(name) for name in _SCRIPTS]
    floor, every = _floor(run), 1
    while True:
        data = pack(*_contents(run, floor, window, every))
        page = template.render(title=page_title(run), report=report, data=data, style=style, scripts=scripts)
        if len(page) <= limit_bytes or len(times) // every < 100:
            return page
        every *= 2


def pack(head: Mapping[str, Any], columns: Mapping[str, Ints]) -> str:
    """Put a description and columns of whole numbers into one text.

    Args:
        head: anything JSON can say; the columns' names and lengths are added as ``columns``.
        columns: numbers below 2^30 in size, also their differences.

    Returns:
        Base64 of a zlib stream: length of the JSON (4 bytes, little-endian), the JSON, then each column's
        differences in zigzag coding, seven bits a byte, the lowest first.
    """
    names = [[name, len(values)] for name, values in columns.items()]
    text = json.dumps({**head, "columns": names}, separators=(",", ":"), allow_nan=False).encode()
    body = b"".join(_varints(np.diff(values, prepend=0)) for values in columns.values())
    return base64.b64encode(zlib.compress(struct.pack("<I", len(text)) + text + body, 9)).decode()


def _varints(values: Ints) -> bytes:
    coded = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    size = np.ones(len(coded), dtype=np.int64)
    for bits in (7, 14, 21, 28):
        size += coded >= 1 << bits
    end = np.cumsum(size)
    out = np.zeros(int(end[-1]) if len(end) else 0, dtype=np.uint8)
    for k in range(5):
        has = size > k
        more = (size[has] > k + 1).astype(np.uint64) << np.uint64(7)
        out[(end - size)[has] + k] = (coded[has] >> np.uint64(7 * k)) & np.uint64(127) | more
    return out.tobytes()


def _source(name: str) -> str:
    return (files("analysis") / "templates" / name).read_text(encoding="utf-8")


# --- the whole ----------------------------------------------------------------------------------------------------


def _load(folder: Path) -> Run:
    try:
        run = load_run(folder)
    except FileNotFoundError as error:
        raise InputError(str(error)) from None
    missing = [table for table in COLUMNS if not (folder / f"{table}.parquet").is_file()]
    if missing:
        raise InputError(f"{folder}: the record has no table {missing[0]!r}; run it again with this version")
    return run


def _window(run: Run, times: Floats, start_s: float | None, end_s: float | None) -> Window:
    last = float(times[-1])
    window = Window(max(0.0, start_s or 0.0), min(last, last if end_s is None else end_s))
    if not ((times >= window.start_s) & (times <= window.end_s)).any():
        raise InputError(f"{run.name}: no sample from {clock(window.start_s)} to {clock(window.end_s)}")
    return window


def _contents(run: Run, floor: _Floor, window: Window, every: int) -> tuple[dict[str, Any], dict[str, Ints]]:
    """Everything the page shows: the description, and the columns."""
    track = _track(run.trajectory)
    cars = sorted({*run.tasks["car"], *run.events["car"]} - {""})
    number = {car: k for k, car in enumerate(cars)}
    keep = np.flatnonzero((track.time_s >= window.start_s) & (track.time_s <= window.end_s))[::every]
    columns = {
        "time": _ms(track.time_s[keep]),
        **{name: values[keep].T.ravel() for name, values in track.columns.items()},
        **_stays(run, floor, track, number, window),
        **_jobs(run, floor, number, window),
        **_plans(run.plans, window, every * _interval(track.time_s)),
        **_timeline(run.timeline, window, every),
    }
    agv = (run.meta.get("scenario") or {}).get("agv") or {}
    head = {
        "status": words(run.meta.get("status", "")),
        "agvs": track.columns["x"].shape[1],
        "length": agv.get("length_m", 4.7),
        "width": agv.get("width_m", 2.0),
        "modes": [words(mode) for mode in _MODES],
        "cars": cars,
        "tasks": _count(run.meta.get("tasks_wanted"), len(run.tasks)),
        "slots": len(floor.places["slot"]),
        "start": int(_ms(track.time_s[keep[:1]])[0]),
        "end": int(_ms(track.time_s[keep[-1:]])[0]),
        "note": _note(track.time_s, window, every),
        "floor": floor.drawn,
        "deadlocks": _deadlocks(run, window),
        "incidents": _incidents(run, window),
    }
    return head, columns


def _note(times: Floats, window: Window, every: int) -> str:
    """What of the run is on the page, in words."""
    whole = window.start_s <= times[0] and window.end_s >= times[-1]
    part = "Whole run" if whole else f"{clock(window.start_s)} to {clock(window.end_s)} of {clock(float(times[-1]))}"
    step = _interval(times)
    if every == 1:
        return f"{part}, a position every {step:g} s"
    return f"{part}, thinned to a position every {step * every:g} s to keep the file small (recorded: {step:g} s)"


def _interval(times: Floats) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 1.0


def _count(value: object, otherwise: int) -> int:
    return int(value) if isinstance(value, int | float) and math.isfinite(value) else otherwise


def _ms(seconds: Any) -> Ints:
    """Seconds as whole milliseconds; what never came lies far ahead."""
    values = np.asarray(seconds, dtype=np.float64)
    return np.rint(np.where(np.isfinite(values), values * 1000.0, _NEVER)).astype(np.int64)


def _cm(metres: Any) -> Ints:
    return np.rint(np.asarray(metres, dtype=np.float64) * 100.0).astype(np.int64)


# --- where AGVs are -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Track:
    """The trajectory as arrays of shape (samples, AGVs): x and y (cm), angle (0.1 degrees), mode, soc (percent)."""

    time_s: Floats
    columns: Mapping[str, Ints]

    def pose(self, agv: int, time_s: float) -> tuple[int, int, int]:
        """Where an AGV was at the last sample before a time."""
        k = max(0, int(np.searchsorted(self.time_s, time_s, side="right")) - 1)
        x, y, angle = (int(self.columns[name][k, agv]) for name in ("x", "y", "angle"))
        return x, y, angle


def _track(trajectory: pd.DataFrame) -> _Track:
    agvs = int(trajectory["agv"].max()) + 1
    modes = trajectory["mode"].map({mode: k for k, mode in enumerate(_MODES)}).fillna(0)
    columns = {
        "x": _cm(trajectory["x_m"]),
        "y": _cm(trajectory["y_m"]),
        "angle": np.rint(trajectory["angle_deg"].to_numpy() * 10.0).astype(np.int64),
        "mode": modes.to_numpy().astype(np.int64),
        "soc": np.rint(trajectory["soc"].to_numpy() * 100.0).astype(np.int64),
    }
    times = trajectory["time_s"].to_numpy(dtype=np.float64)[::agvs]
    return _Track(times, {name: values.reshape(-1, agvs) for name, values in columns.items()})


def _plans(plans: pd.DataFrame, window: Window, step_s: float) -> dict[str, Ints]:
    """The plans by AGV and time; of those within one step of the page's samples only the last."""
    rows = plans[plans["time_s"] <= window.end_s]
    slot = np.floor(np.maximum(rows["time_s"] - window.start_s, -1.0) / step_s)
    rows = rows[~rows.assign(slot=slot).duplicated(["agv", "slot"], keep="last")]
    rows = rows.sort_values(["agv", "time_s"], kind="stable")
    paths = [text.split() for text in rows["path"]]
    return {
        "plan_agv": rows["agv"].to_numpy().astype(np.int64),
        "plan_time": _ms(rows["time_s"]),
        "plan_granted": rows["granted"].to_numpy().astype(np.int64),
        "plan_length": np.array([len(path) for path in paths], dtype=np.int64),
        "plan_path": np.array([int(vertex) for path in paths for vertex in path], dtype=np.int64),
    }


def _timeline(line: pd.DataFrame, window: Window, every: int) -> dict[str, Ints]:
    rows = line[(line["time_s"] >= window.start_s) & (line["time_s"] <= window.end_s)].iloc[::every]
    counts = {"line_queue": "queue", "line_parked": "parked", "line_waiting": "waiting_requests"}
    return {
        "line_time": _ms(rows["time_s"]),
        **{name: rows[column].to_numpy().astype(np.int64) for name, column in counts.items()},
    }


# --- what AGVs do, where cars stand -------------------------------------------------------------------------------


def _jobs(run: Run, floor: _Floor, number: Mapping[str, int], window: Window) -> dict[str, Ints]:
    """What AGVs were told to do in the window, by AGV and time; and when each task of the run was done."""
    tasks = run.tasks
    seen = tasks[(tasks["agv"] >= 0) & (tasks["assigned_s"] <= window.end_s)]
    seen = seen[~(seen["done_s"] < window.start_s)].sort_values(["agv", "assigned_s"], kind="stable")
    return {
        "job_agv": seen["agv"].to_numpy().astype(np.int64),
        "job_parks": (seen["kind"] == "park").to_numpy().astype(np.int64),
        "job_car": _numbers(seen["car"], number),
        "job_from": _numbers(seen["origin"], floor.index),
        "job_to": _numbers(seen["destination"], floor.index),
        "job_assigned": _ms(seen["assigned_s"]),
        "job_lifted": _ms(seen["lifted_s"]),
        "job_delivered": _ms(seen["delivered_s"]),
        "done": np.sort(_ms(tasks["done_s"].dropna())),
    }


def _numbers(names: Iterable[str], number: Mapping[str, int]) -> Ints:
    return np.array([number.get(name, -1) for name in names], dtype=np.int64)


def _stays(run: Run, floor: _Floor, track: _Track, number: Mapping[str, int], window: Window) -> dict[str, Ints]:
    """Where cars stood: in slots as the AGV set them down, and at the bays' places in the street.

    ``ready`` is when the customer has left an arriving car; for other stays it is when the stay began.
    """
    rows = [*_street_stays(run, floor), *_slot_stays(run, floor, track)]
    shown = [row for row in rows if row[4] >= window.start_s and row[2] <= window.end_s]
    shown.sort(key=lambda row: (row[2], row[1]))
    return {
        "stay_place": np.array([row[0] for row in shown], dtype=np.int64),
        "stay_car": _numbers((row[1] for row in shown), number),
        "stay_from": _ms([row[2] for row in shown]),
        "stay_ready": _ms([row[3] for row in shown]),
        "stay_to": _ms([row[4] for row in shown]),
        "stay_vertex": np.array([row[5] for row in shown], dtype=np.int64),
        **{f"stay_{axis}": np.array([row[6][k] for row in shown], dtype=np.int64)
           for k, axis in enumerate(("x", "y", "angle"))},
    }  # fmt: skip


_Pose = tuple[int, int, int]
#: Place, car, from, ready, to (seconds), vertex, pose.
_Stay = tuple[int, str, float, float, float, int, _Pose]


def _street_stays(run: Run, floor: _Floor) -> list[_Stay]:
    stays: list[_Stay] = []
    for task in run.tasks.to_dict("records"):
        parks = task["kind"] == "park"
        begin, end = (task["at_bay_s"], task["lifted_s"]) if parks else (task["delivered_s"], task["done_s"])
        bay = task["origin"] if parks else task["destination"]
        place = _INBOUND if parks else _OUTBOUND
        if math.isfinite(begin) and (pose := floor.street_place(bay, place)):
            ready = task["ready_s"] if parks else begin
            stays.append((place, task["car"], begin, ready, _or_never(end), floor.index[bay], pose))
    return stays


def _slot_stays(run: Run, floor: _Floor, track: _Track) -> list[_Stay]:
    """Pair each car's arrivals in a slot with its departures, both in order of time."""
    begins: dict[str, list[tuple[float, str, int]]] = {}
    ends: dict[str, list[tuple[float, int]]] = {}
    for event in run.events[run.events["kind"] == "car_initial"].to_dict("records"):
        begins.setdefault(event["car"], []).append((0.0, event["vertex"], -1))
    for task in run.tasks.sort_values("requested_s", kind="stable").to_dict("records"):
        if task["kind"] == "park" and math.isfinite(task["delivered_s"]):
            begins.setdefault(task["car"], []).append((task["delivered_s"], task["destination"], task["agv"]))
        elif task["kind"] == "retrieve" and math.isfinite(task["lifted_s"]):
            ends.setdefault(task["car"], []).append((task["lifted_s"], task["agv"]))
    stays: list[_Stay] = []
    for car, arrivals in begins.items():
        departures = ends.get(car, [])
        for k, (begin, slot, agv) in enumerate(arrivals):
            end, lifter = departures[k] if k < len(departures) else (math.inf, -1)
            pose = floor.standing(slot)
            if agv >= 0 or lifter >= 0:
                pose = track.pose(agv, begin) if agv >= 0 else track.pose(lifter, end)
            stays.append((_SLOT, car, begin, begin, end, floor.index[slot], pose))
    return stays


def _or_never(time_s: float) -> float:
    return time_s if math.isfinite(time_s) else math.inf


# --- the floor ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Floor:
    """The floor plan.

    Attributes:
        index: number of each vertex by name.
        drawn: what the page draws, coordinates in centimetres.
        places: role -> numbers of the vertices that have it.
        bodies: where an AGV stands that came by a lane into a vertex: x, y (cm) and angle (0.1 degrees).
        streets: centre lines of the street but for its entry.
        xy: vertices in metres.
    """

    index: Mapping[str, int]
    drawn: Mapping[str, Any]
    places: Mapping[str, Sequence[int]]
    bodies: Mapping[int, _Pose]
    streets: Sequence[Floats]
    xy: Floats

    def standing(self, name: str) -> _Pose:
        """Where a car stands in a slot."""
        vertex = self.index[name]
        x, y = _cm(self.xy[vertex]).tolist()
        return self.bodies.get(vertex, (x, y, 0))

    def street_place(self, bay: str, place: int) -> _Pose | None:
        """Where a customer's car stands at a bay; None without a street or bay."""
        if bay not in self.index or not self.streets:
            return None
        at = self.xy[self.index[bay]]
        gap, foot, along = min((_foot(line, at) for line in self.streets), key=lambda found: found[0])
        aside = (at - foot) / max(gap, 1e-9) * _BESIDE_M
        x, y = _cm(foot + aside + along * (_ALONG_M if place == _OUTBOUND else -_ALONG_M)).tolist()
        return x, y, _tenths(along)


def _floor(run: Run) -> _Floor:
    names = run.vertices["vertex"].tolist()
    xy = run.vertices[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    roles = [set(text.split(",")) for text in run.vertices["roles"]]
    places = {role: [v for v, has in enumerate(roles) if role in has] for role in _ROLES}
    ends = run.edges[["tail", "head"]].to_numpy(dtype=np.int64)
    lines = _lines(run.shapes)
    lanes = {edge: line for edge, _, line in lines if edge >= 0}
    streets = [(part, line) for edge, part, line in lines if edge < 0]
    spurs = _spur_ends(ends, places["slot"])
    length = ((run.meta.get("scenario") or {}).get("agv") or {}).get("length_m", 4.7)
    bodies = {int(head): _body(lanes[e], length) for e, (_, head) in enumerate(ends) if e in lanes}
    drawn = {
        "names": names,
        "xy": _cm(xy).tolist(),
        "lanes": _drawn_lanes(xy, ends, lanes, spurs),
        "places": [
            [role, v, *(bodies[v] if v in spurs and v in bodies else (*_cm(xy[v]).tolist(), 0)), int(v in spurs)]
            for role in _ROLES for v in places[role]
        ],
        "streets": [[part, _cm(line).ravel().tolist()] for part, line in streets],
    }  # fmt: skip
    near = [line for part, line in streets if part != "entry"]
    return _Floor({name: v for v, name in enumerate(names)}, drawn, places, bodies, near, xy)


def _lines(shapes: pd.DataFrame) -> list[tuple[int, str, Floats]]:
    """Edge, part of the street and points of each line."""
    first = np.flatnonzero(np.diff(shapes["line"].to_numpy(), prepend=-1))
    points = np.split(shapes[["x_m", "y_m"]].to_numpy(dtype=np.float64), first[1:])
    heads = shapes.iloc[first]
    return list(zip(heads["edge"].tolist(), heads["part"].tolist(), points, strict=bool(len(first))))


def _spur_ends(ends: Ints, slots: Iterable[int]) -> set[int]:
    """Vertices with one lane in and one out, by the same neighbour; none on an open floor, where slots are aisle."""
    tails: dict[int, list[int]] = {}
    heads: dict[int, list[int]] = {}
    for tail, head in ends.tolist():
        heads.setdefault(tail, []).append(head)
        tails.setdefault(head, []).append(tail)
    found = {v for v, onward in heads.items() if len(onward) == 1 and tails.get(v) == onward}
    return found if found.issuperset(slots) else set()


def _drawn_lanes(xy: Floats, ends: Ints, lanes: Mapping[int, Floats], spurs: set[int]) -> list[list[int]]:
    """Kind (0 two-way, 1 one-way, 2 spur), ends and points of each lane; both directions of one lane once."""
    directed = {(int(tail), int(head)) for tail, head in ends}
    rows = []
    for e, (tail, head) in enumerate(ends.tolist()):
        two_way = (head, tail) in directed
        if two_way and tail > head:
            continue
        spur = two_way and (tail in spurs or head in spurs)
        points = lanes.get(e, xy[[tail, head]]) if spur else xy[[tail, head]]
        rows.append([2 if spur else 0 if two_way else 1, tail, head, *_cm(points).ravel().tolist()])
    return rows


def _body(lane: Floats, length_m: float) -> _Pose:
    """Where an AGV stands with its front at the end of a lane."""
    along = (lane[-1] - lane[-2]) / max(float(np.hypot(*(lane[-1] - lane[-2]))), 1e-9)
    x, y = _cm(lane[-1] - along * length_m / 2).tolist()
    return x, y, _tenths(along)


def _tenths(direction: Floats) -> int:
    return round(math.degrees(math.atan2(direction[1], direction[0])) * 10)


def _foot(line: Floats, at: Floats) -> tuple[float, Floats, Floats]:
    """Distance to a line, its nearest point, and its direction there."""
    best: tuple[float, Floats, Floats] | None = None
    for a, b in pairwise(line):
        step = b - a
        share = float(np.clip((at - a) @ step / max(float(step @ step), 1e-9), 0.0, 1.0))
        foot = a + share * step
        found = float(np.hypot(*(at - foot))), foot, step / max(float(np.hypot(*step)), 1e-9)
        best = found if best is None or found[0] < best[0] else best
    if best is None:
        raise ValueError("a line has two points at least")
    return best


# --- what went wrong ----------------------------------------------------------------------------------------------


def _deadlocks(run: Run, window: Window) -> list[dict[str, Any]]:
    """Deadlocks of the window: from when to when, who, where, why, and what resolved them."""
    end = {detail.get("deadlock"): (time, detail) for time, _, detail in _details(run, "deadlock_resolved")}
    tried: dict[Any, list[str]] = {}
    for _, _, detail in _details(run, "stage_failed"):
        tried.setdefault(detail.get("deadlock"), []).append(words(detail.get("stage", "")))
    rows = []
    for time, row, detail in _details(run, "deadlock_found"):
        over, outcome = end.get(detail.get("deadlock"), (math.inf, {}))
        if time <= window.end_s and over >= window.start_s:
            rows.append(
                {
                    "from": int(_ms(time)),
                    "to": int(_ms(over)),
                    "members": detail.get("members", []),
                    "waits": [[int(a), int(b)] for a, b in (detail.get("waits") or {}).items()],
                    "where": row["vertex"],
                    "cause": words(detail.get("cause", "")),
                    "tried": tried.get(detail.get("deadlock"), []),
                    "stage": words(outcome.get("stage", "")),
                    "cost": outcome.get("cost_s"),
                }
            )
    return rows


def _incidents(run: Run, window: Window) -> list[dict[str, Any]]:
    """Whatever else deserves a mark on the time bar."""
    return [
        {
            "time": int(_ms(time)),
            "kind": words(kind),
            "who": row["car"] or (f"AGV {row['agv']}" if row["agv"] >= 0 else ""),
            "what": ", ".join(f"{words(key)} {value}" for key, value in detail.items()),
        }
        for kind in _INCIDENTS
        for time, row, detail in _details(run, kind)
        if window.start_s <= time <= window.end_s
    ]


def _details(run: Run, kind: str) -> list[tuple[float, Mapping[Any, Any], dict[str, Any]]]:
    """Time, row and parsed detail of the events of one kind."""
    rows = run.events[run.events["kind"] == kind].to_dict("records")
    return [(float(row["time_s"]), row, json.loads(row["detail"] or "{}")) for row in rows]
