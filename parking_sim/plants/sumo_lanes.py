"""Lanes in metres, and how far an AGV has come along the lanes granted to it: no call to SUMO.

An AGV's place counts in edges and in granted vertices: edge number k ends at granted vertex k.
"""

from __future__ import annotations

import math

from parking_sim.plants.sumo_agv import AgvType
from parking_sim.plants.sumo_api import PlantError
from parking_sim.plants.sumo_clearance import rear_clearances
from sumo_nets.numbering import EdgeIndex, Numbered
from sumo_nets.read import GarageNet

#: An AGV this close to the end of its lane may have stopped there.
NEAR_END_M = 0.2


class Lanes:
    """What an AGV's progress is measured by; lists have an entry for each edge.

    Args:
        garage: the net.
        agv_type: whose body.
        length_m: length of each edge's lane, as SUMO has it.
        step_s: seconds a step lasts.

    Attributes:
        names: of the edges.
        length_m: of their lanes.
        before_m: from the centre of the tail's node to the lane's begin.
        pitch_m: from centre to centre.
        clear_m: from the tail's centre to where a rear is out of the way there.
        body_m: length of an AGV.
        reach_m: an AGV this far before its lane's end, or less, may be on the next one after a step.

    Raises:
        PlantError: an edge is too short for an AGV to stand clear of the vertex behind it.
    """

    def __init__(
        self, garage: GarageNet, agv_type: AgvType, length_m: Numbered[EdgeIndex, float], step_s: float
    ) -> None:
        graph = garage.graph
        self.names: Numbered[EdgeIndex, str] = graph.edge_names
        self.length_m, self.body_m = length_m, agv_type.length_m
        self.reach_m = max(agv_type.empty_mps, agv_type.loaded_mps) * step_s + NEAR_END_M
        self.before_m: Numbered[EdgeIndex, float] = [
            math.dist(shape[0], graph.xy[tail]) for shape, tail in zip(garage.shapes, graph.tail, strict=True)
        ]
        self.pitch_m: Numbered[EdgeIndex, float] = [
            before + lane + math.dist(shape[-1], graph.xy[head])
            for before, lane, shape, head in zip(self.before_m, length_m, garage.shapes, graph.head, strict=True)
        ]
        self.clear_m = rear_clearances(garage, agv_type, length_m, self.before_m)
        for name, before, lane, clear in zip(self.names, self.before_m, length_m, self.clear_m, strict=True):
            if before + lane - self.body_m < clear - 1e-6:
                raise PlantError(f"edge {name} is too short: an AGV that stands on it touches the vertex behind it")


class LaneProgress:
    """How far one AGV has come.

    Args:
        edge: where it stands at the start.
        lanes: their lengths.

    Attributes:
        edges: driven and granted; the first one is where it starts.
        k: its front is on edge number ``k``.
        reached: last granted vertex at which its front is or which it has passed.
        left: last granted vertex that its rear has left.
        near_end: the next step may end on another edge.
        on_junction: its front is between two edges.
    """

    __slots__ = ("_at_m", "_lanes", "_rear_m", "_road", "edges", "k", "left", "near_end", "on_junction", "reached")

    def __init__(self, edge: EdgeIndex, lanes: Lanes) -> None:
        self._lanes = lanes
        self.edges = [edge]
        self.k = self.reached = self.left = 0
        self.near_end = True
        self.on_junction = False
        self._road = lanes.names[edge]
        self._at_m = [0.0]  # metres from the start vertex to each granted vertex, along the way
        # where the rear is on that scale when the lane position is 0: the lane begins one pitch before the start vertex
        self._rear_m = lanes.before_m[edge] - lanes.pitch_m[edge] - lanes.body_m

    def grant(self, edge: EdgeIndex) -> None:
        """One edge more."""
        self.edges.append(edge)
        self._at_m.append(self._at_m[-1] + self._lanes.pitch_m[edge])

    def enter(self, road: str) -> bool:
        """Move the front's edge up to where SUMO says it is; False on a junction, between two edges."""
        self.on_junction = road[0] == ":"
        if self.on_junction:
            self.reached = self.k
            return False
        if road != self._road:
            while self._road != road:
                self.k += 1
                self._road = self._lanes.names[self.edges[self.k]]
            self.reached = self.k - 1
            self._rear_m = self._at_m[self.k - 1] + self._lanes.before_m[self.edges[self.k]] - self._lanes.body_m
        return True

    def drive(self, position_m: float) -> None:
        """Free the vertices that the rear has left, and see whether the next step may end on another edge."""
        lanes, edges = self._lanes, self.edges
        self.near_end = position_m + lanes.reach_m >= lanes.length_m[edges[self.k]]
        rear = self._rear_m + position_m + 1e-6
        while self.left < self.k and rear >= self._at_m[self.left] + lanes.clear_m[edges[self.left + 1]]:
            self.left += 1

    def at_end(self, position_m: float) -> bool:
        """Its front is where it stops on its edge, or nearly."""
        return position_m >= self._lanes.length_m[self.edges[self.k]] - NEAR_END_M
