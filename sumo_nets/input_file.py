"""Files of a user's are looked at before they are opened, and are never read beyond what such a file may have."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MEGABYTE = 1_000_000
_KINDS = {
    stat.S_IFDIR: "is a folder, not a file",
    stat.S_IFIFO: "is a pipe, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
    stat.S_IFCHR: "is a device, not a file",
    stat.S_IFBLK: "is a device, not a file",
}


def is_file(path: Path) -> bool:
    """Whether a file is there; False also for a name that no file can have."""
    return os.path.isfile(path)  # the method of Path raises for names that are too long


def check_file(path: Path, most: int) -> None:
    """Look at a file before it is opened: a pipe would wait for ever, a device never end.

    Args:
        path: the file.
        most: bytes that such a file may have.

    Raises:
        OSError: there is none, it is no plain file, or has more; ``strerror`` says what.
    """
    try:
        found = path.stat()
    except ValueError:
        raise OSError(errno.EINVAL, "no file can have this name") from None
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, _KINDS.get(stat.S_IFMT(found.st_mode), "is no plain file"))
    if found.st_size > most:
        raise OSError(errno.EFBIG, _too_large(most))


def read_bytes(path: Path, most: int) -> bytes:
    """Read a file.

    Args:
        path: the file.
        most: bytes that such a file may have.

    Raises:
        OSError: it can't be read, see :func:`check_file`.
    """
    check_file(path, most)
    with path.open("rb") as file:
        data = file.read(most + 1)  # a file of /proc has more than its size says
    if len(data) > most:
        raise OSError(errno.EFBIG, _too_large(most))
    return data


def read_text(path: Path, most: int) -> str:
    """Read a file of UTF-8; arguments and errors as for :func:`read_bytes`, and UnicodeDecodeError if it is none."""
    return read_bytes(path, most).decode("utf-8-sig")


def _too_large(most: int) -> str:
    return f"is too large: at most {most / MEGABYTE:g} MB are valid"
