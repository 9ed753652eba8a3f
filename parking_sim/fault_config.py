"""What can go wrong in a run: the keys under ``faults`` in a scenario. Nothing does unless it is asked for."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

#: Faults of one AGV, of places on the floor, and of the whole floor.
AgvFault = Literal["stop", "slow", "stale", "breakdown", "battery"]
PlaceFault = Literal["blocked", "bay", "charger", "zone_stop"]
AnyFault = AgvFault | PlaceFault | Literal["all_stop"]

AGV_FAULTS: tuple[AgvFault, ...] = ("stop", "slow", "stale", "breakdown", "battery")
PLACE_FAULTS: tuple[PlaceFault, ...] = ("blocked", "bay", "charger", "zone_stop")
DRAWN_FAULTS: tuple[AnyFault, ...] = (*AGV_FAULTS, *PLACE_FAULTS, "all_stop")

#: Longest that a fault may last: some three hundred years, longer than any run.
LONGEST_S = 1e10
#: Shortest one.
SHORTEST_S = 1e-6


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Drawn(_Options):
    """Faults of one kind that come as a Poisson stream and last a uniformly drawn time."""

    per_h: float = Field(ge=0, le=3600, description="mean number in an hour free of it: of each AGV, or of the floor")
    least_s: float = Field(default=10.0, ge=SHORTEST_S, le=LONGEST_S, description="shortest one, seconds")
    most_s: float = Field(default=60.0, ge=SHORTEST_S, le=LONGEST_S, description="longest one, seconds")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.least_s > self.most_s:
            raise ValueError("give least_s <= most_s")
        return self


class Slow(Drawn):
    """An AGV drives slowly."""

    share: float = Field(default=0.5, gt=0, le=1, description="share of its speed that is left")


class Stale(Drawn):
    """An AGV's positions reach the controller late."""

    age_s: float = Field(default=3.0, gt=0, le=60, description="age of the positions, seconds")


class Breakdown(Drawn):
    """An AGV stands until a tow has come, is towed (with its car to where that goes, then home), and repaired there."""

    least_s: float = Field(
        default=300.0, ge=SHORTEST_S, le=LONGEST_S, description="shortest time until the tow has come, seconds"
    )
    most_s: float = Field(
        default=900.0, ge=SHORTEST_S, le=LONGEST_S, description="longest time until the tow has come, seconds"
    )
    tow_share: float = Field(default=0.3, gt=0, le=1, description="share of its speed under tow")
    repair_s: float = Field(default=600.0, ge=0, le=LONGEST_S, description="repair at home, seconds")


class Battery(Drawn):
    """A battery is suddenly empty; the AGV stands until service has brought energy."""

    least_s: float = Field(
        default=300.0, ge=SHORTEST_S, le=LONGEST_S, description="shortest time until service has come, seconds"
    )
    most_s: float = Field(
        default=600.0, ge=SHORTEST_S, le=LONGEST_S, description="longest time until service has come, seconds"
    )
    brings: float = Field(default=0.2, gt=0, le=1, description="state of charge after service, 0 to 1")


class ZoneStop(Drawn):
    """Emergency stop of everything round a place."""

    radius_m: float = Field(default=15.0, gt=0, le=1e6, description="radius of the zone, metres")


class Commands(_Options):
    """Commands that reach AGVs late. A lost one is sent again until it arrives; commands never overtake each other."""

    late: float = Field(default=0.0, ge=0, le=1, description="share of commands that come late")
    late_s: float = Field(default=3.0, ge=SHORTEST_S, le=LONGEST_S, description="delay of a late one, seconds")
    lost: float = Field(default=0.0, ge=0, le=0.99, description="share of commands lost, each time they are sent")
    retry_s: float = Field(
        default=5.0, ge=SHORTEST_S, le=LONGEST_S, description="seconds after which a lost command is sent again"
    )


class Scripted(_Options):
    """One fault at a fixed time."""

    at_s: float = Field(ge=0, le=LONGEST_S, description="when it begins, seconds")
    kind: AnyFault = Field(description="what happens")
    for_s: float = Field(
        ge=SHORTEST_S, le=LONGEST_S, description="how long it lasts, seconds; of a breakdown: until the tow has come"
    )
    agv: int = Field(default=-1, ge=-1, le=1_000_000, description="number of the AGV, for faults of one AGV")
    place: str = Field(default="", description="name of the vertex: blocked, out of order, or the zone's centre")

    @model_validator(mode="after")
    def _has_a_target(self) -> Self:
        if self.kind in AGV_FAULTS and self.agv < 0:
            raise ValueError(f"{self.kind} needs agv: its number")
        if self.kind in PLACE_FAULTS and not self.place:
            raise ValueError(f"{self.kind} needs place: the name of a vertex")
        return self


class FaultConfig(_Options):
    """Everything that can go wrong; each kind has its own random stream, so that adding one leaves the others alone."""

    travel_noise: float = Field(
        default=0.0, ge=0, le=2, description="sigma of the log-normal factor (median 1) on the time of each move"
    )
    commands: Commands = Field(default_factory=Commands, description="late and lost commands")
    stop: Drawn | None = Field(default=None, description="an AGV stops for a time, nobody is told why")
    slow: Slow | None = Field(default=None, description="an AGV is slow for a time")
    stale: Stale | None = Field(default=None, description="an AGV's positions come late for a time")
    breakdown: Breakdown | None = Field(default=None, description="an AGV breaks down and is towed home")
    battery: Battery | None = Field(default=None, description="an AGV's battery is empty")
    blocked: Drawn | None = Field(default=None, description="a person or a dropped part blocks a lane or slot")
    bay: Drawn | None = Field(default=None, description="a bay is out of order")
    charger: Drawn | None = Field(default=None, description="a charger is out of order")
    zone_stop: ZoneStop | None = Field(default=None, description="emergency stop of a zone")
    all_stop: Drawn | None = Field(default=None, description="emergency stop of all AGVs")
    script: list[Scripted] = Field(default_factory=list, description="faults at fixed times")

    @property
    def any(self) -> bool:
        """Something can go wrong."""
        return self != FaultConfig()
