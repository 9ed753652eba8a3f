"""The folder of a run: whether it may be used is decided before anything heavy starts."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from parking_sim.errors import InputError

#: A folder that holds this file holds a run. It is the last file of a run to be written.
RUN_FILE = "run.json"
#: A folder that holds this one holds a run that has not ended, see ``parking_sim.journal``.
JOURNAL = "journal.jsonl"
#: Folder within a run's, or a sweep's, for copies of the user's own files that it reads.
INPUTS = "inputs"

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
            if _did_not_end(folder):
                if not force:
                    raise InputError(f"--out: {_go_on(folder)}, or give --force to replace it")
            elif not (folder / RUN_FILE).is_file():
                raise InputError(f"--out: {folder}: holds files that are not a run's; give another folder")
            elif not force:
                raise InputError(
                    f"--out: {folder}: holds an earlier run; give another folder, or --force to replace it"
                )
        _try_writing(folder)
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None


def check_ended(folder: Path) -> None:
    """Make sure that a folder does not hold a run that was killed.

    Raises:
        InputError: it does.
    """
    if _did_not_end(folder):
        raise InputError(_go_on(folder))


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


def _did_not_end(folder: Path) -> bool:
    return (folder / JOURNAL).is_file() and not (folder / RUN_FILE).is_file()


def _go_on(folder: Path) -> str:
    return f"{folder}: holds a run that did not end; go on with it: parking-sim resume {folder}"


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
