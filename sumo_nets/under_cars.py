"""Whether an empty AGV gets out from under the car that it has set down, and in under it, without touching it.

An AGV lies under a car lengthwise. Where it turns at the aisle, its rear swings out: an AGV that is too long for the
lane into the slot is still under the car then. The check of a run measures what SUMO does
(``parking_sim/footprint.py``). This module shares the rule with it, but no code.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sumo_nets.bodies import bodies_along, gaps_m, line_m, seen_from, standing_bodies
from sumo_nets.graph import FloatArray, Graph
from sumo_nets.numbering import EdgeIndex, Vertex
from sumo_nets.read import GarageNet

#: An empty AGV is aligned with a parked car when their axes differ by this angle or less, and the AGV's end that is
#: nearer to the middle of the car is this many metres or less from the car's axis. The angle is what the bend of the
#: shipped garages' spurs needs: there the front swings out by 23 to 32 degrees, depending on the AGV's length, while
#: the rear is still under the car.
ALIGNED_DEG = 35.0
ALIGNED_ASIDE_M = 0.3
#: An AGV is looked at each time its front has come this much further.
_SAMPLE_M = 0.02
#: Lengths of AGVs are tried in such steps, down to the shortest.
_TRIED_M, _SHORTEST_M = 0.1, 1.0


@dataclass(frozen=True)
class SlotTurn:
    """An empty AGV on its way between a slot, where a car is parked, and a lane behind the slot's own.

    Attributes:
        room_m: the least room in metres between the car and the AGV while it is not aligned with the car; negative if
            they overlap.
        slot: the slot.
        beyond: the lane onto which the AGV turns, or from which it comes.
    """

    room_m: float
    slot: Vertex
    beyond: EdgeIndex


def cramped_slots(graph: Graph, agv_m: float) -> frozenset[Vertex]:
    """Slots whose lane is too short for an AGV to drive straight out from under a car before it turns.

    Args:
        graph: the garage.
        agv_m: length of an AGV.
    """
    short = set(graph.head[graph.length_m < 2 * agv_m].tolist())
    return frozenset(slot for slot in graph.slots if slot in short)


def tightest_turn(garage: GarageNet, size_m: tuple[float, float]) -> SlotTurn | None:
    """The turn at which an empty AGV comes closest to the car in its own slot.

    Args:
        garage: a garage in which each slot is a leaf.
        size_m: length and width of AGVs and cars.

    Returns:
        The turn, or None where no AGV ever gets near its car while it turns. Cramped slots don't count: AGVs turn
        under cars there.
    """
    turns = list(_turns(garage, size_m))
    return turns[int(np.argmin([turn.room_m for turn in turns]))] if turns else None


def longest_with_room_m(garage: GarageNet, size_m: tuple[float, float], room_m: float) -> float | None:
    """The length of the longest AGV that has room in each slot, in whole decimetres.

    Args:
        garage: as in :func:`tightest_turn`.
        size_m: length and width of an AGV without room; only shorter ones are tried.
        room_m: the room that is needed.

    Returns:
        The length in metres, or None if even an AGV of 1 m has no room.
    """
    for tenths in range(math.ceil(size_m[0] / _TRIED_M) - 1, round(_SHORTEST_M / _TRIED_M) - 1, -1):
        length_m = round(tenths * _TRIED_M, 1)
        tightest = tightest_turn(garage, (length_m, size_m[1]))
        if tightest is None or tightest.room_m >= room_m:
            return length_m
    return None


def _turns(garage: GarageNet, size_m: tuple[float, float]) -> Iterator[SlotTurn]:
    """Every way out of a slot and into it."""
    graph, shapes = garage.graph, garage.shapes
    cramped = cramped_slots(graph, size_m[0])
    for slot in (slot for slot in graph.slots if slot not in cramped):
        for into in graph.in_edges(slot):
            out = EdgeIndex(int(graph.reverse[into]))
            ways = [(e, (e, into)) for e in graph.in_edges(Vertex(int(graph.tail[into]))) if e != out]
            if out >= 0:
                ways += [(e, (out, e)) for e in graph.out_edges(Vertex(int(graph.tail[into]))) if e != into]
            for beyond, (first, second) in ways:
                if graph.leads_on(first, second):
                    way = seen_from(shapes[into][-1], np.concatenate([shapes[first], shapes[second]]))
                    yield SlotTurn(_room_m(way, seen_from(shapes[into][-1], shapes[into]), size_m), slot, beyond)


@lru_cache(maxsize=1 << 12)
def _room_m(way: bytes, into: bytes, size_m: tuple[float, float]) -> float:
    """Room between a car at the end of a lane and an AGV on a way, wherever the AGV is not aligned with the car."""
    line, lane = (np.frombuffer(points).reshape(-1, 2) for points in (way, into))
    car = standing_bodies([lane], size_m[0])
    agv = bodies_along(line, np.arange(size_m[0], line_m(line), _SAMPLE_M), size_m[0])
    turned = agv[~_aligned(agv, car[0], size_m[0])]
    return float(gaps_m(turned, np.repeat(car, len(turned), axis=0), size_m).min(initial=np.inf))


def _aligned(agv: FloatArray, car: FloatArray, length_m: float) -> NDArray[np.bool_]:
    """Whether the axes differ by little, and the AGV's end that is nearer to the car's middle is on the car's axis."""
    axis, across = car[2:], np.array([-car[3], car[2]])
    ends = agv[:, None, :2] + agv[:, None, 2:] * np.array([[length_m / 2], [-length_m / 2]]) - car[:2]
    inner = np.argmin(np.abs(ends @ axis), axis=1)
    aside_m = np.abs(ends @ across)[np.arange(len(agv)), inner]
    straight = np.abs(agv[:, 2:] @ axis) >= math.cos(math.radians(ALIGNED_DEG))
    aligned: NDArray[np.bool_] = straight & (aside_m <= ALIGNED_ASIDE_M)
    return aligned
