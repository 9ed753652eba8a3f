"""What a set of runs and a table of the docs are, and what all tables are made with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Row = dict[str, Any]
Rows = Sequence[Row]


@dataclass(frozen=True)
class RunSet:
    """Runs of one kind.

    Attributes:
        words: what they are.
        cases: what each is run with; all have the same keys.
        run: makes one, and returns its figures.
    """

    words: str
    cases: tuple[Row, ...]
    run: Callable[[Row], Row]


@dataclass(frozen=True)
class Table:
    """A table of the docs.

    Attributes:
        runs: the set that it shows.
        show: rows of the set -> lines of Markdown; none if what it needs is not there.
    """

    runs: str
    show: Callable[[Rows], list[str]]


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown; none without rows."""
    return [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)] if rows else []


def percent(share: float) -> str:
    """A share in whole per cent."""
    return f"{100 * share:.0f} %"


def groups(rows: Rows, *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some columns, in the order in which these come."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def mean(rows: Rows, key: str) -> float:
    """Mean of a column."""
    return float(np.mean([row[key] for row in rows]))


def total(rows: Rows, *keys: str) -> int:
    """Sum of some columns; what is not measured counts as 0."""
    return round(float(np.nansum([row[key] for row in rows for key in keys])))
