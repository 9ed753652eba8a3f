"""Whether this installation can run, and what to do if not."""

from __future__ import annotations

import importlib
import importlib.metadata
import platform
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from parking_sim.shadowing import hidden_packages

#: Distributions whose versions are worth knowing in a question about a run.
_PACKAGES = ("libsumo", "numpy", "numba", "networkx", "pandas", "duckdb", "pydantic", "matplotlib", "typer", "rich")

#: Extra of this package -> a distribution of it, and what it adds.
EXTRAS = {
    "nets": ("eclipse-sumo", "netconvert to build nets, and sumo-gui to watch runs"),
    "cluster": ("distributed", "sweeps on a dask cluster: sweep --scheduler"),
    "tune": ("optuna", "tuning of parameters: tune"),
}


@dataclass(frozen=True, slots=True)
class Look:
    """One thing looked at.

    Attributes:
        what: its name.
        ok: it is as it should be.
        detail: version or place, or what to do.
        needed: no run is possible without it.
    """

    what: str
    ok: bool
    detail: str
    needed: bool = True


def examine() -> list[Look]:
    """Look at everything a run needs.

    Returns:
        The findings, in the order in which to put them right.
    """
    versions = [Look("python", True, platform.python_version())]
    versions += [_probe(name, lambda name=name: importlib.metadata.version(name)) for name in _PACKAGES]  # type: ignore[misc]
    return [
        *versions,
        *_own_packages(),
        _probe("SUMO", _sumo_version),
        _probe("shipped garages", _garages),
        _probe("cache of compiled searches", _numba_cache, needed=False),
        _probe("netconvert (to build nets)", _netconvert, needed=False),
        *(_extra(extra, package, adds) for extra, (package, adds) in EXTRAS.items()),
    ]


def _probe(what: str, look: Callable[[], str], needed: bool = True) -> Look:
    try:
        return Look(what, True, look(), needed)
    except Exception as error:
        return Look(what, False, " ".join(f"{type(error).__name__}: {error}".split()), needed)


def _own_packages() -> list[Look]:
    """The files that hide packages of this program, or that there are none."""
    hidden = hidden_packages()
    if not hidden:
        return [Look("own packages", True, "none is hidden by a file of the same name")]
    return [Look(f"package {name}", False, complaint) for name, complaint in hidden.items()]


def _extra(extra: str, package: str, adds: str) -> Look:
    """Whether an extra is installed, and what it adds."""
    try:
        return Look(f"extra {extra}", True, f"{adds} ({package} {importlib.metadata.version(package)})", False)
    except importlib.metadata.PackageNotFoundError:
        return Look(f"extra {extra}", False, f"pip install 'parking-sim[{extra}]' adds {adds}", False)


def _sumo_version() -> str:
    libsumo = importlib.import_module("libsumo")
    return str(libsumo.getVersion()[1])


def _garages() -> str:
    from sumo_nets.read import read_net, shipped_nets

    names = shipped_nets()
    for name in names:
        read_net(name)
    if not names:
        raise FileNotFoundError("none; build them with parking-sim build-net --all")
    return ", ".join(names)


def _numba_cache() -> str:
    """Numba caches beside the sources, or where NUMBA_CACHE_DIR says; without that, every process compiles anew."""
    import controller

    config = importlib.import_module("numba.core.config")
    folder = Path(config.CACHE_DIR or Path(controller.__file__).parent)
    with tempfile.TemporaryFile(dir=folder):
        return str(folder)


def _netconvert() -> str:
    from sumo_nets.build import find_netconvert

    return find_netconvert()
