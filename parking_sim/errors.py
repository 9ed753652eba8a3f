"""What the command line says in one line: input that a user can put right, and a run that came to no end."""

from __future__ import annotations

from sumo_nets.errors import InputError

__all__ = ["InputError", "RunFailedError"]


class RunFailedError(RuntimeError):
    """A run that ended without a record, with the reason in one line.

    Example:
        >>> import tempfile
        >>> import parking_sim as ps
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     try:
        ...         ps.sweep([], folder)
        ...     except ps.RunFailedError:
        ...         print("nothing was run")
        nothing was run
    """
