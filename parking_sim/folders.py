"""The folder of a run: whether it may be used is decided before anything heavy starts."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from analysis.run_files import INPUTS, JOURNAL, RUN_FILE, did_not_end, go_on
from sumo_nets.errors import InputError

#: What is not written to a folder with these in its name, and why.
_UNREADABLE = {
    ",": "SUMO reads a comma as the end of a path",
    "%": "SUMO reads a per cent sign as the code of a character",
    "\\": "DuckDB reads a backslash as a sign of its own",
}
_SUFFIXES = {".parquet", ".json", ".jsonl", ".html", ".xml", ".gz", ".sumocfg", ".yaml", ".svg", ".png"}


def check_folder(folder: Path, force: bool) -> None:
    """Make sure that a run may be written to a folder, and leave everything as it was.

    Args:
        folder: where the run shall go; it need not exist.
        force: an earlier run there may be replaced.

    Raises:
        InputError: it can't be written, holds an earlier run and ``force`` is not set, or holds something else; or SUMO
            or DuckDB can't name it.
    """
    check_path(folder)
    try:
        if folder.is_dir() and any(folder.iterdir()):
            if did_not_end(folder):
                if not force:
                    raise InputError(f"--out: {go_on(folder)}, or give --force to replace it")
            elif not (folder / RUN_FILE).is_file():
                raise InputError(f"--out: {folder}: holds files that are not a run's; give another folder")
            elif not force:
                raise InputError(
                    f"--out: {folder}: holds an earlier run; give another folder, or --force to replace it"
                )
        _try_writing(folder)
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None


def check_path(folder: Path) -> None:
    """Make sure that SUMO and DuckDB understand the name of a folder.

    Raises:
        InputError: it doesn't.
    """
    if found := next((c for c in str(folder.resolve()) if c in _UNREADABLE), None):
        raise InputError(f"--out: {folder}: {_UNREADABLE[found]}; give a folder without one")


def clear_run(folder: Path) -> None:
    """Remove an earlier run's files, so that none of them is taken for the new run's.

    Args:
        folder: a run's folder. One that is absent or holds no run is left as it is, and so are folders within but that
            of the inputs, and files of kinds that a run doesn't write.
    """
    if (folder / RUN_FILE).is_file() or (folder / JOURNAL).is_file():
        for path in (folder / RUN_FILE, *folder.iterdir()):
            if path.is_file() and path.suffix in _SUFFIXES:
                path.unlink(missing_ok=True)
        shutil.rmtree(folder / INPUTS, ignore_errors=True)


def _try_writing(folder: Path) -> None:
    """Make the folder and a file in it, then remove what was made."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    made: list[Path] = []
    try:
        for path in reversed(missing):
            path.mkdir()
            made.append(path)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for path in reversed(made):
            path.rmdir()
