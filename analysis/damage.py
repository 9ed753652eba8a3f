"""A record that fails to be read is compared with its digests: what is damaged is told in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from analysis.json_files import read_meta
from analysis.record import COLUMNS, digest_of
from analysis.run_files import RUN_FILE
from analysis.tables import read_table
from sumo_nets.errors import InputError


@contextmanager
def readable(folder: Path) -> Iterator[None]:
    """Within, whatever fails because a record is damaged is told as such; other failures stay as loud as they are.

    Args:
        folder: of a run, or of a sweep.

    Raises:
        InputError: something failed, and a table is not what the run wrote.
    """
    try:
        yield
    except (InputError, OSError):
        raise
    except Exception:
        runs = [path.parent for path in (folder / RUN_FILE, *folder.glob(f"runs/*/{RUN_FILE}")) if path.is_file()]
        wrong = next((wrong for run in runs if (wrong := damage(run))), "")
        if wrong:
            raise InputError(wrong) from None
        raise


def damage(folder: Path) -> str:
    """What is not as the run wrote it, in one line; "" if everything is.

    Args:
        folder: of a run that has ended.
    """
    try:
        written = read_meta(folder / RUN_FILE).get("digest") or {}
        for table in COLUMNS:
            if digest_of(table, read_table(folder, table)) != written.get(table):
                return f"{folder}/{table}.parquet: is damaged: it is not the table that the run wrote"
    except InputError as error:
        return str(error)
    return ""
