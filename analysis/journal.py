"""The journal of a run: its record so far, appended to a file while the run lasts and left behind if it is killed.

A line is a table's name and one row; a line that begins with a number says that everything up to that second stands
before it. Wall-clock columns are left out, so that the same run writes the same bytes: a run that is resumed is
simulated again from its start, and what it would write is compared with what the journal holds already.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from analysis.record import COLUMNS, Recorder
from analysis.run_files import JOURNAL
from sumo_nets.errors import InputError

#: Simulated seconds between two writes.
FLUSH_S = 60.0

#: Places of wall-clock columns by table.
_WALL = {table: [k for k, name in enumerate(names) if name.startswith("wall_")] for table, names in COLUMNS.items()}


class Journal:
    """A journal that is written, or compared as far as it is there already and then written.

    Args:
        folder: the run's folder.
        resumed: go on with the journal that is there.

    Raises:
        OSError: it can't be written.
    """

    def __init__(self, folder: Path, resumed: bool) -> None:
        self._path = folder / JOURNAL
        self._there = _whole_lines(self._path) if resumed else b""
        self._file = self._path.open("r+b" if resumed else "wb")
        self._file.truncate(len(self._there))  # what is there is never written again: the disk may be full
        self._file.seek(0, os.SEEK_END)
        self._at = 0
        self._done = dict.fromkeys(COLUMNS, 0)

    def flush(self, recorder: Recorder, time_s: float) -> None:
        """Bring the journal up to what is recorded now.

        Raises:
            InputError: the journal holds something else: another version or machine has begun this run.
        """
        lines = []
        for table in COLUMNS:
            rows = recorder.rows(table)
            lines += [json.dumps([table, _without_wall(table, row)]) for row in rows[self._done[table] :]]
            self._done[table] = len(rows)
        text = "".join(f"{line}\n" for line in [*lines, json.dumps(time_s)]).encode()
        there = self._there[self._at : self._at + len(text)]
        if not text.startswith(there):
            raise InputError(f"{self._path}: up to {time_s:g} s the run differs from its journal: it can't be resumed")
        self._at += len(text)
        self._file.write(text[len(there) :])
        self._file.flush()

    def close(self, finished: bool) -> None:
        """End writing; the journal of a finished run is removed, its record holds everything."""
        with suppress(OSError):  # the disk is full, as ``flush`` has told
            self._file.close()
        if finished:
            self._path.unlink(missing_ok=True)


def _without_wall(table: str, row: Sequence[Any]) -> list[Any]:
    values = list(row)
    for k in _WALL[table]:
        values[k] = math.nan
    return values


def _whole_lines(path: Path) -> bytes:
    """What a journal holds, without a last line that was cut off."""
    data = path.read_bytes()
    return data[: data.rfind(b"\n") + 1]


def _value(line: bytes) -> float | tuple[str, tuple[Any, ...]] | None:
    """A line's second, or its table and row; None if it is neither."""
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if not (isinstance(value, list) and len(value) == 2 and isinstance(value[0], str) and isinstance(value[1], list)):
        return None
    table, row = value
    return (table, tuple(row)) if table in COLUMNS and len(row) == len(COLUMNS[table]) else None


def read_journal(folder: Path) -> tuple[Recorder, float]:
    """The record of a run that was killed, as far as its journal goes.

    Args:
        folder: the run's folder.

    Returns:
        The rows, and the last second up to which all of them are there.

    Raises:
        FileNotFoundError: there is no journal.
        InputError: it is damaged.
    """
    recorder, time_s = Recorder(), 0.0
    fresh: list[tuple[str, tuple[Any, ...]]] = []
    for number, line in enumerate(_whole_lines(folder / JOURNAL).splitlines(), start=1):
        value = _value(line)
        if value is None:
            raise InputError(f"{folder / JOURNAL}: line {number}: is damaged, or no line that a run wrote")
        if not isinstance(value, float):
            fresh.append(value)
            continue
        time_s = value
        for table, row in fresh:
            recorder.add(table, row)
        fresh = []
    try:
        for table in COLUMNS:
            recorder.columns(table)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{folder / JOURNAL}: is damaged: table {table} has a value of another kind") from None
    return recorder, time_s
