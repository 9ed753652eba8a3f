"""How search kernels are compiled: without counting references, as they only work on what they are handed."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
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


def forget_stale_code(root: Path, packages: Sequence[str]) -> None:
    """Delete the machine code of each file that has changed, or that imports one that has, however indirectly.

    numba looks at the file that a function is in, and at none of those that the functions are in which it calls: it
    would go on with the old code of these.

    Args:
        root: folder of the packages; machine code lies beside the sources.
        packages: names of the packages.
    """
    files = {file.relative_to(root).as_posix(): file for name in packages for file in (root / name).rglob("*.py")}
    times = {name: file.stat().st_mtime_ns for name, file in sorted(files.items())}
    seen = root / packages[0] / "__pycache__" / "kernels.json"
    with suppress(OSError):  # where nothing can be written no machine code lies either
        kept: dict[str, Any] = json.loads(seen.read_text(encoding="utf-8")) if seen.exists() else {}
        if kept.get("times") == times:
            return
        sources = {name: file.read_bytes() for name, file in files.items()}
        digests = {
            name: _digest(name, sources)
            for name, source in sources.items()
            if b"numba" in source or b"kernel" in source
        }
        for name, digest in digests.items():
            if kept.get("digests", {}).get(name) != digest:
                for code in files[name].parent.joinpath("__pycache__").glob(f"{files[name].stem}.*.nb[ci]"):
                    code.unlink(missing_ok=True)
        seen.parent.mkdir(exist_ok=True)
        seen.write_text(json.dumps({"times": times, "digests": digests}), encoding="utf-8")


def _digest(name: str, sources: Mapping[str, bytes]) -> str:
    """Hash of a source and of all that it imports."""
    reached, new = {name}, [name]
    while new:
        imported = _imported(sources[new.pop()], sources) - reached
        reached |= imported
        new += imported
    total = hashlib.sha256()
    for each in sorted(reached):
        total.update(each.encode() + sources[each])
    return total.hexdigest()


def _imported(source: bytes, sources: Mapping[str, bytes]) -> set[str]:
    """The sources that a source names in its imports."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {file for name in names if (file := name.replace(".", "/") + ".py") in sources}


# before the first kernel is compiled, whoever imports it: a script that plans without parking_sim, too
forget_stale_code(Path(__file__).parents[1], ("controller", "sumo_nets", "parking_sim"))
