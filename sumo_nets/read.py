"""Read a garage back from its SUMO files alone, so that a net edited in netedit works too.

What the reader relies on is listed in :mod:`sumo_nets.build`: AGV lanes are edges that allow ``tram``, roles are
``garage.*`` parameters of junctions, the street's parts are ``garage.street`` parameters of edges, and bays' street
places are parkingAreas with ``garage.bay`` and ``garage.use``. A net whose bays have such places hands over at the
bay; in a net without any, hand-over is at the AGV's home and every bay is a home too.
"""

from __future__ import annotations

import gzip
import xml.parsers.expat
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np

from sumo_nets.graph import ROLES, FloatArray, Graph, Role, make_graph
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered

_NET_SUFFIXES = (".net.xml.gz", ".net.xml")
#: Where the first waiting car's front stands, before the end of the hold lane.
HOLD_BEFORE_END_M = 1.0

Attributes = dict[str, str]


class NetError(ValueError):
    """A net that can't be read or lacks what a garage needs; the message is one line."""


@dataclass(frozen=True, slots=True)
class BaySite:
    """Where customers' cars stand at one bay.

    Attributes:
        in_area, out_area: ids of the parkingAreas for arriving and for leaving cars, one car each.
        in_route: street edges from the queue edge by the in_area's edge to the exit edge.
        out_route: street edges from the out_area's edge to the exit edge.
    """

    in_area: str
    out_area: str
    in_route: tuple[str, ...]
    out_route: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Street:
    """The public street that feeds the bays.

    Attributes:
        entry_edge: public street upstream; customers' cars appear here.
        queue_edge: the garage's own hold lane.
        exit_edge: last edge, where leaving cars disappear.
        hold_pos_m: position on the queue edge where the first waiting car's front stands.
        entry_m, queue_m: lengths of the entry and the queue edge.
    """

    entry_edge: str
    queue_edge: str
    exit_edge: str
    hold_pos_m: float
    entry_m: float
    queue_m: float


@dataclass(frozen=True)
class GarageNet:
    """A garage as read from its SUMO files.

    Attributes:
        graph: what AGVs drive on; vertices in the order of the net's junctions. An edge's ``length_m`` is SUMO's lane
            length: between the rims of its two junctions.
        net_file, additional_file: the files to give to SUMO.
        handover: ``bay``: customers' cars come to the bays; ``home``: cars appear and disappear at AGVs' homes.
        bay_sites: street places of each bay, by the bay's vertex and in the order of ``graph.bays``; empty when
            hand-over is at home. No other number of a bay finds a site.
        charging_station_of_edge: id of the chargingStation on an edge into a charger, by edge index. An AGV stands
            on the edge it came by, so a charger with several edges in has a station on each.
        street: the street, or None when hand-over is at home.
        shapes: centre line of each edge's lane in metres, each of shape (k, 2), aligned with the graph's edges.
        street_shapes: centre line of each street edge in metres, by edge id.
        bidi: whether SUMO treats an edge and its reverse as one track, shape (m,).
    """

    graph: Graph
    net_file: Path
    additional_file: Path
    handover: Literal["bay", "home"]
    bay_sites: Mapping[Vertex, BaySite]
    charging_station_of_edge: Mapping[EdgeIndex, str]
    street: Street | None
    shapes: Numbered[EdgeIndex, FloatArray]
    street_shapes: Mapping[str, FloatArray]
    bidi: np.ndarray[tuple[int], np.dtype[np.bool_]]

    @property
    def name(self) -> str:
        """The net's name: its file's, without the suffix."""
        return self.graph.name


def shipped_nets() -> tuple[str, ...]:
    """Names of the nets that come with the package, sorted."""
    suffix = _NET_SUFFIXES[0]
    return tuple(sorted(p.name.removesuffix(suffix) for p in _nets_folder().glob(f"*{suffix}")))


def net_files(name_or_path: str | Path) -> tuple[Path, Path]:
    """The files that make a garage, which need not be valid.

    Args:
        name_or_path: as for :func:`read_net`.

    Returns:
        The net and its additional file.

    Raises:
        NetError: unknown name or missing net.
    """
    net_file, name = _find(name_or_path)
    return net_file, net_file.with_name(f"{name}.add.xml")


def read_net(name_or_path: str | Path) -> GarageNet:
    """Read a garage from its net and its additional file.

    Args:
        name_or_path: name of a shipped net (:func:`shipped_nets`), or path of a ``NAME.net.xml[.gz]`` with
            ``NAME.add.xml`` beside it.

    Returns:
        The garage.

    Raises:
        NetError: unknown name, missing or unreadable file, a net without bays, or roles that contradict each other.
    """
    paths = net_files(name_or_path)
    return _read(*paths, tuple(_version(path) for path in paths))


def _version(path: Path) -> tuple[int, int] | None:
    """What tells versions of a file apart; None if there is none."""
    if not path.exists():
        return None
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=8)
def _read(net_file: Path, additional_file: Path, _versions: tuple[object, ...]) -> GarageNet:
    """Read both files, once for all runs of a process: to read a net takes longer than many a run."""
    net = _read_net_file(net_file)
    extra = _read_additional_file(additional_file)
    graph = _graph(net, additional_file.name.removesuffix(".add.xml"), net_file)
    if not graph.bays:
        raise NetError(f"{net_file}: the net has no bays: mark a junction with the parameter garage.bay")
    street, bay_sites = _bay_sites(net, extra, graph, net_file)
    edge_of = {edge: e for e, edge in numbered(graph.edge_names)}
    rows = [net.edges[edge] for edge in graph.edge_names]
    return GarageNet(
        graph=graph,
        net_file=net_file,
        additional_file=additional_file,
        handover="bay" if bay_sites else "home",
        bay_sites=bay_sites,
        charging_station_of_edge={
            edge_of[lane.edge]: station
            for station, lane_id in extra.stations.items()
            if (lane := net.lanes.get(lane_id)) and lane.edge in edge_of
        },
        street=street,
        shapes=tuple(_points(net.lanes[row.lane].shape) for row in rows),
        street_shapes={name: _points(net.lanes[edge.lane].shape) for name, edge in net.street_edges().items()},
        bidi=np.array([row.bidi for row in rows], dtype=np.bool_),
    )


def _nets_folder() -> Path:
    return Path(str(files("sumo_nets"))) / "nets"


def _find(name_or_path: str | Path) -> tuple[Path, str]:
    """The net's file and name."""
    given = str(name_or_path)
    if given in shipped_nets():
        return _nets_folder() / f"{given}{_NET_SUFFIXES[0]}", given
    path = Path(name_or_path)
    for suffix in _NET_SUFFIXES:
        if path.name.endswith(suffix) and path.is_file():
            return path, path.name.removesuffix(suffix)
    raise NetError(
        f"unknown map {given!r}: valid are {', '.join(shipped_nets())}, or the path of a .net.xml or .net.xml.gz file"
    )


@dataclass(frozen=True, slots=True)
class _Lane:
    edge: str
    length_m: float
    shape: str


@dataclass(slots=True)
class _Edge:
    tail: str
    head: str
    bidi: bool
    lane: str = ""
    allow: frozenset[str] = frozenset()
    street: str = ""


@dataclass(slots=True)
class _Net:
    """The parts of a net file that matter here."""

    edges: dict[str, _Edge] = field(default_factory=dict)
    lanes: dict[str, _Lane] = field(default_factory=dict)
    junctions: dict[str, tuple[float, float]] = field(default_factory=dict)
    roles: list[tuple[Role, str, str]] = field(default_factory=list)

    def agv_edges(self) -> dict[str, _Edge]:
        return {name: edge for name, edge in self.edges.items() if "tram" in edge.allow}

    def street_edges(self) -> dict[str, _Edge]:
        return {name: edge for name, edge in self.edges.items() if "passenger" in edge.allow}


@dataclass(slots=True)
class _Extra:
    """The parts of an additional file that matter here: ids to lanes, and (bay, use) to area."""

    areas: dict[str, str] = field(default_factory=dict)
    uses: dict[str, Attributes] = field(default_factory=dict)
    stations: dict[str, str] = field(default_factory=dict)


class _EnoughRead(Exception):  # noqa: N818 - no error, a way out of the parser
    """All that matters has been read."""


def _read_net_file(path: Path) -> _Net:
    net = _Net()
    # an edge's lanes and parameters follow it, a junction's parameters follow it
    inside: list[str] = ["", ""]

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "connection":
            raise _EnoughRead  # SUMO wants edges and junctions before the connections, which are half of the file
        if tag in ("edge", "junction"):
            inside[:] = [tag, attributes["id"]]
        if tag == "edge" and attributes.get("function", "normal") == "normal":
            net.edges[attributes["id"]] = _Edge(attributes["from"], attributes["to"], "bidi" in attributes)
        elif tag == "lane":
            _take_lane(net, inside[1], attributes)
        elif tag == "junction" and attributes.get("type") != "internal":
            net.junctions[attributes["id"]] = (float(attributes["x"]), float(attributes["y"]))
        elif tag == "param" and attributes["key"].startswith("garage."):
            _take_param(net, inside[0], inside[1], attributes)

    _parse(path, start)
    return net


def _take_lane(net: _Net, edge_id: str, attributes: Attributes) -> None:
    edge = net.edges.get(edge_id)
    if edge is None or edge.lane:
        return
    edge.lane = attributes["id"]
    edge.allow = frozenset(attributes.get("allow", "").split())
    net.lanes[attributes["id"]] = _Lane(edge_id, float(attributes["length"]), attributes["shape"])


def _take_param(net: _Net, tag: str, owner: str, attributes: Attributes) -> None:
    key = attributes["key"].removeprefix("garage.")
    if tag == "edge" and key == "street" and owner in net.edges:
        net.edges[owner].street = attributes["value"]
    elif tag == "junction" and key in ROLES:
        net.roles.append((ROLES[ROLES.index(key)], owner, attributes["value"]))


def _read_additional_file(path: Path) -> _Extra:
    extra = _Extra()
    last: list[str] = [""]

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "parkingArea":
            last[0] = attributes["id"]
            extra.areas[last[0]] = attributes["lane"]
        elif tag == "chargingStation":
            extra.stations[attributes["id"]] = attributes["lane"]
        elif tag == "param" and attributes["key"].startswith("garage.") and last[0]:
            extra.uses.setdefault(last[0], {})[attributes["key"]] = attributes["value"]

    _parse(path, start)
    return extra


def _parse(path: Path, start: Callable[[str, Attributes], None]) -> None:
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = start
    try:
        for chunk in _chunks(path):
            parser.Parse(chunk)
        parser.Parse(b"", True)
    except _EnoughRead:
        return
    except (OSError, EOFError, zlib.error) as err:
        reason = getattr(err, "strerror", None) or str(err)
        raise NetError(f"{path}: can't read: {reason}") from None
    except xml.parsers.expat.ExpatError as err:
        raise NetError(f"{path}: not XML: {err}") from None
    except KeyError as err:
        raise NetError(f"{path}: line {parser.CurrentLineNumber}: attribute {err} is missing") from None
    except ValueError as err:
        raise NetError(f"{path}: line {parser.CurrentLineNumber}: {err}") from None


def _chunks(path: Path) -> Iterator[bytes]:
    with gzip.open(path) if path.name.endswith(".gz") else path.open("rb") as stream:
        while chunk := stream.read(1 << 18):
            yield chunk


def _points(shape: str) -> FloatArray:
    return np.array([point.split(",")[:2] for point in shape.split()], dtype=np.float64)


def _graph(net: _Net, name: str, source: Path) -> Graph:
    edges = net.agv_edges()
    used = {end for edge in edges.values() for end in (edge.tail, edge.head)}
    missing = used - net.junctions.keys()
    if missing:
        raise NetError(f"{source}: junction {min(missing)!r} is missing, but an edge ends there")
    return make_graph(
        name,
        [(junction, x, y) for junction, (x, y) in net.junctions.items() if junction in used],
        [(eid, edge.tail, edge.head, net.lanes[edge.lane].length_m) for eid, edge in edges.items()],
        _roles(net, used, source),
    )


def _roles(net: _Net, used: set[str], source: Path) -> dict[Role, list[str]]:
    ranked: dict[Role, list[tuple[int, str]]] = {role: [] for role in ROLES}
    for role, junction, value in net.roles:
        if junction not in used:
            raise NetError(f"{source}: junction {junction!r} is a {role}, but no lane that allows tram leads to it")
        try:
            ranked[role].append((int(value), junction))
        except ValueError:
            raise NetError(
                f"{source}: junction {junction!r}: garage.{role} is {value!r}; a whole number is valid"
            ) from None
    return {role: [junction for _, junction in sorted(rows)] for role, rows in ranked.items()}


def _bay_sites(net: _Net, extra: _Extra, graph: Graph, source: Path) -> tuple[Street | None, dict[Vertex, BaySite]]:
    areas = {(use.get("garage.bay", ""), use.get("garage.use", "")): area for area, use in extra.uses.items()}
    if not areas:
        stray = sorted(set(graph.bays) - set(graph.homes))
        if stray:
            raise NetError(
                f"{source}: bay {graph.names[stray[0]]!r} has no parkingArea with garage.bay, and is no home either"
            )
        return None, {}
    street = _street(net, source)
    sites = {}
    for vertex in graph.bays:
        for use in ("in", "out"):
            if (graph.names[vertex], use) not in areas:
                raise NetError(f"{source}: bay {graph.names[vertex]!r} has no parkingArea with garage.use {use!r}")
        in_area, out_area = (areas[graph.names[vertex], use] for use in ("in", "out"))
        in_edge, out_edge = (_area_edge(net, extra, area, source) for area in (in_area, out_area))
        onward = _street_route(net, in_edge, street.exit_edge, source)
        sites[vertex] = BaySite(
            in_area,
            out_area,
            _street_route(net, street.queue_edge, in_edge, source) + onward[1:],
            _street_route(net, out_edge, street.exit_edge, source),
        )
    return street, sites


def _street(net: _Net, source: Path) -> Street:
    parts = {edge.street: name for name, edge in net.street_edges().items() if edge.street}
    for part in ("entry", "queue", "exit"):
        if part not in parts:
            raise NetError(f"{source}: no edge that allows passenger has the parameter garage.street={part}")
    entry, queue = (net.lanes[net.edges[parts[part]].lane].length_m for part in ("entry", "queue"))
    return Street(parts["entry"], parts["queue"], parts["exit"], max(queue - HOLD_BEFORE_END_M, 0.0), entry, queue)


def _area_edge(net: _Net, extra: _Extra, area: str, source: Path) -> str:
    lane = net.lanes.get(extra.areas[area])
    if lane is None:
        raise NetError(f"{source}: parkingArea {area!r} lies on lane {extra.areas[area]!r}, which the net doesn't have")
    return lane.edge


def _street_route(net: _Net, start: str, goal: str, source: Path) -> tuple[str, ...]:
    """Shortest chain of street edges, both ends included."""
    edges = net.street_edges()
    came_from: dict[str, str] = {start: ""}
    queue = deque([start])
    while queue and goal not in came_from:
        here = queue.popleft()
        for onward, edge in edges.items():
            if here in edges and edge.tail == edges[here].head and onward not in came_from:
                came_from[onward] = here
                queue.append(onward)
    if goal not in came_from:
        raise NetError(f"{source}: the street leads nowhere from {start!r} to {goal!r}")
    route = [goal]
    while came_from[route[-1]]:
        route.append(came_from[route[-1]])
    return tuple(reversed(route))
