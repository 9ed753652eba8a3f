"""One door for each slot, where AGVs have bodies.

On the thesis grids a slot may have several neighbours, and an empty one may be passed. In SUMO an AGV and the car it
leaves stand on the lane by which they came, so a car can only be fetched through the lane by which it was brought. Each
slot therefore keeps one lane in and out, and slots are not passed.
"""

from __future__ import annotations

from dataclasses import replace

from sumo_nets.graph import Graph
from sumo_nets.numbering import EdgeIndex, Vertex, numbered
from sumo_nets.read import GarageNet


def one_door_each(net: GarageNet) -> GarageNet:
    """The same garage in which every slot is a leaf.

    Args:
        net: a garage.

    Returns:
        The garage itself if its slots are leaves already. Otherwise one in which each slot keeps the lanes to the
        neighbour with the lowest index that is no slot, and a slot without such a neighbour has no lanes at all:
        :func:`sumo_nets.check.check_net` names it.
    """
    graph = net.graph
    kept = lanes_by_doors(graph)
    if len(kept) == len(graph.tail):
        return net
    stations = net.charging_station_of_edge
    return replace(
        net,
        graph=graph.with_edges(kept),
        shapes=tuple(net.shapes[e] for e in kept),
        bidi=net.bidi[kept],
        charging_station_of_edge={EdgeIndex(i): stations[e] for i, e in enumerate(kept) if e in stations},
    )


def lanes_by_doors(graph: Graph) -> list[EdgeIndex]:
    """The lanes that are left when each slot keeps only those to its door and back."""
    door = doors(graph)
    return [e for e, (u, v) in numbered(graph.ends) if door.get(u, v) == v and door.get(v, u) == u]


def doors(graph: Graph) -> dict[Vertex, Vertex]:
    """By slot the neighbour through which it is entered and left: the one with the lowest index that is no slot.

    A slot without a two-way lane to such a neighbour has itself for a door: it is cut off.
    """
    slots = set(graph.slots)
    door = {}
    for slot in graph.slots:
        both_ways = (v for v in graph.successors[slot] if v not in slots and (v, slot) in graph.edge_index)
        door[slot] = min(both_ways, default=slot)
    return door
