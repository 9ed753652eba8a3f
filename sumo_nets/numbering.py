"""Types for numbers, so that a number of one numbering can't be used in another.

All numbers are plain ints at run time. To mypy a ``Vertex`` is no ``EdgeIndex`` and neither is any other int:
``Numbered[Vertex, str]`` is a tuple or list that only a vertex number may index. Numpy arrays and compiled kernels take
any int; what comes out of them gets its type where it leaves them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Final, NewType, Protocol, TypeVar, cast

#: Number of a vertex: its position in ``Graph.names``.
Vertex = NewType("Vertex", int)
NO_VERTEX: Final = Vertex(-1)

#: Number of a directed edge: its position in ``Graph.edge_names``.
EdgeIndex = NewType("EdgeIndex", int)
NO_EDGE: Final = EdgeIndex(-1)

_Number = TypeVar("_Number", bound=int)
_Key = TypeVar("_Key", bound=int, contravariant=True)
_Value = TypeVar("_Value", covariant=True)
_Item = TypeVar("_Item")


class Numbered(Collection[_Value], Protocol[_Key, _Value]):
    """A tuple or list that is indexed by the numbers of one numbering, 0 first."""

    def __getitem__(self, number: _Key, /) -> _Value:
        """What has this number."""


class NumberedList(Collection[_Item], Protocol[_Key, _Item]):
    """A ``Numbered`` whose items may be replaced and which may grow."""

    def __getitem__(self, number: _Key, /) -> _Item:
        """What has this number."""

    def __setitem__(self, number: _Key, item: _Item, /) -> None:
        """Replace what has this number."""

    def append(self, item: _Item, /) -> None:
        """Give an item the next number."""


class Places(Collection[Vertex], Protocol):
    """Vertices of one role in the layout's order; they are gone through or cut, never looked up by a number."""

    def __getitem__(self, part: slice, /) -> Places:
        """Some of them, as of a tuple."""


def numbers(items: Numbered[_Number, object]) -> Sequence[_Number]:
    """The numbers of a collection's items, in order."""
    return cast("Sequence[_Number]", range(len(items)))


def numbered(items: Numbered[_Number, _Item]) -> Iterable[tuple[_Number, _Item]]:
    """Each item with its number, in order."""
    return cast("Iterable[tuple[_Number, _Item]]", enumerate(items))
