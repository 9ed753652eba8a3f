"""Requests from a CSV file with the columns time_s, kind, car and, if wanted, zone.

The kind is park, retrieve, or inside: a car that is parked already when the run starts.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Literal

from pydantic import Field

from controller.types import Request, RequestKind
from demand.types import Demand, Workload
from sumo_nets.errors import InputError

_NEEDED = ("time_s", "kind", "car")
_COLUMNS = (*_NEEDED, "zone")
#: Kind of a row that is no request: its car is parked already when the run starts.
INSIDE = "inside"

#: What a car's name is told to be when it is refused.
_NAMES = "give at least one character, and no line breaks or other control characters"


class Csv(Workload):
    """Requests as they stand in a file, for example a gate log."""

    kind: Literal["csv"] = Field(default="csv", description="requests from a file")
    path: str = Field(min_length=1, description="the file; a relative path counts from the scenario's folder")
    initial_cars: tuple[str, ...] = Field(default=(), strict=False, description="cars already parked at the start")

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        for car in self.initial_cars:
            if not _is_name(car):
                raise InputError(f"workload.initial_cars: {car!r}: {_NAMES}")
            if self.initial_cars.count(car) > 1:
                raise InputError(f"workload.initial_cars: {car!r}: name each car once")
        inside, rows = _read(base_dir / self.path)
        initial = (*self.initial_cars, *inside)
        if repeated := next((car for car in initial if initial.count(car) > 1), ""):
            raise InputError(f"{self.path}: car: {repeated!r}: is inside at the start already; name it once")
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
    return bool(car.strip()) and car.isprintable()


def _read(path: Path) -> tuple[tuple[str, ...], list[tuple[int, Request]]]:
    """Cars inside at the start; requests in order of time, each with its row in the file (the header is row 1)."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            header = [cell.strip() for cell in next(reader, [])]
            _check_header(header, path)
            rows = [(reader.line_num, _row(header, cells, reader.line_num, path)) for cells in reader if any(cells)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
        raise InputError(f"workload.path: {path}: can't be read as a CSV file: {reason}") from None
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
        raise InputError(f"{path}: row 1: {','.join(header)!r}: the columns are time_s, kind, car and, if wanted, zone")


def _row(header: list[str], cells: list[str], number: int, path: Path) -> dict[str, str]:
    """The cells of a row by column, checked."""
    where = f"{path}: row {number}"
    if len(cells) != len(header):
        raise InputError(f"{where}: {len(cells)} cells: give {len(header)}, as many as the header")
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    try:
        time_s = float(row["time_s"])
    except ValueError:
        time_s = math.nan
    if not 0 <= time_s < math.inf:
        raise InputError(f"{where}: time_s: {row['time_s']!r}: give seconds from the start, 0 or more")
    if row["kind"] not in (*RequestKind, INSIDE):
        raise InputError(
            f"{where}: kind: {row['kind']!r}: give park or retrieve, or inside for a car there at the start"
        )
    if not _is_name(row["car"]):
        raise InputError(f"{where}: car: {row['car']!r}: {_NAMES}")
    return row


def _check_order(rows: list[tuple[int, Request]], inside: set[str], path: str) -> None:
    """A car is parked before it is retrieved, and not parked again before it is asked for."""
    for number, request in rows:
        where = f"{path}: row {number}: car: {request.car!r}"
        if request.kind is RequestKind.PARK:
            if request.car in inside:
                raise InputError(f"{where}: is parked already; retrieve it first")
            inside.add(request.car)
        else:
            if request.car not in inside:
                raise InputError(
                    f"{where}: never came, or was retrieved before; park it at an earlier time_s, or give"
                    f" it as inside: in a row of kind {INSIDE}, or by name in initial_cars"
                )
            inside.remove(request.car)
