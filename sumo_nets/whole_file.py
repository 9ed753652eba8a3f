"""Files that are written whole or not at all: under another name in the same folder, to the disk, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Names of files that are not whole yet begin with this; a killed process leaves them behind.
PART = ".part-"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to be written by whatever takes a path.

    Args:
        path: the file; one that is there stays as it is until the new one is whole.

    Yields:
        Where to write it: a name with the same ending in the same folder.

    Raises:
        OSError: it can't be written; nothing is left behind then.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with whole_file(Path(folder) / "figures.csv") as part:
        ...         _ = part.write_text("a,b")
        ...     [path.name for path in Path(folder).iterdir()]
        ['figures.csv']
    """
    part = path.with_name(f"{PART}{os.getpid()}-{path.name}")
    try:
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        if error.filename in (None, str(part)):  # a disk that is full names no file
            error.filename = str(path)  # the name that the user knows
        raise
    finally:
        with suppress(OSError):
            part.unlink()


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file.

    Args:
        path: the file.
        content: bytes, or text to be written as UTF-8.

    Returns:
        The path.

    Raises:
        OSError: it can't be written; nothing is left behind then.
    """
    with whole_file(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
