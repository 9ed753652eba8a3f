"""Read a garage back from its SUMO files alone, so that a net edited in netedit works too.

What the reader relies on is listed in :mod:`sumo_nets.build`: AGV lanes are edges that allow ``tram``, roles are
``garage.*`` parameters of junctions, the street's parts are ``garage.street`` parameters of edges, and bays' street
places are parkingAreas with ``garage.bay`` and ``garage.use``. A net whose bays have such places hands over at the
bay; in a net without any, hand-over is at the AGV's home and every bay is a home too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np

from sumo_nets.errors import NetError
from sumo_nets.graph import ROLES, FloatArray, Graph, Role, make_graph
from sumo_nets.input_file import is_file
from sumo_nets.net_files import MOST_DIGITS, AdditionalFile, Lane, NetFile, read_additional_file, read_net_file
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered
from sumo_nets.street import BaySite, Street, read_street
from sumo_nets.sumo_rules import POSITION_EPS_M, stopping_place
from sumo_nets.wording import shown

_NET_SUFFIXES = (".net.xml.gz", ".net.xml")


@dataclass(frozen=True, eq=False)
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

    def __repr__(self) -> str:
        """The garage's name and its places by role."""
        counts = ", ".join(f"{len(places)} {role}s" for role, places in self.graph.roles.items() if places)
        return f"<GarageNet {self.name}: {counts}>"

    @property
    def name(self) -> str:
        """The net's name: its file's, without the suffix."""
        return self.graph.name


def shipped_nets() -> tuple[str, ...]:
    """Names of the nets that come with the package, sorted."""
    suffix = _NET_SUFFIXES[0]
    return tuple(sorted(p.name.removesuffix(suffix) for p in _nets_folder().glob(f"*{suffix}")))


def is_shipped(garage: GarageNet) -> bool:
    """Whether a garage is one of :func:`shipped_nets`."""
    return garage.net_file.parent == _nets_folder()


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

    Example:
        >>> import parking_sim as ps
        >>> garage = ps.read_net("map1")
        >>> garage
        <GarageNet map1: 61 slots, 2 bays, 8 homes, 3 chargers>
        >>> garage.graph.names[garage.graph.bays[0]]
        'bay2_3w'
    """
    paths = net_files(name_or_path)
    return _read(*paths, tuple(_version(path) for path in paths))


def _version(path: Path) -> tuple[int, int] | None:
    """What tells versions of a file apart; None if there is none."""
    if not is_file(path):
        return None
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=8)
def _read(net_file: Path, additional_file: Path, _versions: tuple[object, ...]) -> GarageNet:
    """Read both files, once for all runs of a process: to read a net takes longer than many a run."""
    net = read_net_file(net_file)
    extra = read_additional_file(additional_file)
    lanes = _agv_lanes(net)
    graph = _graph(net, lanes, additional_file.name.removesuffix(".add.xml"))
    if not graph.bays:
        raise NetError(f"{net_file}: the net has no bays: mark a junction with the parameter garage.bay")
    street, bay_sites = read_street(net, extra, graph)
    edge_of = {lanes[name].name: e for e, name in numbered(graph.edge_names)}
    twins = [graph.edge_names[EdgeIndex(r)] if r >= 0 else "" for r in graph.reverse.tolist()]
    return GarageNet(
        graph=graph,
        net_file=net_file,
        additional_file=additional_file,
        handover="bay" if bay_sites else "home",
        bay_sites=bay_sites,
        charging_station_of_edge=_stations(extra, net, edge_of),
        street=street,
        shapes=tuple(lanes[name].shape for name in graph.edge_names),
        street_shapes={name: usable[0].shape for name, usable in net.open_to("passenger").items()},
        bidi=np.array(
            [bool(t) and net.edges[e].bidi == t for e, t in zip(graph.edge_names, twins, strict=True)], dtype=np.bool_
        ),
    )


def _nets_folder() -> Path:
    return Path(str(files("sumo_nets"))) / "nets"


def _find(name_or_path: str | Path) -> tuple[Path, str]:
    """The net's file and name."""
    given = str(name_or_path)
    if given in shipped_nets():
        return _nets_folder() / f"{given}{_NET_SUFFIXES[0]}", given
    try:
        given.encode()
    except UnicodeEncodeError:
        raise NetError(f"{shown(given)}: not in UTF-8: rename the file") from None
    path = Path(name_or_path)
    for suffix in _NET_SUFFIXES:
        if path.name.endswith(suffix) and is_file(path):
            return path, path.name.removesuffix(suffix)
    if path.name.endswith(_NET_SUFFIXES):
        raise NetError(f"{given}: no such file")
    raise NetError(
        f"unknown map {shown(given)}: valid are {', '.join(shipped_nets())}, or the path of a .net.xml or .net.xml.gz"
        " file"
    )


def _agv_lanes(net: NetFile) -> dict[str, Lane]:
    """The lane of each edge on which AGVs drive: the one that allows trams."""
    cars = net.open_to("passenger")
    lanes = {}
    for name, usable in net.open_to("tram").items():
        if name in cars:
            raise NetError(
                f"{net.path}: edge {name!r} allows tram and passenger: allow only one of them, because AGVs and"
                " customers' cars keep apart"
            )
        if len(usable) > 1 or usable[0].index > 0:
            found = ", ".join(str(lane.index) for lane in usable)
            raise NetError(f"{net.path}: edge {name!r}: lanes that allow tram: {found}; lane 0 alone is valid")
        lanes[name] = usable[0]
    return lanes


def _graph(net: NetFile, lanes: Mapping[str, Lane], name: str) -> Graph:
    used: set[str] = set()
    by_ends: dict[tuple[str, str], str] = {}
    for edge in lanes:
        ends = (net.edges[edge].tail, net.edges[edge].head)
        used.update(ends)
        if ends[0] == ends[1]:
            raise NetError(f"{net.path}: edge {edge!r} leads from junction {ends[0]!r} to itself")
        if by_ends.setdefault(ends, edge) != edge:
            raise NetError(
                f"{net.path}: edges {by_ends[ends]!r} and {edge!r} both lead from {ends[0]!r} to {ends[1]!r};"
                " one lane each way is valid"
            )
    missing = used - net.junctions.keys()
    if missing:
        raise NetError(f"{net.path}: junction {min(missing)!r} is missing, but an edge ends there")
    connected = net.connected("tram")
    return make_graph(
        name,
        [(junction, x, y) for junction, (x, y) in net.junctions.items() if junction in used],
        [(edge, *ends, lanes[edge].length_m) for ends, edge in by_ends.items()],
        _roles(net, used),
        {edge: lane.speed_mps for edge, lane in lanes.items()},
        lambda edge, onto: (lanes[edge].name, lanes[onto].name) in connected,
    )


def _roles(net: NetFile, used: set[str]) -> dict[Role, list[str]]:
    ranked: dict[Role, dict[int, str]] = {role: {} for role in ROLES}
    for role, junction, value in net.roles:
        if junction not in used:
            raise NetError(f"{net.path}: junction {junction!r} is a {role}, but no lane that allows tram leads to it")
        if not value.isascii() or not value.isdigit() or len(value) > MOST_DIGITS:
            raise NetError(
                f"{net.path}: junction {junction!r}: garage.{role} is {shown(value)}; a whole number is valid"
            )
        first = ranked[role].setdefault(int(value), junction)
        if first != junction:
            raise NetError(
                f"{net.path}: junctions {first!r} and {junction!r} are both {role} number {int(value)}:"
                " a net holds one garage, and each of its places has a number of its own"
            )
    return {role: [junction for _, junction in sorted(rows.items())] for role, rows in ranked.items()}


def _stations(extra: AdditionalFile, net: NetFile, edge_of: Mapping[str, EdgeIndex]) -> dict[EdgeIndex, str]:
    """By edge the chargingStation that covers the end of its lane, where an AGV stops; of several SUMO's first one."""
    lane_m = {lane.name: lane.length_m for edge in net.edges.values() for lane in edge.lanes}
    stations: dict[EdgeIndex, str] = {}
    for name, place in sorted(extra.stations.items()):
        if place.lane not in lane_m:
            raise NetError(
                f"{extra.path}: chargingStation {name!r} lies on lane {place.lane!r}, which the net doesn't have"
            )
        try:
            _, end_m = stopping_place(place.start, place.end, place.friendly, lane_m[place.lane])
        except ValueError as error:
            raise NetError(f"{extra.path}: chargingStation {name!r}: {error}") from None
        if place.lane in edge_of and end_m >= lane_m[place.lane] - POSITION_EPS_M:
            stations.setdefault(edge_of[place.lane], name)
    return stations
