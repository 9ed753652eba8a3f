"""Every reader of files, for :mod:`fuzz`: files of the repository's own to spoil, and a call that reads them."""

from __future__ import annotations

import gzip
import io
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from analysis.damage import readable
from analysis.explain import explain
from analysis.metrics import run_metrics
from analysis.run_files import JOURNAL
from analysis.tables import load_run
from demand.csv_file import Csv
from demand.gate_logs.dialect import Dialect
from demand.gate_logs.fit import fit_profile
from demand.gate_logs.log import read_gate_log
from demand.gate_logs.requests import requests_of
from demand.profile_traffic import ProfileTraffic
from demand.profiles import PROFILES, write_profile
from parking_sim.assembly import assemble
from parking_sim.config import load_scenario
from parking_sim.stepwise import Simulation
from parking_sim.sweep_plan import load_sweep
from sumo_nets.build import build_net
from sumo_nets.check import check_net
from sumo_nets.freespace.floorplan import load_plan
from sumo_nets.layout import load_layout
from sumo_nets.movingai import read_map, read_scenario
from sumo_nets.plan import plan_garage
from sumo_nets.read import read_net

#: Name of a file -> its content.
Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        name: what it reads.
        seeds: sets of files that it takes.
        read: read the files of a folder.
    """

    name: str
    seeds: Callable[[], Iterator[Files]]
    read: Callable[[Path], object]


def _shipped(package: str, folder: str, ending: str) -> Iterator[tuple[str, bytes]]:
    for path in sorted(files(package).joinpath(folder).iterdir(), key=lambda path: path.name):
        if path.name.endswith(ending):
            yield path.name, path.read_bytes()


_FULL = b"""garage: map1
agvs: 3
bays: 2
plant: discrete
planner: whca
planner_options: {}
seed: 3
duration_s: 60.0
homes: null
workload: {kind: bursts, bursts: [{at_min: 1.0, cars: 3}], arrivals_per_h: 9.0, duration_min: 10.0}
control: {period_s: 5.0, window_cells: 11, replanning: both, stuck_s: 90.0, cbs_nodes: 64}
agv: {empty_mps: 1.5, length_m: 4.7, battery_wh: 5000.0, charge_below: 0.2}
customers: {handling_median_s: 40.0, balk_cars: 4}
faults: {stop: {per_h: 2.0}, travel_noise: 0.1, script: [{at_s: 5.0, kind: all_stop, for_s: 9.0}]}
record: {sample_s: 5.0, plans: false}
"""


def _scenarios() -> Iterator[Files]:
    log = dict(_shipped("parking_sim", "scenarios", "gate_log.csv"))
    for folder in ("scenarios", "examples"):
        for _, content in _shipped("parking_sim", folder, ".yaml"):
            if b"garage:" in content and b"grid:" not in content and b"pitch_m:" not in content:
                yield {"scenario.yaml": content, **({} if b"csv" not in content else log)}
    yield {"scenario.yaml": _FULL}


def _read_scenario(folder: Path) -> None:
    scenario = load_scenario(folder / "scenario.yaml")
    if scenario.garage.startswith("map1"):
        assemble(scenario)


def _layouts() -> Iterator[Files]:
    for package, folder in (("sumo_nets", "layouts"), ("parking_sim", "examples")):
        for _, content in _shipped(package, folder, ".yaml"):
            if b"aisles:" in content or b"picture:" in content:
                yield {"layout.yaml": content}


_PLAN = b"""name: hall
pitch_m: 8.1
outline: [[0, 0], [60, 0], [60, 30], [0, 30]]
walls:
  - [[20, 12], [26, 12], [26, 15], [20, 15]]
pillars:
  - {from: [8.1, 8.1], to: [56.7, 24.3], every: 8.1, size: 0.6}
slots:
  - {box: [8.1, 0, 56.7, 8.1], opens: south}
bays:
  - {box: [0, 8.1, 4, 24.3], opens: east, per_cell: 1}
homes:
  - {box: [50, 20, 60, 30], opens: west}
picture: {file: walls.png, metres_per_pixel: 0.1, threshold: 0.5}
street: {from: [-8, 30], to: [-8, 0]}
"""


@lru_cache
def _pictures() -> tuple[bytes, ...]:
    from PIL import Image

    pixels = np.full((60, 90), 255, dtype=np.uint8)
    pixels[10:20, 30:40] = 0
    found = []
    for mode in ("L", "RGB", "RGBA", "P", "1", "LA", "I;16"):
        target = io.BytesIO()
        image = Image.fromarray(pixels)
        (Image.fromarray(pixels.astype(np.uint16) * 257) if mode == "I;16" else image.convert(mode)).save(target, "PNG")
        found.append(target.getvalue())
    return tuple(found)


def _plans() -> Iterator[Files]:
    yield {"plan.yaml": _PLAN, "walls.png": _pictures()[0]}


def _walls() -> Iterator[Files]:
    for picture in _pictures():
        yield {"walls.png": picture}


def _read_walls(folder: Path) -> None:
    (folder / "plan.yaml").write_bytes(_PLAN)
    load_plan(folder / "plan.yaml")


def _profiles() -> Iterator[Files]:
    with tempfile.TemporaryDirectory() as folder:
        for profile in PROFILES.values():
            write_profile(profile, Path(folder) / "profile.yaml")
            yield {"profile.yaml": (Path(folder) / "profile.yaml").read_bytes()}


def _read_profile(folder: Path) -> None:
    workload = ProfileTraffic(name="profile.yaml")
    workload.day_start_h(folder)
    workload.demand(61, 1, folder)


_SWEEP = b"""base: {garage: map1_thesis, agvs: 2, plant: discrete, duration_s: 60.0}
grid:
  agvs: [1, 2]
  workload: {few: {kind: poisson, arrivals_per_h: 10.0}, many: {kind: poisson, arrivals_per_h: 60.0}}
list: [{name: one, planner: whca}, {planner: token, control.period_s: 4.0}]
seeds: 1..3, 9
"""


def _sweeps() -> Iterator[Files]:
    yield {"sweep.yaml": _SWEEP}
    for _, content in _shipped("parking_sim", "examples", ".yaml"):
        if b"grid:" in content:
            yield {"sweep.yaml": content}


def _requests() -> Iterator[Files]:
    for _, content in _shipped("parking_sim", "scenarios", "gate_log.csv"):
        yield {"log.csv": content}
    yield {"log.csv": b"time_s,kind,car,zone\n0,inside,a,\n5,retrieve,a,\n7.5,park,b,s\n9,retrieve,b,\n"}


_LOGS = (
    b"Zeitpunkt;Richtung;Kennzeichen\n"
    b"04.05.2024 07:00;Einfahrt;KA-1\n04.05.2024 09:30;Ausfahrt;KA-1\n13.05.2024 09:31;Einfahrt;\n",
    b"time,event,car\n2024-05-04T07:00:00Z,in,A 1\n2024-05-04T08:00:00Z,out,A 1\n2024-05-05T08:00:00Z,in,B\n",
    b"time,event,car\n1714806000,in,A\n1714809600,out,A\n1714896000,in,B\n",
    b"date,time,event,plate\n5/14/2024,1:07 PM,in,A\n5/14/2024,3:07 PM,out,A\n5/15/2024,11:59 PM,in,B\n",
    b"time\tevent\n04-May-2024 13:07\tin\n04-May-2024 14:07\tout\n",
)


def _gate_logs() -> Iterator[Files]:
    yield from ({"log.csv": content} for content in _LOGS)


def _read_log(folder: Path) -> None:
    log = read_gate_log(folder / "log.csv", Dialect())
    fit_profile(log, 500, "fuzz")
    requests_of(log)


@lru_cache
def _small_net() -> tuple[bytes, bytes]:
    layout = files("parking_sim").joinpath("examples", "loop.yaml")
    with tempfile.TemporaryDirectory() as folder:
        net, add = build_net(load_layout(Path(str(layout))), folder)
        return net.read_bytes(), add.read_bytes()


def _nets() -> Iterator[Files]:
    net, add = _small_net()
    yield {"a.net.xml": gzip.decompress(net), "a.add.xml": add}


def _packed_nets() -> Iterator[Files]:
    net, add = _small_net()
    yield {"a.net.xml.gz": net, "a.add.xml": add}


def _read_net(folder: Path) -> None:
    path = next(iter(folder.glob("*.net.xml*")))
    check_net(read_net(path), (4.7, 2.0), loads=False)


def _maps() -> Iterator[Files]:
    rows = "\n".join(("...@....", "..TT.ee.", "b......r", "........"))
    scen = "version 1\n0\ta.map\t8\t4\t0\t0\t3\t3\t6.0\n1\ta.map\t8\t4\t1\t3\t0\t2\t2.0\n"
    yield {"a.map": f"type octile\nheight 4\nwidth 8\nmap\n{rows}\n".encode(), "a.scen": scen.encode()}


def _read_map(folder: Path) -> None:
    read_scenario(folder / "a.scen", read_map(folder / "a.map"))


@lru_cache
def _record() -> tuple[dict[str, bytes], bytes]:
    """The files of a small run, and its journal before it ended."""
    keys = {"plant": "discrete", "agvs": 2, "duration_s": 180.0, "record": {"replay": False}}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        with Simulation(load_scenario("map1", keys), out) as run:
            while run.step():
                journal = (out / JOURNAL).read_bytes()
        return {path.name: path.read_bytes() for path in sorted(out.iterdir()) if path.is_file()}, journal


def _read_record(folder: Path) -> None:
    with readable(folder):
        explain(folder, None, None)
        run_metrics(load_run(folder))


READERS: Mapping[str, Reader] = {
    reader.name: reader
    for reader in (
        Reader("scenario", _scenarios, _read_scenario),
        Reader("layout", _layouts, lambda folder: plan_garage(load_layout(folder / "layout.yaml"))),
        Reader("floorplan", _plans, lambda folder: load_plan(folder / "plan.yaml")),
        Reader("picture", _walls, _read_walls),
        Reader("profile", _profiles, _read_profile),
        Reader("sweep", _sweeps, lambda folder: load_sweep(folder / "sweep.yaml")),
        Reader(
            "requests", _requests, lambda folder: Csv(path="log.csv", initial_cars=("KA-2207",)).demand(61, 0, folder)
        ),
        Reader("gate_log", _gate_logs, _read_log),
        Reader("net", _nets, _read_net),
        Reader("net_gz", _packed_nets, _read_net),
        Reader("movingai", _maps, _read_map),
        Reader("record", lambda: iter([_record()[0]]), _read_record),
        Reader("journal", lambda: iter([{JOURNAL: _record()[1]}]), _read_record),
    )
}
