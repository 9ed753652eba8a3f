"""Poisson traffic with bursts: the end of a film, the start of a shift."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from demand.poisson import OpenTraffic, Stays, Times, demand_of
from demand.types import Demand, check_cars, stream


class Burst(BaseModel):
    """Many customers at once."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    at_min: float = Field(ge=0, le=1e9, description="start of the burst, minutes from the start of the run")
    cars: int = Field(
        ge=1, le=1_000_000, description="number of cars; a retrieve burst takes at most those that are there"
    )
    spread_min: float = Field(default=5.0, ge=0, le=1e9, description="minutes over which the requests spread evenly")
    wish: Literal["park", "retrieve"] = Field(default="park", description="what these customers want")


class Bursts(OpenTraffic):
    """Poisson traffic plus bursts at given times."""

    kind: Literal["bursts"] = Field(default="bursts", description="a Poisson stream with bursts")
    bursts: tuple[Burst, ...] = Field(min_length=1, strict=False, description="the bursts")

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        check_cars(sum(burst.cars for burst in self.bursts), "bursts")
        stays = self.stays(slots, seed)
        rng = stream(seed, "bursts")
        for burst in sorted(self.bursts, key=lambda b: b.at_min):
            when = 60 * (burst.at_min + burst.spread_min * rng.random(burst.cars))
            if burst.wish == "park":
                stays.add(when, self.dwell_s(rng, burst.cars))
            else:
                _call_back(stays, 60 * burst.at_min, when, rng)
        return demand_of(stays, 60 * self.duration_min)


def _call_back(stays: Stays, start_s: float, when: Times, rng: np.random.Generator) -> None:
    """Move to ``when`` the retrievals of cars drawn from those that are there when the burst starts."""
    there = np.flatnonzero((stays.arrive_s <= start_s) & (stays.leave_s > start_s))
    chosen = rng.permutation(there)[: len(when)]
    stays.leave_s[chosen] = when[: len(chosen)]
