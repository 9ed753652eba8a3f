"""What is wrong with the fields of a nested model, a line for each."""

from __future__ import annotations

import difflib
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from sumo_nets.wording import one_of, shown

#: Kinds of a value that may be of several, as pydantic names them behind the field.
_SCALARS = {"bool", "int", "float", "str"}
#: Keys are compared by so many characters.
_LONGEST = 100


def all_errors(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """All that is wrong with a model.

    Args:
        error: what pydantic says.
        model: the outermost model.

    Returns:
        For each field its name, value, and what would be valid, such as "agvs: -1: must be greater than or equal to 1".
    """
    # a misspelt key is also a missing one: the misspelling says more
    found = sorted(error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden")
    outer = {each["loc"][:length] for each in found for length in range(len(each["loc"]))}
    told: dict[str, None] = {}
    meant: set[str] = set()
    for each in found:
        if each["loc"] and each["loc"] in outer:
            continue  # a list without its wrong parts is too short
        field, owner = locate(model, each["loc"])
        if each["type"] == "missing" and field in meant:
            continue
        wrong = _wrong(each, owner)
        if each["type"] == "extra_forbidden" and owner and (key := _meant(each, owner)):
            meant.add(f"{field.rpartition('.')[0]}.{key}".removeprefix("."))
        told[f"{field}{wrong}" if field else wrong.removeprefix(": ")] = None
    return list(told)


def _meant(error: ErrorDetails, owner: type[BaseModel] | None) -> str:
    """The key that an unknown one is most like; "" if it is like none."""
    fields = fields_of(owner) if owner else {}
    return next(iter(difflib.get_close_matches(str(error["loc"][-1])[:_LONGEST], fields, n=1)), "")


def _wrong(error: ErrorDetails, owner: type[BaseModel] | None) -> str:
    """What stands behind the field's name."""
    kind, context, given = error["type"], error.get("ctx", {}), shown(error["input"], 60)
    key = str(error["loc"][-1]) if error["loc"] else ""
    fields = fields_of(owner) if owner else {}
    if kind == "extra_forbidden":
        close = _meant(error, owner)
        return f": unknown key; {f'did you mean {close}?' if close else 'valid keys are ' + ', '.join(sorted(fields))}"
    if kind == "missing":
        wanted = fields[key].description if key in fields else None
        return f": missing ({wanted})" if wanted else ": missing; give a value"
    if kind == "invalid_key":
        return f": {given}: give a key that is a text"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f": {given}: give a mapping of keys to values"
    if kind == "too_short":
        return f": {given}: give at least {context['min_length']}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        members = models_in(fields[key].annotation) if key in fields else ()
        valid = one_of(str(member.model_fields["kind"].default) for member in members)
        return f".kind: {shown(context['tag']) + ': ' if 'tag' in context else 'missing; '}{valid}"
    if kind == "literal_error":
        return f": {given}: give {context['expected']}"
    if key in _SCALARS:
        return f": {given}: give a number, a text, true or false"
    message = error["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return f": {message}"
    return (
        f": {given}: must be {message.removeprefix('Input should be ')}"
        if "Input should" in message
        else f": {given}: {message[0].lower()}{message[1:]}"
    )


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
        elif part in _SCALARS and not inner:
            continue
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
