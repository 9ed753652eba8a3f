"""YAML that is a mapping of keys: layouts, floor plans, scenarios, sweeps and profiles are read by one loader."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml


class YamlError(ValueError):
    """Text that can't be used; the message is one line, without the file's name."""


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice, where the standard silently keeps the last, and texts with a NUL."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Build a mapping whose keys differ."""
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        """Build a text that may be a file's name."""
        if isinstance(node, yaml.ScalarNode) and "\0" in node.value:
            raise yaml.MarkedYAMLError(problem="a text with a NUL character", problem_mark=node.start_mark)
        return super().construct_scalar(node)


def read_mapping(path: Path, such_as: str) -> dict[str, Any]:
    """Read a YAML file.

    Args:
        path: the file.
        such_as: an entry that it might have, for errors.

    Returns:
        Its keys and values, not checked further.

    Raises:
        YamlError: it can't be read, is not YAML, gives a key twice, or is no mapping.
    """
    try:
        return parse_mapping(path.read_text(encoding="utf-8"), such_as)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise YamlError(f"can't be read: {reason}") from None


def parse_mapping(text: str, such_as: str) -> dict[str, Any]:
    """Read YAML text; arguments, result and errors as for :func:`read_mapping`."""
    try:
        data = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise YamlError(f"{line}not YAML: {error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise YamlError(f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise YamlError("not YAML that can be read: groups within groups, too many deep") from None
    if not isinstance(data, dict):
        shown = " ".join(repr(data).split())
        raise YamlError(f"{shown[:60]}: give a mapping of keys to values, such as {such_as}")
    return data
