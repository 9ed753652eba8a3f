"""The files SUMO starts from: the AGVs with their types, and a configuration that anybody can open in sumo-gui."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from controller.types import AgvNumber, RequestNumber
from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.numbering import Numbered, numbered
from sumo_nets.whole_file import write_whole

if TYPE_CHECKING:
    from sumo_nets.read import GarageNet

#: SUMO vehicle types.
EMPTY, LOADED = "agv_empty", "agv_loaded"
CUSTOMER_IN, CUSTOMER_OUT = "customer_in", "customer_out"

_COLORS = {EMPTY: "40,160,90", LOADED: "220,120,30", CUSTOMER_IN: "60,110,220", CUSTOMER_OUT: "150,80,190"}


def agv_name(agv: AgvNumber) -> str:
    """SUMO id of an AGV."""
    return f"agv{agv}"


def customer_name(request: RequestNumber) -> str:
    """SUMO id of the car of one request. A car that comes back has another request, so that no two cars share an id."""
    return f"customer{request}"


def request_of(customer: str) -> RequestNumber:
    """Number of the request whose car has this SUMO id."""
    return RequestNumber(int(customer.removeprefix("customer")))


def write_run(
    folder: Path, garage: GarageNet, start_edges: Numbered[AgvNumber, str], agv_type: AgvType, seed: int, step_s: float
) -> Path:
    """Write ``agvs.rou.xml`` and ``run.sumocfg``.

    Opened on its own the configuration shows the garage with the AGVs at home; it writes no outputs, so that looking at
    a run does not overwrite its files.

    Args:
        folder: where; made if needed.
        garage: the net; referred to relative to ``folder``.
        start_edges: SUMO edge on which each AGV stands.
        agv_type: what the AGVs can do.
        seed: SUMO's seed.
        step_s: seconds a step lasts.

    Returns:
        Path of the configuration.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["<routes>", _agv_type(EMPTY, agv_type, False), _agv_type(LOADED, agv_type, True)]
    lines += [_customer_type(CUSTOMER_IN), _customer_type(CUSTOMER_OUT)]
    for i, edge in numbered(start_edges):
        lines.append(
            f'    <vehicle id="{agv_name(i)}" type="{EMPTY}" depart="0" departPos="last" departSpeed="0">\n'
            f'        <route edges={quoteattr(edge)}/>\n        <stop lane={quoteattr(edge + "_0")} duration="1e9"/>\n'
            "    </vehicle>"
        )
    write_whole(folder / "agvs.rou.xml", "\n".join([*lines, "</routes>\n"]))
    options = {
        "net-file": _relative(garage.net_file, folder),
        "additional-files": _relative(garage.additional_file, folder),
        "route-files": "agvs.rou.xml",
        "step-length": f"{step_s:g}",
        "seed": str(seed),
        "time-to-teleport": "-1",
        "collision.action": "warn",
        "collision.check-junctions": "true",
        "default.speeddev": "0",
        "no-step-log": "true",
        "duration-log.disable": "true",
    }
    rows = "".join(f"    <{key} value={quoteattr(value)}/>\n" for key, value in options.items())
    config = folder / "run.sumocfg"
    write_whole(config, f"<configuration>\n{rows}</configuration>\n")
    return config


def output_options(folder: Path, fcd: bool) -> list[str]:
    """SUMO options for the outputs of a run, all in its folder."""
    options = ["--tripinfo-output", str(folder / "tripinfo.xml"), "--tripinfo-output.write-unfinished", "true"]
    options += ["--stop-output", str(folder / "stops.xml"), "--stop-output.write-unfinished", "true"]
    options += ["--statistic-output", str(folder / "statistics.xml")]
    return [*options, "--fcd-output", str(folder / "fcd.xml.gz")] if fcd else options


def _relative(path: Path | str, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder.resolve())).as_posix()
    except ValueError:  # another drive
        return Path(path).resolve().as_posix()


def _agv_type(name: str, agv_type: AgvType, loaded: bool) -> str:
    mass = agv_type.empty_kg + (agv_type.car_kg if loaded else 0.0)
    parameters = {
        "has.battery.device": "true",
        "device.battery.capacity": f"{agv_type.battery_wh:g}",
        "device.battery.chargeLevel": f"{agv_type.battery_wh:g}",
        "constantPowerIntake": f"{agv_type.idle_w:g}",
        "rotatingMass": "0",
        "frontSurfaceArea": "3",
        "airDragCoefficient": "0.5",
        "rollDragCoefficient": "0.02",
        "radialDragCoefficient": "0",
        "maximumPower": "10000",
        "propulsionEfficiency": "0.8",
        "recuperationEfficiency": "0.3",
    }
    rows = "".join(f'        <param key="{key}" value="{value}"/>\n' for key, value in parameters.items())
    return (
        f'    <vType id="{name}" vClass="tram" length="{agv_type.length_m:g}" width="{agv_type.width_m:g}"'
        f' height="{1.6 if loaded else 0.3:g}" minGap="0" mass="{mass:g}" maxSpeed="{agv_type.speed_mps(loaded):g}"'
        f' accel="{agv_type.accel(loaded):g}" decel="{agv_type.braking:g}" emergencyDecel="{agv_type.braking:g}"'
        f' carFollowModel="Krauss" sigma="0" speedDev="0" emissionClass="Energy/default" color="{_COLORS[name]}">\n'
        f"{rows}    </vType>"
    )


def _customer_type(name: str) -> str:
    return (
        f'    <vType id="{name}" vClass="passenger" length="4.7" width="1.8" minGap="1" maxSpeed="8.3" speedDev="0"'
        f' color="{_COLORS[name]}"/>'
    )
