"""The library that talks to SUMO, and what goes wrong there."""

from __future__ import annotations

import io
import os
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from parking_sim.errors import RunFailedError
from sumo_nets.errors import InputError


class PlantError(RunFailedError):
    """SUMO refused something, or was asked for what it cannot do: the run ends with what its journal holds."""


def load_api(gui: bool) -> tuple[Any, str]:
    """The library to talk to SUMO, libsumo or for sumo-gui TraCI, and the program it starts.

    Raises:
        PlantError: sumo-gui or traci is not installed.
    """
    if not gui:
        with redirect_stdout(io.StringIO()):  # it prints hints about optional packages
            import libsumo
        return libsumo, "sumo"
    try:
        import traci
    except ImportError:
        raise PlantError("sumo-gui needs traci: install parking-sim with the extra 'nets'") from None
    return traci, _find_binary("sumo-gui")


@contextmanager
def silent() -> Iterator[None]:
    """Within, TraCI says nothing of its tries to reach sumo-gui; that it failed is told once, as an error."""
    with redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        yield


def check_display() -> None:
    """Make sure that a window can be opened at all, before anything is written for it.

    Raises:
        InputError: this is a Linux machine, and no display is named.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise InputError("--gui: there is no display for sumo-gui's window: run it on a desktop, or set DISPLAY")


def _find_binary(name: str) -> str:
    """A program of SUMO: the one in the package eclipse-sumo, or one on the search path."""
    try:
        from sumo import SUMO_HOME
    except ImportError:
        SUMO_HOME = ""
    found = shutil.which(name, path=os.path.join(SUMO_HOME, "bin")) or shutil.which(name)
    if found is None:
        raise PlantError(f"{name} is not installed: install parking-sim with the extra 'nets'")
    return found
