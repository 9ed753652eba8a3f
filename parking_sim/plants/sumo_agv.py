"""What an AGV can do, and how long its moves take in SUMO.

Defaults follow published figures of parking robots where there are any (driving 1.2 to 1.5 m/s, lifting within 20 s,
charging in an idle hour); accelerations, turning rates and the battery are assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controller.types import Motion, make_motion, whole_steps
from sumo_nets.graph import Graph

#: Below this many degrees a bend is driven through without stopping.
SMALL_BEND_DEG = 15.0


@dataclass(frozen=True, slots=True)
class AgvType:
    """An AGV: a path-tracking carrier that drives either way and turns in place.

    Attributes:
        empty_mps, loaded_mps: driving speed in metres a second.
        empty_accel, loaded_accel: acceleration in m/s^2.
        braking: deceleration in m/s^2, empty and loaded.
        empty_turn_dps, loaded_turn_dps: turning in place, degrees a second.
        lift_s, lower_s: seconds to lift and to lower a car.
        length_m, width_m: the body, with or without a car on it.
        empty_kg, car_kg: mass of the AGV and of the car it carries.
        idle_w: power that electronics draw all the time, in watts.
        battery_wh: capacity; the default lasts about 8 hours of driving, half of it loaded.
        charge_w: charging power in watts; with the default 30 % to 90 % takes about 45 minutes.
    """

    empty_mps: float = 1.5
    loaded_mps: float = 1.0
    empty_accel: float = 0.5
    loaded_accel: float = 0.3
    braking: float = 0.8
    empty_turn_dps: float = 30.0
    loaded_turn_dps: float = 20.0
    lift_s: float = 20.0
    lower_s: float = 15.0
    length_m: float = 4.7
    width_m: float = 2.0
    empty_kg: float = 1500.0
    car_kg: float = 1800.0
    idle_w: float = 150.0
    battery_wh: float = 6000.0
    charge_w: float = 5000.0

    def speed_mps(self, loaded: bool) -> float:
        """Driving speed in metres a second."""
        return self.loaded_mps if loaded else self.empty_mps

    def accel(self, loaded: bool) -> float:
        """Acceleration in m/s^2."""
        return self.loaded_accel if loaded else self.empty_accel

    def rotation_s(self, angle_deg: float, loaded: bool) -> float:
        """Seconds to rotate in place; a bend below ``SMALL_BEND_DEG`` and a reversal (180) rotate nothing."""
        if angle_deg < SMALL_BEND_DEG or angle_deg >= 180.0:
            return 0.0
        return angle_deg / (self.loaded_turn_dps if loaded else self.empty_turn_dps)

    def stop_and_go_s(self, loaded: bool) -> float:
        """Seconds that braking to a stop and starting again cost against driving through."""
        speed = self.speed_mps(loaded)
        return speed / (2 * self.accel(loaded)) + speed / (2 * self.braking)


def sumo_motion(graph: Graph, agv_type: AgvType, step_s: float) -> Motion:
    """How long moves take in SUMO, in steps.

    A run at full speed takes length / speed; no AGV drives faster than a lane's limit. A turn adds its rotation and the
    stop before it. A reversal adds a stop but spares the body's length: the AGV's back becomes its front, and that is
    where the way on is counted from. It is at least 1 step, which says that the AGV has to stand first. Executed moves
    take 0 to 5 % less than planned: rounding up to whole steps, and 2 to 3 s less than planned for a reversal.

    Args:
        graph: the garage; a move goes from centre to centre of its vertices, lengths being those of lanes.
        agv_type: the AGV.
        step_s: seconds a step lasts.

    Returns:
        The tables of the planner, without following: the body needs both vertices while it drives.
    """

    def steps(seconds: float) -> int:
        return whole_steps(seconds, step_s)

    def drive(length_m: float, limit_mps: float, loaded: bool) -> int:
        return max(1, steps(length_m / min(agv_type.speed_mps(loaded), limit_mps)))

    def rotation(angle_deg: float, loaded: bool) -> int:
        return steps(agv_type.rotation_s(angle_deg, loaded))

    def turn(angle_deg: float, loaded: bool) -> int:
        if angle_deg < SMALL_BEND_DEG:
            return 0
        stop = steps(agv_type.stop_and_go_s(loaded))
        if angle_deg >= 180.0:
            return max(1, stop - steps(agv_type.length_m / agv_type.speed_mps(loaded)))
        return stop + rotation(angle_deg, loaded)

    between_m = np.hypot(*(graph.xy[graph.head] - graph.xy[graph.tail]).T)
    ways_m = np.maximum(graph.length_m, between_m).tolist()
    driving = [
        [drive(way_m, limit, loaded) for way_m, limit in zip(ways_m, graph.limit_mps.tolist(), strict=True)]
        for loaded in (False, True)
    ]
    turns = make_motion(graph, step_s, lambda *_: 1, turn, following=False, rotation_steps=rotation)
    return replace(turns, edge_steps=np.array(driving, dtype=np.int32))
