"""The least room between bodies, told twice: by the check within each run, and from SUMO's floating car data alone.

The second witness reads ``fcd.xml.gz`` and the record's lifts and lowerings, makes polygons with shapely, and goes from
one step to the next by the two ends of each body, in parts of a few centimetres. It shares no line with the check. Runs
and table: ``python benchmarks/remake.py clearances``.
"""

from __future__ import annotations

import gzip
import math
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from docs_tables import Row, Rows, RunSet, Table, markdown
from numpy.typing import NDArray
from soak import faults

from analysis.tables import Run, load_run

#: Bodies further apart than this are not measured, and how far a body goes between two looks, metres.
REACH_M, PART_M = 4.0, 0.03
#: An empty AGV may be under a parked car whose axis is turned by less than this, with its nearer end so near the axis.
ALIGNED_DEG, ASIDE_M = 35.0, 0.3
LENGTH_M, WIDTH_M, CUSTOMER_WIDTH_M = 4.7, 2.0, 1.8

Points = NDArray[np.float64]


@dataclass
class Moment:
    """All bodies of one step: front and rear of each AGV, shape (2, 2), which are loaded, and the customers' cars."""

    time_s: float
    agvs: dict[int, Points] = field(default_factory=dict)
    loaded: set[int] = field(default_factory=set)
    customers: dict[str, Points] = field(default_factory=dict)


def moments(path: Path, start_s: float) -> Iterator[Moment]:
    """The steps in SUMO's floating car data; SUMO gives the middle of the front, and degrees clockwise from north."""
    with gzip.open(path) as stream:
        for _, step in ET.iterparse(stream):
            if step.tag != "timestep":
                continue
            moment = Moment(round(float(step.attrib["time"]) - start_s, 3))
            for vehicle in step:
                angle = math.radians(90.0 - float(vehicle.attrib["angle"]))
                front = np.array([float(vehicle.attrib["x"]), float(vehicle.attrib["y"])])
                ends = np.array([front, front - LENGTH_M * np.array([math.cos(angle), math.sin(angle)])])
                name = vehicle.attrib["id"]
                if name.startswith("agv"):
                    moment.agvs[int(name[3:])] = ends
                    if vehicle.attrib["type"] == "agv_loaded":
                        moment.loaded.add(int(name[3:]))
                else:
                    moment.customers[name] = ends
            step.clear()
            yield moment


def body(ends: Points, width_m: float = WIDTH_M) -> Any:
    """The polygon of a body from the middles of its two ends."""
    way = (ends[0] - ends[1]) / np.hypot(*(ends[0] - ends[1]))
    side = np.array([-way[1], way[0]]) * width_m / 2
    return shapely.Polygon([ends[0] + side, ends[0] - side, ends[1] - side, ends[1] + side])


def flipped(before: Points, now: Points) -> Points:
    """The ends of a body in the order in which they were before: an AGV that reverses changes front and rear."""
    straight, crossed = (np.hypot(*(before - other).T).max() for other in (now, now[::-1]))
    return now if straight <= crossed else now[::-1]


def between(a: Points, b: Points, t: float) -> Points:
    """The ends of a body on the way from one step to the next, at its true length."""
    ends: Points = a + t * (b - a)
    middle, way = ends.mean(axis=0), ends[0] - ends[1]
    half = way / np.hypot(*way) * LENGTH_M / 2
    return np.array([middle + half, middle - half])


def may_be_under(agv: Points, car: Points, loaded: bool) -> bool:
    """Whether an AGV is where it may be under a parked car, told in the car's own frame."""
    along = (car[0] - car[1]) / np.hypot(*(car[0] - car[1]))
    frame = np.array([[along[0], -along[1]], [along[1], along[0]]])
    seen = (agv - car.mean(axis=0)) @ frame
    if loaded:
        return bool(np.hypot(*seen.mean(axis=0)) <= ASIDE_M)
    turned = math.degrees(math.atan2(abs(seen[0, 1] - seen[1, 1]), abs(seen[0, 0] - seen[1, 0])))
    nearer = seen[np.argmin(np.abs(seen[:, 0]))]
    return turned <= ALIGNED_DEG and abs(nearer[1]) <= ASIDE_M


@dataclass
class Least:
    """The least room found so far between AGVs, to parked cars, and to customers' cars."""

    agvs: float = math.inf
    parked: float = math.inf
    customers: float = math.inf


def least_room(record: Run) -> Least:
    """The least room in a run by its floating car data."""
    assert record.folder is not None
    found, cars = Least(), initial_cars(record)
    events = record.events[record.events.kind.isin(("lift", "lower"))]
    slots = set(record.vertices[record.vertices.roles.str.contains("slot")].vertex)
    due = [row for row in events[["time_s", "kind", "agv", "car", "vertex"]].to_numpy().tolist() if row[4] in slots]
    last: Moment | None = None
    for moment in moments(record.folder / "fcd.xml.gz", record.meta["sumo_start_s"]):
        if moment.time_s > record.meta["simulated_s"]:
            break
        if last is not None and moment.time_s >= 0.0:
            _look(last, moment, cars, found)
        while due and due[0][0] <= moment.time_s:
            _, kind, agv, car, _ = due.pop(0)
            if kind == "lift":
                cars.pop(car, None)
            else:
                cars[car] = moment.agvs[agv]
        last = moment
    return found


def initial_cars(record: Run) -> dict[str, Points]:
    """The cars that stand there at the start, their fronts at the ends of their slots' lanes."""
    started = record.events[record.events.kind == "car_initial"]
    names, heads = record.vertices.vertex.tolist(), record.edges["head"].tolist()
    ends: dict[str, Points] = {}
    for edge, x, y in record.shapes[["edge", "x_m", "y_m"]].to_numpy().tolist():
        if edge >= 0:
            name = names[heads[int(edge)]]
            ends[name] = np.array([*ends.get(name, np.empty((0, 2)))[-1:], [x, y]])
    cars = {}
    for car, vertex in started[["car", "vertex"]].to_numpy().tolist():
        tail, head = ends[vertex]
        way = (head - tail) / np.hypot(*(head - tail))
        cars[car] = np.array([head, head - LENGTH_M * way])
    return cars


def _look(before: Moment, now: Moment, cars: Mapping[str, Points], found: Least) -> None:
    """What the bodies do from one step to the next."""
    pairs = {n: (before.agvs.get(n, ends), flipped(before.agvs.get(n, ends), ends)) for n, ends in now.agvs.items()}
    moved = {n: bool((a != b).any()) for n, (a, b) in pairs.items()}
    for n, way in pairs.items():
        for m, other in pairs.items():
            if m < n and (moved[n] or moved[m]):
                found.agvs = min(found.agvs, _nearest(way, other, found.agvs, None))
        if not moved[n]:
            continue
        for car in cars.values():
            found.parked = min(found.parked, _nearest(way, (car, car), found.parked, n in now.loaded))
        for name, ends in now.customers.items():
            there = (before.customers.get(name, ends), ends)
            found.customers = min(found.customers, _nearest(way, there, found.customers, None, CUSTOMER_WIDTH_M))


def _nearest(
    one: tuple[Points, Points], two: tuple[Points, Points], enough: float, under: bool | None, width_m: float = WIDTH_M
) -> float:
    """The least room between two bodies on their ways; ``under``: whether the AGV beside a parked car is loaded."""
    way_m = sum(float(np.hypot(*(b - a).T).max()) for a, b in (one, two))
    apart_m = float(np.hypot(*(one[1].mean(axis=0) - two[1].mean(axis=0)))) - math.hypot(LENGTH_M, WIDTH_M)
    if apart_m - way_m > min(enough, REACH_M):
        return math.inf
    if body(one[1]).distance(body(two[1], width_m)) - way_m > min(enough, REACH_M):
        return math.inf
    least = math.inf
    for t in np.linspace(0.0, 1.0, max(2, math.ceil(way_m / PART_M) + 1)):
        a, b = between(*one, t), between(*two, t)
        if under is None or not may_be_under(a, b, under):
            least = min(least, float(body(a).distance(body(b, width_m))))
    return least


# --- runs and table ---------------------------------------------------------------------------------------------------

CASES = (
    ("map1", 4, "token"), ("map1", 8, "whca"), ("map1", 8, "pibt"), ("map2", 8, "token"), ("map2", 13, "whca"),
    ("map2", 16, "pbs"), ("map3", 8, "token"), ("map3", 16, "whca"), ("map3", 24, "token"),
)  # fmt: skip


def run_clearances(case: Row) -> Row:
    """Five minutes with all faults, many times as frequent; the least room by both witnesses, metres."""
    from parking_sim.config import check_scenario
    from parking_sim.simulation import simulate

    traffic = {"kind": "poisson", "arrivals_per_h": 6 * case["agvs"], "dwell_median_min": 5, "initial_occupancy": 0.4}
    keys: dict[str, Any] = {"garage": case["garage"], "agvs": case["agvs"], "planner": case["planner"], "seed": 1}
    keys |= {"workload": {**traffic, "duration_min": case["minutes"]}, "duration_s": 60 * case["minutes"]}
    keys |= {"faults": faults(6.0), "record": {"replay": False}}
    with tempfile.TemporaryDirectory() as folder:
        simulate(check_scenario(keys, "clearances", Path()), Path(folder) / "run", fcd=True)
        record = load_run(Path(folder) / "run")
        by_fcd = least_room(record)
        inside = record.meta["least_clearance_m"]
        return {
            "in_run_m": inside,
            "fcd_m": min(by_fcd.agvs, by_fcd.parked),
            "fcd_agvs_m": by_fcd.agvs,
            "fcd_parked_m": by_fcd.parked,
            "fcd_customers_m": by_fcd.customers,
            "overlaps": record.meta["footprint_overlaps"],
        }


def show_clearances(rows: Rows) -> list[str]:
    """A line a run."""
    keys = ("in_run_m", "fcd_m", "fcd_agvs_m", "fcd_parked_m", "fcd_customers_m")
    lines = []
    for row in rows:
        metres = [f"{row[key]:.3f}" if row[key] < REACH_M else f"over {REACH_M:g}" for key in keys]
        lines.append([row["garage"], f"{row['agvs']}", f"`{row['planner']}`", *metres, f"{row['overlaps']}"])
    heads = ["garage", "AGVs", "planner", "in the run (m)", "from FCD (m)", "of it AGVs", "parked cars"]
    return markdown([*heads, "customers' cars", "overlaps"], lines)


SETS: Mapping[str, RunSet] = {
    "clearances": RunSet(
        "the least room by two witnesses, with all faults",
        tuple({"garage": g, "agvs": n, "planner": p, "minutes": 5.0} for g, n, p in CASES),
        run_clearances,
    )
}
TABLES: Mapping[str, Table] = {"clearances": Table("clearances", show_clearances)}
