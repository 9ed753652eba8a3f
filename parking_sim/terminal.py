"""The terminal: there is always one to write to, and tables can be read in 80 columns.

Lines of tables are broken between words, and no figure is cut.
"""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence

_GAP = "  "
#: A longer word of a heading or of the first column, such as a path, may be broken.
_LONGEST_WORD = 24


def open_standard_streams() -> None:
    """Give a process that was started with closed standard streams some that lead nowhere.

    The first files that it opens would get their numbers otherwise, and SUMO's words would go into these.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8", closefd=False)


def table(rows: Sequence[Mapping[str, str]], title: str, width: int | None = None) -> str:
    """A table whose first column holds words, and all others figures.

    Args:
        rows: text by heading, the same headings in each.
        title: stands above it.
        width: columns of the terminal; that of the terminal by default, 80 where there is none.

    Returns:
        Lines. A table that is too wide has its headings and its first column broken between words; only figures that
        don't fit beside each other make it wider than asked.
    """
    headings = list(rows[0]) if rows else []
    cells = [[row[heading] for row in rows] for heading in headings]
    widths = _widths(headings, cells, width or shutil.get_terminal_size().columns)
    lines = [*_lines(headings, widths), _GAP.join("-" * each for each in widths)]
    for row in rows:
        lines += _lines(list(row.values()), widths)
    return "\n".join([title, "", *lines, ""])


def print_table(rows: Sequence[Mapping[str, str]], title: str) -> None:
    """Print a table to stdout, see :func:`table`."""
    print(table(rows, title))


def _widths(headings: Sequence[str], cells: Sequence[Sequence[str]], width: int) -> list[int]:
    """Columns' widths: as wide as their text where there is room, and never less than what can't be broken."""
    most = [max(map(len, (heading, *column))) for heading, column in zip(headings, cells, strict=True)]
    least = [max(_longest_word(heading), *map(len, column)) for heading, column in zip(headings, cells, strict=True)]
    if least:
        least[0] = max(map(_longest_word, (headings[0], *cells[0])))
    spare = width - sum(least) - len(_GAP) * (len(least) - 1)
    for k in range(len(least)):
        more = min(max(spare, 0), most[k] - least[k])
        least[k] += more
        spare -= more
    return least


def _longest_word(text: str) -> int:
    return max((min(len(word), _LONGEST_WORD) for word in text.split()), default=1)


def _lines(texts: Sequence[str], widths: Sequence[int]) -> Iterator[str]:
    """The lines that a row takes: the first column to the left, the others to the right."""
    broken = [textwrap.wrap(text, each) or [""] for text, each in zip(texts, widths, strict=True)]
    for i in range(max(map(len, broken), default=0)):
        parts = [lines[i] if i < len(lines) else "" for lines in broken]
        shown = [
            part.rjust(each) if k else part.ljust(each)
            for k, (part, each) in enumerate(zip(parts, widths, strict=True))
        ]
        yield _GAP.join(shown).rstrip()
