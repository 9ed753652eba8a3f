"""Scenario files: defaults, one line for each thing that can be wrong, and a schema that explains every key."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import parking_sim
from demand.park_exit import ParkExit
from demand.workloads import WORKLOADS, make_demand
from parking_sim.assembly import agv_type
from parking_sim.config import DEFAULT_AGVS, AgvConfig, Scenario, load_scenario
from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.errors import InputError
from sumo_nets.read import read_net, shipped_nets

EXAMPLES = sorted((Path(parking_sim.__file__).parent / "scenarios").glob("*.yaml"))
BASE = "garage: map1\nagvs: 2\n"


def load(tmp_path: Path, text: str, **overrides: object) -> Scenario:
    path = tmp_path / "s.yaml"
    path.write_text(text, encoding="utf-8")
    return load_scenario(path, overrides)


@pytest.mark.parametrize("name", shipped_nets())
def test_a_shipped_garage_is_a_scenario(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.agvs == DEFAULT_AGVS[name]
    assert scenario.workload == ParkExit()
    assert scenario.garage_source == name


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_the_examples_are_valid(path: Path) -> None:
    scenario = load_scenario(path)
    graph = read_net(scenario.garage_source).graph
    demand = make_demand(scenario.workload, len(graph.roles["slot"]), scenario.seed, scenario.base_dir)
    assert demand.total > 0
    assert scenario.agvs <= len(graph.roles["home"])
    slots = [graph.names[v] for v in graph.roles["slot"]]
    zones = {request.zone for phase in demand.phases for request in phase}
    assert all(any(slot.startswith(zone) for slot in slots) for zone in zones)


def test_overrides_go_before_the_file(tmp_path: Path) -> None:
    scenario = load(tmp_path, BASE, agvs=3, seed=9)
    assert (scenario.agvs, scenario.seed) == (3, 9)


def test_relative_paths_count_from_the_file(tmp_path: Path) -> None:
    (tmp_path / "nets").mkdir()
    (tmp_path / "nets/own.net.xml").touch()
    (tmp_path / "mine.py").touch()
    scenario = load(tmp_path, "garage: nets/own.net.xml\nagvs: 1\nplanner: mine.py:plan\n")
    assert scenario.planner_source == f"{tmp_path / 'mine.py'}:plan"
    assert scenario.garage_source == tmp_path / "nets/own.net.xml"
    assert pickle.loads(pickle.dumps(scenario)).base_dir == tmp_path


def test_a_net_file_is_a_scenario(tmp_path: Path) -> None:
    net = tmp_path / "own.net.xml.gz"
    net.touch()
    assert load_scenario(net, {"agvs": 2}).garage_source == net


def test_a_scenario_survives_being_written_down() -> None:
    scenario = load_scenario(EXAMPLES[0])
    assert Scenario.model_validate_json(scenario.model_dump_json()).model_dump() == scenario.model_dump()


POISSON = BASE + "workload: {kind: poisson, "
ERRORS: list[tuple[str, str]] = [
    (BASE + "plannner: x", "plannner: unknown key; did you mean planner?"),
    (BASE + "xyz: 1", "xyz: unknown key; valid keys are agv, agvs,"),
    (BASE + "control: {perod_s: 1}", "control.perod_s: unknown key; did you mean period_s?"),
    (POISSON + "arrivals_per_h: 3, dwel_sigma: 1}", "workload.dwel_sigma: unknown key; did you mean dwell_sigma?"),
    (
        BASE + "workload: {kind: bursts, arrivals_per_h: 3, bursts: [{at_min: 1, carss: 2}]}",
        "workload.bursts[0].carss: unknown key; did you mean cars?",
    ),
    (BASE + "workload: {kind: bursts, arrivals_per_h: 3, bursts: []}", "workload.bursts: []: give at least 1"),
    ("agvs: 2", "garage: missing (a shipped garage's name"),
    ("garage: map1", "agvs: missing (number of AGVs)"),
    ("garage: map1\nagvs: 0", "agvs: 0: must be greater than or equal to 1"),
    ("garage: map1\nagvs: -3", "agvs: -3: must be greater than or equal to 1"),
    ("garage: map1\nagvs:", "agvs: None: must be a valid integer"),
    ("garage: map1\nagvs: 2.5", "agvs: 2.5: must be a valid integer"),
    ("garage: map1\nagvs: '2'", "agvs: '2': must be a valid integer"),
    ("garage: map1\nagvs: true", "agvs: True: must be a valid integer"),
    (BASE + "seed: -1", "seed: -1: must be greater than or equal to 0"),
    (BASE + "duration_s: -5", "duration_s: -5: must be greater than 0"),
    # what would not fit into 32 bits of planning steps
    (BASE + "agv: {empty_mps: 1.0e-9}", "agv.empty_mps: 1e-09: must be greater than or equal to 0.01"),
    (BASE + "agv: {braking: 1.0e-9}", "agv.braking: 1e-09: must be greater than or equal to 0.01"),
    (BASE + "agv: {loaded_turn_dps: 1.0e-300}", "agv.loaded_turn_dps: 1e-300: must be greater than or equal to 0.1"),
    (BASE + "agv: {lift_s: 1.0e+300}", "agv.lift_s: 1e+300: must be less than or equal to 86400"),
    (BASE + "control: {period_s: 1.0e+308}", "control.period_s: 1e+308: must be less than or equal to 86400"),
    (
        BASE + "faults: {stop: {per_h: 1, most_s: 1.0e+308}}",
        "faults.stop.most_s: 1e+308: must be less than or equal to",
    ),
    (BASE + "max_time_s: .inf", "max_time_s: inf: must be a finite number"),
    (BASE + "plant: sum", "plant: 'sum': give 'sumo' or 'discrete'"),
    (BASE + "control: {window_cells: 99, window_max: 11}", "control: give window_min <= window_cells <= window_max"),
    (BASE + "agv: {charge_below: 0.95}", "agv: give charge_below < charge_to"),
    (BASE + "agv: 3", "agv: 3: give a mapping of keys to values"),
    (BASE + "workload: {cars: 3}", "workload.kind: missing; give one of park_exit, poisson, bursts, zones, csv"),
    (BASE + "workload: {kind: poison}", "workload.kind: 'poison': give one of park_exit, poisson,"),
    (BASE + "workload: {kind: park_exit, cars: 0}", "workload.cars: 0: must be greater than or equal to 1"),
    (POISSON + "}", "workload: give either arrivals_per_h or arrivals_share_per_h"),
    (POISSON + "arrivals_per_h: -3}", "workload.arrivals_per_h: -3: must be greater than or equal to 0"),
    (
        BASE + "workload: {kind: zones, arrivals_per_h: 3, zones: {a: -1}}",
        "workload.zones.a: -1: must be greater than 0",
    ),
    (BASE + "planner: whcaa", "planner: 'whcaa': give one of whca"),
    (BASE + "planner: mine.py:plan", "planner: 'mine.py:plan': no such file"),
    (BASE + "dispatch: best", "dispatch: 'best': give one of nearest"),
    (BASE + "rules: none", "rules: 'none': give one of "),
    ("garage: map9\nagvs: 1", "garage: 'map9': give one of map1"),
    ("garage: my.net.xml\nagvs: 1", "garage: 'my.net.xml': no such file"),
    ("garage: map1\n agvs: 2", "line 2: not YAML: mapping values are not allowed here"),
    ("garage: [map1\n", "line 2: not YAML: "),
    ("garage: \t@", "line 1: not YAML: "),
    ("garage: map1\ngarage: map2\nagvs: 1", "line 2: not YAML: key 'garage' is given twice"),
    ("- map1", "['map1']: give a mapping of keys to values"),
    ("", "None: give a mapping of keys to values"),
]


@pytest.mark.parametrize(("text", "complaint"), ERRORS, ids=[complaint[:40] for _, complaint in ERRORS])
def test_each_mistake_is_one_line(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 's.yaml'}: {complaint}")
    assert "\n" not in message


def test_a_mistake_on_the_command_line_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^command line: agvs: -1: "):
        load(tmp_path, BASE, agvs=-1)


@pytest.mark.parametrize("source", ["map9", "nowhere.yaml", ".", ""])
def test_no_such_scenario(source: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario(source)
    assert "\n" not in str(caught.value)


def test_every_property_of_an_agv_can_be_set_and_has_the_plants_default() -> None:
    options = AgvConfig().model_dump()
    for field in dataclasses.fields(AgvType):
        assert options[field.name] == field.default
    assert agv_type(AgvConfig(length_m=4.6, empty_mps=2.0)) == AgvType(length_m=4.6, empty_mps=2.0)


def models_of(model: type[BaseModel], seen: set[type[BaseModel]]) -> set[type[BaseModel]]:
    from sumo_nets.fields import models_in

    seen.add(model)
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            if inner not in seen:
                models_of(inner, seen)
    return seen


def test_every_key_is_explained() -> None:
    models = models_of(Scenario, set())
    assert set(WORKLOADS.values()) <= models
    for model in models:
        for name, field in model.model_fields.items():
            assert field.description or name == "kind", f"{model.__name__}.{name}"


def test_the_schema_knows_every_profile() -> None:
    schema: dict[str, Any] = Scenario.model_json_schema()
    assert set(schema["properties"]["workload"]["discriminator"]["mapping"]) == set(WORKLOADS)


def test_reading_a_scenario_loads_nothing_heavy() -> None:
    code = (
        "import sys, parking_sim.cli, parking_sim.config\n"
        "heavy = {'numba', 'pandas', 'matplotlib', 'libsumo', 'duckdb'} & set(sys.modules)\n"
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
