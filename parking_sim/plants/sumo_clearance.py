"""How far an AGV's rear must have driven on before the vertex behind it is free for others."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.bodies import clear_of_ways, ways_past
from sumo_nets.graph import FloatArray
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered
from sumo_nets.read import GarageNet

#: Room beside a body that crosses behind the rear.
REAR_MARGIN_M = 0.05


def rear_clearances(
    garage: GarageNet, agv_type: AgvType, lane_m: Numbered[EdgeIndex, float], before_m: Numbered[EdgeIndex, float]
) -> Numbered[EdgeIndex, float]:
    """For each edge how far a rear must be from its tail vertex to be out of everybody's way there.

    Half a body's width, and on a spur with a bend the whole slanted part: two slots share one vertex, and the body of
    an AGV that leaves one swings over the roots of both. Farther where bodies swing that come out of a spur beside
    the edge or turn at the vertex.

    Args:
        garage: the garage.
        agv_type: whose body.
        lane_m: length of each edge's lane.
        before_m: from the centre of each edge's tail to the lane's begin.

    Returns:
        Metres from the centre of the tail vertex, by edge.
    """
    graph = garage.graph
    into: Numbered[Vertex, list[EdgeIndex]] = [[] for _ in graph.names]
    for f, (_, head) in numbered(graph.ends):
        into[head].append(f)
    clear = []
    for e, (tail, head) in numbered(graph.ends):
        here = graph.xy[tail]
        own = _line(np.vstack((here, garage.shapes[e])), here)
        entering = tuple(_line(garage.shapes[f], here) for f in into[tail] if graph.tail[f] != head)
        leaving = tuple(_line(garage.shapes[g], here) for g in graph.out_edges(tail) if g != e)
        least = _alone(garage.shapes[e], before_m[e], lane_m[e], agv_type)
        clear.append(_clear_m(own, entering, leaving, least, (agv_type.length_m, agv_type.width_m)))
    return clear


def _line(shape: FloatArray, here: FloatArray) -> bytes:
    """A centre line as seen from a vertex, to the centimetre."""
    return np.round(shape - here, 2).tobytes()


@lru_cache(maxsize=1 << 12)
def _clear_m(
    own: bytes, entering: tuple[bytes, ...], leaving: tuple[bytes, ...], least_m: float, size_m: tuple[float, float]
) -> float:
    """Garages repeat a few shapes, and sweeps a few garages."""
    lines = [[np.frombuffer(line).reshape(-1, 2) for line in group] for group in ((own,), entering, leaving)]
    return clear_of_ways(ways_past(lines[1], lines[2]), lines[0][0], least_m, size_m)


def _alone(shape: FloatArray, before_m: float, lane_m: float, agv_type: AgvType) -> float:
    along = np.cumsum(np.hypot(*np.diff(shape, axis=0).T))[:-1] + before_m
    room = before_m + lane_m - agv_type.length_m
    return max([agv_type.width_m / 2 + REAR_MARGIN_M, *(float(bend) for bend in along if bend <= room)])
