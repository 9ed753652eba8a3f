"""Where in a nested model an error of pydantic lies."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo


def locate(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[str, type[BaseModel] | None]:
    """Find a field by the location that pydantic gives of an error.

    Args:
        model: the outermost model.
        location: keys and indices; the tag of a union's member may stand between them.

    Returns:
        The field's path as a file writes it, such as ``faults.script[0].place``, and the model that its last key
        belongs to, None where that could be several.
    """
    path, owner, inner = "", None, [model]
    for part in location:
        tagged = [
            m for m in inner if len(inner) > 1 and "kind" in m.model_fields and m.model_fields["kind"].default == part
        ]
        if tagged:
            inner = tagged
        elif isinstance(part, int):
            path += f"[{part}]"
        else:
            path += f".{part}" if path else part
            owner = inner[0] if len(inner) == 1 else None
            field = fields_of(owner).get(part) if owner else None
            inner = list(models_in(field.annotation)) if field else []
    return path, owner


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a model by the keys that a file has for them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that a field's annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from models_in(argument)
