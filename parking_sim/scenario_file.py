"""The scenario as run, written into the run's folder: with it the run can be repeated from anywhere."""

from __future__ import annotations

from pathlib import Path

import yaml

from parking_sim.config import NET_SUFFIXES, Scenario


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario with every key, and with absolute paths.

    Args:
        scenario: what to write.
        path: file to write.

    Raises:
        OSError: the file can't be written.
    """
    data = scenario.model_dump(mode="json")
    if scenario.garage.endswith(NET_SUFFIXES):
        data["garage"] = str(Path(scenario.garage_source).resolve())
    if ":" in scenario.planner:
        file, _, function = scenario.planner_source.rpartition(":")
        data["planner"] = f"{Path(file).resolve()}:{function}"
    if "path" in data["workload"]:
        data["workload"]["path"] = str((scenario.base_dir / data["workload"]["path"]).resolve())
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
