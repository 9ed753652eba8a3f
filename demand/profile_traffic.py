"""Traffic by a demand profile: a mall's Saturday, an office day, one's own gate log."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from demand.poisson import Stays, demand_of
from demand.profiles import PROFILES, Floats, Profile, find_profile
from demand.types import Demand, Workload, check_cars, stream
from sumo_nets.errors import InputError
from sumo_nets.wording import one_of, shown


class ProfileTraffic(Workload):
    """A day, or some hours of it, of a profile; see ``demand.profiles``.

    The cars that are there at the start are drawn by the profile's occupancy at that hour. What would be asked for
    after the end is dropped. Cars that find the garage full are the garage's business.
    """

    kind: Literal["profile"] = Field(default="profile", description="hours of a demand profile")
    name: str = Field(
        min_length=1,
        description="a profile's name, or a file (.yaml); a relative path counts from the scenario's folder",
    )
    start_h: float | None = Field(
        default=None, ge=0, lt=24, description="hour of the day at which the run starts; default: the profile's first"
    )
    hours: float | None = Field(
        default=None, gt=0, le=24, description="hours during which requests are made; default: to the profile's end"
    )
    scale: float = Field(default=1.0, gt=0, le=10, description="factor on the cars of the profile")

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.name not in PROFILES and not self.name.endswith((".yaml", ".yml")):
            raise ValueError(f"name: {shown(self.name)}: {one_of(PROFILES)}, or a file (.yaml)")
        return self

    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Requests of this profile, see :meth:`Workload.demand`."""
        profile = find_profile(self.name, base_dir)
        begin, end = self._stretch(profile)
        check_cars(self.scale * slots * profile.arrivals_between(begin, end), "name")
        share = min(1.0, self.scale * profile.occupancy_at(begin))
        initial = int(stream(seed, "initial").binomial(slots, share))
        arrive = _arrivals(profile, begin, end, self.scale * slots, stream(seed, "arrivals"))
        there = np.full(initial, begin)
        leave = np.concatenate(
            (profile.leave_at(there, stream(seed, "stays")), profile.leave_at(arrive, stream(seed, "dwell")))
        )
        stays = Stays(initial, 3600 * (np.concatenate((there, arrive)) - begin), 3600 * (leave - begin))
        return demand_of(stays, 3600 * (end - begin))

    def day_start_h(self, base_dir: Path) -> float:
        """The hour of the day at which the run starts."""
        return self._stretch(find_profile(self.name, base_dir))[0]

    @property
    def file_key(self) -> str:
        """The profile's file, if it has one."""
        return "" if self.name in PROFILES else "name"

    def _stretch(self, profile: Profile) -> tuple[float, float]:
        """First and last hour of the run."""
        first, last = profile.hours[0], profile.hours[-1]
        begin = first if self.start_h is None else self.start_h
        end = last if self.hours is None else begin + self.hours
        if not first <= begin < end <= last + 1e-9:
            raise InputError(f"workload: {begin:g} h to {end:g} h: {self.name} covers {first:g} h to {last:g} h")
        return begin, end


def _arrivals(profile: Profile, begin: float, end: float, cars: float, rng: np.random.Generator) -> Floats:
    """Hours of the day at which cars arrive, in order: a Poisson process whose rate changes with the parts."""
    times = []
    for a, b, rate in zip(profile.hours, profile.hours[1:], profile.arrivals, strict=False):
        low, high = max(a, begin), min(b, end)
        if low < high:
            times.append(low + (high - low) * rng.random(rng.poisson(cars * rate * (high - low))))
    return np.sort(np.concatenate(times))
