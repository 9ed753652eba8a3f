"""What every demand profile shares: the demand it yields, its options' base, and its random streams."""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from controller.types import Request
from sumo_nets.errors import InputError


@dataclass(frozen=True, slots=True)
class Demand:
    """What the customers of one run want.

    Attributes:
        initial_cars: cars already parked when the run starts, in the order in which they came.
        phases: requests in order of time; times are seconds from the start of the phase, and a phase starts when
            every request of the one before is finished. An open stream has one phase.
    """

    initial_cars: tuple[str, ...]
    phases: tuple[tuple[Request, ...], ...]

    @property
    def total(self) -> int:
        """Number of requests in all phases."""
        return sum(len(phase) for phase in self.phases)


#: Cars of one run at most.
MOST_CARS = 1_000_000


def check_cars(expected: float, key: str) -> None:
    """Refuse a demand that no memory holds, before it is drawn.

    Args:
        expected: cars that would come.
        key: what makes them so many, for the complaint.

    Raises:
        InputError: they are too many.
    """
    if not expected <= MOST_CARS:
        raise InputError(f"workload.{key}: {expected:.3g} cars would come: at most {MOST_CARS:g} are valid")


class Workload(BaseModel, ABC):
    """Options of a demand profile. A profile is a subclass with its own ``kind`` and its own ``demand``."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @abstractmethod
    def demand(self, slots: int, seed: int, base_dir: Path) -> Demand:
        """Draw the requests of one run.

        Args:
            slots: slots of the garage.
            seed: seed of the run, 0 or more; the same seed yields the same demand.
            base_dir: folder from which relative paths in the options count.

        Returns:
            The demand.

        Raises:
            InputError: the options don't fit the garage, or a file they name is bad.
        """

    def day_start_h(self, base_dir: Path) -> float | None:
        """The hour of the day at which the run starts.

        Args:
            base_dir: folder from which relative paths in the options count.

        Returns:
            The hour, 0 to 24; None for demand without a time of day, as most profiles have it.
        """
        return None

    @property
    def file_key(self) -> str:
        """The key that names the file from which the demand is read; "" if there is none."""
        return ""


def stream(seed: int, name: str) -> np.random.Generator:
    """One random generator per purpose. Extra draws for one purpose do not change another.

    Args:
        seed: seed of the run, 0 or more.
        name: purpose, for example "arrivals".

    Returns:
        The generator; it depends on the seed and the name alone.
    """
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def car_names(prefix: str, count: int) -> tuple[str, ...]:
    """Names that sort in the order of their numbers: ``car001``, ``car002``, ...

    Args:
        prefix: what the names begin with.
        count: how many.

    Returns:
        The names, numbered from 1.
    """
    digits = max(3, len(str(count)))
    return tuple(f"{prefix}{number:0{digits}}" for number in range(1, count + 1))


def by_time(requests: Sequence[Request]) -> tuple[Request, ...]:
    """Requests in order of time; those made at the same moment keep their order."""
    return tuple(sorted(requests, key=lambda request: request.time_s))
