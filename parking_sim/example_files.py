"""The example files that come with the program: scenarios, a layout, a sweep and planners."""

from __future__ import annotations

import shutil
from pathlib import Path

from sumo_nets.errors import InputError

_FOLDERS = ("examples", "scenarios")


def example_files() -> list[Path]:
    """Where the example files are, in the installed package."""
    folders = (Path(__file__).parent / name for name in _FOLDERS)
    return sorted(
        (path for folder in folders for path in folder.iterdir() if path.is_file()), key=lambda path: path.name
    )


def copy_examples(folder: Path) -> list[Path]:
    """Copy the example files.

    Args:
        folder: where to, made if need be.

    Returns:
        The copies.

    Raises:
        InputError: a file of that name is there already, or the folder can't be written; nothing is replaced.
    """
    copies = {path: folder / path.name for path in example_files()}
    if there := [copy.name for copy in copies.values() if copy.exists()]:
        raise InputError(f"--out: {folder}: holds {there[0]} already; give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [Path(shutil.copyfile(path, copy)) for path, copy in copies.items()]
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None
