"""Open traffic: customers arrive as a Poisson stream, stay for a lognormal time and ask for their own car."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from controller.types import Request, RequestKind
from demand.types import Demand, Workload, by_time, car_names, check_cars, stream

Times = NDArray[np.float64]


@dataclass(slots=True)
class Stays:
    """When each car comes and is wanted back, in seconds; the first ``initial`` cars are there from the start.

    Attributes:
        initial: number of cars already parked.
        arrive_s: arrivals, 0 for the cars already parked.
        leave_s: moments at which the cars are asked for.
    """

    initial: int
    arrive_s: Times
    leave_s: Times

    def add(self, arrive_s: Times, dwell_s: Times) -> None:
        """Add cars that arrive at these times and stay so long."""
        self.arrive_s = np.concatenate((self.arrive_s, arrive_s))
        self.leave_s = np.concatenate((self.leave_s, arrive_s + dwell_s))


class OpenTraffic(Workload):
    """What all open streams share.

    Arrivals are a homogeneous Poisson process. That dwell times are lognormal is an assumption: no openly licensed
    distribution for garages was found. A car may be asked for while it still waits to be parked; it then leaves as
    soon as it can.
    """

    arrivals_per_h: float | None = Field(
        default=None, ge=0, le=10_000, description="cars arriving an hour; give this or arrivals_share_per_h"
    )
    arrivals_share_per_h: float | None = Field(
        default=None, ge=0, le=10, description="cars arriving an hour as a share of the garage's slots"
    )
    dwell_median_min: float = Field(default=60.0, gt=0, le=1e9, description="median time a car stays, minutes")
    dwell_sigma: float = Field(
        default=0.8, ge=0, le=3, description="sigma of the lognormal dwell time; 0: every car stays equally long"
    )
    initial_occupancy: float = Field(
        default=0.5, ge=0, le=1, description="share of the slots occupied when the run starts"
    )
    duration_min: float = Field(
        default=120.0,
        gt=0,
        le=60 * 24 * 366,
        description="minutes during which requests are made, a year at most; later retrievals are dropped",
    )

    @model_validator(mode="after")
    def _one_rate(self) -> Self:
        if (self.arrivals_per_h is None) == (self.arrivals_share_per_h is None):
            raise ValueError("give either arrivals_per_h or arrivals_share_per_h")
        return self

    def rate_per_s(self, slots: int) -> float:
        """Arrivals a second in a garage with ``slots`` slots."""
        if self.arrivals_per_h is not None:
            return self.arrivals_per_h / 3600
        return (self.arrivals_share_per_h or 0.0) * slots / 3600

    def dwell_s(self, rng: np.random.Generator, count: int) -> Times:
        """Draw the stays of ``count`` cars, in seconds."""
        return rng.lognormal(np.log(60 * self.dwell_median_min), self.dwell_sigma, count)

    def stays(self, slots: int, seed: int) -> Stays:
        """Draw the stays of the initial cars and of the Poisson arrivals.

        The remaining stay of a car that is there at an arbitrary moment is a uniform share of a length-biased dwell
        time, which for a lognormal is lognormal again with ``mu + sigma**2``: so a garage that starts at the
        stream's mean occupancy stays there.
        """
        check_cars(60 * self.duration_min * self.rate_per_s(slots), "duration_min")
        initial = round(self.initial_occupancy * slots)
        rng = stream(seed, "initial")
        whole = self.dwell_s(rng, initial) * np.exp(self.dwell_sigma**2)
        stays = Stays(initial, np.zeros(initial), whole * rng.random(initial))
        arrive_s = poisson_times(stream(seed, "arrivals"), self.rate_per_s(slots), 60 * self.duration_min)
        stays.add(arrive_s, self.dwell_s(stream(seed, "dwell"), len(arrive_s)))
        return stays


class Poisson(OpenTraffic):
    """Uniform Poisson traffic."""

    kind: Literal["poisson"] = Field(default="poisson", description="a Poisson stream")

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        return demand_of(self.stays(slots, seed), 60 * self.duration_min)


def poisson_times(rng: np.random.Generator, rate_per_s: float, duration_s: float) -> Times:
    """Event times of a Poisson process.

    Args:
        rng: generator to draw from.
        rate_per_s: mean number of events a second.
        duration_s: length of the process, seconds.

    Returns:
        Ascending times within the duration, seconds.
    """
    count = rng.poisson(rate_per_s * duration_s)
    return np.sort(rng.random(count)) * duration_s


def demand_of(stays: Stays, duration_s: float, zones: list[str] | None = None) -> Demand:
    """Turn stays into requests; what would be asked after the end is dropped.

    Args:
        stays: when each car comes and goes.
        duration_s: end of the requests, seconds.
        zones: zone of each car, if they have one.

    Returns:
        Demand of one phase; initial cars are named ``p...``, arriving ones ``c...`` in order of arrival.
    """
    order = np.argsort(stays.arrive_s[stays.initial :], kind="stable") + stays.initial
    initial_cars = car_names("p", stays.initial)
    cars = dict(enumerate(initial_cars)) | dict(zip(order.tolist(), car_names("c", len(order)), strict=True))
    zone = zones if zones is not None else [""] * len(cars)
    arrive = stays.arrive_s.round(3).tolist()
    leave = stays.leave_s.round(3).tolist()
    parks = [Request(arrive[i], RequestKind.PARK, cars[i], zone[i]) for i in order.tolist() if arrive[i] <= duration_s]
    retrievals = [Request(leave[i], RequestKind.RETRIEVE, cars[i], zone[i]) for i in cars if leave[i] <= duration_s]
    return Demand(initial_cars, (by_time(parks + retrievals),))
