"""How search kernels are compiled: without counting references, as they only work on what they are handed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
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


def forget_stale_code(package: Path) -> None:
    """Delete the machine code kept for a package if any of its sources has changed since this was last called.

    numba looks at the file that a function is in, and at none of those that the functions are in which it calls: it
    would go on with the old code of these.

    Args:
        package: folder of the sources; machine code lies beside them.
    """
    sources = [(file.relative_to(package), file.stat()) for file in sorted(package.rglob("*.py"))]
    stamp = "\n".join(f"{name} {stat.st_mtime_ns} {stat.st_size}" for name, stat in sources)
    seen = package / "__pycache__" / "kernels.stamp"
    with suppress(OSError):  # where nothing can be written no machine code lies either
        if seen.exists() and seen.read_text(encoding="utf-8") == stamp:
            return
        for code in (*package.rglob("*.nbi"), *package.rglob("*.nbc")):
            code.unlink(missing_ok=True)
        seen.parent.mkdir(exist_ok=True)
        seen.write_text(stamp, encoding="utf-8")


for _package in ("controller", "sumo_nets", "parking_sim"):
    forget_stale_code(Path(__file__).parents[1] / _package)
