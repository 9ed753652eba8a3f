"""Many runs as three tidy tables: one row per run, per task, per event.

Nothing but the small files of each run is read before a table is looked at. Tables come as pandas tables; over
thousands of runs a DuckDB relation reads only the columns and rows that a question needs::

    found = load_runs("runs/sweep")
    found.runs                                               # pandas
    found.relation("events").filter("kind = 'deadlock_found'").df()
    found.sql("SELECT agvs, avg(delivered_s - requested_s) FROM tasks JOIN runs USING (run) GROUP BY agvs").df()
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.damage import damage
from analysis.json_files import read_object, read_rows
from analysis.metrics import METRICS, run_metrics
from analysis.parquet import parquet_rows, quoted
from analysis.record import COLUMNS
from analysis.run_files import METRICS_FILE, RUN_FILE
from analysis.tables import load_run
from analysis.variants import Variant, by_scenario, flatten
from sumo_nets.errors import InputError

if TYPE_CHECKING:
    import duckdb
    import pandas as pd

#: Columns of the table ``runs`` that are neither keys of the scenario nor metrics -> (unit, meaning).
RUN_COLUMNS: Mapping[str, tuple[str, str]] = {
    "run": ("", "the run: its folder, from the folder that was loaded; the same in all tables"),
    "variant": ("", "what the run is one of, besides its seed: the name in its sweep, or the keys that differ"),
    "status": ("", "how it ended: finished, time_limit, stalled or interrupted"),
}


#: Variants that are named when runs are shown.
_SHOWN = 3


@dataclass(frozen=True, repr=False)
class Runs:
    """The records of many runs.

    Attributes:
        folders: each run's name in the tables -> the folder with its record.
        planned: each run's variant as its sweep has it; None if the runs are not those of a sweep.
        failures: the runs of a sweep that failed: ``run``, ``variant``, ``seed`` and ``error`` of each.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 5.0})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = ps.simulate(scenario, f"{folder}/run")
        ...     runs: ps.Runs = ps.load_runs(folder)
        ...     runs.sql("SELECT kind, count(*) AS n FROM tasks GROUP BY kind").df()
           kind   n
        0  park  61
    """

    folders: Mapping[str, Path]
    planned: Mapping[str, Variant] | None = None
    failures: tuple[Mapping[str, Any], ...] = ()

    @cached_property
    def variants(self) -> Mapping[str, Variant]:
        """Each run's variant: its sweep's, or made of the keys in which the scenarios differ."""
        return self.planned or by_scenario(_what_decides(self._metas))

    @property
    def varied(self) -> tuple[str, ...]:
        """The keys by which the variants are shown, in order."""
        return tuple(dict.fromkeys(key for variant in self.variants.values() for key in variant.shown))

    def only(self, runs: Sequence[str]) -> Runs:
        """Some of the runs, with their variants."""
        return Runs({run: self.folders[run] for run in runs}, {run: self.variants[run] for run in runs}, self.failures)

    def __repr__(self) -> str:
        """How many runs of which variants there are, and how many failed."""
        names = list(dict.fromkeys(variant.name for variant in self.variants.values()))
        shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return f"<Runs: {len(self.folders)} of {len(names)} variants ({shown}){failed}>"

    @cached_property
    def runs(self) -> pd.DataFrame:
        """One row per run: the scenario's keys, joined by dots, and the metrics."""
        return self.table("runs")

    @cached_property
    def tasks(self) -> pd.DataFrame:
        """One row per request: ``run``, and the columns of ``analysis.record.COLUMNS["tasks"]``."""
        return self.table("tasks")

    @cached_property
    def events(self) -> pd.DataFrame:
        """One row per event: ``run``, and the columns of ``analysis.record.COLUMNS["events"]``."""
        return self.table("events")

    def table(self, name: str) -> pd.DataFrame:
        """A table over all runs.

        Args:
            name: ``runs``, or a table of ``analysis.record.COLUMNS``.

        Returns:
            Rows in the order of the runs and of each record.

        Raises:
            InputError: a record is damaged.
        """
        import duckdb

        try:
            frame: pd.DataFrame = self.relation(name).df()
        except duckdb.Error as error:
            wrong = next((wrong for folder in self.folders.values() if (wrong := damage(folder))), "")
            if wrong:
                raise InputError(wrong) from error
            raise
        return frame

    def relation(self, name: str) -> duckdb.DuckDBPyRelation:
        """A table over all runs that is not read before it is asked for.

        Args:
            name: as for :meth:`table`.

        Returns:
            The DuckDB relation, to filter and to sum up; ``.df()`` makes it a pandas table.
        """
        return self._database.table("runs") if name == "runs" else self._database.view(name)

    def sql(self, query: str) -> duckdb.DuckDBPyRelation:
        """Ask in SQL; the tables have their names.

        Args:
            query: a SELECT.

        Returns:
            The answer as a relation.
        """
        return self._database.sql(query)

    @cached_property
    def _metas(self) -> Mapping[str, Mapping[str, Any]]:
        return {run: load_run(folder).meta for run, folder in self.folders.items()}

    def _row(self, run: str) -> dict[str, Any]:
        """The run's row of the table ``runs``."""
        meta, file = self._metas[run], self.folders[run] / METRICS_FILE
        known = read_object(file) if file.is_file() else run_metrics(load_run(file.parent))
        scenario = {
            key: json.dumps(value) if isinstance(value, list) else value
            for key, value in flatten(meta.get("scenario") or {}).items()
        }
        head = {"run": run, "variant": self.variants[run].name, "status": meta.get("status")}
        return {**head, **scenario, **{key: known.get(key) for key in METRICS}}

    @cached_property
    def _database(self) -> duckdb.DuckDBPyConnection:
        import duckdb

        database = duckdb.connect()
        frame = _runs_frame([self._row(run) for run in self.folders])
        database.register("frame", frame)
        database.execute("CREATE TABLE runs AS SELECT * FROM frame")
        database.unregister("frame")
        for table in COLUMNS:
            files = {run: (folder / f"{table}.parquet").resolve() for run, folder in self.folders.items()}
            recorded = {run: path for run, path in files.items() if path.is_file()}
            if recorded:
                database.execute(f"CREATE VIEW {table} AS {_over(recorded)}")
        return database


def load_runs(folder: Path | str) -> Runs:
    """Open all runs in a folder.

    Args:
        folder: folder of a sweep, of which the runs that belong to it and are done are taken; or any folder, of which
            all runs below it are.

    Returns:
        The runs; their tables are read when they are used.

    Raises:
        FileNotFoundError: if there is no run.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for agvs in (2, 4):
        ...         scenario = ps.load_scenario("map1", {"plant": "discrete", "agvs": agvs, "duration_s": 5.0})
        ...         _ = ps.simulate(scenario, f"{folder}/{agvs}")
        ...     runs = ps.load_runs(folder)
        ...     print(runs.runs[["variant", "status", "tasks_wanted"]])
          variant      status  tasks_wanted
        0  agvs=2  time_limit         122.0
        1  agvs=4  time_limit         122.0
    """
    folder = Path(folder)
    plan = folder / "sweep.json"
    if not plan.is_file():
        folders = {path.parent.relative_to(folder).as_posix(): path.parent for path in sorted(folder.rglob("run.json"))}
        return Runs(_some(folders, folder))
    rows = read_rows(plan, "runs", ("run",))
    folders = {row["run"]: folder / "runs" / row["run"] for row in rows}
    done = {run: path for run, path in folders.items() if (path / RUN_FILE).is_file()}
    named = {row["run"]: row for row in rows if row["run"] in done and "variant" in row}
    try:
        planned = {run: Variant(str(row["variant"]), dict(row["shown"])) for run, row in named.items()}
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{plan}: runs: a sweep writes the variant of each as shown: [[key, value], ...]") from None
    return Runs(_some(done, folder), planned, _failures(folder / "failures.json"))


def _some(folders: Mapping[str, Path], folder: Path) -> Mapping[str, Path]:
    if not folders:
        raise FileNotFoundError(f"no run in {folder}")
    return folders


def _failures(path: Path) -> tuple[Mapping[str, Any], ...]:
    return tuple(read_rows(path, "failures", ("run", "variant", "error"))) if path.is_file() else ()


def _runs_frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    import pandas as pd

    frame = pd.DataFrame(rows)
    scenario = [column for column in frame if column not in RUN_COLUMNS and column not in METRICS]
    scenario.sort(key=lambda column: ("." in str(column), str(column)))
    frame = frame[[*RUN_COLUMNS, *scenario, *METRICS]]
    for column in scenario:
        kinds = {type(value) for value in frame[column] if value is not None and value == value}
        if len(kinds) > 1 and not kinds <= {int, float}:
            frame[column] = [None if value is None else str(value) for value in frame[column]]
    return frame.astype(dict.fromkeys(METRICS, float))


def _what_decides(metas: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Each run's scenario without its seed; with hashes of its files where files changed under the same names."""
    scenarios = {run: {**(meta.get("scenario") or {}), "seed": None} for run, meta in metas.items()}
    hashes = {
        run: {name: digest[:8] for name, digest in (meta.get("inputs") or {}).items()} for run, meta in metas.items()
    }
    read = {json.dumps([scenarios[run], hashes[run]], sort_keys=True) for run in metas}
    if len(read) > len({json.dumps(scenario, sort_keys=True) for scenario in scenarios.values()}):
        return {run: {**scenario, "inputs": hashes[run]} for run, scenario in scenarios.items()}
    return scenarios


def _over(files: Mapping[str, Path]) -> str:
    """The query for one table over all runs, each with its file."""
    named = ", ".join(f"({quoted(str(file))}, {quoted(run)})" for run, file in files.items())
    return (
        f"SELECT names.run, rows.* EXCLUDE (filename) FROM {parquet_rows(list(files.values()))} AS rows"
        f" JOIN (VALUES {named}) AS names(file, run) ON rows.filename = names.file"
    )
