"""Demand profiles with their provenance: how many cars come and leave in each part of a day.

A profile is a garage without walls: cars arrive as a Poisson process whose rate is constant within each part of the
day (non-homogeneous Poisson arrivals fit counts at 29 truck parking lots, arXiv:1908.11479), and each car present
leaves with a rate that is constant within each part too. The expected occupancy ``m`` follows
``m' = arrivals - leaving * m``, so that a profile can be made to meet an occupancy that somebody has counted, hour by
hour, exactly.

Stays are therefore exponential as long as the leaving rate does not change, and end together when it jumps, as at the
close of an office. That stays are exponential is an assumption, made because no openly licensed distribution for
garages was found. The one count at hand does not contradict it: of 1,399 stays on 2-hour spaces in Charlottesville
65, 20, 9, 4 and 3 % lasted 1, 2, 3, 4 and 5 or more hours: half or a little more of those left going each hour. The
traffic kinds ``poisson``, ``bursts`` and ``zones`` have lognormal stays instead.

Everything counts in shares of the garage's slots, so that a profile fits any garage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sumo_nets.errors import InputError, in_lines
from sumo_nets.fields import all_errors
from sumo_nets.whole_file import write_whole
from sumo_nets.wording import one_of, shown
from sumo_nets.yaml_file import YamlError, read_mapping

Floats = NDArray[np.float64]
Hour = Annotated[float, Field(ge=0, le=24)]
Rate = Annotated[float, Field(ge=0, le=1e12)]


class Profile(BaseModel):
    """A day's traffic, in shares of the garage's slots."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    words: str = Field(description="what it is")
    source: str = Field(description="where the figures come from, and which are assumed")
    licence: str = Field(default="", description="licence of the source")
    hours: tuple[Hour, ...] = Field(min_length=2, description="hours of the day at which the parts begin, and the end")
    arrivals: tuple[Rate, ...] = Field(description="cars arriving an hour in each part, as a share of the slots")
    leaving: tuple[Rate, ...] = Field(description="share of the cars present that leave an hour, in each part")
    occupancy: float = Field(ge=0, le=1, description="share of the slots occupied at the first hour")
    observed: dict[Hour, Rate] = Field(
        default_factory=dict, description="hour -> share of the slots occupied, as the source gives it"
    )

    @model_validator(mode="after")
    def _parts_in_order(self) -> Self:
        parts = len(self.hours) - 1
        if len(self.arrivals) != parts or len(self.leaving) != parts:
            raise ValueError(f"give {parts} arrivals and {parts} leaving, one for each part between two hours")
        if any(b <= a for a, b in zip(self.hours, self.hours[1:], strict=False)):
            raise ValueError("give the hours in order")
        return self

    def occupancy_at(self, hour: float) -> float:
        """Expected share of the slots occupied.

        Args:
            hour: hour of the day within the profile's.

        Returns:
            The share; it may exceed 1 where more cars come than fit.
        """
        level = self.occupancy
        for begin, end, rate, leaving in zip(self.hours, self.hours[1:], self.arrivals, self.leaving, strict=False):
            if hour <= begin:
                break
            level = _after(level, min(hour, end) - begin, rate, leaving)
        return level

    def arrivals_between(self, begin: float, end: float) -> float:
        """Expected arrivals between two hours of the day, as a share of the slots."""
        total = np.concatenate(([0.0], np.cumsum(np.diff(self.hours) * np.array(self.arrivals))))
        return float(np.interp(end, self.hours, total) - np.interp(begin, self.hours, total))

    def departures_between(self, begin: float, end: float) -> float:
        """Expected departures between two hours of the day, as a share of the slots."""
        return self.arrivals_between(begin, end) - self.occupancy_at(end) + self.occupancy_at(begin)

    def leaving_total(self, hour: Floats | float) -> Floats:
        """Leaving rate added up from the first hour until these hours."""
        total = np.concatenate(([0.0], np.cumsum(np.diff(self.hours) * np.array(self.leaving))))
        return np.asarray(np.interp(hour, self.hours, total))

    def leave_at(self, arrive: Floats, rng: np.random.Generator) -> Floats:
        """Draw when cars leave.

        Args:
            arrive: hours of the day at which they are there.
            rng: generator to draw from.

        Returns:
            Hours of the day; infinite for those that stay beyond the last.
        """
        due = self.leaving_total(arrive) + rng.exponential(size=len(arrive))
        total = self.leaving_total(np.array(self.hours))
        rising = np.concatenate((np.diff(total) > 0, [True]))  # of parts in which nothing leaves only the end counts
        return np.asarray(np.interp(due, total[rising], np.array(self.hours)[rising], right=math.inf))

    def busiest(self, hours: float) -> float:
        """Start of the busiest window of ``hours`` hours (most arrivals plus departures), to a quarter of an hour."""
        first, last = self.hours[0], self.hours[-1]
        begins = np.arange(first, max(first, last - hours) + 1e-9, 0.25)
        ends = np.minimum(begins + hours, last)
        moves = [self.arrivals_between(b, e) + self.departures_between(b, e) for b, e in zip(begins, ends, strict=True)]
        return float(begins[int(np.argmax(np.round(moves, 9)))])


def from_occupancy(
    words: str,
    source: str,
    licence: str,
    occupancy: Mapping[float, float],
    stay_h: float,
    observed: Sequence[float] = (),
    peak: float = 1.0,
) -> Profile:
    """A profile that follows an occupancy. Cars stay ``stay_h`` on average, and less where the occupancy falls faster.

    Args:
        words, source, licence: see :class:`Profile`.
        occupancy: hour of the day -> share of the slots occupied (or of the peak), above 0; straight lines between.
        stay_h: mean stay while the garage does not have to empty faster, hours.
        observed: those hours whose occupancy the source gives; the others are assumed.
        peak: what the occupancies are multiplied by.

    Returns:
        The profile: in each part the leaving rate is ``1 / stay_h``, and the arrivals follow; where the occupancy falls
        faster than that, nobody comes and the leaving rate follows.
    """
    known = sorted(occupancy)
    hours = [*np.arange(known[0], known[-1]).tolist(), *known]
    hours = sorted(set(hours))
    levels = peak * np.interp(hours, known, [occupancy[hour] for hour in known])
    arrivals, leaving = [], []
    for length, a, b in zip(np.diff(hours), levels, levels[1:], strict=False):
        rate = 1 / stay_h
        coming = rate * (b - a * math.exp(-rate * length)) / (1 - math.exp(-rate * length))
        arrivals.append(max(0.0, float(coming)))
        leaving.append(rate if coming >= 0 else float(math.log(a / b) / length))
    return Profile(
        words=words,
        source=source,
        licence=licence,
        hours=tuple(hours),
        arrivals=tuple(arrivals),
        leaving=tuple(leaving),
        occupancy=float(levels[0]),
        observed={hour: peak * occupancy[hour] for hour in observed},
    )


_Levels = dict[float, float]
_BIRMINGHAM = "Birmingham car parks, October to December 2016, UCI Machine Learning Repository, data set 482"
_OGL = "UK Open Government Licence 3.0"
_MALL: _Levels = {8: 0.23, 9: 0.35, 10: 0.50, 11: 0.61, 12: 0.67, 13: 0.71, 14: 0.70, 15: 0.63, 16: 0.54}
_EVENING: _Levels = {17: 0.45, 18: 0.36, 19: 0.26, 20: 0.17, 21: 0.08, 22: 0.02}
_COMMUTERS: _Levels = {8: 0.42, 9: 0.62, 10: 0.76, 11: 0.84, 12: 0.89, 13: 0.89, 16: 0.73}
_STAFF: _Levels = {7: 0.15, 8: 0.50, 9: 0.90, 10: 1.0, 11: 1.0, 12: 0.85, 13: 0.85, 17: 0.60, 18: 0.25}
_GERMAN: _Levels = {
    0: 0.41, 6: 0.43, 7: 0.55, 8: 0.70, 9: 0.83, 10: 0.95, 11: 1.0, 14: 0.91, 17: 0.78, 20: 0.66, 22: 0.51,
}  # fmt: skip
_FLIGHTS = (1, 1, 1, 4, 9, 12, 9, 7, 5, 5, 5, 4, 4, 5, 6, 7, 7, 6, 4, 3, 2, 1, 1, 1)

#: Name -> profile.
PROFILES: Mapping[str, Profile] = {
    "mall-weekday": from_occupancy(
        "a shopping centre from Monday to Friday",
        f"{_BIRMINGHAM}: mean occupancy of the shopping centres' car parks, Monday to Friday, 8 to 16 h. Assumed: the"
        " evening, stays of 1.5 h",
        _OGL,
        {**_MALL, **_EVENING},
        stay_h=1.5,
        observed=tuple(_MALL),
    ),
    "mall-saturday": from_occupancy(
        "a shopping centre on a Saturday",
        f"{_BIRMINGHAM}: highest mean occupancy on Saturdays, at 15 h. Assumed: the other hours, the weekday's curve"
        " two hours later; the evening; stays of 1.5 h",
        _OGL,
        {
            8: 0.05,
            9: 0.12,
            **{hour + 2: round(level * 0.72 / 0.71, 3) for hour, level in _MALL.items()},
            19: 0.40,
            20: 0.25,
            21: 0.10,
            22: 0.02,
        },
        stay_h=1.5,
        observed=(15,),
    ),
    "office": from_occupancy(
        "an office building",
        "Hourly presence of office staff, a standard working day of building planning, 7 to 18 h. Assumed: 90 % of the"
        " slots at the peak, 14 to 16 h, before 7 h and after 18 h; few leave and come back during the day",
        "figures only",
        {6: 0.03, **_STAFF, 14: 0.95, 15: 0.95, 16: 0.85, 19: 0.10, 20: 0.04},
        stay_h=20.0,
        observed=tuple(_STAFF),
        peak=0.9,
    ),
    "commuter": from_occupancy(
        "a car park of commuters",
        f"{_BIRMINGHAM}: mean occupancy of the commuters' car parks, 8 to 16 h. Assumed: before and after; few leave"
        " and come back during the day",
        _OGL,
        {6: 0.05, 7: 0.20, **_COMMUTERS, 17: 0.50, 18: 0.25, 19: 0.10, 20: 0.04},
        stay_h=12.0,
        observed=tuple(_COMMUTERS),
    ),
    "mixed": from_occupancy(
        "a garage in the centre of a town, round the clock",
        "34 German garages, weekdays, occupancy as a share of its peak, from their operators' public counts. Assumed:"
        " 85 % of the slots at the peak, stays of 3 h",
        "figures only",
        {**_GERMAN, 24: 0.41},
        stay_h=3.0,
        observed=tuple(_GERMAN),
        peak=0.85,
    ),
    "event": from_occupancy(
        "the end of an event: a full garage leaves within the hour",
        "Assumed throughout: doors at 18 h, begin at 19:30, end at 22 h. For scale: in an ordinary hour no more than"
        " 17 % of the slots empty on balance (Birmingham, 1st percentile)",
        "none needed",
        {17: 0.10, 18: 0.35, 19: 0.75, 19.5: 0.90, 22: 0.90, 22.25: 0.60, 22.5: 0.30, 22.75: 0.12, 23: 0.05},
        stay_h=50.0,
    ),
    "airport": Profile(
        words="an airport like Lyon: stays of days, and waves of flights",
        source="Published figures of the robotic car park at Lyon airport: up to 200 cars a day on 500 spaces. Assumed:"
        " 80 % of the slots taken, the hours of arrivals and of departures",
        licence="figures only",
        hours=tuple(range(25)),
        arrivals=tuple(0.4 * share / sum(_FLIGHTS) for share in _FLIGHTS),
        leaving=tuple(0.5 * share / sum(_FLIGHTS) for share in (*_FLIGHTS[-4:], *_FLIGHTS[:-4])),
        occupancy=0.8,
    ),
}


def find_profile(name: str, base_dir: Path = Path()) -> Profile:
    """A profile by its name, or from a file.

    Args:
        name: a key of ``PROFILES``, or a YAML file with the fields of :class:`Profile`.
        base_dir: folder from which a relative path counts.

    Returns:
        The profile.

    Raises:
        InputError: no such profile, or a file that is not one.
    """
    if name in PROFILES:
        return PROFILES[name]
    path = base_dir / name
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"profile: {shown(name)}: {one_of(PROFILES)}, or a file (.yaml)")
    try:
        return Profile.model_validate(read_mapping(path, "words: offices of a city"))
    except ValidationError as error:
        raise InputError(in_lines([f"{path}: {wrong}" for wrong in all_errors(error, Profile)])) from None
    except YamlError as error:
        raise InputError(f"{path}: {error}") from None


def write_profile(profile: Profile, path: Path) -> None:
    """Write a profile as a YAML file that :func:`find_profile` reads.

    Args:
        profile: what to write.
        path: the file.

    Raises:
        OSError: it can't be written.
    """
    text = yaml.safe_dump(profile.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=120)
    write_whole(path, text)


def _after(level: float, length: float, arrivals: float, leaving: float) -> float:
    """Solve ``m' = arrivals - leaving * m`` over a part of the day."""
    if leaving < 1e-12:
        return level + arrivals * length
    kept = math.exp(-leaving * length)
    return level * kept + arrivals / leaving * (1 - kept)
