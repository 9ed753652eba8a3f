"""Poisson traffic that crowds into some zones of the garage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from demand.poisson import OpenTraffic, demand_of
from demand.types import Demand, stream

Weight = Annotated[float, Field(gt=0)]


class Zones(OpenTraffic):
    """Poisson traffic in which each arriving car prefers a zone of slots."""

    kind: Literal["zones"] = Field(default="zones", description="a Poisson stream with zones that are preferred")
    zones: dict[str, Weight] = Field(
        min_length=1,
        description="name prefix of a zone's slots -> weight with which arriving cars prefer it; '' is any slot",
    )

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        stays = self.stays(slots, seed)
        weights = np.array(list(self.zones.values()))
        arrivals = len(stays.arrive_s) - stays.initial
        drawn = stream(seed, "zones").choice(list(self.zones), arrivals, p=weights / weights.sum())
        return demand_of(stays, 60 * self.duration_min, [""] * stays.initial + drawn.tolist())
