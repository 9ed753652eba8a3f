"""Files of a user's own that hide a package of this program from Python.

``analysis``, ``controller``, ``demand`` and ``sumo_nets`` are packages at the top level, and Python looks in the folder
of the user's script first: an ``analysis.py`` there is taken for ours.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

#: The package that defines ``InputError``: while it is hidden, the complaint is another exception.
NEEDED_TO_COMPLAIN = "sumo_nets"

#: The packages beside this one.
PACKAGES = (NEEDED_TO_COMPLAIN, "controller", "demand", "analysis")

_home = Path(__file__).resolve().parent.parent


def hidden_packages() -> dict[str, str]:
    """Find the packages that Python takes from elsewhere.

    Returns:
        Package -> one line on the file that hides it.
    """
    found = {name: _place(name) for name in PACKAGES}
    return {
        name: f"{file}: hides the package '{name}' of parking-sim from Python: give it another name"
        for name, file in found.items()
        if file is not None and file != _home / name / "__init__.py"
    }


def require_own_packages() -> None:
    """Refuse to begin anything that would fail on a hidden package later.

    Raises:
        InputError: a file hides a package; ``ImportError`` if that is the package which defines ``InputError``.
    """
    for name, complaint in hidden_packages().items():
        if name == NEEDED_TO_COMPLAIN:
            raise ImportError(complaint)
        from sumo_nets.errors import InputError

        raise InputError(complaint)


def _place(name: str) -> Path | None:
    """The file that ``import name`` runs, or has run."""
    module = sys.modules.get(name)
    if module is not None:
        file = getattr(module, "__file__", None)
    else:
        spec = importlib.util.find_spec(name)
        file = spec.origin if spec is not None else None
    return Path(file).resolve() if file else None
