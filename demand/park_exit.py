"""Park every car, then bring every car back: the workload of the papers."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from controller.types import Request, RequestKind
from demand.types import Demand, Workload, car_names, stream
from sumo_nets.errors import InputError


class ParkExit(Workload):
    """All cars want to be parked at once; when the last is parked, all are wanted back at once."""

    kind: Literal["park_exit"] = Field(default="park_exit", description="every car in, then every car out")
    cars: int | None = Field(default=None, ge=1, description="number of cars; default: as many as the garage has slots")
    order: Literal["parked", "random"] = Field(
        default="parked", description="order in which the cars are wanted back: as they came, or at random"
    )
    park_only: bool = Field(default=False, description="end when every car is parked")

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        count = slots if self.cars is None else self.cars
        if count > slots:
            raise InputError(f"workload.cars: {count}: the garage has {slots} slots, give at most that many")
        cars = car_names("car", count)
        parks = tuple(Request(0.0, RequestKind.PARK, car) for car in cars)
        if self.park_only:
            return Demand((), (parks,))
        if self.order == "random":
            cars = tuple(cars[i] for i in stream(seed, "order").permutation(count))
        return Demand((), (parks, tuple(Request(0.0, RequestKind.RETRIEVE, car) for car in cars)))
