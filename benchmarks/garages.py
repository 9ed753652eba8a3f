"""Random small garages: those that ``check-net`` accepts serve every request, the others are refused.

A number draws a garage: a corridor, a comb of dead ends, a loop, a grid of aisles or an open floor, one-way and
two-way, with slots on both sides or in the way, bays, homes, chargers and refuges anywhere, and a fleet of 1 to 5 AGVs
with its demand. Some cannot work: ``parking-sim check-net`` or the start of the run has to say so. The tests draw from
the same numbers. Runs and table: ``python benchmarks/remake.py garages``; to look at one garage:

    python benchmarks/garages.py 17                    its layout and what check-net says of it
    python benchmarks/garages.py 17 token discrete     a run
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from docs_tables import Row, Rows, RunSet, Table, groups, markdown, total

from parking_sim.config import Scenario, check_scenario
from parking_sim.simulation import simulate
from sumo_nets.build import build_net
from sumo_nets.check import check_net, describe_net
from sumo_nets.errors import InputError, NetError
from sumo_nets.generate import layout_yaml
from sumo_nets.layout import Layout, LayoutError, run_cells
from sumo_nets.plan import plan_garage
from sumo_nets.read import read_net

GARAGES = 300
#: Every tenth of them is also run in SUMO.
SUMO_EVERY = 10
PLANNERS = ("token", "whca", "pbs", "pibt")
#: Simulated seconds or ticks after which a run has failed.
_GIVE_UP_S = {"discrete": 4_000.0, "sumo": 20_000.0}
#: The first cell of all floors: the street needs some length before it.
_X, _Y = 2, 3
_SIDES = ("north", "south", "east", "west")

Cell = tuple[int, int]
Data = dict[str, Any]


@dataclass(frozen=True)
class Draw:
    """A garage and what happens in it.

    Attributes:
        layout: the garage.
        keys: keys of a scenario but for garage, planner and plant.
    """

    layout: Layout
    keys: Data


@lru_cache(maxsize=8)
def draw(number: int) -> Draw:
    """The garage of a number, always the same, with its fleet and demand."""
    rng = random.Random(number)
    floor = rng.choice((_corridor, _comb, _loop, _lattice, _open_floor))
    while (layout := _furnished(floor(rng), rng, f"random{number}")) is None:
        pass
    return Draw(layout, _keys(layout, rng))


def _corridor(rng: random.Random) -> Data:
    length = rng.randint(3, 7)
    return {"aisles": [_run((_X, _Y), (_X + length, _Y), "two")]}


def _comb(rng: random.Random) -> Data:
    """A spine along the street, and dead ends."""
    height = rng.randint(2, 5)
    aisles = [_run((_X, _Y), (_X, _Y + height), "two")]
    for y in range(_Y, _Y + height + 1, rng.randint(2, 3)):
        way = "one" if rng.random() < 0.03 else "two"
        aisles.append(_run((_X, y), (_X + rng.randint(1, 4), y), way))
    return {"aisles": aisles}


def _loop(rng: random.Random) -> Data:
    width, height = rng.randint(1, 5), rng.randint(1, 4)
    corners = [(_X, _Y), (_X + width, _Y), (_X + width, _Y + height), (_X, _Y + height)]
    way = rng.choice(("one", "two"))
    aisles = []
    for k, corner in enumerate(corners):
        ends = (corner, corners[(k + 1) % 4])
        odd = rng.random() < 0.1
        aisles.append(_run(*(ends[::-1] if odd and way == "one" else ends), "two" if odd else way))
    return {"aisles": aisles}


def _lattice(rng: random.Random) -> Data:
    """Rows and columns that cross, each one-way or two-way."""
    columns = [_X, *(_X + x for x in sorted(rng.sample(range(2, 7), rng.randint(1, 2))))]
    rows = [_Y, *(_Y + y for y in sorted(rng.sample(range(1, 6), rng.randint(1, 2))))]
    runs = [((_X, y), (columns[-1], y)) for y in rows] + [((x, _Y), (x, rows[-1])) for x in columns]
    aisles = [
        _run(*(run if rng.random() < 0.5 else run[::-1]), "one" if rng.random() < 0.25 else "two") for run in runs
    ]
    return {"aisles": aisles}


def _open_floor(rng: random.Random) -> Data:
    """A picture: some walls, some slots that an AGV may have to pass."""
    width, height = rng.randint(3, 5), rng.randint(2, 4)
    rows = ["#" * (_X + width)] * _Y
    for _ in range(height):
        rows.append("#" * _X + "".join(rng.choices(".#S", (0.84, 0.1, 0.06), k=width)))
    return {"picture": "\n".join(rows)}


def _run(start: Cell, to: Cell, way: str) -> Data:
    return {"from": list(start), "to": list(to), "way": way}


def _furnished(floor: Data, rng: random.Random, name: str) -> Layout | None:
    """A floor with places, each kept if it fits in; None if there is no room for a bay, a home and a slot."""
    cells = sorted(_cells(floor))
    if len(cells) < 3:
        return None
    made: Layout | None = None
    base: Data = {"name": name, "pitch_m": 7.0, "handover": "home", **floor}
    if rng.random() < 0.85:
        street = {"from": [0, max(y for _, y in cells) + 3], "to": [0, 0]}
        base |= {"handover": "bay", "bays": [_bay(cells, rng)], "street": street}
    for key, row in (("homes", _place(cells, rng, 0.3)), *_wanted(cells, rng)):
        more = {**base, key: [*base.get(key, ()), row]}
        fitting = None if key == "bays" and "street" not in base else _fitting(more)
        if fitting:
            base, made = more, fitting
        elif made is None:
            return None
    return made if made and plan_garage(made).roles["slot"] else None


def _fitting(data: Data) -> Layout | None:
    try:
        layout = Layout.model_validate(data)
        plan_garage(layout)
    except (LayoutError, ValueError):
        return None
    return layout


def _wanted(cells: Sequence[Cell], rng: random.Random) -> Iterator[tuple[str, Data]]:
    """Slots, and more of everything."""
    for _ in range(rng.randint(3, 14)):
        yield "slots", _slots(cells, rng)
    for _ in range(rng.randint(1, 12)):
        yield "homes", _place(cells, rng, 0.3)
    for _ in range(rng.choice((0, 0, 1, 2))):
        yield "bays", _bay(cells, rng)
    for _ in range(rng.randint(0, 3)):
        yield "chargers", _place(cells, rng, 0.3)
    for _ in range(rng.choice((0, 0, 1, 2, 3))):
        yield "refuges", _place(cells, rng, 0.0)


def _place(cells: Sequence[Cell], rng: random.Random, in_the_way: float) -> Data:
    side = "here" if rng.random() < in_the_way else rng.choice(_SIDES)
    return {"at": list(rng.choice(cells)), "side": side, **_pair(side, rng)}


def _bay(cells: Sequence[Cell], rng: random.Random) -> Data:
    """A bay towards the street."""
    x, y = rng.choice([cell for cell in cells if cell[0] == cells[0][0]])
    return {"at": [x, y], "side": rng.choice(("west", "west", "west", "here"))}


def _slots(cells: Sequence[Cell], rng: random.Random) -> Data:
    """Slots beside a few cells of a row, or one slot in the way."""
    x, y = start = rng.choice(cells)
    if rng.random() < 0.04:
        return {"at": list(start), "side": "here"}
    last = x
    while last < x + rng.randint(0, 4) and (last + 1, y) in cells:
        last += 1
    side = rng.choice((*_SIDES, "both"))
    sides = ["north", "south"] if side == "both" else [side]
    return {"from": [x, y], "to": [last, y], "side": sides, **_pair(side, rng)}


def _pair(side: str, rng: random.Random) -> Data:
    return {"per_cell": 2} if side != "here" and rng.random() < 0.3 else {}


def _cells(floor: Data) -> set[Cell]:
    """The cells on which one can drive and build."""
    if "picture" in floor:
        rows = floor["picture"].splitlines()
        return {(x, y) for y, row in enumerate(rows) for x, char in enumerate(row) if char == "."}
    ends = [(tuple(aisle["from"]), tuple(aisle["to"])) for aisle in floor["aisles"]]
    return {cell for start, to in ends for cell in run_cells(start, to)}


def _keys(layout: Layout, rng: random.Random) -> Data:
    """Fleet and demand: every car in and out again, or an hour of customers who ask for their own cars."""
    homes = sum(len(list(row.cells())) * len(row.side) * row.per_cell for row in layout.homes)
    keys: Data = {"agvs": min(rng.randint(1, 5), homes), "seed": rng.randint(0, 999)}
    if rng.random() < 0.5:
        keys["workload"] = {"kind": "park_exit"}
    else:
        share = rng.choice((0.0, 0.5, 1.0))
        keys["workload"] = {
            "kind": "poisson", "arrivals_per_h": 60, "dwell_median_min": 6, "initial_occupancy": share,
            "duration_min": 30,
        }  # fmt: skip
    if layout.chargers:
        # a load lasts for less than an hour
        keys["agv"] = {"battery_wh": 600.0, "charge_w": 10_000.0}
    return keys


@lru_cache(maxsize=8)
def net_of(number: int) -> Path:
    """The net of a garage, built once for all runs of a process."""
    return build_net(draw(number).layout, Path(tempfile.gettempdir()) / "parking-sim-garages")[0]


def scenario(number: int, planner: str, plant: str) -> Scenario:
    """A run of a garage that ends when all is served, or after a time in which all could have been served."""
    keys = {**draw(number).keys, "planner": planner, "plant": plant, "max_time_s": _GIVE_UP_S[plant]}
    keys |= {"garage": str(net_of(number)), "record": {"replay": False, "plans": False, "sample_s": 60.0}}
    return check_scenario(keys, f"garage {number}", Path())


def run(number: int, planner: str, plant: str) -> Data:
    """A run: how it ended, or why the garage was refused.

    Args:
        number: the garage's number.
        planner: a planner's name.
        plant: "discrete" or "sumo".

    Returns:
        ``status`` (that of the run, or "refused"), ``reason``, and figures of the run.
    """
    asked = draw(number).keys
    row: Data = {"agvs": asked["agvs"], "demand": asked["workload"]["kind"]}
    try:
        summary = simulate(scenario(number, planner, plant), None)
    except (InputError, NetError) as refusal:
        reason = str(refusal).removeprefix(f"{net_of(number)}: ")
        return row | {"status": "refused", "reason": reason} | dict.fromkeys(FIGURES, 0)
    kept = {key: summary.metrics[key] for key in FIGURES}
    return row | {"status": summary.status, "reason": "; ".join(summary.held)} | kept


#: Figures kept of each run.
FIGURES = ("tasks_done", "requests", "requests_waiting", "simulated_s", "deadlocks_found", "deadlocks_unresolved")


def is_good(row: Data) -> bool:
    """A run that served everybody, or a refusal."""
    left = row["requests_waiting"] or row["deadlocks_unresolved"]
    return (row["status"] == "finished" and not left) or row["status"] == "refused"


def run_garage(case: Row) -> Row:
    """A run of a garage."""
    return run(case["number"], case["planner"], case["plant"])


def show_garages(rows: Rows) -> list[str]:
    """A line a plant and planner."""
    lines = []
    for (plant, planner), own in groups(rows, "plant", "planner").items():
        runs = [row for row in own if row["status"] != "refused"]
        left = [str(row["number"]) for row in runs if not is_good(row)]
        lines.append(
            [
                "SUMO" if plant == "sumo" else "ticks",
                f"`{planner}`",
                f"{len(own)}",
                f"{len(own) - len(runs)}",
                f"{len(runs) - len(left)} of {len(runs)}",
                ", ".join(left) or "none",
                f"{total(runs, 'tasks_done'):,}",
                f"{total(runs, 'deadlocks_found')}, {total(runs, 'deadlocks_unresolved')}",
            ]
        )
    headings = ["plant", "planner", "garages", "refused", "finished", "not finished", "tasks done"]
    return markdown([*headings, "deadlocks found, left"], lines)


SETS: Mapping[str, RunSet] = {
    "garages": RunSet(
        "random small garages, in ticks, and every tenth in SUMO",
        tuple(
            {"number": number, "planner": planner, "plant": plant}
            for plant, every in (("discrete", 1), ("sumo", SUMO_EVERY))
            for number in range(0, GARAGES, every)
            for planner in PLANNERS
        ),
        run_garage,
    )
}

TABLES: Mapping[str, Table] = {"garages": Table("garages", show_garages)}


def main(words: Sequence[str]) -> None:
    """Show a garage, and run it if a planner and a plant are given."""
    number = int(words[0])
    print(layout_yaml(draw(number).layout), draw(number).keys)
    net = read_net(net_of(number))
    print(describe_net(net), *check_net(net), sep="\n")
    if len(words) > 1:
        print(run(number, words[1], words[2]))


if __name__ == "__main__":
    main(sys.argv[1:])
