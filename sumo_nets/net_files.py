"""What a garage's two SUMO files say, as rows: no graph, no roles that fit together.

Every number is checked where it is read, so that a complaint names the file, the line, the element and what would be
valid, and nothing that is no number goes any further.
"""

from __future__ import annotations

import errno
import gzip
import xml.parsers.expat
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from sumo_nets.errors import NetError
from sumo_nets.graph import ROLES, FloatArray, Role
from sumo_nets.input_file import MEGABYTE, check_file
from sumo_nets.sumo_rules import permits
from sumo_nets.wording import cut, shown

#: Farthest that anything may lie from the origin; beyond it squares of distances lose their metres.
FARTHEST_M = 1e7
#: Points of a line this close to each other are one.
_SAME_POINT_M = 1e-6
#: Digits of a count.
MOST_DIGITS = 6
#: Bytes of a file, and of its text: at most so many, and at most so many times the packed ones or this least.
_MOST_PACKED, _MOST_TEXT, _MOST_TIMES, _LEAST_TEXT = 100 * MEGABYTE, 300 * MEGABYTE, 100, 10 * MEGABYTE

Attributes = dict[str, str]

#: Attributes by which SUMO's elements (detectors, edge data, timed events, inclusions) name files.
_FILES = ("file", "output", "dest", "href")
_Row = TypeVar("_Row")


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane of an edge that isn't inside a junction.

    Attributes:
        name: SUMO lane id.
        edge: SUMO edge id.
        index: place among the edge's lanes, from 0 on the right.
        length_m, speed_mps: length and speed limit, above 0.
        shape: centre line in metres, at least two points that differ, shape (k, 2).
        allow, disallow: who may use it, see :func:`sumo_nets.sumo_rules.permits`.
    """

    name: str
    edge: str
    index: int
    length_m: float
    speed_mps: float
    shape: FloatArray
    allow: str
    disallow: str

    def permits(self, vehicle_class: str) -> bool:
        """Whether vehicles of a class may use it."""
        return permits(vehicle_class, self.allow, self.disallow)


@dataclass(slots=True)
class Edge:
    """An edge that isn't inside a junction; ``bidi`` is the edge that shares its track, ``street`` a part's name."""

    tail: str
    head: str
    bidi: str
    street: str = ""
    lanes: list[Lane] = field(default_factory=list)


class Connection(NamedTuple):
    """A way from a lane onto a lane of the next edge, by edge id and index, through a lane inside the junction."""

    edge: str
    lane: str
    next_edge: str
    next_lane: str
    via: str


@dataclass(slots=True)
class NetFile:
    """The parts of a net file that matter here.

    Attributes:
        path: the file.
        edges, junctions: by id, in the file's order; junctions as x and y in metres.
        roles: role, junction and place in the role's order, as written.
        connections: of edges that aren't inside junctions.
        inner_lanes: ``allow`` and ``disallow`` of the lanes inside junctions, by id.
    """

    path: Path
    edges: dict[str, Edge] = field(default_factory=dict)
    junctions: dict[str, tuple[float, float]] = field(default_factory=dict)
    roles: list[tuple[Role, str, str]] = field(default_factory=list)
    connections: list[Connection] = field(default_factory=list)
    inner_lanes: dict[str, tuple[str, str]] = field(default_factory=dict)

    def open_to(self, vehicle_class: str) -> dict[str, list[Lane]]:
        """The lanes that a class may use, by edge; edges without such a lane are left out."""
        lanes: dict[str, list[Lane]] = {}
        for name, edge in self.edges.items():
            usable = [lane for lane in edge.lanes if lane.permits(vehicle_class)]
            if usable:
                lanes[name] = usable
        return lanes

    def connected(self, vehicle_class: str) -> set[tuple[str, str]]:
        """Pairs of lane ids: vehicles of a class may drive from the first lane onto the second."""
        names = {(lane.edge, str(lane.index)): lane.name for edge in self.edges.values() for lane in edge.lanes}
        inner = {name for name, rule in self.inner_lanes.items() if permits(vehicle_class, *rule)} | {""}
        ends = ((names.get(c[:2], ""), names.get(c[2:4], "")) for c in self.connections if c.via in inner)
        return {pair for pair in ends if all(pair)}


@dataclass(slots=True)
class StoppingPlace:
    """A parkingArea or chargingStation as written.

    Attributes:
        lane: SUMO lane id.
        start, end, friendly: ``startPos``, ``endPos`` and ``friendlyPos``.
        capacity: cars that fit on a parkingArea: beside the road and in spaces of their own.
        bay, use: parameters ``garage.bay`` and ``garage.use``.
    """

    lane: str
    start: str
    end: str
    friendly: str
    capacity: int = 0
    bay: str = ""
    use: str = ""


@dataclass(slots=True)
class AdditionalFile:
    """The parts of an additional file that matter here, by id."""

    path: Path
    areas: dict[str, StoppingPlace] = field(default_factory=dict)
    stations: dict[str, StoppingPlace] = field(default_factory=dict)


def read_net_file(path: Path) -> NetFile:
    """Read a net file.

    Raises:
        NetError: it can't be read, an id is given twice, or a number is missing or not valid.
    """
    net = NetFile(path)
    # an edge's lanes and parameters follow it, a junction's parameters follow it
    inside: list[str] = ["", ""]

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "connection":
            if not attributes["from"].startswith(":"):
                ends = (attributes["from"], attributes["fromLane"], attributes["to"], attributes["toLane"])
                net.connections.append(Connection(*ends, attributes.get("via", "")))
        elif tag == "lane":
            _take_lane(net, inside[1], attributes)
        elif tag in ("edge", "junction"):
            inside[:] = [tag, attributes["id"]]
            if tag == "edge" and attributes.get("function", "normal") == "normal":
                edge = Edge(attributes["from"], attributes["to"], attributes.get("bidi", ""))
                _add(net.edges, attributes["id"], edge, "edge")
            elif tag == "junction" and attributes.get("type") != "internal":
                x, y = (_number("junction", attributes, key, -FARTHEST_M) for key in ("x", "y"))
                _add(net.junctions, attributes["id"], (x, y), "junction")
        elif tag == "param" and attributes["key"].startswith("garage."):
            _take_param(net, inside[0], inside[1], attributes)

    _parse(path, start)
    return net


def read_additional_file(path: Path) -> AdditionalFile:
    """Read an additional file.

    Raises:
        NetError: it can't be read, an id is given twice, or a number is missing or not valid.
    """
    extra = AdditionalFile(path)
    last: list[StoppingPlace] = []

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "param":
            if last and attributes["key"] in ("garage.bay", "garage.use"):
                setattr(last[0], attributes["key"].removeprefix("garage."), attributes["value"])
        elif tag == "space":
            if last:
                last[0].capacity += 1
        else:
            last.clear()
        if tag in ("parkingArea", "chargingStation"):
            place = StoppingPlace(
                attributes["lane"],
                attributes.get("startPos", ""),
                attributes.get("endPos", ""),
                attributes.get("friendlyPos", ""),
                _count(tag, attributes, "roadsideCapacity"),
            )
            if "efficiency" in attributes:
                _number(tag, attributes, "efficiency", 0.0)
            last.append(place)
            _add(extra.areas if tag == "parkingArea" else extra.stations, attributes["id"], place, tag)

    _parse(path, start)
    return extra


def _add(rows: dict[str, _Row], name: str, row: _Row, what: str) -> None:
    if name in rows:
        raise ValueError(f"{what} {shown(name)} is given twice")
    rows[name] = row


def _take_lane(net: NetFile, edge_id: str, attributes: Attributes) -> None:
    speed_mps = _number("lane", attributes, "speed", 0.0)
    rule = (attributes.get("allow", ""), attributes.get("disallow", ""))
    edge = net.edges.get(edge_id)
    if edge is None:
        net.inner_lanes[attributes["id"]] = rule
    else:
        length_m = _number("lane", attributes, "length", 0.0)
        lane = Lane(attributes["id"], edge_id, len(edge.lanes), length_m, speed_mps, _line(attributes), *rule)
        edge.lanes.append(lane)


def _take_param(net: NetFile, tag: str, owner: str, attributes: Attributes) -> None:
    key = attributes["key"].removeprefix("garage.")
    if tag == "edge" and key == "street" and owner in net.edges:
        net.edges[owner].street = attributes["value"]
    elif tag == "junction" and key in ROLES:
        net.roles.append((ROLES[ROLES.index(key)], owner, attributes["value"]))


def _number(what: str, attributes: Attributes, key: str, above: float) -> float:
    try:
        value = float(attributes[key])
    except ValueError:
        value = np.nan
    if not above < value < FARTHEST_M:
        raise ValueError(
            f"{what} {shown(attributes['id'])}: {key} is {shown(attributes[key])}; a number above {above:g} is valid"
        )
    return value


def _count(what: str, attributes: Attributes, key: str) -> int:
    value = attributes.get(key, "0")
    if not value.isascii() or not value.isdigit() or len(value) > MOST_DIGITS:
        raise ValueError(f"{what} {shown(attributes['id'])}: {key} is {shown(value)}; a whole number is valid")
    return int(value)


def _line(attributes: Attributes) -> FloatArray:
    """A lane's centre line, without points that repeat the one before."""
    rows = [point.split(",")[:2] for point in attributes["shape"].split()]
    try:
        points = np.array(rows, dtype=np.float64)
        fine = bool((np.abs(points) < FARTHEST_M).all())
        moves = np.hypot(*np.diff(points if fine else points[:1], axis=0).T) > _SAME_POINT_M
        fine = fine and bool(moves.any())
    except (ValueError, TypeError):
        fine = False
    if not fine:
        raise ValueError(
            f"lane {shown(attributes['id'])}: shape is {shown(attributes['shape'], 40)}; two points x,y or more that"
            " differ are valid"
        )
    line: FloatArray = points[np.append(True, moves)]
    return line


def _parse(path: Path, start: Callable[[str, Attributes], None]) -> None:
    def checked(tag: str, attributes: Attributes) -> None:
        _refuse_files(tag, attributes)
        start(tag, attributes)

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = checked
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        for chunk in _chunks(path):
            parser.Parse(chunk)
        parser.Parse(b"", True)
    except (OSError, EOFError, zlib.error) as err:
        reason = getattr(err, "strerror", None) or str(err)
        raise NetError(f"{path}: can't read: {reason}") from None
    except xml.parsers.expat.ExpatError as err:
        raise NetError(f"{path}: not XML: {err}") from None
    except KeyError as err:
        raise NetError(f"{path}: line {parser.CurrentLineNumber}: attribute {err} is missing") from None
    except (ValueError, LookupError) as err:  # LookupError: an encoding that nobody knows
        raise NetError(f"{path}: line {parser.CurrentLineNumber}: {cut(str(err), 300)}") from None


def _refuse_doctype(name: str, *_: object) -> None:
    """Entities may stand for other files, or for 10^9 times their text."""
    raise ValueError(f"DOCTYPE {cut(name)}: nets have none; take it out")


def _refuse_files(tag: str, attributes: Attributes) -> None:
    """No net of another's may have SUMO write over a file: detectors and edge data are not for a garage's net."""
    for key in _FILES:
        if key in attributes:
            raise ValueError(f"{tag}: {key} names a file for SUMO to read or write; take this element out")


def _chunks(path: Path) -> Iterator[bytes]:
    check_file(path, _MOST_PACKED)
    most = min(_MOST_TEXT, max(_LEAST_TEXT, _MOST_TIMES * path.stat().st_size))
    with gzip.open(path) if path.name.endswith(".gz") else path.open("rb") as stream:
        while chunk := stream.read(1 << 18):
            most -= len(chunk)
            if most < 0:
                raise OSError(errno.EFBIG, "holds more text than any net")
            yield chunk
