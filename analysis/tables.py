"""Records as pandas tables. Columns are those of ``analysis.record.COLUMNS``; pandas is loaded on first use."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.journal import read_journal
from analysis.json_files import FOREIGN, read_meta, read_rows
from analysis.parquet import parquet_rows
from analysis.record import COLUMNS, Recorder, wrong_columns
from analysis.run_files import JOURNAL
from sumo_nets.errors import InputError
from sumo_nets.wording import cut

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["COLUMNS", "Run", "load_run", "recorded_run"]


@dataclass(frozen=True, repr=False)
class Run:
    """One run: what was asked (``meta``) and its tables, each read when first looked at.

    Attributes:
        name: name of the run: its folder's name.
        meta: content of ``run.json``, keys as in ``analysis.record.META``.
        read: gives a table by name.
        folder: where the record is, None if it has not been written.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 5.0})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = ps.simulate(scenario, f"{folder}/run")
        ...     run: ps.Run = ps.load_run(f"{folder}/run")
        ...     run.trajectory["agv"].nunique(), run.meta["seed"]
        (4, 0)
    """

    name: str
    meta: Mapping[str, Any]
    read: Callable[[str], pd.DataFrame] = field(compare=False)
    folder: Path | None = None

    def __repr__(self) -> str:
        """The run's name, garage, status and simulated seconds."""
        ended = f"{self.meta.get('status')} after {self.meta.get('simulated_s', math.nan):g} s"
        return f"<Run {self.name}: {self.meta.get('map', 'unknown garage')}, {ended}>"

    @cached_property
    def variant(self) -> str:
        """Name of the variant of the sweep to which the run belongs; "" if it belongs to none."""
        plan = self.folder.resolve().parent.parent / "sweep.json" if self.folder is not None else None
        if plan is None or not plan.is_file():
            return ""
        rows = read_rows(plan, "runs", ("run",))
        return next((str(row.get("variant", "")) for row in rows if row["run"] == self.name), "")

    @cached_property
    def events(self) -> pd.DataFrame:
        """One row per event."""
        return self.read("events")

    @cached_property
    def tasks(self) -> pd.DataFrame:
        """One row per request."""
        return self.read("tasks")

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """One row per AGV and sample."""
        return self.read("trajectory")

    @cached_property
    def plans(self) -> pd.DataFrame:
        """One row per AGV and sample in which its plan is new."""
        return self.read("plans")

    @cached_property
    def timeline(self) -> pd.DataFrame:
        """One row per sampled moment."""
        return self.read("timeline")

    @cached_property
    def planning(self) -> pd.DataFrame:
        """One row per planning call."""
        return self.read("planning")

    @cached_property
    def agvs(self) -> pd.DataFrame:
        """One row per AGV."""
        return self.read("agvs")

    @cached_property
    def vertices(self) -> pd.DataFrame:
        """One row per vertex of the garage; empty if the floor was not recorded."""
        return self.read("vertices")

    @cached_property
    def edges(self) -> pd.DataFrame:
        """One row per directed edge of the garage."""
        return self.read("edges")

    @cached_property
    def shapes(self) -> pd.DataFrame:
        """One row per point of a lane's or the street's centre line; empty if they were not recorded."""
        return self.read("shapes")

    def details(self, kind: str) -> pd.DataFrame:
        """The events of one kind, with the keys of their detail as columns instead of ``detail``.

        Args:
            kind: one of ``controller.events.KINDS``.

        Returns:
            Rows in the order of the record; without rows only the fixed columns are there.
        """
        import pandas as pd

        chosen = self.events[self.events["kind"] == kind].reset_index(drop=True)
        parsed = [json.loads(text) if text else {} for text in chosen["detail"]]
        return pd.concat([chosen.drop(columns="detail"), pd.DataFrame(parsed, index=chosen.index)], axis=1)


def load_run(folder: Path | str) -> Run:
    """Open the record of one run.

    Args:
        folder: what ``Recorder.write`` wrote.

    Returns:
        The run; tables are read when they are first used. Of one that was killed what its journal holds, with status
        "killed" and the last second recorded.

    Raises:
        FileNotFoundError: if there is no record in the folder.
        InputError: the record is damaged. A table that is damaged raises it when it is first used.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = ps.simulate(scenario, f"{folder}/first")
        ...     run = ps.load_run(f"{folder}/first")
        ...     len(run.tasks), run
        (61, <Run first: map1, time_limit after 60 s>)
    """
    folder = Path(folder)
    path = folder / "run.json"
    if not path.is_file() and (folder / JOURNAL).is_file():
        recorder, time_s = read_journal(folder)
        return recorded_run(recorder, {"status": "killed", "simulated_s": time_s}, folder.resolve().name)
    if not path.is_file():
        raise FileNotFoundError(f"no record of a run in {folder} (run.json is missing)")
    return Run(folder.resolve().name, read_meta(path), partial(read_table, folder), folder)


def recorded_run(recorder: Recorder, meta: Mapping[str, Any], name: str = "run") -> Run:
    """The same view of a record that has not been written.

    Args:
        recorder: rows so far.
        meta: what would go into ``run.json``.
        name: name of the run.

    Returns:
        The run.
    """
    import pandas as pd

    return Run(name, meta, lambda table: pd.DataFrame(recorder.columns(table)))


def read_table(folder: Path, table: str) -> pd.DataFrame:
    """One table of one folder, rows in the order of the file.

    Raises:
        InputError: it is missing or damaged, or lacks a column.
    """
    import duckdb

    path = folder / f"{table}.parquet"
    try:
        with duckdb.connect(config={"threads": 1}) as connection:
            frame: pd.DataFrame = connection.execute(f"SELECT * EXCLUDE (filename) FROM {parquet_rows([path])}").df()
    except duckdb.Error as error:
        why = cut(str(error)) if path.is_file() else "it is missing"
        raise InputError(f"{path}: {FOREIGN}: {why}") from None
    if wrong := wrong_columns(table, frame):
        raise InputError(f"{path}: {wrong}")
    return frame
