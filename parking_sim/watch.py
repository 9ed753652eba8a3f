"""Hands the bodies of a run to the footprint check, and makes events of what the check finds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from controller.events import Event
from controller.garage import Garage
from parking_sim.footprint import Bodies, Clearance, FootprintCheck
from sumo_nets.numbering import numbered
from sumo_nets.read import GarageNet
from sumo_nets.under_cars import cramped_slots


class FootprintWatch:
    """The footprint check of one run.

    Args:
        net: the garage's net.
        garage: its books; the cars that are parked already are known to the check from the start.
        length_m, width_m: of an AGV, metres.
    """

    def __init__(self, net: GarageNet, garage: Garage, length_m: float, width_m: float) -> None:
        self._check = FootprintCheck()
        self._slots = garage.slot_of
        self._cramped = cramped_slots(net.graph, length_m)
        self._overlaps = self._turns = 0
        self._park_initial(net, garage, length_m, width_m)

    def _park_initial(self, net: GarageNet, garage: Garage, length_m: float, width_m: float) -> None:
        """Tell the check of the cars that are parked before the run starts."""
        into = {v: e for e, (_, v) in numbered(net.graph.ends)}
        slots = garage.parked.values()
        ends = np.array([net.shapes[into[slot]][-2:] for slot in slots]).reshape(-1, 2, 2)
        (x, y), (dx, dy) = ends[:, 1].T, (ends[:, 1] - ends[:, 0]).T
        many = np.ones(len(x))
        bodies = Bodies(x, y, np.arctan2(dy, dx), many * length_m, many * width_m, many > 0)
        self._check.standing(list(garage.parked), bodies, [slot in self._cramped for slot in slots])

    def note(self, event: Event) -> None:
        """Take note of a car that is lifted or lowered; other events are none of its business."""
        if event.kind == "lift":
            self._check.lifted(event.car)
        elif event.kind == "lower" and event.vertex in self._slots:
            self._check.lowered(event.car, event.agv, event.vertex in self._cramped)

    def step(self, now_s: float, bodies: Bodies) -> Iterator[Event]:
        """Look at one step.

        Args:
            now_s: simulated seconds.
            bodies: the AGVs.

        Yields:
            An event for each overlap, and for each turn under a car, that has begun.
        """
        check = self._check
        check.step(now_s, bodies)
        for near in check.events[self._overlaps :]:
            detail = {"others": [near.other], "clearance_m": near.clear_m}
            yield Event("overlap", near.agv, detail=detail)
        for near in check.turns[self._turns :]:
            yield Event("turn_under_car", near.agv, str(near.other))
        self._overlaps, self._turns = len(check.events), len(check.turns)

    def result(self) -> Clearance:
        """What the check has found so far."""
        return self._check.result()
