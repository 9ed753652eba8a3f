"""The failure of a run, which the command line says in one line; bad input is ``sumo_nets.errors.InputError``."""

from __future__ import annotations


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
