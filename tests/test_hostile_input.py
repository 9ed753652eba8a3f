"""Input that means harm: each is refused in few lines, soon, and without being read or laid out whole."""

from __future__ import annotations

import gzip
import os
import re
import socket
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from small_net import texts, write_net

from demand.csv_file import Csv
from demand.gate_logs.dialect import Dialect, read_movements
from demand.gate_logs.log import read_gate_log
from demand.profiles import find_profile
from parking_sim.cli import main
from parking_sim.config import check_scenario, load_scenario
from parking_sim.inputs import read_inputs
from parking_sim.sweep_plan import load_sweep, parse_seeds
from sumo_nets.errors import InputError
from sumo_nets.freespace.floorplan import load_plan
from sumo_nets.layout import load_layout
from sumo_nets.movingai import read_map
from sumo_nets.read import read_net
from sumo_nets.yaml_file import YamlError, parse_mapping

#: Seconds that a refusal takes at most, with room for a busy machine.
SOON_S = 5.0
YAML_READERS: tuple[Callable[[Path], object], ...] = (load_scenario, load_sweep, load_layout, load_plan)


@pytest.fixture(autouse=True)
def _soon() -> Iterator[None]:
    begin = time.perf_counter()
    yield
    assert time.perf_counter() - begin < SOON_S


def refused(action: Callable[[], object], said: str = "") -> str:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert said in message
    lines = message.split("\n")
    assert len(lines) <= 21
    assert all(line and line.isprintable() and len(line) < 4200 for line in lines)
    return message


def read_profile(path: Path) -> object:
    return find_profile(str(path))


def read_requests(path: Path) -> object:
    return Csv(path=str(path)).demand(61, 0, Path())


def read_log(path: Path) -> object:
    return read_movements(path, Dialect())


def laughs(inner: str, outer: str) -> str:
    """A kilobyte that stands for 10^12 values."""
    rows = [f"a0: &a0 {inner}"]
    rows += [f"a{k + 1}: &a{k + 1} {outer % ', '.join([f'*a{k}'] * 10)}" for k in range(12)]
    return "\n".join(rows)


@pytest.mark.parametrize("text", [laughs("[x]", "[%s]"), laughs("{x: 1}", "{<<: [%s]}"), "a: &a [*a]"])
def test_aliases_that_unfold_to_too_much_are_refused_by_every_reader_of_yaml(text: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    for read in (*YAML_READERS, read_profile):
        refused(lambda read=read: read(path), "alias")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 2024-13-45", "line 1: not YAML: '2024-13-45' is no date"),
        ("b: 1\na: !!int abc", "line 2: not YAML: 'abc' is no whole number"),
        ("a: " + "9" * 5000, "(5000 characters) is no whole number"),
        ("a: 0x" + "f" * 5000, "is too great a number"),
        ("a: !!bool x", "'x' is no truth value"),
        ("a: !!map x", "line 1: not YAML"),
        ('a: "\\U00FFFFFF"', "not YAML"),
        ("a: " + "[" * 100 + "]" * 100, "too many deep"),
        ("x" * 100_000, "... (100000 characters): give a mapping"),
    ],
)
def test_odd_scalars_are_told_with_their_line(text: str, said: str) -> None:
    with pytest.raises(YamlError, match=re.escape(said)):
        parse_mapping(text, "a: 1")


@pytest.mark.parametrize("kind", ["pipe", "folder", "socket", "device", "large"])
def test_only_plain_files_of_a_fit_size_are_opened(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's name is short
    for name in ("x.yaml", "x.net.xml", "x.csv"):
        path = Path("/dev/zero") if kind == "device" else Path(name)
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "folder":
            path.mkdir()
        elif kind == "socket":
            socket.socket(socket.AF_UNIX).bind(str(path))
        elif kind == "large":
            with path.open("wb") as file:
                file.truncate(10**12)
        readers = {".yaml": (*YAML_READERS, read_profile), ".csv": (read_requests, read_log, read_map)}
        for read in readers.get(Path(name).suffix, (read_net,)):
            if kind != "device" or read not in (load_scenario, read_profile, read_net):  # by its name no file of theirs
                refused(lambda read=read, path=path: read(path))


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "a/" * 5000, "\ud800", "x" * 10_000_000])
def test_names_that_no_file_has_are_refused(name: str, tmp_path: Path) -> None:
    data = {"agvs": 1, "garage": "map1"}
    for key, value in (("garage", f"{name}.net.xml"), ("planner", f"{name}.py:plan"), ("planner", name)):
        refused(lambda key=key, value=value: check_scenario({**data, key: value}, "s.yaml", tmp_path), key)
    refused(lambda: find_profile(f"{name}.yaml", tmp_path))
    csv = {**data, "workload": {"kind": "csv", "path": name}}
    refused(lambda: check_scenario(csv, "s.yaml", tmp_path).workload.demand(61, 0, tmp_path))


def test_sweeps_are_refused_by_number_before_they_are_laid_out(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    keys = ("agvs", "seed_", "control.period_s", "agv.lift_s", "agv.lower_s", "step_s")
    grid = "\n".join(f"  {key}: {list(range(1, 101))}" for key in keys)
    path.write_text(f"base: map1\ngrid:\n{grid}\n")
    refused(lambda: load_sweep(path), "1000000000000 variants with 1 seeds are 1000000000000 runs: give at most")
    for seeds in ("1..2000000000", "1..1000000000000", "1" * 5000, "1..9" + ",1..90000" * 3):
        refused(lambda seeds=seeds: parse_seeds(seeds))
    for grid, said in (("{1: [2]}", "1: "), ("{2024-01-01: [2]}", "2024-01-01: "), ("{agvs: [2024-01-01]}", "agvs: ")):
        path.write_text(f"base: map1\ngrid: {grid}\n")
        refused(lambda: load_sweep(path), said)


def png(width: int, height: int, data: bytes) -> bytes:
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", data), (b"IEND", b""))
    rows = (struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(rows)


PLAN = """name: hall
slots: [{box: [8, 0, 56, 8], opens: south}]
bays: [{box: [0, 8, 4, 24], opens: east}]
homes: [{box: [50, 20, 60, 30], opens: west}]
picture: {file: walls.png, metres_per_pixel: 0.1}
street: {from: [-8, 30], to: [-8, 0]}
"""


@pytest.mark.parametrize("side", [8001, 60_000, 2**31 - 1])
def test_a_picture_is_refused_by_its_declared_size(side: int, tmp_path: Path) -> None:
    (tmp_path / "walls.png").write_bytes(png(side, side, zlib.compress(bytes(100))))
    (tmp_path / "plan.yaml").write_text(PLAN)
    refused(lambda: load_plan(tmp_path / "plan.yaml"), "at most 8000 pixels a side")


def test_a_picture_of_noise_and_a_forest_of_pillars_are_no_walls(tmp_path: Path) -> None:
    rows = bytes(b for y in range(200) for b in (0, *(255 * ((x + y) % 2) for x in range(200))))
    (tmp_path / "walls.png").write_bytes(png(200, 200, zlib.compress(rows)))
    (tmp_path / "plan.yaml").write_text(PLAN)
    refused(lambda: load_plan(tmp_path / "plan.yaml"), "more than 5000 walls")
    forest = "outline: [[0, 0], [60, 0], [60, 30]]\npillars: [{from: [0, 0], to: [5000, 5000], every: 1, size: 1}]"
    (tmp_path / "plan.yaml").write_text(re.sub("picture:.*", forest, PLAN))
    refused(lambda: load_plan(tmp_path / "plan.yaml"), "more than 5000 walls")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<net ", '<!DOCTYPE net [<!ENTITY a "ha">]><net ', "DOCTYPE net: nets have none"),
        ("<net ", '<!DOCTYPE net SYSTEM "file:///etc/passwd"><net ', "DOCTYPE net: nets have none"),
        ('encoding="UTF-8"', 'encoding="no-such"', "no-such"),
        ('encoding="UTF-8"', 'encoding="shift_jis"', "spoilt.net.xml"),
        ('encoding="UTF-8"', 'encoding="UTF-16"', "not XML"),
        ('value="0"', f'value="{"9" * 5000}"', "a whole number is valid"),
        (' speed="', ' speed="nan" x="', "speed is 'nan'"),
        (' length="', ' length="-1" y="', "length is '-1'"),
        (' shape="', ' shape="1,1" z="', "two points x,y or more"),
        (' shape="', ' shape="nan,inf inf,inf" z="', "two points x,y or more"),
    ],
)
def test_odd_nets_are_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    head = texts()["net"][:60]
    if "encoding" in old and old not in head:
        old, new = head[: head.index("?>") + 2], f'<?xml version="1.0" {new}?>'
    lane = next(lane for lane in re.findall("<lane [^>]*>", texts()["net"]) if 'id=":' not in lane)
    change = (lane, lane.replace(old, new)) if old in lane else (old, new)
    refused(lambda: read_net(write_net(tmp_path, ("net", *change))), said)


def test_a_net_that_unpacks_to_more_than_any_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.net.xml.gz"
    path.write_bytes(gzip.compress(b"<net>" + b" " * 30_000_000, 9))
    (tmp_path / "bomb.add.xml").write_text("<additional/>")
    refused(lambda: read_net(path), "more text than any net")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("agvs", 10**18), ("duration_s", 1e15), ("max_time_s", 1e300), ("step_s", 1e-300),
        ("control", {"window_cells": 10**18}), ("control", {"period_s": 1e-300}), ("control", {"score_up": 10**30}),
        ("agv", {"empty_mps": 1e-300}), ("agv", {"length_m": 1e-300}), ("record", {"sample_s": 1e-300}),
        ("faults", {"commands": {"lost": 1 - 1e-16}}), ("faults", {"zone_stop": {"per_h": 1.0, "radius_m": 1e300}}),
    ],
)  # fmt: skip
def test_absurd_numbers_are_refused_by_their_field(key: str, value: object, tmp_path: Path) -> None:
    refused(lambda: check_scenario({"garage": "map1", "agvs": 1, key: value}, "s.yaml", tmp_path), f"s.yaml: {key}")


def test_a_demand_that_no_memory_holds_is_refused_before_it_is_drawn(tmp_path: Path) -> None:
    flood = {"kind": "poisson", "arrivals_per_h": 10_000.0, "duration_min": 500_000.0}
    crowd = {**flood, "kind": "bursts", "duration_min": 1.0, "bursts": [{"at_min": 0.0, "cars": 10**6}] * 5}
    for workload in (flood, crowd):
        scenario = check_scenario({"garage": "map1", "agvs": 1, "workload": workload}, "s.yaml", tmp_path)
        refused(lambda scenario=scenario: scenario.workload.demand(61, 0, tmp_path), "cars would come")


def test_all_errors_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    data = {"garage": "map1", "agvs": -1, "seed": "x", "agv": {"empty_mps": 0.0}, "plannr": "token"}
    message = refused(lambda: check_scenario(data, "s.yaml", tmp_path))
    assert {line.split(": ")[1] for line in message.split("\n")} == {"agvs", "seed", "agv.empty_mps", "plannr"}
    path = tmp_path / "log.csv"
    path.write_text("time_s,kind,car\n-1,park,a\n2,fly,b\n" + "x,park,c\n" * 50)
    lines = refused(lambda: Csv(path="log.csv").demand(61, 0, tmp_path)).split("\n")
    assert [line.split(": ")[1] for line in lines[:2]] == ["row 2", "row 3"]
    assert lines[20] == "and 32 more"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,event,car\n1001-05-04 07:00,in,A\n2024-05-04 08:00,out,A\n", "at most 3660 days are valid"),
        ("x," * 200_000 + "\n1,2\n", "no column for the time"),
        ("x" * 200_000 + "\n1,2\n", "no column for the time"),
        ("time,event\n" + "2024-99-99,in\n" * 50, "and 30 more"),
    ],
)
def test_odd_gate_logs_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text)
    refused(lambda: read_gate_log(tmp_path / "log.csv"), said)


def test_words_of_a_file_do_not_drive_a_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.yaml"
    path.write_text('garage: "\\e[2J\\e]0;owned\\a.net.xml"\nagvs: 1\n"\\e[31m": 1\n')
    with pytest.raises(SystemExit) as end:
        main(["run", str(path)])
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert "\x1b" not in said
    assert all(line.startswith("error: ") for line in said.splitlines())


def test_files_that_a_scenario_names_are_looked_at_before_they_are_copied(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.csv")
    data = {"garage": "map1", "agvs": 1, "workload": {"kind": "csv", "path": "log.csv"}}
    refused(lambda: read_inputs(check_scenario(data, "s.yaml", tmp_path)), "is a pipe, not a file")
