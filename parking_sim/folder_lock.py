"""One process at a time writes to a folder: a lock on the folder itself, which dies with its process."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Self

from sumo_nets.errors import InputError


class FolderLock:
    """Holds a folder until it is released, or its process ends in whatever way.

    The folder gets no file for it. Where a file system has no locks nothing is locked.

    Args:
        folder: a folder that is there.

    Raises:
        InputError: another process, or another run of this one, holds it.
        OSError: it can't be opened.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder, FolderLock(Path(folder)):
        ...     try:
        ...         FolderLock(Path(folder))
        ...     except InputError as error:
        ...         print(str(error).replace(folder, "FOLDER"))
        --out: FOLDER: a run is being written there now; wait until it has ended, or give another folder
    """

    def __init__(self, folder: Path) -> None:
        self._handle = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise InputError(
                f"--out: {folder}: a run is being written there now; wait until it has ended, or give another folder"
            ) from None
        except OSError:
            return  # a network file system: each has its own words for having no locks on folders

    def release(self) -> None:
        """Let others have it. A second call does nothing."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def __enter__(self) -> Self:
        """Nothing more: it is held already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release it."""
        self.release()
