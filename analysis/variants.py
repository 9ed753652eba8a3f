"""Variants: groups of runs that differ in nothing but the seed, each with a name of its own.

A name is the user's, or made of the few keys that tell a variant from the others. Equal names always mean equal
scenarios: made names that would be the same are numbered.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: The key under which an entry of a sweep's list has its name.
NAME = "name"
_LONGEST = 60


@dataclass(frozen=True)
class Variant:
    """One variant among others.

    Attributes:
        name: what it is called; no other variant has this name.
        shown: what tables and figures show of it: key that varies -> its value, or a short text for a group of keys.
    """

    name: str
    shown: Mapping[str, Any]


def variant_of(shown: Mapping[str, Any]) -> Variant:
    """The variant that is called by what is shown of it."""
    return Variant(label(shown), shown)


def label(shown: Mapping[str, Any]) -> str:
    """A variant in words: ``saturday, agvs=4``; ``base`` if nothing varies."""
    parts = (value_text(value) if key == NAME else f"{key}={value_text(value)}" for key, value in shown.items())
    return ", ".join(parts) or "base"


def tell_apart(values: Sequence[Any]) -> list[Any]:
    """What to show of several values of one key: plain values as they are, groups of keys by the keys that differ.

    Args:
        values: plain values, lists or mappings.

    Returns:
        A plain value or a short text for each. Equal values have the same text, and others have different ones.
    """
    distinct = {_identity(value): value for value in values}
    groups = [flatten(value) for value in distinct.values() if isinstance(value, Mapping)]
    keys = dict.fromkeys(key for group in groups for key in group)
    differing = [key for key in keys if len({_identity(group.get(key, _Missing)) for group in groups}) > 1]
    shown = _numbered([_shown(value, differing or list(keys)) for value in distinct.values()])
    shown_as = dict(zip(distinct, shown, strict=True))
    return [shown_as[_identity(value)] for value in values]


def by_scenario(scenarios: Mapping[str, Mapping[str, Any]]) -> dict[str, Variant]:
    """Variants of runs that are no sweep's: runs with the same keys and values are of one variant.

    Args:
        scenarios: run -> its scenario and whatever else decides its outcome, nested, without the seed.

    Returns:
        Run -> its variant, named by the keys that differ.
    """
    distinct = {_identity(keys): keys for keys in scenarios.values()}
    if len(distinct) < 2:
        return dict.fromkeys(scenarios, variant_of({}))
    names = tell_apart(list(distinct.values()))
    groups = {identity: flatten(keys) for identity, keys in distinct.items()}
    keys = dict.fromkeys(key for group in groups.values() for key in group)
    differing = [key for key in keys if len({_identity(group.get(key)) for group in groups.values()}) > 1]
    variants = {
        identity: Variant(name, {key: _shown(group.get(key), ()) for key in differing})
        for (identity, group), name in zip(groups.items(), names, strict=True)
    }
    return {run: variants[_identity(keys)] for run, keys in scenarios.items()}


def flatten(keys: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Keys and values, nested, as one mapping with keys joined by dots.

    Args:
        keys: keys and values, nested.
        prefix: what the names begin with.

    Returns:
        Plain values and lists.
    """
    flat: dict[str, Any] = {}
    for key, value in keys.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def value_text(value: Any) -> str:
    """A value in a few words, never as JSON."""
    if isinstance(value, str):
        return value
    if value is None or isinstance(value, bool | int | float):
        return json.dumps(value)
    if isinstance(value, Mapping):
        return _group_text(flatten(value), list(flatten(value)))
    if not isinstance(value, Collection):
        return str(value)  # a date, which no key takes
    if any(isinstance(item, Mapping | list) for item in value):
        return f"{len(value)} entries" if len(value) > 1 else "1 entry"
    return " ".join(map(value_text, value)) or "none"


class _Missing:
    """Stands for a key that a group does not have, which is not the same as null."""


def _identity(value: Any) -> Hashable:
    """Equal for equal values, whatever the order of their keys."""
    if isinstance(value, Mapping):
        return frozenset((str(key), _identity(item)) for key, item in value.items())
    if isinstance(value, list | tuple):
        return tuple(map(_identity, value))
    return type(value).__name__, repr(value)


def _shown(value: Any, keys: Sequence[str]) -> Any:
    if isinstance(value, Mapping):
        return _group_text(flatten(value), keys)
    return value_text(value) if isinstance(value, list) else value


def _group_text(group: Mapping[str, Any], keys: Sequence[str]) -> str:
    """``poisson arrivals_per_h=20``: the kind by its value alone and first, other keys with theirs."""
    kind = [value_text(group["kind"])] if "kind" in group else []
    others = [f"{key}={value_text(group[key])}" for key in keys if key in group and key != "kind"]
    words = " ".join([*kind, *others]) or "default"
    return words if len(words) <= _LONGEST else words[: _LONGEST - 1] + "…"


def _numbered(shown: Sequence[Any]) -> list[Any]:
    """The same with a number behind texts that occur more than once, until none does."""
    result = list(shown)
    while len(count := Counter(map(value_text, result))) < len(result):
        seen = Counter[str]()
        for place, words in enumerate(map(value_text, result)):
            seen[words] += 1
            if count[words] > 1:
                result[place] = f"{words} ({seen[words]})"
    return result
