"""Sweep files: many scenarios from one, each with the same seeds, and the key under which a run is kept.

A sweep file has a ``base`` scenario (a shipped garage, a scenario file or its keys), a ``grid`` of values for scenario
keys, of which every combination is run, a ``list`` of variants, each of which meets every point of the grid, and
``seeds``. A value may be a group of keys (``workload``, ``faults``, ``agv``). An entry of the list may have a ``name``;
values in the grid have names when they are given as a mapping of names to values. All variants get the same seeds, so
that they meet the same customers (common random numbers).
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.variants import NAME, Variant, label, tell_apart, variant_of
from parking_sim.config import Scenario, check_scenario, read_yaml, scenario_keys
from parking_sim.inputs import read_inputs
from parking_sim.versions import code_version
from sumo_nets.errors import InputError
from sumo_nets.input_file import is_file
from sumo_nets.wording import shown

#: Key of a sweep file -> (what it holds, meaning).
KEYS = {
    "base": ("text or mapping, needed", "the scenario that varies: a shipped garage, a scenario file, or its keys"),
    "grid": ("mapping to lists or to mappings of names to values", "values of scenario keys; every combination is run"),
    "list": ("list of mappings", "variants, each with every point of the grid; `name` is a variant's name"),
    "seeds": ("number, list, or text such as `1..5, 9`", "seeds of every variant; default: 1"),
}
_RANGE = re.compile(r"(\d{1,12})(?:\.\.(\d{1,12}))?")
#: Runs of a sweep at most: more would take years, and days to lay out.
_MOST_RUNS = 100_000


@dataclass(frozen=True)
class RunSpec:
    """One run of a sweep.

    Attributes:
        scenario: what to run, with its seed.
        variant: the variant of the sweep that it is a run of.
        key: hash of the scenario, of the files it names and of the code that runs it, 16 hexadecimal digits.
    """

    scenario: Scenario
    variant: Variant
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
        if key not in KEYS:
            raise InputError(f"{path}: {key}: unknown key; valid keys are {', '.join(KEYS)}")
    if "base" not in data:
        raise InputError(f"{path}: base: missing (a shipped garage, a scenario file, or the keys of a scenario)")
    base, base_dir = _base(data["base"], path)
    seeds = parse_seeds(data.get("seeds", "1"), f"{path}: seeds")
    variants, scenarios = [], []
    for short, values in _points(data, path, len(seeds)):
        variants.append(variant_of(short))
        keys = set_keys(base, values, str(path))
        scenarios.append(check_scenario(keys, f"{path}: {variants[-1].name}", base_dir))
    _check_differ(variants, scenarios, path)
    return make_runs(scenarios, variants, seeds)


def make_runs(scenarios: Sequence[Scenario], variants: Sequence[Variant], seeds: Sequence[int]) -> tuple[RunSpec, ...]:
    """All variants with all seeds.

    Args:
        scenarios: one for each variant.
        variants: their names and what is shown of them, in the same order.
        seeds: seeds for each of them.

    Returns:
        The runs, all variants of the first seed first; a run that two variants share is there once.
    """
    found: dict[str, RunSpec] = {}
    contents = [_content(scenario) for scenario in scenarios]
    for seed in seeds:
        for scenario, variant, content in zip(scenarios, variants, contents, strict=True):
            key = _key(content, seed)
            found.setdefault(key, RunSpec(scenario.model_copy(update={"seed": seed}), variant, key))
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
    for part in parts[: _MOST_RUNS + 1]:
        match = _RANGE.fullmatch(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not first <= last < 2**31:
            raise InputError(f"{where}: {shown(value)}: give seeds such as 1..50, 7 or [1, 2, 3]")
        if len(seeds) + last + 1 - first > _MOST_RUNS:
            raise InputError(f"{where}: {shown(value)}: give at most {_MOST_RUNS} seeds")
        seeds.extend(range(first, last + 1))
    return tuple(dict.fromkeys(seeds))


def run_key(scenario: Scenario) -> str:
    """The key of a run: the same for the same scenario, seed, input files and code.

    Args:
        scenario: what to run.

    Returns:
        16 hexadecimal digits.

    Raises:
        InputError: a file that the scenario names can't be read.
    """
    return _key(_content(scenario), scenario.seed)


def _content(scenario: Scenario) -> dict[str, object]:
    """What decides the outcome of a run besides its seed."""
    inputs = read_inputs(scenario)
    return {"scenario": {**inputs.scenario, "seed": None}, "files": inputs.digests, "code": code_version()}


def _key(content: Mapping[str, object], seed: int) -> str:
    return hashlib.sha256(json.dumps([content, seed], sort_keys=True).encode()).hexdigest()[:16]


def _base(given: object, path: Path) -> tuple[dict[str, object], Path]:
    """The base scenario's keys, and the folder from which its relative paths count."""
    if isinstance(given, dict):
        return given, path.parent.resolve()
    if not isinstance(given, str):
        raise InputError(
            f"{path}: base: {shown(given)}: give a shipped garage, a scenario file, or the keys of a scenario"
        )
    beside = path.parent / given
    keys, folder = scenario_keys(beside if is_file(beside) else given)
    return keys, folder.resolve()


#: A factor of a sweep: for each of its levels what is shown of it, and the keys that it sets.
_Factor = list[tuple[dict[str, object], dict[str, object]]]


def _points(
    data: Mapping[str, object], path: Path, seeds: int
) -> Iterator[tuple[dict[str, object], dict[str, object]]]:
    """Every entry of the list with every point of the grid: what is shown of it, and the keys that it sets."""
    entries, grid = _listed(data.get("list"), path), _grid(data.get("grid"), path)
    for key in sorted({key for _, values in entries for key in values} | grid.keys()):
        if key == "seed":
            raise InputError(f"{path}: seed: give the seeds of all variants as seeds: 1..50")
        if key in grid and any(key in values for _, values in entries):
            raise InputError(f"{path}: {key}: is in grid and in list; give it once")
    variants = math.prod(map(len, (entries, *grid.values())))
    if variants * seeds > _MOST_RUNS:
        raise InputError(
            f"{path}: {variants} variants with {seeds} seeds are {variants * seeds} runs: give at most {_MOST_RUNS}"
        )
    for levels in itertools.product(entries, *grid.values()):
        short, values = dict[str, object](), dict[str, object]()
        for level_short, level_values in levels:
            short |= level_short
            values |= level_values
        yield short, values


def _listed(entries: object, path: Path) -> _Factor:
    """The entries of the list; those without a name are shown by their keys."""
    if entries is None:
        return [({}, {})]
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: list: give a list of variants, each a mapping of scenario keys to values")
    if not entries:
        raise InputError(f"{path}: list: give at least one variant")
    values = [{str(key): value for key, value in entry.items() if key != NAME} for entry in entries]
    short: list[dict[str, object]] = [{} for _ in entries]
    for key in dict.fromkeys(key for entry in values for key in entry):
        having = [number for number, entry in enumerate(values) if key in entry]
        for number, value in zip(having, tell_apart([values[n][key] for n in having]), strict=True):
            short[number][key] = value
    if any(NAME in entry for entry in entries):
        names = [
            _name(entry[NAME], f"{path}: list[{number}].name") if NAME in entry else label(short[number])
            for number, entry in enumerate(entries)
        ]
        short = [{NAME: name} for name in names]
    return list(zip(short, values, strict=True))


def _grid(grid: object, path: Path) -> dict[str, _Factor]:
    """The keys of the grid, each with its levels."""
    if grid is None:
        return {}
    if not isinstance(grid, dict):
        raise InputError(f"{path}: grid: {shown(grid)}: give a mapping such as agvs: [1, 2, 4]")
    factors = {}
    for key, values in grid.items():
        if not isinstance(values, list | dict) or not values:
            raise InputError(
                f"{path}: grid.{key}: {shown(values)}: give a list of values, or a mapping of names to values"
            )
        if isinstance(values, dict):
            short: list[Any] = [_name(name, f"{path}: grid.{key}") for name in values]
        else:
            short = tell_apart(values)
        level = list(values.values()) if isinstance(values, dict) else values
        factors[str(key)] = [({str(key): name}, {str(key): value}) for name, value in zip(short, level, strict=True)]
    return factors


def _name(given: object, where: str) -> str:
    if not isinstance(given, str) or not given.strip() or not given.isprintable():
        raise InputError(f"{where}: {shown(given)}: give a name of one line, such as saturday")
    return given.strip()


def _check_differ(variants: Sequence[Variant], scenarios: Sequence[Scenario], path: Path) -> None:
    """No two variants are the same scenario or have the same name."""
    names: set[str] = set()
    name_of: dict[str, str] = {}
    for variant, scenario in zip(variants, scenarios, strict=True):
        content = _key(_content(scenario), 0)
        if content in name_of:
            raise InputError(
                f"{path}: {shown(name_of[content])} and {shown(variant.name)} are the same scenario; remove one of them"
            )
        if variant.name in names:
            raise InputError(f"{path}: {shown(variant.name)}: two variants have this name; give each a name of its own")
        name_of[content] = variant.name
        names.add(variant.name)


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
    for key, value in sorted(varied.items(), key=lambda item: item[0].count(".")):  # groups before keys in them
        *groups, last = key.split(".")
        inner = data
        for group in groups:
            nested = inner.setdefault(group, {})
            if not isinstance(nested, dict):
                raise InputError(f"{source}: {key}: {group} has no keys below it")
            inner = nested
        inner[last] = copy.deepcopy(value)
    return data
