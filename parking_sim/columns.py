"""What the columns of the table ``runs`` mean: keys of a scenario, and metrics."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from analysis.metrics import METRICS
from analysis.runs import RUN_COLUMNS
from parking_sim.config import Scenario


def run_columns() -> dict[str, tuple[str, str]]:
    """What the columns of the table ``runs`` mean.

    Returns:
        Column -> (unit, meaning): the run's own, then the scenario's keys, then the metrics. Lists in a scenario are
        JSON text. A table has the columns of the scenario that its runs have, and one more for each key of a mapping
        with free keys, such as ``planner_options.NAME``.
    """
    scenario = {name: ("", meaning) for name, meaning in _described(Scenario, "")}
    return {**RUN_COLUMNS, **scenario, **METRICS}


def _described(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, str]]:
    """The keys of a model of options and of the models in it, with their descriptions."""
    for name, field in model.model_fields.items():
        nested = _models(field.annotation)
        if not nested or type(None) in typing.get_args(field.annotation):
            yield prefix + name, field.description or "which of the kinds it is"
        for inner in nested:
            yield from _described(inner, f"{prefix}{name}.")


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models of options that a field may hold; none for lists and mappings of them."""
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, BaseModel) else []
    if typing.get_origin(annotation) in (tuple, list, dict):
        return []
    return [model for argument in typing.get_args(annotation) for model in _models(argument)]
