"""How far an AGV's rear must have driven on before the vertex behind it is free for others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.bodies import clear_of_entering
from sumo_nets.graph import FloatArray
from sumo_nets.read import GarageNet

#: Room beside a body that crosses behind the rear.
REAR_MARGIN_M = 0.05


def rear_clearances(
    garage: GarageNet, agv_type: AgvType, lane_m: Sequence[float], before_m: Sequence[float]
) -> list[float]:
    """For each edge how far a rear must be from its tail vertex to be out of everybody's way there.

    Half a body's width, and on a spur with a bend the whole slanted part: two slots share one vertex, and the body of
    an AGV that leaves one swings over the roots of both. On lanes beside such a spur as far as bodies swing that come
    out of it.

    Args:
        garage: the garage.
        agv_type: whose body.
        lane_m: length of each edge's lane.
        before_m: from the centre of each edge's tail to the lane's begin.

    Returns:
        Metres from the centre of the tail vertex, by edge.
    """
    graph = garage.graph
    spurs_into: dict[int, list[int]] = {}
    for f, head in enumerate(graph.head.tolist()):
        if len(garage.shapes[f]) > 2:
            spurs_into.setdefault(head, []).append(f)
    known: dict[bytes, float] = {}  # garages repeat a few shapes
    clear = []
    for e, (tail, head) in enumerate(zip(graph.tail.tolist(), graph.head.tolist(), strict=True)):
        least = _alone(garage.shapes[e], before_m[e], lane_m[e], agv_type)
        here = graph.xy[tail]
        spurs = [garage.shapes[f] - here for f in spurs_into.get(tail, ()) if graph.tail[f] != head]
        leaving = np.vstack((np.zeros(2), garage.shapes[e] - here))
        clear.append(_beside_spurs(spurs, leaving, least, known) if spurs else least)
    return clear


def _alone(shape: FloatArray, before_m: float, lane_m: float, agv_type: AgvType) -> float:
    along = np.cumsum(np.hypot(*np.diff(shape, axis=0).T))[:-1] + before_m
    room = before_m + lane_m - agv_type.length_m
    return max([agv_type.width_m / 2 + REAR_MARGIN_M, *(float(bend) for bend in along if bend <= room)])


def _beside_spurs(spurs: list[FloatArray], leaving: FloatArray, least_m: float, known: dict[bytes, float]) -> float:
    key = b"|".join(np.round(line, 2).tobytes() for line in (leaving, *spurs, np.array([[least_m, 0.0]])))
    if key not in known:
        known[key] = clear_of_entering(spurs, leaving, least_m)
    return known[key]
