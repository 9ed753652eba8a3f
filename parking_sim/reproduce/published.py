"""The papers' printed figures, from ``published.yaml``."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

import yaml


@cache
def _all() -> Any:
    return yaml.safe_load(files("parking_sim.reproduce").joinpath("published.yaml").read_text(encoding="utf-8"))


def published(paper: str) -> Any:
    """What a paper printed, as it stands in the file under the paper's name."""
    return _all()[paper]
