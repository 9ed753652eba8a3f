"""A record repeated: its scenario is run again, from the files that its folder keeps, and the tables are compared."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.run_files import SCENARIO_FILE, check_ended
from analysis.tables import load_run
from analysis.variants import flatten
from parking_sim.config import Scenario, load_scenario
from parking_sim.inputs import check_trust, read_inputs
from parking_sim.simulation import RunProgress, simulate
from parking_sim.versions import code_version, versions
from sumo_nets.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Rerun:
    """What came out when a record was repeated.

    Attributes:
        notes: what is not as it was when the record was made (versions, code, scenario, files), a line each.
        differences: the tables that came out differently, a line each; none if the record was repeated.
    """

    notes: tuple[str, ...]
    differences: tuple[str, ...]


def rerun(
    folder: Path,
    out: Path | None = None,
    progress: Callable[[RunProgress], None] | None = None,
    *,
    trust: bool = False,
) -> Rerun:
    """Run the scenario of a record again and compare the two records.

    Args:
        folder: folder of the record; it is left as it is.
        out: folder for the new record; None keeps none.
        progress: called a few times a second.
        trust: run a planner's file that the record holds.

    Returns:
        What is different.

    Raises:
        InputError: there is no record that ended by itself, its scenario can't be run, or it names a planner's file and
            ``trust`` is not set.
    """
    meta = _recorded(folder)
    check_trust(folder, trust)
    scenario = load_scenario(folder / SCENARIO_FILE)
    notes = [*_changed_versions(meta), *_changed_inputs(meta, scenario)]
    with ExitStack() as stack:
        target = out or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run"
        simulate(scenario, target, progress=progress)
        return Rerun(tuple(notes), tuple(_differences(folder, target)))


def _recorded(folder: Path) -> Mapping[str, Any]:
    check_ended(folder)
    try:
        meta = load_run(folder).meta
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(str(error)) from None
    if meta.get("status") == "interrupted":
        stopped = f"was stopped by hand at {meta['simulated_s']:g} s"
        raise InputError(f"{folder}: {stopped}: give a run that ended by itself")
    return meta


def _changed_versions(meta: Mapping[str, Any]) -> Iterator[str]:
    made, here = meta.get("versions") or {}, versions()
    for name in sorted(made.keys() | here.keys()):
        if made.get(name) != here.get(name):
            yield f"the record was made with {name} {made.get(name, '(unknown)')}; this is {name} {here.get(name)}"
    if meta.get("code") != code_version():
        yield f"the record was made by code {meta.get('code', '(unknown)')}; this is {code_version()}"


def _changed_inputs(meta: Mapping[str, Any], scenario: Scenario) -> Iterator[str]:
    inputs, asked = read_inputs(scenario), flatten(meta.get("scenario") or {})
    for key, value in flatten(inputs.scenario).items():
        if key in asked and asked[key] != value:
            yield f"{SCENARIO_FILE}: {key}: {value!r}: was {asked[key]!r} when the record was made"
    for name, digest in (meta.get("inputs") or {}).items():
        if inputs.digests.get(name) != digest:
            yield f"{name}: is not the file with which the record was made"


def _differences(before: Path, after: Path) -> Iterator[str]:
    old, new = load_run(before), load_run(after)
    if old.meta["status"] != new.meta["status"]:
        yield f"status: {old.meta['status']}, now {new.meta['status']}"
    made, here = old.meta.get("digest") or {}, new.meta["digest"]
    for table in sorted(made.keys() | here.keys()):
        if table not in made or table not in here:
            yield f"{table}: only in the {'new record' if table in here else 'record'}"
        elif made[table] != here[table]:
            yield f"{table}: {_first_difference(old.read(table), new.read(table))}"


def _first_difference(old: pd.DataFrame, new: pd.DataFrame) -> str:
    """Where two tables part, wall-clock columns aside."""
    if list(old) != list(new):
        return f"the columns are {', '.join(map(str, new))}; were {', '.join(map(str, old))}"
    lengths = f"{len(new)} rows, were {len(old)}; " if len(old) != len(new) else ""
    columns = [str(name) for name in old if not str(name).startswith("wall_")]
    parted = {column: _first_row(old[column].tolist(), new[column].tolist()) for column in columns}
    column = min(parted, key=lambda name: parted[name])
    row = parted[column]
    if row >= min(len(old), len(new)):
        return f"{lengths}the rows that both have are equal"
    return f"{lengths}{column} in row {row} is {new[column][row]}, was {old[column][row]}"


def _first_row(old: Sequence[object], new: Sequence[object]) -> int:
    """The first row in which two columns differ, where NaN equals NaN; the shorter one's length if there is none."""
    pairs = enumerate(zip(old, new, strict=False))
    return next((row for row, (a, b) in pairs if a != b and (a == a or b == b)), min(len(old), len(new)))
