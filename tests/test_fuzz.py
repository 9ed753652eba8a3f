"""Fuzzing: mutated scenario, layout and request files run, or end in one clear line and exit code 2.

``FUZZ`` in the environment sets how many mutants of each file are tried; the full form takes 10,000 in all.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import yaml
from fuzz_files import mutated
from fuzz_readers import READERS

from demand.csv_file import Csv
from parking_sim.assembly import assemble
from parking_sim.cli import main
from parking_sim.config import check_scenario, load_scenario, read_yaml
from sumo_nets.errors import InputError, NetError
from sumo_nets.layout import LayoutError, parse_layout
from sumo_nets.plan import plan_garage

MUTANTS = int(os.environ.get("FUZZ", "150"))
#: Mutants of each scenario that are run from the command line, and seconds after which one hangs.
RUNS, HANGS_S = max(1, MUTANTS // 30), 120
INF = float("inf")
ODD: tuple[Any, ...] = (-1, 0, 0.5, 1e300, INF - INF, INF, "", "x", None, [], {}, True, 10**30, "\u2603", [[]])
SCENARIOS = sorted(p.name for p in files("parking_sim").joinpath("scenarios").iterdir() if p.name.endswith(".yaml"))
FAULTS = {"stop": {"per_h": 2}, "script": [{"at_s": 5, "kind": "bay", "for_s": 9, "place": "bay2_3w"}]}


def mutate(value: Any, rng: random.Random) -> Any:
    """A copy with one thing changed somewhere inside."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(sorted(value, key=str))
        what = rng.random()
        if what < 0.1:
            return {k: v for k, v in value.items() if k != key}
        if what < 0.2:
            return {**value, f"{key}_": value[key]}
        return {**value, key: mutate(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        k = rng.randrange(len(value))
        what = rng.random()
        if what < 0.1:
            return value[:k] + value[k + 1 :]
        if what < 0.2:
            return [*value, value[k]]
        return [*value[:k], mutate(value[k], rng), *value[k + 1 :]]
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        return rng.choice((-value, value * 1000, value + 1, value / 3))
    return rng.choice(ODD)


def garble(text: str, rng: random.Random) -> str:
    """A text with a few characters or lines lost, doubled or replaced."""
    for _ in range(rng.randint(1, 3)):
        if rng.random() < 0.3:
            lines = text.splitlines(keepends=True) or [""]
            k = rng.randrange(len(lines))
            text = "".join(lines[:k] + lines[k:][:1] * rng.choice((0, 2)) + lines[k + 1 :])
        else:
            k = rng.randrange(len(text) + 1)
            text = text[:k] + rng.choice(("", "\t", ":", "[", "-", "\x00", "9", ",", '"', "\u2603")) + text[k + 1 :]
    return text


def said_in_few_lines(error: Exception) -> None:
    lines = str(error).split("\n")
    assert len(lines) <= 21
    assert all(line.strip() and len(line) < 4200 and "Traceback" not in line for line in lines)


@pytest.mark.parametrize("name", SCENARIOS)
def test_mutated_scenarios_are_taken_or_refused(name, tmp_path):
    source = Path(str(files("parking_sim").joinpath("scenarios", name)))
    good = {**read_yaml(source), "faults": FAULTS}
    rng = random.Random(name)
    refused = 0
    mutants = (mutate(good, rng) for _ in range(MUTANTS))
    for mutant in (m for m in mutants if isinstance(m, dict)):
        try:
            scenario = check_scenario(mutant, name, source.parent)
            if scenario.garage.startswith("map1") and scenario.agvs <= 64:
                assemble(scenario)
        except (InputError, NetError) as error:
            said_in_few_lines(error)
            refused += 1
    assert 0 < refused < MUTANTS


@pytest.mark.parametrize("name", SCENARIOS)
def test_garbled_scenario_files_are_taken_or_refused(name, tmp_path):
    text = files("parking_sim").joinpath("scenarios", name).read_text()
    rng = random.Random(name)
    for _ in range(MUTANTS):
        path = tmp_path / name
        path.write_text(garble(text, rng), encoding="utf-8")
        try:
            load_scenario(path)
        except InputError as error:
            said_in_few_lines(error)


@pytest.mark.parametrize("name", SCENARIOS)
def test_mutated_scenarios_run_or_leave_nothing(name, tmp_path, capsys):
    """From the command line, a minute each: a record, or one line, exit code 2 and no folder."""
    source = Path(str(files("parking_sim").joinpath("scenarios", name)))
    shutil.copy(source.with_name("gate_log.csv"), tmp_path)
    short = {
        "garage": "map1_thesis",
        "agvs": 3,
        "plant": "discrete",
        "duration_s": 60.0,
        "faults": {"stop": {"per_h": 9}},
    }
    good = {**read_yaml(source), **short, "record": {"replay": False, "sample_s": 5.0}}
    rng = random.Random(name)
    mutants = (mutate(good, rng) for _ in range(RUNS))
    for number, mutant in enumerate(m for m in mutants if isinstance(m, dict)):
        out = tmp_path / f"run{number}"
        (tmp_path / name).write_text(yaml.safe_dump(ended(mutant)), encoding="utf-8")
        signal.alarm(HANGS_S)
        with pytest.raises(SystemExit) as end:
            main(["run", str(tmp_path / name), "--out", str(out), "--no-report", "-q"])
        signal.alarm(0)
        said = capsys.readouterr().err
        assert end.value.code in (0, 1, 2)
        assert (out / "run.json").is_file() == (end.value.code != 2)
        assert out.exists() == (end.value.code != 2)
        refused = bool(said) and all(line.startswith("error: ") for line in said.splitlines())
        assert refused == (end.value.code == 2)


def ended(mutant: dict[str, Any]) -> dict[str, Any]:
    """The mutant with an end not far off, unless what says so has become nonsense."""
    asked = mutant.get("duration_s", 60.0)
    return (
        {**mutant, "duration_s": 60.0} if asked is None or (isinstance(asked, int | float) and asked > 60) else mutant
    )


def layouts() -> Iterator[str]:
    folder = files("sumo_nets").joinpath("layouts")
    yield from sorted(p.name for p in folder.iterdir() if p.name.endswith(".yaml"))


@pytest.mark.parametrize("name", [n for n in layouts() if "1" in n])
def test_mutated_layouts_are_taken_or_refused(name):
    text = files("sumo_nets").joinpath("layouts", name).read_text()
    good = yaml.safe_load(text)
    rng = random.Random(name)
    refused = 0
    for number in range(MUTANTS):
        mutant = garble(text, rng) if number % 2 else yaml.safe_dump(mutate(good, rng))
        try:
            plan_garage(parse_layout(mutant, name))
        except LayoutError as error:
            said_in_few_lines(error)
            refused += 1
    assert 0 < refused < MUTANTS


def test_garbled_request_files_are_taken_or_refused(tmp_path):
    text = files("parking_sim").joinpath("scenarios", "gate_log.csv").read_text()
    rng = random.Random(1)
    refused = 0
    for _ in range(MUTANTS):
        (tmp_path / "log.csv").write_text(garble(text, rng), encoding="utf-8")
        try:
            Csv(path="log.csv", initial_cars=["KA-2207"]).demand(61, 0, tmp_path)
        except InputError as error:
            said_in_few_lines(error)
            refused += 1
    assert 0 < refused < MUTANTS


@pytest.mark.parametrize("name", sorted(READERS))
def test_mutated_files_of_every_reader_are_taken_or_refused(name, tmp_path):
    """The small form of ``benchmarks/fuzz.py``."""
    rng = random.Random(name)
    seeds = list(READERS[name].seeds())
    refused = 0
    for number in range(max(8, MUTANTS // 15)):
        good = rng.choice(seeds)
        spoilt = rng.choice(sorted(good))
        folder = tmp_path / str(number)
        folder.mkdir()
        for file, content in good.items():
            changed = mutated(file, content, list(rng.choice(seeds).values()), rng) if file == spoilt else content
            (folder / file).write_bytes(changed)
        try:
            READERS[name].read(folder)
        except InputError as error:
            said_in_few_lines(error)
            refused += 1
    assert refused
