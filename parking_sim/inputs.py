"""What a run reads: the scenario and the files that it names, which the run's folder keeps.

A run on shipped nets and traffic is described by its scenario alone. Files of the user's own (a net with its additional
file, requests, a profile, a planner) are copied into the run's folder, and the scenario in it names the copies. The run
can then be repeated wherever the folder is.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from analysis.run_files import INPUTS, SCENARIO_FILE
from parking_sim.config import NET_SUFFIXES, Scenario, read_yaml
from sumo_nets.errors import InputError
from sumo_nets.input_file import MEGABYTE, read_bytes
from sumo_nets.read import net_files
from sumo_nets.whole_file import write_whole
from sumo_nets.wording import cut, shown

#: Bytes of a file that a scenario names.
_MOST_BYTES = 100 * MEGABYTE


@dataclass(frozen=True)
class Inputs:
    """The inputs of one run.

    Attributes:
        scenario: the scenario with every key, as plain values; own files are named as within the run's folder.
        own: the user's own files: path within the run's folder -> content.
        digests: SHA-256 of every file that is read: own ones by their path within the run's folder, those of a shipped
            net by their names.
    """

    scenario: Mapping[str, object]
    own: Mapping[str, bytes]
    digests: Mapping[str, str]


def read_inputs(scenario: Scenario) -> Inputs:
    """Read the files that a scenario names.

    Args:
        scenario: what is run.

    Returns:
        Their contents, and the scenario for the run's folder.

    Raises:
        InputError: one can't be read.
    """
    data = scenario.model_dump(mode="json")
    own: dict[str, bytes] = {}

    def keep(path: Path) -> str:
        name = f"{INPUTS}/{path.name}"
        own[name] = _content(path)
        return name

    is_own = scenario.garage.endswith(NET_SUFFIXES)
    files = net_files(scenario.garage_source)
    if is_own:
        data["garage"], _ = map(keep, files)
    planner, _, function = scenario.planner_source.rpartition(":")
    if planner:
        data["planner"] = f"{keep(Path(planner))}:{function}"
    if key := scenario.workload.file_key:
        data["workload"][key] = keep(scenario.base_dir / data["workload"][key])
    shipped = {} if is_own else {path.name: _content(path) for path in files}
    return Inputs(data, own, {name: hashlib.sha256(text).hexdigest() for name, text in {**shipped, **own}.items()})


def check_trust(folder: Path, trust: bool) -> None:
    """Make sure that a record from elsewhere runs no code of its own unasked.

    Args:
        folder: of a run, whose scenario is to be run again.
        trust: the user knows the planner's file in it.

    Raises:
        InputError: the scenario names a planner's file, and ``trust`` is not set.
    """
    path = folder / SCENARIO_FILE
    planner = str(read_yaml(path).get("planner", ""))
    if ":" in planner and not trust:
        file = planner.rpartition(":")[0]
        raise InputError(
            f"{path}: planner: {shown(planner)} is code that would run; read {cut(file)}, then give --trust"
        )


def write_inputs(inputs: Inputs, folder: Path, shared: Path | None = None) -> None:
    """Write the scenario and the user's own files into the folder of a run.

    Args:
        inputs: see :func:`read_inputs`.
        folder: the run's folder.
        shared: a folder for files that many runs have in common: each is kept there once, and the runs' folders get
            hard links to it, or copies where the file system has no links.

    Raises:
        OSError: something can't be written.
    """
    for name, content in inputs.own.items():
        target = folder / name
        if target.is_file() and target.read_bytes() == content:
            continue  # a run that is resumed
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)  # it may be a link to what other runs read
        if shared is None:
            write_whole(target, content)
        else:
            _link(_shared(content, inputs.digests[name], shared), target)
    text = yaml.safe_dump(dict(inputs.scenario), sort_keys=False, allow_unicode=True)
    write_whole(folder / SCENARIO_FILE, text)


def kept_net(scenario: Scenario, folder: Path) -> tuple[Path, Path]:
    """The net and its additional file that a run reads: the copies in its folder, or those of a shipped net."""
    paths = net_files(scenario.garage_source)
    if not scenario.garage.endswith(NET_SUFFIXES):
        return paths
    net, additional = (folder.resolve() / INPUTS / path.name for path in paths)
    return net, additional


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, _MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: can't be read: {error.strerror}") from None


def _shared(content: bytes, digest: str, folder: Path) -> Path:
    """The one file of a folder with this content, made if need be; other processes may do the same."""
    path = folder / digest
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    return path


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
