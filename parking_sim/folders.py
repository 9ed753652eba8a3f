"""The folder of a run: whether it may be used is decided before anything heavy starts."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from analysis.record import COLUMNS
from analysis.run_files import INPUTS, JOURNAL, METRICS_FILE, RUN_FILE, SCENARIO_FILE, did_not_end, go_on
from parking_sim.config import NET_SUFFIXES, read_yaml
from parking_sim.folder_lock import FolderLock
from sumo_nets.errors import InputError
from sumo_nets.whole_file import PART

#: What is not written to a folder with these in its name, and why.
_UNREADABLE = {
    ",": "SUMO reads a comma as the end of a path",
    "%": "SUMO reads a per cent sign as the code of a character",
    "\\": "DuckDB reads a backslash as a sign of its own",
}
#: All that a run and its pages write, but for the user's own files in ``inputs/``.
WRITTEN = (
    RUN_FILE,
    JOURNAL,
    METRICS_FILE,
    SCENARIO_FILE,
    *(f"{table}.parquet" for table in COLUMNS),
    *("report.html", "replay.html"),
    *("agvs.rou.xml", "run.sumocfg", "tripinfo.xml", "stops.xml", "statistics.xml", "fcd.xml.gz"),
)


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
            FolderLock(folder).release()
            check_links(folder)
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
        InputError: they don't.
    """
    name = os.path.realpath(folder)
    if found := next((c for c in name if c in _UNREADABLE), None):
        raise InputError(f"--out: {folder}: {_UNREADABLE[found]}; give a folder without one")
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"--out: {folder}: DuckDB reads names in UTF-8; give such a folder, and set PYTHONUTF8=1 in the locale C"
        ) from None


def check_links(folder: Path) -> None:
    """Make sure that what a run writes to its folder stays there.

    Raises:
        InputError: a link leads elsewhere.
    """
    for path in (folder / INPUTS, folder / JOURNAL):
        if path.is_symlink():
            raise InputError(f"--out: {path}: is a link, and a run writes within its folder only; remove the link")


def clear_run(folder: Path) -> None:
    """Remove an earlier run's files, so that none of them is taken for the new run's.

    The folder counts as that of a run until the last file has gone, so that a kill meanwhile does no harm.

    Args:
        folder: a run's folder. One that is absent or holds no run is left as it is, and so is whatever a run does not
            write: other files, other folders, and other files in the folder of the inputs.

    Raises:
        OSError: something can't be removed.
    """
    if not ((folder / RUN_FILE).is_file() or (folder / JOURNAL).is_file()):
        return
    (folder / JOURNAL).touch()
    inputs = own_inputs(folder)
    for path in (*(folder / name for name in WRITTEN if name != JOURNAL), *inputs, *folder.glob(f"{PART}*")):
        path.unlink(missing_ok=True)
    with suppress(OSError):
        (folder / INPUTS).rmdir()
    (folder / JOURNAL).unlink()


def own_inputs(folder: Path) -> list[Path]:
    """The user's own files of which a run's folder keeps copies, by its scenario; none if that can't be read."""
    try:
        data = read_yaml(folder / SCENARIO_FILE)
    except InputError:
        return []
    workload = data.get("workload")
    named = [data.get("garage"), str(data.get("planner", "")).rpartition(":")[0]]
    named += list(workload.values()) if isinstance(workload, dict) else []
    kept = [name for name in named if isinstance(name, str) and Path(name).parent == Path(INPUTS)]
    for suffix in NET_SUFFIXES:
        kept += [f"{name.removesuffix(suffix)}.add.xml" for name in kept if name.endswith(suffix)]
    return [folder / name for name in kept if (folder / name).is_file()]


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
