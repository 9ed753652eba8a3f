"""What SUMO itself wrote about a run: stops, trips, batteries and counts, with the places of the net they name.

It reads SUMO's files and nothing else: no code of the controller, the plant or the reader of nets, so that a mistake
there can't hide itself here.
"""

from __future__ import annotations

import gzip
import math
import xml.parsers.expat
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

Attributes = dict[str, str]


@dataclass(frozen=True, slots=True)
class Stop:
    """A vehicle stood.

    Attributes:
        lane: SUMO lane.
        pos_m: where its front stood, metres along the lane.
        area: parkingArea, empty if it stood on the lane itself.
        vehicle_type: SUMO vehicle type when the stop ended.
        start_s, end_s: when, by SUMO's clock; infinity if it still stood at the end.
    """

    lane: str
    pos_m: float
    area: str
    vehicle_type: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class SumoOutputs:
    """SUMO's own account of a run.

    Attributes:
        stops: the stops of each vehicle, by time.
        trips: attributes of each vehicle's ``tripinfo``; those of its battery are among them.
        counts: attributes of ``statistics``, by element and name: ``counts["safety", "collisions"]``.
        lane_ends: lane -> junction where it ends, and its length in metres.
        longest_crossing_m: length of the longest lane within a junction.
        areas: parkingArea -> name of its bay, and its use ("in" or "out").
    """

    stops: Mapping[str, Sequence[Stop]]
    trips: Mapping[str, Attributes]
    counts: Mapping[tuple[str, str], float]
    lane_ends: Mapping[str, tuple[str, float]]
    longest_crossing_m: float
    areas: Mapping[str, tuple[str, str]]


def read_sumo_outputs(folder: Path) -> SumoOutputs:
    """Read what SUMO wrote into the folder of a run.

    Args:
        folder: folder of a run that has ended.

    Returns:
        SUMO's account.

    Raises:
        OSError: a file is missing or can't be read.
        xml.parsers.expat.ExpatError: a file is not XML.
    """
    inputs = {tag: row["value"] for tag, row in _elements(folder / "run.sumocfg") if "value" in row}
    lane_ends, longest_crossing_m = _lanes(folder / inputs["net-file"])
    return SumoOutputs(
        stops=_stops(folder / "stops.xml"),
        trips=_trips(folder / "tripinfo.xml"),
        counts=_counts(folder / "statistics.xml"),
        lane_ends=lane_ends,
        longest_crossing_m=longest_crossing_m,
        areas=_areas(folder / inputs["additional-files"]),
    )


def _stops(path: Path) -> dict[str, list[Stop]]:
    found: dict[str, list[Stop]] = defaultdict(list)
    for tag, row in _elements(path):
        if tag == "stopinfo":
            ended = float(row["ended"])
            found[row["id"]].append(
                Stop(
                    row["lane"],
                    float(row["pos"]),
                    row.get("parkingArea", ""),
                    row["type"].split("@")[0],  # "@" and its name follow when a vehicle has a speed of its own
                    float(row["started"]),
                    ended if ended >= 0 else math.inf,
                )
            )
    for stops in found.values():
        stops.sort(key=lambda stop: stop.start_s)
    return found


def _trips(path: Path) -> dict[str, Attributes]:
    found: dict[str, Attributes] = {}
    vehicle = ""
    for tag, row in _elements(path):
        if tag == "tripinfo":
            vehicle = row["id"]
            found[vehicle] = row
        elif tag == "battery":
            found[vehicle] = {**found[vehicle], **row}
    return found


def _counts(path: Path) -> dict[tuple[str, str], float]:
    wanted = ("performance", "vehicles", "teleports", "safety")
    return {(tag, name): float(value) for tag, row in _elements(path) if tag in wanted for name, value in row.items()}


def _lanes(path: Path) -> tuple[dict[str, tuple[str, float]], float]:
    """Where lanes end, with their lengths; and the length of the longest lane within a junction."""
    found: dict[str, tuple[str, float]] = {}
    head, crossing_m = "", 0.0
    for tag, row in _elements(path, until="junction"):
        if tag == "edge":
            head = row.get("to", "")
        elif tag == "lane" and head:
            found[row["id"]] = (head, float(row["length"]))
        elif tag == "lane":
            crossing_m = max(crossing_m, float(row["length"]))
    return found, crossing_m


def _areas(path: Path) -> dict[str, tuple[str, str]]:
    use: dict[str, Attributes] = defaultdict(dict)
    owner = ""
    for tag, row in _elements(path):
        if tag != "param":
            owner = row["id"] if tag == "parkingArea" else ""
        elif owner:
            use[owner][row["key"]] = row["value"]
    return {area: (row.get("garage.bay", ""), row.get("garage.use", "")) for area, row in use.items()}


class _EnoughRead(Exception):  # noqa: N818 - no error, a way out of the parser
    """All that matters has been read."""


def _elements(path: Path, until: str = "") -> Iterator[tuple[str, Attributes]]:
    """Tag and attributes of each element of a file, in its order, up to the first one called ``until``."""
    rows: list[tuple[str, Attributes]] = []
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = _collector(rows, until)
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        try:
            while chunk := file.read(1 << 18):
                parser.Parse(chunk)
                yield from rows
                rows.clear()
            parser.Parse(b"", True)
        except _EnoughRead:
            pass
        yield from rows


def _collector(rows: list[tuple[str, Attributes]], until: str) -> Callable[[str, Attributes], None]:
    def start(tag: str, attributes: Attributes) -> None:
        if tag == until:
            raise _EnoughRead
        rows.append((tag, attributes))

    return start
