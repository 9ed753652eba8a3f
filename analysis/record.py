"""The record of a run: one row per event, per task, per sample and per planning call, written as Parquet.

Rows are kept as plain tuples while the run lasts, which costs about a microsecond each (five with a detail), and become
columns only when the run is written. The order of rows is the order in which they were added, files are compressed by
one thread, and columns of wall-clock time start with ``wall_``: two runs of one scenario and seed write the same bytes
but for these.

``COLUMNS`` explains every column, ``EVENTS`` every kind of event and what its detail holds, ``META`` the keys of
``run.json`` that the analysis reads.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from analysis.parquet import quoted
from analysis.run_files import METRICS_FILE, RUN_FILE
from controller.events import KINDS, EventKind
from controller.types import NO_AGV, AgvNumber, RequestNumber
from sumo_nets.whole_file import whole_file, write_whole

if TYPE_CHECKING:
    import duckdb
    import pandas as pd

    from controller.garage import TaskState
    from sumo_nets.graph import Graph
    from sumo_nets.numbering import Numbered, Vertex
    from sumo_nets.read import GarageNet

#: What an AGV can be doing in a step.
Activity = Literal["empty", "loaded", "turning", "lifting", "lowering", "waiting", "charging", "idle"]
ACTIVITIES: tuple[Activity, ...] = get_args(Activity)

#: Not reached: the value of a time that never came.
NAN = math.nan

_TIME = ("time_s", "DOUBLE", "s", "simulated time since the start of the run")
_AGV = ("agv", "INTEGER", "", "number of the AGV, -1 for none")
_CAR = ("car", "VARCHAR", "", "name of the car, empty for none")

#: Table -> (column, SQL type, unit, meaning), in the order of the file.
_SCHEMA: Mapping[str, tuple[tuple[str, str, str, str], ...]] = {
    "events": (
        _TIME,
        ("kind", "VARCHAR", "", "what happened, one of controller.events.KINDS"),
        _AGV,
        _CAR,
        ("vertex", "VARCHAR", "", "name of the vertex where it happened, empty for none"),
        ("detail", "VARCHAR", "", "JSON object with sorted keys, keys as in controller.events.KINDS; empty for none"),
    ),
    "tasks": (
        ("request", "INTEGER", "", "number of the request, in the order in which requests were made"),
        ("kind", "VARCHAR", "", "park or retrieve"),
        _CAR,
        (
            "state",
            "VARCHAR",
            "",
            "served; waiting at the end of the run; turned_away: the customer came with a car and found every slot"
            " taken or promised, or the queue too long; void: the request means nothing (to retrieve: the car is not"
            " there, was turned away, or is asked for already; to park: it is inside already)",
        ),
        ("reason", "VARCHAR", "", "why it was turned away or is void, figures after a colon; or why it still waits"),
        ("agv", "INTEGER", "", "number of the AGV that served it, -1 for none"),
        ("origin", "VARCHAR", "", "name of the vertex where the car was lifted, empty if never assigned"),
        ("destination", "VARCHAR", "", "name of the vertex where the car was lowered, empty if never assigned"),
        ("requested_s", "DOUBLE", "s", "the request was made; to park: the customer reached the garage"),
        ("at_bay_s", "DOUBLE", "s", "to park: the car stands at the bay; null to retrieve"),
        ("ready_s", "DOUBLE", "s", "to park: the customer has left the car; to retrieve: the car could be fetched"),
        ("assigned_s", "DOUBLE", "s", "an AGV was told to do it"),
        ("lifted_s", "DOUBLE", "s", "the car is on the AGV"),
        ("delivered_s", "DOUBLE", "s", "the car is lowered: in its slot (park) or at the bay (retrieve)"),
        ("done_s", "DOUBLE", "s", "served: to park: as delivered_s; to retrieve: the customer has driven off"),
    ),
    "trajectory": (
        _TIME,
        ("agv", "INTEGER", "", "number of the AGV"),
        ("x_m", "DOUBLE", "m", "centre of the AGV, to the east"),
        ("y_m", "DOUBLE", "m", "centre of the AGV, to the north"),
        ("angle_deg", "DOUBLE", "degree", "heading, counter-clockwise from east"),
        ("speed_mps", "DOUBLE", "m/s", "speed"),
        ("mode", "VARCHAR", "", "state of the AGV, one of controller.types.AgvMode"),
        ("car", "VARCHAR", "", "name of the car it carries, empty for none"),
        ("soc", "DOUBLE", "", "state of charge of the battery, 0 to 1"),
    ),
    "plans": (
        _TIME,
        ("agv", "INTEGER", "", "number of the AGV; it has a row for each sample in which its plan differs"),
        ("granted", "INTEGER", "", "vertices of the path from the first on that it owns, the others are planned"),
        ("path", "VARCHAR", "", "row numbers in vertices (from 0) apart by spaces: the last one reached, those ahead"),
    ),
    "timeline": (
        _TIME,
        ("queue", "INTEGER", "cars", "cars of customers that wait to reach a bay"),
        ("spilled", "INTEGER", "cars", "those of them that stand on the public street"),
        ("parked", "INTEGER", "cars", "cars in slots"),
        ("waiting_requests", "INTEGER", "requests", "requests that could be served but have no AGV yet"),
        ("active_agvs", "INTEGER", "AGVs", "AGVs that have a task"),
    ),
    "planning": (
        _TIME,
        ("agents", "INTEGER", "AGVs", "agents planned for in this call"),
        ("status", "VARCHAR", "", "solved, partial, infeasible or timeout"),
        ("window_steps", "INTEGER", "steps", "planning horizon"),
        ("expanded", "BIGINT", "states", "states taken from an open list and expanded"),
        ("heap_moves", "BIGINT", "moves", "pushes, pops and swaps inside heaps"),
        ("generated", "BIGINT", "states", "states put on an open list"),
        ("valid", "BIGINT", "states", "expanded states that were not stale"),
        ("slot_choice", "BIGINT", "states", "states expanded while choosing a slot, not counted in expanded"),
        ("wall_ms", "DOUBLE", "ms", "wall-clock time of the call; differs from run to run"),
        ("window_cells", "INTEGER", "moves", "planning horizon in moves; 0 under planners of complete paths"),
        ("score", "INTEGER", "", "congestion score that the window goes by; 0 under planners that meet no conflicts"),
        (
            "wait_edges",
            "INTEGER",
            "edges",
            "wait-for edges: met while planning (pipeline), or of AGVs that really wait",
        ),
        ("rings", "INTEGER", "rings", "strongly connected components of two or more among these"),
    ),
    "agvs": (
        ("agv", "INTEGER", "", "number of the AGV"),
        ("moves", "INTEGER", "edges", "edges driven (cells on a grid)"),
        ("distance_m", "DOUBLE", "m", "distance driven"),
        ("tasks", "INTEGER", "tasks", "tasks done"),
        ("empty_s", "DOUBLE", "s", "driving without a car"),
        ("loaded_s", "DOUBLE", "s", "driving with a car"),
        ("turning_s", "DOUBLE", "s", "turning in place"),
        ("lifting_s", "DOUBLE", "s", "lifting cars"),
        ("lowering_s", "DOUBLE", "s", "lowering cars"),
        ("waiting_s", "DOUBLE", "s", "standing with a task, for others or for a customer"),
        ("charging_s", "DOUBLE", "s", "charging"),
        ("idle_s", "DOUBLE", "s", "standing without a task"),
        ("energy_wh", "DOUBLE", "Wh", "energy drawn from the battery, without what was charged"),
    ),
    "vertices": (
        ("vertex", "VARCHAR", "", "name of the vertex"),
        ("x_m", "DOUBLE", "m", "position to the east"),
        ("y_m", "DOUBLE", "m", "position to the north"),
        ("roles", "VARCHAR", "", "what it is for (slot, bay, home, charger, refuge), joined by commas; empty: aisle"),
        ("numbers", "VARCHAR", "", "for each role its number among the places of that role, from 1, in layout order"),
    ),
    "edges": (
        ("tail", "INTEGER", "", "row number in vertices (from 0) where the edge begins"),
        ("head", "INTEGER", "", "row number in vertices where it ends; two-way lanes have two edges"),
        ("length_m", "DOUBLE", "m", "driving length"),
    ),
    "shapes": (
        ("line", "INTEGER", "", "number of the line; a line's rows are its points in driving direction"),
        ("edge", "INTEGER", "", "row number in edges (from 0) of which this is the lane, -1 for the street"),
        ("part", "VARCHAR", "", "of the street: entry, queue, exit, or empty for a stretch between; empty for lanes"),
        ("x_m", "DOUBLE", "m", "point of the centre line, to the east"),
        ("y_m", "DOUBLE", "m", "point of the centre line, to the north"),
    ),
}

#: The column dictionary: table -> column -> (unit, meaning).
COLUMNS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    table: {name: (unit, meaning) for name, _, unit, meaning in columns} for table, columns in _SCHEMA.items()
}

#: Kinds of event, and the keys of their details as ``kind.key`` -> (unit, meaning), as in ``COLUMNS``.
EVENTS: Mapping[str, tuple[str, str]] = {
    name: ("", meaning)
    for kind, what in KINDS.items()
    for name, meaning in [(kind, what.meaning), *((f"{kind}.{key}", text) for key, text in what.keys.items())]
}

#: Keys of ``run.json`` that the analysis knows -> (unit, meaning). Others are kept and shown as they are. Keys that
#: start with ``wall_`` differ from run to run.
META: Mapping[str, tuple[str, str]] = {
    "status": ("", "finished, time_limit, stalled, interrupted or failed"),
    "command": ("", "command line that repeats the run"),
    "scenario": ("", "the whole scenario as run, defaults filled in"),
    "inputs": ("", "SHA-256 of each file the run read: own ones by path in its folder, a shipped net's by name"),
    "seed": ("", "seed of the run"),
    "versions": ("", "name -> version of program, Python, SUMO and libraries"),
    "code": ("", "hash of the sources that took part, and of the versions"),
    "map": ("", "name of the layout"),
    "step_s": ("s", "simulated seconds a planning step lasts"),
    "sumo_start_s": ("s", "SUMO's clock when the run's began: the AGVs stand by then; null without SUMO"),
    "simulated_s": ("s", "simulated seconds"),
    "day_start_h": ("h", "hour of the day at which the run starts; null if the demand has no time of day"),
    "tasks_wanted": ("tasks", "tasks the scenario asks for"),
    "sumo_collisions": ("", "collisions SUMO reported"),
    "footprint_overlaps": ("", "pairs of bodies seen to overlap by the independent check"),
    "turns_under_cars": ("", "turns of an empty AGV under a parked car, in slots too short to drive straight out of"),
    "least_clearance_m": ("m", "least distance between two bodies in the run"),
    "cars_initial": ("cars", "cars parked before the first step"),
    "cars_arrived": ("cars", "cars that came and were let in"),
    "cars_parked": ("cars", "cars in slots at the end"),
    "cars_left": ("cars", "cars that have left"),
    "cars_in_transit": ("cars", "cars in the street, at bays and on AGVs at the end"),
    "wall_s": ("s", "wall-clock seconds: total, and its parts by name"),
    "witnesses": ("", "witness -> facts compared with SUMO's outputs, how many are wrong, and the first in words"),
    "held": ("", "what holds the work that is still open at the end, one sentence for each cause"),
    "audit": ("", "what the garage's own count of cars found wrong, in words; empty if nothing"),
    "digest": ("", "table -> SHA-256 of its rows without wall-clock columns; added by the recorder"),
}


@dataclass(frozen=True, slots=True)
class AgvSample:
    """Where an AGV is, for the trajectory table: metres, degrees counter-clockwise from east, metres a second."""

    agv: AgvNumber
    x_m: float
    y_m: float
    angle_deg: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class TaskRow:
    """One request and what became of it; the fields are the columns of ``COLUMNS["tasks"]``."""

    request: RequestNumber
    kind: str
    car: str
    state: TaskState
    _: KW_ONLY
    reason: str = ""
    agv: AgvNumber = NO_AGV
    origin: str = ""
    destination: str = ""
    requested_s: float = NAN
    at_bay_s: float = NAN
    ready_s: float = NAN
    assigned_s: float = NAN
    lifted_s: float = NAN
    delivered_s: float = NAN
    done_s: float = NAN


@dataclass(frozen=True, slots=True)
class AgvRow:
    """What one AGV did in the whole run; the fields are the columns of ``COLUMNS["agvs"]``."""

    agv: AgvNumber
    moves: int = 0
    distance_m: float = 0.0
    tasks: int = 0
    empty_s: float = 0.0
    loaded_s: float = 0.0
    turning_s: float = 0.0
    lifting_s: float = 0.0
    lowering_s: float = 0.0
    waiting_s: float = 0.0
    charging_s: float = 0.0
    idle_s: float = 0.0
    energy_wh: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningRow:
    """One planning call; the fields are the columns of ``COLUMNS["planning"]``."""

    time_s: float
    agents: int
    status: str
    window_steps: int
    expanded: int
    heap_moves: int
    generated: int
    valid: int
    slot_choice: int = 0
    wall_ms: float
    window_cells: int = 0
    score: int = 0
    wait_edges: int = 0
    rings: int = 0


_task_values = attrgetter(*(f.name for f in fields(TaskRow)))
_agv_values = attrgetter(*(f.name for f in fields(AgvRow)))
_planning_values = attrgetter(*(f.name for f in fields(PlanningRow)))


def _plain(value: object) -> object:
    """What JSON can't say itself: numpy numbers and arrays, sets (sorted), anything else as text."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


_compact = json.JSONEncoder(sort_keys=True, separators=(",", ":"), default=_plain).encode


class Recorder:
    """Collects the rows of one run; ``write`` puts them into a folder."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[Any, ...]]] = {table: [] for table in _SCHEMA}
        self._event = self._rows["events"].append
        self._samples = self._rows["trajectory"].extend

    def event(
        self, time_s: float, kind: EventKind, agv: AgvNumber = NO_AGV, car: str = "", vertex: str = "", **detail: object
    ) -> None:
        """Something happened.

        Args:
            time_s: simulated seconds.
            kind: one of ``controller.events.KINDS``.
            agv: number of the AGV, -1 for none.
            car: name of the car.
            vertex: name of the vertex.
            detail: what ``KINDS`` names for this kind; finite numbers, texts, lists and dictionaries of these.
        """
        self._event((time_s, kind, agv, car, vertex, _compact(detail) if detail else ""))

    def task(self, row: TaskRow) -> None:
        """One request, at the end of the run."""
        self._rows["tasks"].append(_task_values(row))

    def agv(self, row: AgvRow) -> None:
        """What one AGV did, at the end of the run."""
        self._rows["agvs"].append(_agv_values(row))

    def sample(
        self,
        time_s: float,
        samples: Sequence[AgvSample],
        modes: Sequence[str],
        cars: Sequence[str],
        socs: Sequence[float],
    ) -> None:
        """Where all AGVs are.

        Args:
            time_s: simulated seconds.
            samples: position, heading and speed of each AGV.
            modes, cars, socs: state, carried car ("" for none) and state of charge of each, in the same order.

        Raises:
            ValueError: if the sequences differ in length.
        """
        self._samples(
            [
                (time_s, s.agv, s.x_m, s.y_m, s.angle_deg, s.speed_mps, mode, car, soc)
                for s, mode, car, soc in zip(samples, modes, cars, socs, strict=True)
            ]
        )

    def timeline(
        self, time_s: float, queue: int, spilled: int, parked: int, waiting_requests: int, active_agvs: int
    ) -> None:
        """Counts at one moment; each holds until the next one. See ``COLUMNS["timeline"]``."""
        self._rows["timeline"].append((time_s, queue, spilled, parked, waiting_requests, active_agvs))

    def planning(self, row: PlanningRow) -> None:
        """One planning call."""
        self._rows["planning"].append(_planning_values(row))

    def floor(self, graph: Graph) -> None:
        """The garage, once per run: with it a record can be drawn and replayed by itself."""
        roles: Numbered[Vertex, list[tuple[str, str]]] = [[] for _ in graph.names]
        for role, vertices in graph.roles.items():
            for number, v in enumerate(vertices, start=1):
                roles[v].append((role, str(number)))
        self._rows["vertices"] = [
            (name, float(x), float(y), ",".join(role for role, _ in has), ",".join(number for _, number in has))
            for name, (x, y), has in zip(graph.names, graph.xy, roles, strict=True)
        ]
        self._rows["edges"] = list(zip(graph.tail.tolist(), graph.head.tolist(), graph.length_m.tolist(), strict=True))

    def shapes(self, garage: GarageNet) -> None:
        """Where lanes and street run, once per run, after ``floor``."""
        street = garage.street
        parts = {street.entry_edge: "entry", street.queue_edge: "queue", street.exit_edge: "exit"} if street else {}
        lines = [(e, "", shape) for e, shape in enumerate(garage.shapes)]
        lines += [(-1, parts.get(name, ""), shape) for name, shape in garage.street_shapes.items()]
        self._rows["shapes"] = [
            (number, edge, part, x, y) for number, (edge, part, shape) in enumerate(lines) for x, y in shape.tolist()
        ]

    def plan(self, time_s: float, agv: AgvNumber, granted: int, path: Sequence[Vertex]) -> None:
        """An AGV's plan has changed. See ``COLUMNS["plans"]``."""
        self._rows["plans"].append((time_s, agv, granted, " ".join(map(str, path))))

    def add(self, table: str, row: tuple[Any, ...]) -> None:
        """A row as ``rows`` gives it."""
        self._rows[table].append(row)

    def rows(self, table: str) -> Sequence[tuple[Any, ...]]:
        """The rows of a table so far, in the order of ``COLUMNS[table]``."""
        return self._rows[table]

    def columns(self, table: str) -> dict[str, NDArray[Any]]:
        """A table so far as arrays: numbers, or objects for text; NaN where a time was not reached."""
        rows = self._rows[table]
        values: Sequence[Sequence[Any]] = list(zip(*rows, strict=True)) if rows else [()] * len(_SCHEMA[table])
        return {
            name: np.array(column, dtype=_DTYPES[sql])
            for (name, sql, _, _), column in zip(_SCHEMA[table], values, strict=True)
        }

    def write(self, folder: Path, meta: Mapping[str, object], metrics: Mapping[str, object] | None = None) -> None:
        """Write all tables, the metrics and ``run.json`` into a folder, which is made if need be.

        Each file appears whole or not at all, and ``run.json`` comes last: a folder that has it has everything.

        Args:
            folder: where to.
            meta: see ``META``; numbers that are not finite become null.
            metrics: what goes into ``metrics.json``; None writes none.

        Raises:
            OSError: if the folder can't be written.
        """
        import duckdb

        folder.mkdir(parents=True, exist_ok=True)
        digest = {}
        with duckdb.connect(config={"threads": 1}) as connection:
            for table in _SCHEMA:
                arrays = self.columns(table)
                digest[table] = _digest(arrays)
                _write_parquet(connection, table, arrays, folder / f"{table}.parquet")
        if metrics is not None:
            write_json(folder / METRICS_FILE, metrics)
        write_json(folder / RUN_FILE, {**meta, "digest": digest})


_DTYPES: Mapping[str, Any] = {"DOUBLE": np.float64, "INTEGER": np.int32, "BIGINT": np.int64, "VARCHAR": object}


def _write_parquet(
    connection: duckdb.DuckDBPyConnection, table: str, arrays: dict[str, NDArray[Any]], path: Path
) -> None:
    """One table to one file. NaN becomes null; the casts give empty columns of text their type."""
    casts = ", ".join(f"CAST({name} AS {sql}) AS {name}" for name, sql, _, _ in _SCHEMA[table])
    connection.register("recorded", arrays)
    with whole_file(path) as part:
        connection.execute(
            f"COPY (SELECT {casts} FROM recorded) TO {quoted(str(part))} (FORMAT parquet, COMPRESSION zstd)"
        )
    connection.unregister("recorded")


def wrong_columns(table: str, frame: pd.DataFrame) -> str:
    """Which column a table lacks, or has with values of another kind; "" if it is as a run writes it."""
    for name, sql, _, _ in _SCHEMA[table]:
        if name not in frame:
            return f"has no column {name}: another version, or another program, wrote it"
        kinds = "O" if sql == "VARCHAR" else "fiu"
        if len(frame) and frame[name].dtype.kind not in kinds and str(frame[name].dtype) not in ("str", "string"):
            return f"{name} is {frame[name].dtype}: a run writes {sql}"
    return ""


def digest_of(table: str, frame: pd.DataFrame) -> str:
    """The digest of a table that was read back, as :meth:`Recorder.write` takes it."""
    try:
        return _digest({name: _array(frame[name], sql) for name, sql, _, _ in _SCHEMA[table]})
    except (TypeError, ValueError):  # text where there is none in a run's table
        return ""


def _array(column: pd.Series[Any], sql: str) -> NDArray[Any]:
    return column.to_numpy(dtype=_DTYPES[sql])


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of a table's names and values, in order, without the wall-clock columns."""
    total = hashlib.sha256()
    for name, column in arrays.items():
        if name.startswith("wall_"):
            continue
        total.update(f"{name}:{len(column)};".encode())
        total.update("\0".join(column).encode() if column.dtype == object else column.tobytes())
    return total.hexdigest()


def write_json(path: Path, value: Mapping[str, object]) -> None:
    """Write a JSON object with sorted keys, whole or not at all. Numbers that are not finite become null.

    Args:
        path: file to write.
        value: what to write; numpy values, sets and tuples are understood, other objects become text.

    Raises:
        OSError: if the file can't be written.
    """
    write_whole(path, json.dumps(_finite(value), sort_keys=True, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _finite(value: object) -> object:
    """The same value with null for numbers that JSON can't hold."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    return _finite(_plain(value))
