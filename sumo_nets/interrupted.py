"""Interrupts that come while a compiled kernel is loaded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def as_interrupts() -> Iterator[None]:
    """Within, a ``SystemError`` that an interrupt has caused is raised as that interrupt.

    numba loads a kernel through C code, which turns whatever the handler of a signal raises there into a
    ``SystemError``: Ctrl-C, the signals that end a run, and the end of a planner's time.

    Example:
        >>> try:
        ...     with as_interrupts():
        ...         raise SystemError("a result with an exception set") from KeyboardInterrupt()
        ... except KeyboardInterrupt:
        ...     print("interrupted")
        interrupted
    """
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, Exception):
            cause = cause.__cause__ or cause.__context__
        if cause is None:
            raise
        raise cause from None
