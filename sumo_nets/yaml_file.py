"""YAML that is a mapping of keys: layouts, floor plans, scenarios, sweeps and profiles are read by one loader."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from sumo_nets.input_file import MEGABYTE, read_text
from sumo_nets.wording import cut, shown

#: No YAML file of a garage or scenario comes near these.
_MOST_BYTES, _DEEPEST, _MOST_BY_ALIASES, _MOST_BITS = 4 * MEGABYTE, 60, 20_000, 1000
_TOO_DEEP = "not YAML that can be read: groups within groups, too many deep"
#: Kinds of values by YAML's tags.
_KINDS = {"int": "whole number", "float": "number", "bool": "truth value", "timestamp": "date", "map": "mapping"}


class YamlError(ValueError):
    """Text that can't be used; the message is one line, without the file's name."""


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice, where the standard silently keeps the last, and texts with a NUL.

    What the standard fails on becomes a complaint with its line, too: odd dates, numbers, words behind ``!!``.
    """

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a value, if it is not too deep within others."""
        if self.depth > _DEEPEST:
            raise YamlError(_TOO_DEEP)
        self.depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Build a mapping whose keys differ."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise _marked(f"key {shown(key.value)} is given twice", key)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Build a value, if there is one of this kind with this text."""
        if isinstance(node, yaml.ScalarNode) and "\0" in node.value:
            raise _marked("a text with a NUL character", node)
        try:
            value = super().construct_object(node, deep)
        except (ValueError, ArithmeticError, AttributeError, LookupError, TypeError):
            kind = node.tag.rpartition(":")[2]
            raise _marked(f"{shown(node.value)} is no {_KINDS.get(kind, cut(kind))} that can be read", node) from None
        if isinstance(value, int) and value.bit_length() > _MOST_BITS:
            raise _marked(f"{shown(node.value, 20)} is too great a number", node)
        return value


def _marked(problem: str, node: yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


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
        return parse_mapping(read_text(path, _MOST_BYTES), such_as)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise YamlError(f"can't be read: {reason}") from None


def parse_mapping(text: str, such_as: str) -> dict[str, Any]:
    """Read YAML text; arguments, result and errors as for :func:`read_mapping`."""
    try:
        data = _load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise YamlError(f"{line}not YAML: {cut(str(error.problem or error.context), 200)}") from None
    except yaml.YAMLError as error:
        raise YamlError(f"not YAML: {cut(str(error), 200)}") from None
    except YamlError:
        raise
    except ValueError as error:  # of the parser's own, such as an escaped character beyond Unicode
        raise YamlError(f"not YAML: {cut(str(error), 200)}") from None
    if not isinstance(data, dict):
        raise YamlError(f"{shown(data, 60)}: give a mapping of keys to values, such as {such_as}")
    return data


def _load(text: str) -> object:
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _check_size(node)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _check_size(root: yaml.Node) -> None:
    """Bound what aliases unfold to: a thousand bytes can stand for 10^9 values, or for themselves."""
    sizes: dict[int, int] = {}
    above: set[int] = set()

    def size(node: yaml.Node) -> int:
        known = sizes.get(id(node))
        if known is not None:
            return known
        if id(node) in above:
            raise _marked("an alias that stands for a part of itself", node)
        above.add(id(node))
        parts = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else node.value
        found = 1 + (0 if isinstance(parts, str) else sum(size(part) for part in parts))
        above.discard(id(node))
        sizes[id(node)] = found
        return found

    unfolded = size(root)
    if unfolded - len(sizes) > _MOST_BY_ALIASES:
        raise YamlError(f"aliases unfold to {unfolded} values: at most {_MOST_BY_ALIASES} more than written are valid")
