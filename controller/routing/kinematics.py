"""The fork AGV as a path-tracking vehicle, and whether it can drive a floor's turns (Do et al. 2010, section 2.1).

One wheel at the front steers and drives; two wheels at the rear follow. The reference point is the middle between the
rear wheels. With the steering angle d, the distance l from it to the drive wheel and the drive wheel's speed v_d, the
drive wheel is h = l / sin d from the centre of rotation and v = v_d cos d is the speed of the reference point.

Departures from the paper: its equation (2) gives v_d / h the name of the steering rate; it is the rate of the heading,
as its own equation (3) says. Whether a turn fits an aisle is ours: the paper stops at the equations of motion.
Limits: the steering angle is taken to change at once where an arc begins.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_nets.graph import FloatArray, Graph
from sumo_nets.numbering import Vertex, numbered

#: Bends below this many degrees count as straight on.
STRAIGHT_DEG = 1.0


@dataclass(frozen=True, slots=True)
class ForkAgv:
    """A fork AGV; the defaults are those of a counterbalanced pallet truck (the paper gives no dimensions).

    Attributes:
        l: metres from the rear wheels to the drive wheel (the paper: the body's length without the fork).
        steer_deg: largest steering angle to either side, degrees, above 0 and at most 90.
        front_m: body ahead of the rear wheels, metres.
        rear_m: fork and load behind the rear wheels, metres.
        width_m: width of body and load, metres.
    """

    l: float = 1.4  # noqa: E741  the paper's symbol
    steer_deg: float = 75.0
    front_m: float = 1.7
    rear_m: float = 1.2
    width_m: float = 1.0

    @property
    def least_radius_m(self) -> float:
        """Radius of the tightest circle of the reference point, l / tan d."""
        return 0.0 if self.steer_deg >= 90.0 else self.l / math.tan(math.radians(self.steer_deg))

    def swept_radii_m(self, radius_m: float) -> tuple[float, float]:
        """Inner and outer radius of the ring that the body sweeps on a circle of this radius.

        The inner one is 0 if the centre lies under the body.
        """
        half = self.width_m / 2
        return max(0.0, radius_m - half), math.hypot(radius_m + half, max(self.front_m, self.rear_m))

    def swept_width_m(self, radius_m: float) -> float:
        """Width of that ring in metres."""
        inner, outer = self.swept_radii_m(radius_m)
        return outer - inner

    def aisle_width_m(self, radius_m: float, bend_deg: float) -> float:
        """Least width of two aisles with which their bend can be driven on an arc of this radius, in metres.

        The arc joins the centre lines. The ring must reach neither the outer walls nor the corner between the aisles.
        """
        inner, outer = self.swept_radii_m(radius_m)
        to_walls = 2 * (outer - radius_m)
        to_corner = 2 * (radius_m - inner * math.cos(math.radians(bend_deg) / 2))
        return max(to_walls, to_corner, self.width_m)


def icr_distance_m(l: float, delta: float) -> float:  # noqa: E741
    """Equation (1), h = l / sin d: metres from the drive wheel to the centre of rotation, infinite straight on."""
    return math.inf if delta == 0 else l / math.sin(delta)


def rates(l: float, theta: float, v_d: float, delta: float) -> tuple[float, float, float]:  # noqa: E741
    """Equation (3): how fast x, y (m/s) and the heading (rad/s) of the reference point change.

    Args:
        l: metres between rear wheels and drive wheel.
        theta: heading in radians.
        v_d: speed of the drive wheel, m/s.
        delta: its steering angle in radians, positive to the left.

    Returns:
        v cos t, v sin t and v_d sin d / l, with v = v_d cos d.
    """
    v = v_d * math.cos(delta)
    return v * math.cos(theta), v * math.sin(theta), v_d * math.sin(delta) / l


def drive(l: float, pose: tuple[float, float, float], v_d: FloatArray, delta: FloatArray, dt: float) -> FloatArray:  # noqa: E741
    """Follow the equations of motion, by Runge and Kutta's fourth-order steps.

    Args:
        l: metres between rear wheels and drive wheel.
        pose: x, y in metres and heading in radians at the start.
        v_d, delta: speed (m/s) and steering angle (radians) of the drive wheel in each step, shape (k,).
        dt: seconds a step lasts.

    Returns:
        Poses from the start on, shape (k + 1, 3).
    """
    poses = np.empty((len(v_d) + 1, 3))
    poses[0] = pose
    for i, (v, d) in enumerate(zip(v_d.tolist(), delta.tolist(), strict=True)):
        theta = float(poses[i, 2])
        omega = rates(l, theta, v, d)[2]  # constant within the step, so three headings are all there is to evaluate
        k = [np.array(rates(l, theta + f * dt * omega, v, d)) for f in (0.0, 0.5, 1.0)]
        poses[i + 1] = poses[i] + dt / 6 * (k[0] + 4 * k[1] + k[2])
    return poses


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn on a floor and whether it can be driven.

    Attributes:
        vertices: the vertex before, the one of the turn, and the one after.
        bend_deg: change of heading, degrees.
        radius_m: the widest arc for which both edges leave room.
        drivable: the AGV can steer that arc, and some arc it can steer and has room for keeps clear of the walls.
    """

    vertices: tuple[Vertex, Vertex, Vertex]
    bend_deg: float
    radius_m: float
    drivable: bool


def check_turns(graph: Graph, agv: ForkAgv, aisle_m: float) -> Iterator[Turn]:
    """Every turn that the lanes of a floor allow.

    Reversals are no turns: the AGV leaves a loading node the way it came. An arc takes at most half of an edge at
    either end, and all of one that ends at a dead end, so that arcs don't overlap.

    Args:
        graph: the floor.
        agv: what shall drive there.
        aisle_m: clear width of its aisles, metres.

    Yields:
        One turn for each edge and next edge whose bend is neither straight on nor a fold.
    """
    room = graph.length_m * np.where(_ends_dead(graph), 1.0, 0.5)
    for e, (u, v) in numbered(graph.ends):
        for f in graph.out_edges(v):
            bend = graph.bend_deg(e, f)
            if f == graph.reverse[e] or bend <= STRAIGHT_DEG or not graph.leads_on(e, f):
                continue
            widest = float(min(room[e], room[f])) / math.tan(math.radians(bend) / 2)
            vertices = (u, v, graph.ends[f][1])
            yield Turn(vertices, bend, widest, widest >= agv.least_radius_m and _fits(agv, widest, bend, aisle_m))


def _fits(agv: ForkAgv, widest_m: float, bend_deg: float, aisle_m: float) -> bool:
    """Whether some arc between the tightest and the widest one fits the aisle, looked for in 64 steps."""
    radii = np.linspace(agv.least_radius_m, widest_m, 65).tolist()
    return any(agv.aisle_width_m(radius, bend_deg) <= aisle_m for radius in radii)


def _ends_dead(graph: Graph) -> NDArray[np.bool_]:
    """For each edge whether one of its ends has no other neighbour."""
    ends = np.stack((graph.tail, graph.head), axis=1)
    pairs = np.unique(np.concatenate((ends, ends[:, ::-1])), axis=0)
    dead = np.bincount(pairs[:, 0], minlength=len(graph.names)) <= 1
    return np.asarray(dead[graph.tail] | dead[graph.head])
