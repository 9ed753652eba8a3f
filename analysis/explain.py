"""What ``parking-sim explain`` prints: what held the run at its end, its deadlocks, and its longest waits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.clock import Clock
from analysis.deadlocks import RecordedDeadlock, deadlocks, draw, story
from analysis.holds import LongWait, long_waits
from sumo_nets.errors import InputError
from sumo_nets.whole_file import write_whole

if TYPE_CHECKING:
    from analysis.tables import Run

#: So many of the longest waits are told.
_WAITS = 10


def explain(folder: Path, number: int | None, picture: Path | None) -> str:
    """What the command line prints.

    Args:
        folder: a run's record.
        number: the deadlock to explain; None for the whole run.
        picture: SVG file to write the deadlock to, None for none.

    Returns:
        Text of several lines.

    Raises:
        InputError: no record, no such deadlock, or a picture of more than one or that can't be drawn or written.
    """
    from analysis.tables import load_run

    try:
        run = load_run(folder)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{folder}: no record of a run") from None
    found, clock = deadlocks(run), Clock.of(run.meta)
    if number is None:
        if picture is not None:
            raise InputError("--svg: name one deadlock by its number")
        return "\n".join(_whole(run, found, clock))
    chosen = next((d for d in found if d.number == number), None)
    if chosen is None:
        known = f"it has 0 to {len(found) - 1}" if found else "it has none"
        raise InputError(f"{folder}: no deadlock {number}; {known}")
    if picture is not None:
        _write_picture(run, chosen, folder, picture)
    return story(chosen, clock)


def longest_waits(run: Run) -> list[LongWait]:
    """The longest waits of a run's AGVs, the longest one first; equal ones in order of time."""
    end_s = float(run.meta.get("simulated_s") or 0.0)
    return sorted(long_waits(run), key=lambda wait: wait.start_s - min(wait.end_s, end_s))[:_WAITS]


def wait_words(wait: LongWait, run: Run, clock: Clock) -> str:
    """A wait of an AGV as one line."""
    lasted = math.isinf(wait.end_s)
    end_s = float(run.meta.get("simulated_s") or 0.0) if lasted else wait.end_s
    car = f" (task: {wait.car})" if wait.car else ""
    span = f"{end_s - wait.start_s:g} s from {clock.at(wait.start_s)}{', to the end of the run' if lasted else ''}"
    return f"AGV {wait.agv}{car}: {span}: {'; then '.join(wait.reasons)}"


def _whole(run: Run, found: list[RecordedDeadlock], clock: Clock) -> list[str]:
    held = [f"held at the end: {line}" for line in run.meta.get("held") or ()]
    stories = [story(d, clock) for d in found] or ["no deadlock was found"]
    waits = [wait_words(wait, run, clock) for wait in longest_waits(run)]
    told = ["the longest waits of AGVs:", *(f"  {line}" for line in waits)] if waits else ["no AGV waited for long"]
    return [f"times are {clock.name}", *held, *stories, *told]


def _write_picture(run: Run, deadlock: RecordedDeadlock, folder: Path, picture: Path) -> None:
    svg = draw(deadlock, run.vertices, run.edges)
    if not svg:
        raise InputError(f"--svg: {folder}: the record says nothing of places")
    try:
        write_whole(picture, svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))
    except OSError as error:
        raise InputError(f"--svg: {picture}: can't be written: {error.strerror}") from None
