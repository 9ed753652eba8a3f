"""Deadlocks explained: which AGV held what and waited for which, why, what resolved it, and what it cost.

Whatever shows deadlocks (report, replay, figures, metrics, command line) takes them from ``deadlocks``.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import cycle
from typing import TYPE_CHECKING, Any

from analysis.clock import Clock
from analysis.faults import fault_spans
from analysis.words import words
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
class RecordedDeadlock:
    """One deadlock, as recorded.

    Attributes:
        number: its number in the run, from 0.
        began_s: when the wait began, seconds.
        found_s: when it was found, seconds.
        over_s: when it was resolved, seconds; infinite if it was not.
        where: name of the vertex that its first member wanted, "" if it wanted none.
        cause: ring, idle or stuck.
        members: AGV numbers.
        waits: for each waiting AGV the one it waited for.
        wants: for each waiting AGV the vertex it wanted.
        holds: the vertices that belonged to each member, the last one is where its authority ended.
        goals: where each member had to go.
        tried: stages that found nothing, with the reason and how often.
        stage: what resolved it; empty if nothing did.
        plans_failed: agents without a path and refused plans in the minute before.
        faults: what was wrong in the garage while it lasted: the cause, and the AGV or place concerned.
    """

    number: int
    began_s: float
    found_s: float
    over_s: float
    where: str
    cause: str
    members: tuple[AgvNumber, ...]
    waits: Mapping[AgvNumber, AgvNumber]
    wants: Mapping[AgvNumber, str]
    holds: Mapping[AgvNumber, tuple[str, ...]]
    goals: Mapping[AgvNumber, str]
    tried: Mapping[str, int]
    stage: str
    plans_failed: int
    faults: tuple[str, ...]

    @property
    def in_vain(self) -> list[str]:
        """The stages that found nothing, each with its reason and how often."""
        return [text if times == 1 else f"{text} × {times}" for text, times in self.tried.items()]

    @property
    def cost_s(self) -> float:
        """Seconds from the beginning of the wait to the resolution; infinite if there was none."""
        return self.over_s - self.began_s


def deadlocks(run: Run) -> list[RecordedDeadlock]:
    """The deadlocks of a run, in the order in which they were found.

    Args:
        run: a record.
    """
    resolved = {int(row["deadlock"]): row for row in _rows(run, "deadlock_resolved")}
    tried: dict[int, Counter[str]] = {}
    for row in _rows(run, "stage_failed"):
        tried.setdefault(row["deadlock"], Counter())[words(f"{row['stage']}: {row['reason']}")] += 1
    events = run.events
    failed_s = events["time_s"][events["kind"].isin(["plan_partial", "plan_rejected"])].to_numpy()
    faults = [span for span in fault_spans(run).values() if span.cause not in ("late", "lost")]
    found = []
    for row in _rows(run, "deadlock_found"):
        number, found_s = row["deadlock"], row["time_s"]
        end = resolved.get(number)
        over_s = end["time_s"] if end else math.inf
        began_s = over_s - end["cost_s"] if end else row.get("since_s", found_s)
        found.append(
            RecordedDeadlock(
                number,
                began_s,
                found_s,
                over_s,
                row["vertex"],
                row.get("cause", ""),
                tuple(map(AgvNumber, row["members"])),
                {AgvNumber(int(n)): AgvNumber(other) for n, other in row.get("waits", {}).items()},
                {AgvNumber(int(n)): name for n, name in row.get("wants", {}).items()},
                {AgvNumber(int(n)): tuple(names) for n, names in row.get("holds", {}).items()},
                {AgvNumber(int(n)): name for n, name in row.get("goals", {}).items()},
                tried.get(number, Counter()),
                end["stage"] if end else "",
                int(((failed_s > found_s - BEFORE_S) & (failed_s <= found_s)).sum()),
                tuple(fault.text for fault in faults if fault.start_s < over_s and fault.end_s > began_s),
            )
        )
    return found


def _rows(run: Run, kind: str) -> list[dict[str, Any]]:
    """The events of one kind with the keys of their details; keys that a detail lacks are missing in its row too."""
    rows = run.events[run.events["kind"] == kind].to_dict("records")
    return [{**{str(key): value for key, value in row.items()}, **json.loads(row["detail"] or "{}")} for row in rows]


def why(deadlock: RecordedDeadlock) -> str:
    """Why a deadlock arose, in a sentence or two."""
    d = deadlock
    if d.cause == "ring" and len(d.members) == 2:
        text = "Two AGVs met: each was in the other one's way, and their plans did not bring them past each other."
    elif d.cause == "ring":
        text = f"{len(d.members)} AGVs waited in a ring: each was in the way of the one before it."
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


def story(deadlock: RecordedDeadlock, clock: Clock) -> str:
    """A deadlock as text of a few lines."""
    d = deadlock
    lines = [f"deadlock {d.number}, found at {clock.at(d.found_s)}: {why(d)}"]
    for n in d.members:
        holds = f"held {', '.join(d.holds[n])}" if n in d.holds else "held unrecorded places"
        goal = f", on the way to {d.goals[n]}" if d.goals.get(n, "") not in ("", *d.holds.get(n, ())[-1:]) else ""
        wait = f", wanted {d.wants[n]} and waited for AGV {d.waits[n]}" if n in d.waits else ""
        lines.append(f"  AGV {n} {holds}{goal}{wait}")
    lines += [f"  tried in vain: {text}" for text in d.in_vain]
    lines.append(f"  {outcome(d)}")
    return "\n".join(lines)


def outcome(deadlock: RecordedDeadlock) -> str:
    """What resolved a deadlock, and the seconds that it cost."""
    d = deadlock
    return f"resolved by {words(d.stage)}, {d.cost_s:g} s after the wait began" if d.stage else "not resolved"


def _names(members: Sequence[int]) -> str:
    return ", ".join(f"AGV {n}" for n in members)


def draw(deadlock: RecordedDeadlock, vertices: pd.DataFrame, edges: pd.DataFrame) -> str:
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
