"""Deadlocks explained: who held what, who waited for whom, why it arose, what resolved it, and what it cost."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.figures import words
from controller.types import AgvNumber

if TYPE_CHECKING:
    import pandas as pd

    from analysis.tables import Run

#: Seconds before a deadlock in which plans that failed are counted.
BEFORE_S = 60.0
#: Metres of floor shown round a deadlock.
MARGIN_M = 12.0
_COLORS = ("#c2410c", "#1d4ed8", "#15803d", "#7e22ce", "#be185d", "#0f766e", "#a16207", "#334155")


@dataclass(frozen=True)
class Deadlock:
    """One deadlock, as recorded.

    Attributes:
        number: its number in the run, from 0.
        found_s: when it was found, seconds.
        cause: ring, idle or stuck.
        members: AGV numbers.
        waits: for each waiting AGV the one it waited for.
        wants: for each waiting AGV the vertex it wanted.
        holds: the vertices that belonged to each member, the last one is where its authority ended.
        goals: where each member had to go.
        tried: stages that found nothing, with the reason and how often.
        stage: what resolved it; empty if nothing did.
        cost_s: seconds from the beginning of the wait to the resolution; NaN if there was none.
        plans_failed: agents without a path and refused plans in the minute before.
        faults: what was wrong in the garage while it lasted: cause and whom or what it concerned.
    """

    number: int
    found_s: float
    cause: str
    members: tuple[AgvNumber, ...]
    waits: Mapping[AgvNumber, AgvNumber]
    wants: Mapping[AgvNumber, str]
    holds: Mapping[AgvNumber, tuple[str, ...]]
    goals: Mapping[AgvNumber, str]
    tried: Mapping[str, int]
    stage: str
    cost_s: float
    plans_failed: int
    faults: tuple[str, ...]


def deadlocks(run: Run) -> list[Deadlock]:
    """The deadlocks of a run, in the order in which they were found.

    Args:
        run: a record.
    """
    resolved = {int(row["deadlock"]): row for row in _rows(run, "deadlock_resolved")}
    tried: dict[int, Counter[str]] = {}
    for row in _rows(run, "stage_failed"):
        tried.setdefault(int(row["deadlock"]), Counter())[f"{words(row['stage'])}: {row['reason']}"] += 1
    events = run.events
    failed_s = events["time_s"][events["kind"].isin(["plan_partial", "plan_rejected"])].to_numpy()
    faults = _faults(run)
    found = []
    for row in _rows(run, "deadlock_found"):
        number, found_s = int(row["deadlock"]), float(row["time_s"])
        end = resolved.get(number, {})
        over_s = float(end.get("time_s", math.inf))
        cost_s = float(end.get("cost_s", math.nan))
        began_s = over_s - cost_s if end else found_s
        found.append(
            Deadlock(
                number,
                found_s,
                str(row.get("cause", "")),
                tuple(AgvNumber(int(n)) for n in row.get("members", ())),
                {AgvNumber(int(n)): AgvNumber(int(other)) for n, other in _mapping(row, "waits")},
                {AgvNumber(int(n)): str(name) for n, name in _mapping(row, "wants")},
                {AgvNumber(int(n)): tuple(names) for n, names in _mapping(row, "holds")},
                {AgvNumber(int(n)): str(name) for n, name in _mapping(row, "goals")},
                tried.get(number, Counter()),
                str(end.get("stage", "")),
                cost_s,
                int(((failed_s > found_s - BEFORE_S) & (failed_s <= found_s)).sum()),
                tuple(text for start, stop, text in faults if start < over_s and stop > began_s),
            )
        )
    return found


def _rows(run: Run, kind: str) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in run.details(kind).to_dict("records")]


def _mapping(row: Mapping[str, Any], key: str) -> Iterator[tuple[str, Any]]:
    """A detail that older records lack."""
    value = row.get(key)
    yield from value.items() if isinstance(value, dict) else ()


def _faults(run: Run) -> list[tuple[float, float, str]]:
    """Begin, end and words for each fault that the controller was told of or an AGV had."""
    ends = {int(row["fault"]): float(row["time_s"]) for row in _rows(run, "fault_end")}
    spans = []
    for row in _rows(run, "fault_start"):
        if row["cause"] not in ("late", "lost"):
            whom = row["vertex"] or ", ".join(f"AGV {n}" for n in row["agvs"])
            spans.append((float(row["time_s"]), ends.get(int(row["fault"]), math.inf), f"{row['cause']} ({whom})"))
    return spans


def why(deadlock: Deadlock) -> str:
    """Why a deadlock arose, in a sentence or two."""
    d = deadlock
    if d.cause == "ring" and len(d.members) == 2:
        text = "Two AGVs met: each wanted the place that the other one held or was to have first."
    elif d.cause == "ring":
        text = f"{len(d.members)} AGVs waited in a ring: each wanted a place that the next held or was to have first."
    elif d.cause == "idle":
        text = f"AGV {d.members[0]} had nothing to do and stood in the way of {_names(d.members[1:])}."
    elif len(d.members) > 1:
        text = f"AGV {d.members[0]} came no nearer to its goal; {_names(d.members[1:])} stood before it."
    else:
        text = f"AGV {d.members[0]} came no nearer to its goal, though it waited for nobody in particular."
    if d.faults:
        text += f" Out of order meanwhile: {'; '.join(sorted(set(d.faults)))}."
    if d.plans_failed:
        text += f" In the minute before, {d.plans_failed} planning calls left AGVs without a path."
    return text


def story(deadlock: Deadlock) -> str:
    """A deadlock as text of a few lines."""
    d = deadlock
    lines = [f"deadlock {d.number}, found at {d.found_s:g} s: {why(d)}"]
    for n in d.members:
        holds = f"held {', '.join(d.holds[n])}" if n in d.holds else "held unrecorded places"
        goal = f", on the way to {d.goals[n]}" if d.goals.get(n, "") not in ("", *d.holds.get(n, ())[-1:]) else ""
        wait = f", wanted {d.wants[n]} and waited for AGV {d.waits[n]}" if n in d.waits else ""
        lines.append(f"  AGV {n} {holds}{goal}{wait}")
    lines += [f"  tried in vain: {text}" + (f" (x{times})" if times > 1 else "") for text, times in d.tried.items()]
    lines.append(f"  resolved by {words(d.stage)} after {d.cost_s:g} s" if d.stage else "  not resolved")
    return "\n".join(lines)


def _names(members: Sequence[int]) -> str:
    return ", ".join(f"AGV {n}" for n in members)


def draw(deadlock: Deadlock, vertices: pd.DataFrame, edges: pd.DataFrame) -> str:
    """The deadlock as a picture: lanes, what each AGV held, and an arrow from each to the place it wanted.

    Args:
        deadlock: what to draw.
        vertices, edges: the garage, tables of the record.

    Returns:
        An SVG element; empty if the record has no floor or says nothing of places.
    """
    d = deadlock
    at = {name: (float(x), -float(y)) for name, x, y in vertices[["vertex", "x_m", "y_m"]].itertuples(index=False)}
    shown = [at[name] for names in (*d.holds.values(), d.wants.values()) for name in names if name in at]
    if not shown:
        return ""
    left, right = min(x for x, _ in shown) - MARGIN_M, max(x for x, _ in shown) + MARGIN_M
    top, bottom = min(y for _, y in shown) - MARGIN_M, max(y for _, y in shown) + MARGIN_M
    box = f"{left:.1f} {top:.1f} {right - left:.1f} {bottom - top:.1f}"
    parts = [
        f'<svg viewBox="{box}" style="max-width:{12 * (right - left):.0f}px" role="img" font-family="sans-serif">',
        f"<title>{escape(why(d))}</title>",
        f'<defs><marker id="tip{d.number}" viewBox="0 0 6 6" refX="5" refY="3" markerWidth="4" markerHeight="4"'
        ' orient="auto"><path d="M0 0L6 3L0 6z" fill="#111"/></marker></defs>',
        *_lanes(list(at.values()), edges, (left, top, right, bottom)),
    ]
    for n, color in zip((n for n in d.members if d.holds.get(n)), cycle(_COLORS), strict=False):
        parts += _agv(n, [at[name] for name in d.holds[n]], at.get(d.wants.get(n, "")), d.number, color)
    parts += [_label(at[name], name) for name in sorted({*d.wants.values()} & at.keys())]
    return "".join([*parts, "</svg>"])


def _lanes(
    places: Sequence[tuple[float, float]], edges: pd.DataFrame, box: tuple[float, float, float, float]
) -> Iterator[str]:
    left, top, right, bottom = box
    for u, v in edges[["tail", "head"]].itertuples(index=False):
        (x1, y1), (x2, y2) = places[u], places[v]
        if left <= min(x1, x2) and max(x1, x2) <= right and top <= min(y1, y2) and max(y1, y2) <= bottom:
            yield f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#cbd5e1" stroke-width=".5"/>'


def _agv(
    n: int, held: Sequence[tuple[float, float]], wanted: tuple[float, float] | None, number: int, color: str
) -> Iterator[str]:
    line = "L".join(f"{x:.1f} {y:.1f}" for x, y in held)
    x, y = held[-1]
    yield f'<path d="M{line}" stroke="{color}" stroke-width="1.6" stroke-linecap="round" fill="none" opacity=".5"/>'
    if wanted is not None:
        # bowed, so that the arrows of two AGVs that want each other's place are told apart
        bend_x, bend_y = (x + wanted[0]) / 2 + (wanted[1] - y) / 4, (y + wanted[1]) / 2 - (wanted[0] - x) / 4
        yield (
            f'<path d="M{x:.1f} {y:.1f}Q{bend_x:.1f} {bend_y:.1f} {wanted[0]:.1f} {wanted[1]:.1f}" stroke="#111"'
            f' stroke-width=".4" stroke-dasharray="1 .6" fill="none" marker-end="url(#tip{number})"/>'
        )
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.8" fill="{color}"/>'
    yield f'<text x="{x:.1f}" y="{y + 0.8:.1f}" font-size="2.2" fill="#fff" text-anchor="middle">{n}</text>'


def _label(place: tuple[float, float], name: str) -> str:
    return f'<text x="{place[0] + 2:.1f}" y="{place[1] - 2:.1f}" font-size="2" fill="#475569">{escape(name)}</text>'


def explain(folder: Path, number: int | None, picture: Path | None) -> str:
    """What the command line prints.

    Args:
        folder: a run's record.
        number: the deadlock to explain; None for all.
        picture: SVG file to write the deadlock to, None for none.

    Returns:
        Text of several lines.

    Raises:
        InputError: no record, no such deadlock, or a picture of more than one or that can't be drawn or written.
    """
    from analysis.tables import load_run
    from parking_sim.errors import InputError

    try:
        run = load_run(folder)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{folder}: no record of a run") from None
    all_ = deadlocks(run)
    chosen = [d for d in all_ if number is None or d.number == number]
    if number is not None and not chosen:
        known = f"it has 0 to {len(all_) - 1}" if all_ else "it has none"
        raise InputError(f"{folder}: no deadlock {number}; {known}")
    if picture is not None:
        if number is None:
            raise InputError("--svg: name one deadlock by its number")
        svg = draw(chosen[0], run.vertices, run.edges)
        if not svg:
            raise InputError(f"--svg: {folder}: the record says nothing of places")
        try:
            picture.write_text(svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1), encoding="utf-8")
        except OSError as error:
            raise InputError(f"--svg: {picture}: can't be written: {error.strerror}") from None
    return "\n".join(map(story, chosen)) if chosen else "no deadlock was found"
