"""The report of a run, and an overview of several: each is one HTML file that needs nothing else, also on paper."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.checks import failed_checks, run_checks
from analysis.clock import Clock
from analysis.deadlocks import deadlocks, draw, outcome, why
from analysis.explain import longest_waits, wait_words
from analysis.figures import figures
from analysis.metrics import METRICS, Metrics, run_metrics
from analysis.run_files import INPUTS
from analysis.tables import Run, load_run
from analysis.turned_away import turned_away, turned_away_words
from analysis.words import counted, words
from sumo_nets.whole_file import write_whole

if TYPE_CHECKING:
    from jinja2 import Environment

_STORIES = 200
_PICTURES = 12
_SERVICE_ROWS = (
    ("retrieval_wait", "Retrieval: request to car at the bay"),
    ("retrieval_total", "Retrieval: request to customer gone"),
    ("park_queue", "Parking: arrival to bay"),
    ("park_wait", "Parking: bay to car on an AGV"),
    ("park_total", "Parking: arrival to car in its slot"),
)
_SERVICE_COLUMNS = ("mean", "p50", "p90", "p95", "p99", "max")
_THESIS = (
    "throughput", "movement_cost", "nodes_expanded", "heap_moves", "nodes_generated", "valid_expansions", "valid_ratio",
)  # fmt: skip


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a run.

    Args:
        folder: what ``Recorder.write`` wrote.

    Returns:
        Path of the report.

    Raises:
        FileNotFoundError: if there is no record.
        OSError: if the folder can't be written.
    """
    run = load_run(folder)
    metrics, clock = run_metrics(run), Clock.of(run.meta)
    page = environment().get_template("report.html").render(
        run=run,
        title=page_title(run),
        headlines=headlines(run, metrics),
        checks=run_checks(run.meta, metrics),
        tiles=_tiles(metrics),
        asked=_asked(run.meta.get("scenario") or {}),
        service=_service(metrics),
        service_columns=_SERVICE_COLUMNS,
        away=turned_away_words(turned_away(run.tasks)),
        drawings=figures(run),
        stories=deadlock_stories(run)[:_STORIES],
        story_count=int(metrics["deadlocks_found"]),
        pictures=[(clock.at(d.found_s), why(d), draw(d, run.vertices, run.edges)) for d in deadlocks(run)[:_PICTURES]],
        incidents=incidents(run)[:_STORIES],
        contradictions=[line for seen in (run.meta.get("witnesses") or {}).values() for line in seen["words"]],
        held=run.meta.get("held") or (),
        waits=[wait_words(wait, run, clock) for wait in longest_waits(run)],
        clock=clock,
        thesis=[(key, number(metrics[key]), *METRICS[key]) for key in _THESIS],
        metrics=[(key, number(metrics[key]), *METRICS[key]) for key in METRICS],
        versions=sorted((run.meta.get("versions") or {}).items()),
        wall=[(part, f"{seconds:.2f} s") for part, seconds in (run.meta.get("wall_s") or {}).items()],
        digest=sorted((run.meta.get("digest") or {}).items()),
        files=_files(folder),
        replay=(folder / "replay.html").is_file(),
    )  # fmt: skip
    return write_page(folder / "report.html", page)


def write_index(folders: Sequence[Path], path: Path) -> Path:
    """Write one page that compares runs and links to their reports.

    Args:
        folders: folders of runs, in the order of the table.
        path: HTML file to write; links are relative to its folder.

    Returns:
        ``path``.

    Raises:
        FileNotFoundError: if a folder has no record.
        OSError: if the file can't be written.
    """
    rows = [_index_row(folder, path.parent) for folder in folders]
    page = environment().get_template("index.html").render(rows=rows, title=f"{len(rows)} runs")
    return write_page(path, page)


def headlines(run: Run, metrics: Metrics) -> list[str]:
    """The outcome in a few sentences. They stand alone: a reader may read nothing else.

    Args:
        run: a record.
        metrics: its metrics.

    Returns:
        One to seven sentences.
    """
    m = metrics
    wanted = m["tasks_wanted"] if _known(m["tasks_wanted"]) else m["requests"]
    lines = [f"{m['tasks_done']:,} of {wanted:,} tasks were done in {_span(m['simulated_s'])} of simulated time."]
    if m["retrievals_done"]:
        missed = ", customers turned away counted as missed" if m["customers_turned_away"] else ""
        lines.append(
            f"A customer who asked for a car had it at the bay after {_span(m['retrieval_wait_p50_s'])} (median); "
            f"19 of 20 within {_span(m['retrieval_wait_p95_s'])}. "
            f"{_percent(m['retrieval_within_300_s_share'])} waited at most 5 minutes{missed}."
        )
    away = turned_away_words(turned_away(run.tasks))
    lines.append(f"{away[0].upper()}{away[1:]}.")
    if m["parks_done"] and _known(m["park_wait_p50_s"]):
        lines.append(f"A car to be parked stood at the bay for {_span(m['park_wait_p50_s'])} (median).")
    if _known(m["spill_back_s"]) and m["spill_back_s"] > 0:
        lines.append(
            f"Cars waited on the street for {_span(m['spill_back_s'])}, at most {m['spill_back_max']} at a time."
        )
    if len(run.agvs):
        lines.append(
            f"{counted(len(run.agvs), 'AGV')} did this, busy {_percent(m['agv_busy_share'])} of the time; "
            f"{_percent(m['empty_travel_share'])} of the driving was without a car."
        )
    lines.append(_deadlock_line(m))
    return lines


def deadlock_stories(run: Run) -> list[dict[str, str]]:
    """Each deadlock as the cells of a table row.

    Args:
        run: a record.

    Returns:
        For each: ``found`` (time), ``members``, ``where``, ``cause``, ``tried`` (stages that failed), ``outcome`` (what
        resolved it, and the seconds since the wait began), in the order in which they were found.
    """
    clock = Clock.of(run.meta)
    return [
        {
            "found": clock.at(d.found_s),
            "members": ", ".join(map(str, d.members)),
            "where": d.where,
            "cause": words(d.cause),
            "tried": "; ".join(d.in_vain),
            "outcome": outcome(d),
        }
        for d in deadlocks(run)
    ]


def incidents(run: Run) -> list[tuple[str, str, str, str]]:
    """Collisions and overlaps: time, kind, who, and the detail as recorded.

    Args:
        run: a record.

    Returns:
        One row each, in the order of the record; none in a safe run.
    """
    events, clock = run.events[run.events["kind"].isin(["collision", "overlap"])], Clock.of(run.meta)
    return [
        (
            clock.at(row["time_s"]),
            row["kind"],
            row["car"] or f"AGV {row['agv']}",
            f"{row['vertex']} {row['detail']}".strip(),
        )
        for row in events.to_dict("records")
    ]


def number(value: float | int) -> str:
    """A number for a table: thousands apart, four figures, a dash if it is not known."""
    if not _known(value):
        return "–"
    if isinstance(value, int) or (value == round(value) and abs(value) < 1e15):
        return f"{round(value):,}"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _known(value: float | int) -> bool:
    return bool(np.isfinite(value))


def _span(seconds: float) -> str:
    """Seconds in words, as precise as a reader wants."""
    if not _known(seconds):
        return "an unknown time"
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{round(seconds) // 60} min {round(seconds) % 60:02d} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def _percent(share: float) -> str:
    return f"{share * 100:.0f} %" if _known(share) else "an unknown share"


def _deadlock_line(m: Metrics) -> str:
    found, lost = int(m["deadlocks_found"]), int(m["deadlocks_unresolved"])
    if not found:
        return "No deadlock arose."
    return f"{_resolved_line(m, found, lost)}{_stuck_line(int(m.get('deadlocks_stuck', 0)))}"


def _stuck_line(stuck: int) -> str:
    """The last net reported apart from rings and chains."""
    return f" Of these {stuck} showed only when an AGV had come no nearer to its goal for long." if stuck else ""


def _resolved_line(m: Metrics, found: int, lost: int) -> str:
    if lost >= found:
        return f"{counted(found, 'deadlock')} arose; none was resolved."
    longest = f", the longest {_span(m['deadlock_max_s'])} after its wait began" if _known(m["deadlock_max_s"]) else ""
    if lost > 0:
        return f"{counted(found, 'deadlock')} arose; {found - lost} resolved{longest}; {lost} not resolved."
    return f"{counted(found, 'deadlock')} arose, all resolved{longest}."


def page_title(run: Run) -> str:
    """The variant of its sweep, garage, fleet, planner and seed, as far as they are known."""
    scenario = run.meta.get("scenario") or {}
    agvs = scenario.get("agvs", len(run.agvs))
    garage = run.meta.get("map") or scenario.get("garage") or run.name
    parts = [*filter(None, [run.variant]), garage, counted(int(agvs), "AGV")]
    parts += [scenario[key] for key in ("planner",) if key in scenario]
    if "seed" in run.meta:
        parts.append(f"seed {run.meta['seed']}")
    return " · ".join(str(part) for part in parts)


def _tiles(m: Metrics) -> list[tuple[str, str]]:
    """The few figures shown large: value and caption."""
    within = m["retrieval_within_300_s_share"]
    tiles = [
        (number(m["tasks_done"]), "tasks done"),
        (_minutes(m["retrieval_wait_p50_s"]), "retrieval wait, median (min:s)"),
        (_minutes(m["retrieval_wait_p95_s"]), "retrieval wait, 95 % (min:s)"),
        (_percent(within) if _known(within) else "–", "retrievals within 5 min"),
        (number(m["customers_turned_away"]), "customers turned away"),
        (number(round(float(m["cars_out_per_hour"]), 1)), "cars out per hour"),
        (number(m["deadlocks_found"]), "deadlocks found"),
        (number(m["sumo_collisions"]), "collisions"),
    ]
    return [*tiles, (f"{m['wall_speed']:,.0f}×", "real time")] if _known(m["wall_speed"]) else tiles


def _minutes(seconds: float) -> str:
    return f"{round(seconds) // 60}:{round(seconds) % 60:02d}" if _known(seconds) else "–"


def _service(m: Metrics) -> list[tuple[str, list[str]]]:
    return [(label, [_minutes(m[f"{wait}_{q}_s"]) for q in _SERVICE_COLUMNS]) for wait, label in _SERVICE_ROWS]


def _asked(scenario: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The scenario as rows: plain keys first, then one row for each group of keys."""
    plain = [(key, _shown(value)) for key, value in scenario.items() if not isinstance(value, Mapping)]
    groups = [(key, _listed(value)) for key, value in scenario.items() if isinstance(value, Mapping)]
    return [*plain, *(group for group in groups if group[1])]


def _listed(group: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {_shown(item)}" for name, item in group.items())


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return f"({_listed(value)})"
    if isinstance(value, list):
        return "; ".join(map(_shown, value)) or "–"
    return f"{value:.10g}" if isinstance(value, float) else "–" if value is None else str(value)


def _files(folder: Path) -> list[tuple[str, str, str]]:
    """Name, size and SHA-256 of the run's files but its pages."""
    rows = []
    for path in sorted([*folder.iterdir(), *(folder / INPUTS).glob("*")]):
        if path.is_file() and path.suffix != ".html":
            name = path.relative_to(folder).as_posix()
            with path.open("rb") as file:
                rows.append((name, f"{path.stat().st_size:,}", hashlib.file_digest(file, "sha256").hexdigest()))
    return rows


def _index_row(folder: Path, base: Path) -> dict[str, Any]:
    run = load_run(folder)
    metrics = run_metrics(run)
    target = folder / ("report.html" if (folder / "report.html").is_file() else "run.json")
    return {
        "name": run.name,
        "title": page_title(run),
        "link": Path(os.path.relpath(target, base)).as_posix(),
        "status": run.meta.get("status", "–"),
        "passed": not failed_checks(run_checks(run.meta, metrics)),
        "done": f"{number(metrics['tasks_done'])} / {number(metrics['tasks_wanted'])}",
        "cells": [
            _minutes(metrics["retrieval_wait_p50_s"]),
            _minutes(metrics["retrieval_wait_p95_s"]),
            number(metrics["customers_turned_away"]),
            number(round(float(metrics["cars_out_per_hour"]), 1)),
            number(metrics["throughput"]),
            f"{metrics['agv_busy_share'] * 100:.0f} %" if _known(metrics["agv_busy_share"]) else "–",
            f"{metrics['deadlocks_found']} / {metrics['deadlocks_unresolved']}",
            f"{number(metrics['sumo_collisions'])} / {number(metrics['footprint_overlaps'])}",
            number(metrics["least_clearance_m"]),
            number(metrics["wall_speed"]),
        ],
    }


def environment() -> Environment:
    """The templates of the pages."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("analysis"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def write_page(path: Path, page: str) -> Path:
    """Write a page, whole or not at all, and return its path."""
    return write_whole(path, page)
