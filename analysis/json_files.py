"""Files of a record in JSON: one that is damaged, or that another program wrote, is told in one line."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sumo_nets.errors import InputError
from sumo_nets.wording import cut, shown

#: What is said of a file that can't be read as what its name says.
FOREIGN = "is damaged, or no file that parking-sim wrote"

_Test = tuple[str, Callable[[Any], bool]]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _maps(test: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, dict) and all(map(test, value.values()))


def _lists(test: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(test, value))


def _is_testimony(value: object) -> bool:
    return isinstance(value, dict) and _lists(_is_text)(value.get("words"))


_NUMBER: _Test = ("a number", _is_number)
_TEXT: _Test = ("text", _is_text)
_TEXTS: _Test = ("a list of texts", _lists(_is_text))
_TEXT_MAP: _Test = ("texts by name", _maps(_is_text))
_ANY_MAP: _Test = ("values by key", _maps(lambda _: True))

#: Keys of ``run.json`` that are read, and what they have to be where they are there and not null.
_META: Mapping[str, _Test] = {
    **dict.fromkeys(("seed", "step_s", "sumo_start_s", "day_start_h", "simulated_s", "tasks_wanted"), _NUMBER),
    **dict.fromkeys(("sumo_collisions", "footprint_overlaps", "turns_under_cars", "least_clearance_m"), _NUMBER),
    **dict.fromkeys(("cars_initial", "cars_arrived", "cars_parked", "cars_left", "cars_in_transit"), _NUMBER),
    **dict.fromkeys(("status", "command", "code", "map"), _TEXT),
    **dict.fromkeys(("inputs", "versions", "digest"), _TEXT_MAP),
    **dict.fromkeys(("held", "audit"), _TEXTS),
    "scenario": _ANY_MAP,
    "wall_s": ("numbers by name", _maps(_is_number)),
    "witnesses": ("testimonies with words by name", _maps(_is_testimony)),
}


def read_object(path: Path) -> dict[str, Any]:
    """Read a file with a JSON object.

    Args:
        path: a file that this program wrote.

    Raises:
        InputError: it can't be read, or is damaged.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: is damaged, or no file that parking-sim wrote: not JSON: {cut(str(error))}"
        ) from None
    if not isinstance(value, dict):
        raise InputError(f"{path}: is damaged, or no file that parking-sim wrote: holds no JSON object")
    return value


def read_meta(path: Path) -> dict[str, Any]:
    """Read the ``run.json`` of a record.

    Raises:
        InputError: it can't be read, is damaged, or has a value of another kind than a run writes.
    """
    meta = read_object(path)
    for key, (kind, test) in _META.items():
        if meta.get(key) is not None and not test(meta[key]):
            raise InputError(f"{path}: {key}: {shown(meta[key])}: a run writes {kind}")
    return meta


def read_rows(path: Path, key: str, texts: tuple[str, ...]) -> list[dict[str, Any]]:
    """Read a file that lists runs, as ``sweep.json`` does.

    Args:
        path: the file.
        key: where the list is.
        texts: keys that each row has, with texts.

    Raises:
        InputError: it can't be read, or is damaged.
    """
    found = read_object(path).get(key)
    rows = [row for row in found if isinstance(row, dict)] if isinstance(found, list) else []
    if not isinstance(found, list) or len(rows) < len(found) or not all(_has_texts(row, texts) for row in rows):
        raise InputError(f"{path}: {key}: {shown(found)}: a sweep writes a list of runs with {', '.join(texts)}")
    return rows


def _has_texts(row: Mapping[str, object], texts: tuple[str, ...]) -> bool:
    return all(isinstance(row.get(text), str) for text in texts)
