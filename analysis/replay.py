"""The replay of a run: one HTML file that shows the garage at work, offline and in any browser.

The page holds what it draws as columns of numbers (``replay_data``): about 0.1 MB for an hour with eight AGVs. A run
that would need more than the limit keeps every second, fourth, ... sample only, and the page says so.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from analysis.clock import Clock
from analysis.deadlocks import deadlocks, outcome
from analysis.faults import fault_spans
from analysis.record import COLUMNS
from analysis.replay_cars import MODES, plans_shown, read_track, stays_shown, tasks_shown
from analysis.replay_data import Floats, Ints, Window, ms, pack
from analysis.replay_floor import Floor, read_floor
from analysis.report import environment, page_title, write_page
from analysis.run_files import check_ended
from analysis.tables import Run, load_run
from analysis.words import words
from sumo_nets.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

#: Largest page, in bytes, unless told otherwise.
LIMIT_BYTES: Final = 10_000_000

_SCRIPTS: Final = ("replay_data.js", "replay_draw.js", "replay_page.js")
_INCIDENTS: Final = ("collision", "overlap", "fault_start", "fault_end", "plan_rejected", "turned_away", "request_void")


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
    run = load_replayed(folder)
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
    floor, every = read_floor(run), 1
    while True:
        data = pack(*_contents(run, floor, window, every))
        page = template.render(title=page_title(run), report=report, data=data, style=style, scripts=scripts)
        if len(page) <= limit_bytes or len(times) // every < 100:
            return page
        every *= 2


def _source(name: str) -> str:
    return (files("analysis") / "templates" / name).read_text(encoding="utf-8")


# --- the whole ----------------------------------------------------------------------------------------------------


def load_replayed(folder: Path) -> Run:
    """The record of a run that is to be shown.

    Raises:
        InputError: there is none, one of a run that was killed, or one of another version.
    """
    check_ended(folder)
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
        clock = Clock.of(run.meta)
        raise InputError(f"{run.name}: no sample from {clock.at(window.start_s)} to {clock.at(window.end_s)}")
    return window


def _contents(run: Run, floor: Floor, window: Window, every: int) -> tuple[dict[str, Any], dict[str, Ints]]:
    """Everything the page shows: the description, and the columns."""
    track = read_track(run.trajectory)
    cars = sorted({*run.tasks["car"], *run.events["car"]} - {""})
    number = {car: k for k, car in enumerate(cars)}
    keep = np.flatnonzero((track.time_s >= window.start_s) & (track.time_s <= window.end_s))[::every]
    columns = {
        "time": ms(track.time_s[keep]),
        **{name: values[keep].T.ravel() for name, values in track.columns.items()},
        **stays_shown(run, floor, track, number, window),
        **tasks_shown(run, floor, number, window),
        **plans_shown(run.plans, window, every * _interval(track.time_s)),
        **_timeline(run.timeline, window, every),
    }
    agv = (run.meta.get("scenario") or {}).get("agv") or {}
    head = {
        "status": words(run.meta.get("status", "")),
        "agvs": track.columns["x"].shape[1],
        "length": agv.get("length_m", 4.7),
        "width": agv.get("width_m", 2.0),
        "modes": [words(mode) for mode in MODES],
        "cars": cars,
        "tasks": _count(run.meta.get("tasks_wanted"), len(run.tasks)),
        "slots": len(floor.places["slot"]),
        "start": int(ms(track.time_s[keep[:1]])[0]),
        "end": int(ms(track.time_s[keep[-1:]])[0]),
        "clock": {"name": Clock.of(run.meta).name, "offset": 1000 * Clock.of(run.meta).offset_s},
        "note": _note(track.time_s, window, every, Clock.of(run.meta)),
        "floor": floor.drawn,
        "deadlocks": _deadlocks(run, window),
        "incidents": _incidents(run, window),
    }
    return head, columns


def _note(times: Floats, window: Window, every: int, clock: Clock) -> str:
    """What of the run is on the page, in words."""
    whole = window.start_s <= times[0] and window.end_s >= times[-1]
    shown = f"{clock.at(window.start_s)} to {clock.at(window.end_s)}"
    part = "Whole run" if whole else f"{shown} of a run to {clock.at(float(times[-1]))}"
    step = _interval(times)
    if every == 1:
        return f"{part}, a position every {step:g} s"
    return f"{part}, thinned to a position every {step * every:g} s to keep the file small (recorded: {step:g} s)"


def _interval(times: Floats) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 1.0


def _count(value: object, otherwise: int) -> int:
    return int(value) if isinstance(value, int | float) and math.isfinite(value) else otherwise


def _timeline(line: pd.DataFrame, window: Window, every: int) -> dict[str, Ints]:
    rows = line[(line["time_s"] >= window.start_s) & (line["time_s"] <= window.end_s)].iloc[::every]
    counts = {
        "line_queue": "queue", "line_spilled": "spilled", "line_parked": "parked", "line_waiting": "waiting_requests",
    }  # fmt: skip
    return {
        "line_time": ms(rows["time_s"]),
        **{name: rows[column].to_numpy().astype(np.int64) for name, column in counts.items()},
    }


# --- what went wrong ----------------------------------------------------------------------------------------------


def _deadlocks(run: Run, window: Window) -> list[dict[str, Any]]:
    """Deadlocks of the window: from when to when, who, where, why, and what resolved them."""
    return [
        {
            "from": int(ms(d.began_s)),
            "found": int(ms(d.found_s)),
            "to": int(ms(d.over_s)),
            "members": d.members,
            "waits": [[a, b] for a, b in d.waits.items()],
            "where": d.where,
            "cause": words(d.cause),
            "tried": d.in_vain,
            "end": outcome(d),
            "cost_s": d.cost_s if math.isfinite(d.cost_s) else None,
        }
        for d in deadlocks(run)
        if d.began_s <= window.end_s and d.over_s >= window.start_s
    ]


def _incidents(run: Run, window: Window) -> list[dict[str, Any]]:
    """Whatever else deserves a mark on the time bar."""
    faults = fault_spans(run)
    return [
        {
            "time": int(ms(time)),
            "kind": words(kind),
            "who": row["car"] or (f"AGV {row['agv']}" if row["agv"] >= 0 else ""),
            "what": faults[detail["fault"]].text
            if kind in ("fault_start", "fault_end")
            else ", ".join(f"{words(key)} {value}" for key, value in detail.items()),
        }
        for kind in _INCIDENTS
        for time, row, detail in _details(run, kind)
        if window.start_s <= time <= window.end_s
    ]


def _details(run: Run, kind: str) -> list[tuple[float, Mapping[Any, Any], dict[str, Any]]]:
    """Time, row and parsed detail of the events of one kind."""
    rows = run.events[run.events["kind"] == kind].to_dict("records")
    return [(float(row["time_s"]), row, json.loads(row["detail"] or "{}")) for row in rows]
