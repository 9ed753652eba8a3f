"""Requests from a CSV file with the columns time_s, kind, car and, if wanted, zone.

The kind is park, retrieve, or inside: a car that is parked already when the run starts.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from controller.types import Request, RequestKind
from demand.types import Demand, Workload
from sumo_nets.errors import InputError, in_lines
from sumo_nets.input_file import MEGABYTE, read_text
from sumo_nets.wording import shown

_NEEDED = ("time_s", "kind", "car")
_COLUMNS = (*_NEEDED, "zone")
#: Kind of a row that is no request: its car is parked already when the run starts.
INSIDE = "inside"
#: Bytes of a file, and the latest time in it, seconds: some three hundred years.
_MOST_BYTES, _LATEST_S = 100 * MEGABYTE, 1e10

#: What a car's name is told to be when it is refused.
_LONGEST_NAME = 1000
_NAMES = f"give 1 to {_LONGEST_NAME} characters, and no line breaks or other control characters"


class Csv(Workload):
    """Requests as they stand in a file, for example a gate log."""

    kind: Literal["csv"] = Field(default="csv", description="requests from a file")
    path: str = Field(min_length=1, description="the file; a relative path counts from the scenario's folder")
    initial_cars: tuple[str, ...] = Field(default=(), strict=False, description="cars already parked at the start")

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        for car in self.initial_cars:
            if not _is_name(car):
                raise InputError(f"workload.initial_cars: {shown(car)}: {_NAMES}")
        if repeated := _repeated(self.initial_cars):
            raise InputError(f"workload.initial_cars: {shown(repeated)}: name each car once")
        inside, rows = _read(base_dir / self.path)
        initial = (*self.initial_cars, *inside)
        if repeated := _repeated(initial):
            raise InputError(f"{self.path}: car: {shown(repeated)}: is inside at the start already; name it once")
        if len(initial) > slots:
            raise InputError(
                f"workload.initial_cars: {len(initial)} cars, with those in the file: give at most {slots}, the"
                " garage's slots"
            )
        _check_order(rows, set(initial), self.path)
        return Demand(initial, (tuple(request for _, request in rows),))

    @property
    def file_key(self) -> str:
        """The requests' file."""
        return "path"


def _is_name(car: str) -> bool:
    return bool(car.strip()) and car.isprintable() and len(car) <= _LONGEST_NAME


def _read(path: Path) -> tuple[tuple[str, ...], list[tuple[int, Request]]]:
    """Cars inside at the start; requests in order of time, each with its row in the file (the header is row 1)."""
    try:
        reader = csv.reader(io.StringIO(read_text(path, _MOST_BYTES), newline=""))
        header = [cell.strip() for cell in next(reader, [])]
        _check_header(header, path)
        cells_of = [(reader.line_num, cells) for cells in reader if any(cells)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
        raise InputError(f"workload.path: {path}: can't be read as a CSV file: {reason}") from None
    rows, wrong = [], []
    for number, cells in cells_of:
        row, found = _row(header, cells)
        wrong += [f"{path}: row {number}: {what}" for what in found]
        rows.append((number, row))
    if wrong:
        raise InputError(in_lines(wrong))
    requests = [
        (number, Request(float(row["time_s"]), RequestKind(row["kind"]), row["car"], row.get("zone", "")))
        for number, row in rows
        if row["kind"] != INSIDE
    ]
    inside = tuple(row["car"] for _, row in rows if row["kind"] == INSIDE)
    return inside, sorted(requests, key=lambda row: row[1].time_s)


def _check_header(header: list[str], path: Path) -> None:
    missing = [name for name in _NEEDED if name not in header]
    unknown = [name for name in header if name not in _COLUMNS]
    if missing or unknown or len(set(header)) < len(header):
        raise InputError(
            f"{path}: row 1: {shown(','.join(header))}: the columns are time_s, kind, car and, if wanted, zone"
        )


def _repeated(cars: Sequence[str]) -> str:
    """The first car that comes again, "" if none does."""
    counts = Counter(cars)
    return next((car for car in cars if counts[car] > 1), "")


def _row(header: list[str], cells: list[str]) -> tuple[dict[str, str], list[str]]:
    """The cells of a row by column, and what is wrong with them."""
    if len(cells) != len(header):
        return {}, [f"{len(cells)} cells: give {len(header)}, as many as the header"]
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    try:
        time_s = float(row["time_s"])
    except ValueError:
        time_s = math.nan
    wrong = []
    if not 0 <= time_s <= _LATEST_S:
        wrong.append(f"time_s: {shown(row['time_s'])}: give seconds from the start, 0 or more (at most {_LATEST_S:g})")
    if row["kind"] not in (*RequestKind, INSIDE):
        wrong.append(f"kind: {shown(row['kind'])}: give park or retrieve, or inside for a car there at the start")
    if not _is_name(row["car"]):
        wrong.append(f"car: {shown(row['car'])}: {_NAMES}")
    return row, wrong


def _check_order(rows: list[tuple[int, Request]], inside: set[str], path: str) -> None:
    """A car is parked before it is retrieved, and not parked again before it is asked for."""
    wrong = []
    for number, request in rows:
        where = f"{path}: row {number}: car: {shown(request.car)}"
        parks = request.kind is RequestKind.PARK
        if parks and request.car in inside:
            wrong.append(f"{where}: is parked already; retrieve it first")
        elif not parks and request.car not in inside:
            wrong.append(
                f"{where}: never came, or was retrieved before; park it at an earlier time_s, or give"
                f" it as inside: in a row of kind {INSIDE}, or by name in initial_cars"
            )
        (inside.add if parks else inside.discard)(request.car)
    if wrong:
        raise InputError(in_lines(wrong))
