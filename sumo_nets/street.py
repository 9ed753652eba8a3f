"""The public street of a garage, and where customers' cars stand at each bay."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sumo_nets.errors import NetError
from sumo_nets.graph import Graph
from sumo_nets.net_files import AdditionalFile, Lane, NetFile
from sumo_nets.numbering import Vertex
from sumo_nets.sumo_rules import stopping_place

#: Where the first waiting car's front stands, before the end of the hold lane.
HOLD_BEFORE_END_M = 1.0
#: The entry and the queue edge hold at least one waiting car each.
MIN_PART_M = 7.5
_PARTS = ("entry", "queue", "exit")


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


def read_street(net: NetFile, extra: AdditionalFile, graph: Graph) -> tuple[Street | None, dict[Vertex, BaySite]]:
    """Find the street and the bays' places along it.

    Args:
        net, extra: the garage's files.
        graph: what AGVs drive on.

    Returns:
        The street and a site for each bay, by the bay's vertex and in the order of ``graph.bays``; None and no sites
        if no parkingArea belongs to a bay, so that hand-over is at home.

    Raises:
        NetError: a part or a place is missing, given twice, too small, or can't be reached.
    """
    areas = _areas(extra)
    if not areas:
        stray = sorted(set(graph.bays) - set(graph.homes))
        if stray:
            raise NetError(
                f"{net.path}: bay {graph.names[stray[0]]!r} has no parkingArea with garage.bay, and is no home either"
            )
        return None, {}
    roads = _roads(net)
    street = _street(net, roads)
    sites: dict[Vertex, BaySite] = {}
    for vertex in graph.bays:
        for use in ("in", "out"):
            if (graph.names[vertex], use) not in areas:
                raise NetError(f"{net.path}: bay {graph.names[vertex]!r} has no parkingArea with garage.use {use!r}")
        in_area, out_area = (areas[graph.names[vertex], use] for use in ("in", "out"))
        in_edge, out_edge = (_area_edge(extra, area, roads, street) for area in (in_area, out_area))
        sites[vertex] = BaySite(
            in_area,
            out_area,
            roads.route(street.queue_edge, in_edge) + roads.route(in_edge, street.exit_edge)[1:],
            roads.route(out_edge, street.exit_edge),
        )
    return street, sites


@dataclass(frozen=True)
class _Roads:
    """What customers' cars may drive on: the lanes by id, each edge's lanes, and the edges that each edge leads to."""

    source: Path
    lanes: Mapping[str, Lane]
    of_edge: Mapping[str, list[Lane]]
    onward: Mapping[str, list[str]]

    def route(self, start: str, goal: str) -> tuple[str, ...]:
        """Shortest chain of edges, both ends included."""
        came_from: dict[str, str] = {start: ""}
        queue = deque([start])
        while queue and goal not in came_from:
            here = queue.popleft()
            for there in self.onward[here]:
                if there not in came_from:
                    came_from[there] = here
                    queue.append(there)
        if goal not in came_from:
            raise NetError(f"{self.source}: the street leads nowhere from {start!r} to {goal!r}")
        route = [goal]
        while came_from[route[-1]]:
            route.append(came_from[route[-1]])
        return tuple(reversed(route))


def _roads(net: NetFile) -> _Roads:
    of_edge = net.open_to("passenger")
    lanes = {lane.name: lane for usable in of_edge.values() for lane in usable}
    onward: dict[str, list[str]] = {edge: [] for edge in of_edge}
    for a, b in sorted(net.connected("passenger")):
        if a in lanes and b in lanes:
            onward[lanes[a].edge].append(lanes[b].edge)
    return _Roads(net.path, lanes, of_edge, onward)


def _areas(extra: AdditionalFile) -> dict[tuple[str, str], str]:
    """Ids of parkingAreas by bay and use."""
    areas: dict[tuple[str, str], str] = {}
    for name, area in extra.areas.items():
        if area.bay and areas.setdefault((area.bay, area.use), name) != name:
            first = areas[area.bay, area.use]
            raise NetError(
                f"{extra.path}: parkingAreas {first!r} and {name!r} are both for bay {area.bay!r}, use {area.use!r}"
            )
    return areas


def _street(net: NetFile, roads: _Roads) -> Street:
    parts: dict[str, str] = {}
    for name in roads.of_edge:
        part = net.edges[name].street
        if part and parts.setdefault(part, name) != name and part in _PARTS:
            raise NetError(
                f"{net.path}: edges {parts[part]!r} and {name!r} both have the parameter garage.street={part}:"
                " a net holds one garage"
            )
    for part in _PARTS:
        if part not in parts:
            raise NetError(f"{net.path}: no edge that allows passenger has the parameter garage.street={part}")
    entry, queue, exit_ = (parts[part] for part in _PARTS)
    for name in (entry, queue):
        lane = roads.of_edge[name][0]
        if lane.index > 0:
            raise NetError(f"{net.path}: edge {name!r}: cars wait on its lane 0, which doesn't allow passenger")
        if lane.length_m < MIN_PART_M:
            raise NetError(f"{net.path}: edge {name!r} is {lane.length_m:.2f} m long; {MIN_PART_M} m or more are valid")
    if queue not in roads.onward[entry]:
        raise NetError(f"{net.path}: no connection leads cars from {entry!r} to {queue!r}")
    entry_m, queue_m = (roads.of_edge[name][0].length_m for name in (entry, queue))
    return Street(entry, queue, exit_, queue_m - HOLD_BEFORE_END_M, entry_m, queue_m)


def _area_edge(extra: AdditionalFile, name: str, roads: _Roads, street: Street) -> str:
    """The street edge that a bay's place lies on."""
    area = extra.areas[name]
    source = f"{extra.path}: parkingArea {name!r}"
    lane = roads.lanes.get(area.lane)
    if lane is None:
        raise NetError(f"{source} lies on lane {area.lane!r}, which is no lane of the net that allows passenger")
    if area.capacity < 1:
        raise NetError(f"{source} holds no car; a roadsideCapacity of 1 or more is valid")
    if lane.edge in (street.entry_edge, street.queue_edge):
        raise NetError(f"{source} lies on edge {lane.edge!r}, where cars wait; a place behind the queue edge is valid")
    try:
        stopping_place(area.start, area.end, area.friendly, lane.length_m)
    except ValueError as error:
        raise NetError(f"{source}: {error}") from None
    return lane.edge
