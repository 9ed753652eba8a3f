"""How search kernels are compiled: without counting references, as they only work on what they are handed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

#: ``_nrt`` is numba's runtime, which allocates arrays and counts references.
_OPTIONS: dict[str, Any] = {"cache": True, "_nrt": False}


def kernel(function: F) -> F:
    """Compile a function that works in place and makes no array of its own.

    numba counts a reference, atomically, for each array that a tuple of arrays holds, wherever the tuple is handed on
    or taken apart; in searches over tables that took two thirds of the time. Whoever calls a kernel holds its arrays
    until it returns, so that nothing has to be counted.

    Args:
        function: returns numbers alone. If it makes an array numba refuses to compile it: use ``njit`` there.

    Returns:
        The compiled function; its machine code is kept on disk.
    """
    compiled: F = njit(**_OPTIONS)(function)
    return compiled
