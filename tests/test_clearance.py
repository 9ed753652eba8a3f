"""When a vertex is free for others: bodies as polygons, against those who drive in."""

import math

import numpy as np
import pytest
from shapely import LineString, Polygon

from parking_sim.config import load_scenario
from parking_sim.plants.sumo_agv import AgvType
from parking_sim.plants.sumo_clearance import rear_clearances
from sumo_nets.doors import one_door_each
from sumo_nets.read import read_net

BODY = AgvType()


def body(way, rear_m):
    """The rectangle of an AGV whose rear and front are on a line."""
    rear, front = (np.array(way.interpolate(at).coords[0]) for at in (rear_m, rear_m + BODY.length_m))
    ahead = (front - rear) / math.dist(rear, front)
    back, side = front - BODY.length_m * ahead, np.array([-ahead[1], ahead[0]]) * BODY.width_m / 2
    return Polygon([front + side, front - side, back - side, back + side])


@pytest.mark.parametrize("name", ["map1", "map2"])
def test_who_drives_out_of_a_spur_does_not_touch_who_has_left_its_root(name):
    garage = one_door_each(read_net(load_scenario(name, {}).garage_source))
    graph = garage.graph
    before = [math.dist(shape[0], graph.xy[v]) for shape, v in zip(garage.shapes, graph.tail, strict=True)]
    lanes = [LineString(shape) for shape in garage.shapes]
    clear = rear_clearances(garage, BODY, [lane.length for lane in lanes], before)
    needed = 0
    for e in range(0, len(graph.head), 7):
        v = graph.tail[e]
        way = LineString([graph.xy[v], *garage.shapes[e]])
        into = [f for f in range(len(graph.head)) if graph.head[f] == v and graph.tail[f] != graph.head[e]]
        swept = [body(lanes[f], at) for f in into for at in np.arange(0.0, lanes[f].length - BODY.length_m, 0.11)]
        assert not any(body(way, clear[e]).intersects(other) for other in swept)
        needed += any(body(way, BODY.width_m / 2 + 0.05).intersects(other) for other in swept)
    assert needed > 0
