"""Sweep files: many scenarios from one, each with the same seeds, and the key under which a run is kept.

A sweep file has a ``base`` scenario (a shipped garage, a scenario file or its keys), a ``grid`` of values for scenario
keys, of which every combination is run, a ``list`` of variants, each of which meets every point of the grid, and
``seeds``. All variants get the same seeds, so that they meet the same customers (common random numbers).
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from parking_sim.config import Scenario, check_scenario, read_yaml, scenario_keys
from parking_sim.errors import InputError

_KEYS = ("base", "grid", "list", "seeds")
_RANGE = re.compile(r"(\d+)(?:\.\.(\d+))?")

#: Modules of ``parking_sim`` that start runs but take no part in them: a change there leaves finished runs valid.
_AROUND_A_RUN = {
    "cli", "demo", "doctor", "executors", "folders", "progress", "reproduce", "sizing", "studies", "sweep",
    "sweep_plan", "tuning",
}  # fmt: skip
_OF_ANALYSIS = {"metrics", "tables"}


@dataclass(frozen=True)
class RunSpec:
    """One run of a sweep.

    Attributes:
        scenario: what to run, with its seed.
        varied: the keys in which the variants of the sweep differ -> their values in this one.
        key: hash of the scenario, of the files it names and of the code that runs it, 16 hexadecimal digits.
    """

    scenario: Scenario
    varied: Mapping[str, object]
    key: str


def load_sweep(path: Path) -> tuple[RunSpec, ...]:
    """Read a sweep file.

    Args:
        path: a YAML file with the keys ``base``, ``grid``, ``list`` and ``seeds``.

    Returns:
        The runs, all variants of the first seed first: a sweep that is stopped leaves whole sets of variants.

    Raises:
        InputError: it can't be read, has an unknown key, or a value or variant is not valid.
    """
    data = read_yaml(path)
    for key in data:
        if key not in _KEYS:
            raise InputError(f"{path}: {key}: unknown key; valid keys are {', '.join(_KEYS)}")
    if "base" not in data:
        raise InputError(f"{path}: base: missing (a shipped garage, a scenario file, or the keys of a scenario)")
    base, base_dir = _base(data["base"], path)
    seeds = parse_seeds(data.get("seeds", "1"), f"{path}: seeds")
    variants = list(_variants(data, path))
    if not variants:
        raise InputError(f"{path}: give at least one variant")
    scenarios = [
        check_scenario(set_keys(base, varied, str(path)), f"{path}: {label(varied)}", base_dir) for varied in variants
    ]
    return make_runs(scenarios, variants, seeds)


def make_runs(
    scenarios: Sequence[Scenario], variants: Sequence[Mapping[str, object]], seeds: Sequence[int]
) -> tuple[RunSpec, ...]:
    """All variants with all seeds.

    Args:
        scenarios: one for each variant.
        variants: what differs in each, the same keys in all.
        seeds: seeds for each of them.

    Returns:
        The runs, all variants of the first seed first; a run that two variants share is there once.
    """
    found: dict[str, RunSpec] = {}
    for seed in seeds:
        for scenario, varied in zip(scenarios, variants, strict=True):
            seeded = scenario.model_copy(update={"seed": seed})
            spec = RunSpec(seeded, varied, run_key(seeded))
            found.setdefault(spec.key, spec)
    return tuple(found.values())


def parse_seeds(value: object, where: str = "seeds") -> tuple[int, ...]:
    """Seeds as a file or the command line writes them.

    Args:
        value: a number, a list of numbers, or text such as ``1..50`` or ``1..10, 99``.
        where: first words of a complaint.

    Returns:
        The seeds in the order given, each once.

    Raises:
        InputError: anything else.
    """
    parts = [str(part) for part in value] if isinstance(value, list) else str(value).split(",")
    seeds: list[int] = []
    for part in parts:
        match = _RANGE.fullmatch(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not first <= last < 2**31:
            raise InputError(f"{where}: {value!r}: give seeds such as 1..50, 7 or [1, 2, 3]")
        seeds.extend(range(first, last + 1))
    return tuple(dict.fromkeys(seeds))


def label(varied: Mapping[str, object]) -> str:
    """A variant in words: ``agvs=4 planner=whca``; ``base`` if nothing varies."""
    return " ".join(f"{key}={_text(value)}" for key, value in varied.items()) or "base"


def run_key(scenario: Scenario) -> str:
    """The key of a run: the same for the same scenario, seed, input files and code.

    Args:
        scenario: what to run.

    Returns:
        16 hexadecimal digits.

    Raises:
        InputError: a file that the scenario names can't be read.
    """
    content = {
        "scenario": scenario.model_dump(mode="json"),
        "files": [_digest(path) for path in _input_files(scenario)],
        "code": code_version(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


@cache
def code_version() -> str:
    """Hash of the sources that take part in a run and of the versions of the libraries that decide its outcome."""
    from parking_sim.simulation import versions

    root = Path(__file__).parent.parent
    sources = [path for name in ("controller", "demand", "sumo_nets") for path in (root / name).rglob("*.py")]
    own = root / "parking_sim"
    sources += [p for p in own.rglob("*.py") if p.relative_to(own).parts[0].removesuffix(".py") not in _AROUND_A_RUN]
    sources += [root / "analysis" / f"{name}.py" for name in _OF_ANALYSIS]
    total = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    for path in sorted(sources):
        total.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()[:16]


def _base(given: object, path: Path) -> tuple[dict[str, object], Path]:
    """The base scenario's keys, and the folder from which its relative paths count."""
    if isinstance(given, dict):
        return given, path.parent.resolve()
    if not isinstance(given, str):
        raise InputError(f"{path}: base: {given!r}: give a shipped garage, a scenario file, or the keys of a scenario")
    beside = path.parent / given
    keys, folder = scenario_keys(beside if beside.is_file() else given)
    return keys, folder.resolve()


def _variants(data: Mapping[str, object], path: Path) -> Iterator[dict[str, object]]:
    """Every entry of the list with every point of the grid."""
    grid, entries = data.get("grid") or {}, data.get("list") or [{}]
    if not isinstance(grid, dict):
        raise InputError(f"{path}: grid: {grid!r}: give a mapping such as agvs: [1, 2, 4]")
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise InputError(f"{path}: grid.{key}: {values!r}: give a list of values")
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: list: give a list of variants, each a mapping of scenario keys to values")
    if len({frozenset(entry) for entry in entries}) > 1:
        raise InputError(f"{path}: list: give the same keys in every variant")
    for key in (*grid, *entries[0]):
        if key == "seed":
            raise InputError(f"{path}: seed: give the seeds of all variants as seeds: 1..50")
        if key in grid and key in entries[0]:
            raise InputError(f"{path}: {key}: is in grid and in list; give it once")
    for entry in entries:
        for values in itertools.product(*grid.values()):
            yield {**entry, **dict(zip(grid, values, strict=True))}


def set_keys(base: Mapping[str, object], varied: Mapping[str, object], source: str) -> dict[str, object]:
    """A scenario's keys with some of them set.

    Args:
        base: keys of a scenario, nested.
        varied: keys, whose dots lead into groups of keys -> values.
        source: first words of a complaint.

    Returns:
        New keys.

    Raises:
        InputError: a key leads into one that is no group.
    """
    data = copy.deepcopy(dict(base))
    for key, value in varied.items():
        *groups, last = str(key).split(".")
        inner = data
        for group in groups:
            nested = inner.setdefault(group, {})
            if not isinstance(nested, dict):
                raise InputError(f"{source}: {key}: {group} has no keys below it")
            inner = nested
        inner[last] = value
    return data


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def _input_files(scenario: Scenario) -> list[Path]:
    """The files that a run reads besides the scenario: net, customers, a planner of the user's own."""
    from sumo_nets.read import net_files

    files = [*net_files(scenario.garage_source), *scenario.workload.files(scenario.base_dir)]
    planner = Path(scenario.planner_source.rpartition(":")[0])
    return [*files, planner] if planner.is_file() else files


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: can't be read: {error.strerror}") from None
