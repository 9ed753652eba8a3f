"""When a vertex is free for others: bodies as polygons, against those who drive in."""

import math

import clearances
import numpy as np
import pytest
from shapely import LineString, Polygon

from parking_sim.config import load_scenario
from parking_sim.plants.sumo_agv import AgvType
from parking_sim.plants.sumo_clearance import rear_clearances
from sumo_nets.doors import one_door_each
from sumo_nets.read import read_net


def body(kind, way, rear_m):
    """The rectangle of an AGV whose rear and front are on a line."""
    rear, front = (np.array(way.interpolate(at).coords[0]) for at in (rear_m, rear_m + kind.length_m))
    ahead = (front - rear) / math.dist(rear, front)
    back, side = front - kind.length_m * ahead, np.array([-ahead[1], ahead[0]]) * kind.width_m / 2
    return Polygon([front + side, front - side, back - side, back + side])


def ways_past(graph, shapes, e):
    """Each way into the vertex that an edge leaves, and on by another edge; none folds back or uses the same lane."""
    v, ahead = graph.tail[e], graph.head[e]
    out = [g for g in range(graph.first_out[v], graph.first_out[v + 1]) if g != e]
    for f in range(len(graph.head)):
        if graph.head[f] == v and graph.tail[f] != ahead:
            yield LineString(shapes[f])
            came = shapes[f][-1] - shapes[f][-2]
            for g in out:
                on = shapes[g][1] - shapes[g][0]
                if graph.head[g] != graph.tail[f] and came @ on > -0.9 * math.hypot(*came) * math.hypot(*on):
                    yield LineString([*shapes[f], *shapes[g]])


SMALL = AgvType(length_m=4.2, width_m=1.7)


@pytest.mark.parametrize(
    ("name", "every", "kind"), [("map1", 7, AgvType()), ("map1", 7, SMALL), ("map2", 61, AgvType())]
)
def test_nobody_who_drives_past_a_vertex_touches_who_has_left_it(name, every, kind):
    garage = one_door_each(read_net(load_scenario(name, {}).garage_source))
    graph = garage.graph
    before = [math.dist(shape[0], graph.xy[v]) for shape, v in zip(garage.shapes, graph.tail, strict=True)]
    clear = rear_clearances(garage, kind, [LineString(shape).length for shape in garage.shapes], before)
    needed = 0
    for e in range(0, len(graph.head), every):
        own = LineString([graph.xy[graph.tail[e]], *garage.shapes[e]])
        ways = ways_past(graph, garage.shapes, e)
        swept = [body(kind, way, at) for way in ways for at in np.arange(0.0, way.length - kind.length_m, 0.11)]
        assert not any(body(kind, own, clear[e]).intersects(other) for other in swept)
        needed += any(body(kind, own, kind.width_m / 2 + 0.05).intersects(other) for other in swept)
    assert needed > 0


def test_the_least_room_is_the_same_by_the_check_and_from_sumos_floating_car_data():
    """Two witnesses that share no line: five centimetres, with faults, parked cars and customers on the street."""
    found = clearances.run_clearances({"garage": "map1", "agvs": 6, "planner": "whca", "minutes": 2.0})
    assert found["overlaps"] == 0
    assert found["in_run_m"] < clearances.REACH_M
    assert abs(found["in_run_m"] - found["fcd_m"]) < 0.05
