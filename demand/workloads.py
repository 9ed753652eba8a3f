"""The table of demand profiles. A new one is a file with one class, and its name here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, get_args

from pydantic import Field

from demand.bursts import Bursts
from demand.csv_file import Csv
from demand.park_exit import ParkExit
from demand.poisson import Poisson
from demand.profile_traffic import ProfileTraffic
from demand.types import Demand, Workload
from demand.zones import Zones

AnyWorkload = ParkExit | Poisson | Bursts | Zones | Csv | ProfileTraffic

#: What a scenario file may say under ``workload``; its ``kind`` says which.
WorkloadConfig = Annotated[AnyWorkload, Field(discriminator="kind")]

#: Profiles by the ``kind`` that a scenario names.
WORKLOADS: dict[str, type[Workload]] = {model.model_fields["kind"].default: model for model in get_args(AnyWorkload)}


def make_demand(workload: Workload, slots: int, seed: int, base_dir: Path) -> Demand:
    """Draw the requests of one run.

    Args:
        workload: options of a profile.
        slots: slots of the garage.
        seed: seed of the run, 0 or more. The demand depends on nothing but these arguments, so that two controllers
            meet the same customers.
        base_dir: folder from which relative paths in the options count.

    Returns:
        The demand.

    Raises:
        InputError: the options don't fit the garage, or a file they name is bad.
    """
    return workload.demand(slots, seed, base_dir)
