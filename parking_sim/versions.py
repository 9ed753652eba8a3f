"""Which version of the program makes a record: the libraries that decide its outcome, and a hash of the code."""

from __future__ import annotations

import hashlib
import json
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

#: Modules of ``parking_sim`` that start runs but take no part in them: a change there leaves finished runs valid.
_AROUND_A_RUN = {
    "__init__", "__main__", "cli", "columns", "command_groups", "demo", "doctor", "example_files", "examples",
    "folders", "gate_logs", "library", "many_runs", "planner_check", "progress", "reproduce", "rerun", "routes",
    "shadowing", "sizing", "stepwise", "studies", "sweep_plan", "terminal", "tuning", "versions", "workers",
}  # fmt: skip
_OF_ANALYSIS = {"journal", "metrics", "parquet", "record", "tables"}


def versions() -> dict[str, str]:
    """Versions of the program, Python and the libraries that decide a run's outcome."""
    found = {"python": platform.python_version()}
    for package in ("parking-sim", "libsumo", "numpy", "numba", "networkx"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


@cache
def code_version() -> str:
    """Hash of the sources that take part in a run and of the versions of the libraries that decide its outcome."""
    root = Path(__file__).parent.parent
    sources = [path for name in ("controller", "demand", "sumo_nets") for path in (root / name).rglob("*.py")]
    own = root / "parking_sim"
    sources += [p for p in own.rglob("*.py") if p.relative_to(own).parts[0].removesuffix(".py") not in _AROUND_A_RUN]
    sources += [root / "analysis" / f"{name}.py" for name in _OF_ANALYSIS]
    total = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    for path in sorted(sources):
        total.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()[:16]
