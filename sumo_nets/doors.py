"""One door for each slot, where AGVs have bodies.

On the thesis grids a slot may have several neighbours, and an empty one may be passed. In SUMO an AGV and the car it
leaves stand on the lane by which they came, so a car can only be fetched through the lane by which it was brought. Each
slot therefore keeps one lane in and out, and slots are not passed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sumo_nets.graph import Graph
from sumo_nets.numbering import EdgeIndex, Vertex, numbered
from sumo_nets.read import GarageNet


def one_door_each(net: GarageNet) -> GarageNet:
    """The same garage in which every slot is a leaf.

    Args:
        net: a garage.

    Returns:
        The garage itself if its slots are leaves already. Otherwise one in which each slot keeps the lanes to the
        neighbour with the lowest index that is no slot.

    Raises:
        ValueError: a slot has no neighbour but slots.
    """
    graph = net.graph
    slots = set(graph.slots)
    door: dict[Vertex, Vertex] = {}
    for slot in graph.slots:
        around = [v for v in graph.successors[slot] if v not in slots]
        if not around:
            raise ValueError(f"slot {graph.names[slot]} of {net.name} can only be reached through other slots")
        door[slot] = min(around)
    kept = [e for e, (u, v) in numbered(graph.ends) if door.get(u, v) == v and door.get(v, u) == u]
    if len(kept) == len(graph.tail):
        return net
    position = {e: EdgeIndex(i) for i, e in enumerate(kept)}
    index = np.array(kept)
    smaller = Graph(
        graph.name,
        graph.names,
        graph.xy,
        graph.tail[index],
        graph.head[index],
        graph.length_m[index],
        tuple(graph.edge_names[e] for e in kept),
        graph.roles,
    )
    stations = {position[e]: s for e, s in net.charging_station_of_edge.items() if e in position}
    return replace(
        net,
        graph=smaller,
        shapes=tuple(net.shapes[e] for e in kept),
        bidi=net.bidi[index],
        charging_station_of_edge=stations,
    )
