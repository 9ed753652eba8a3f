"""The one place that names Parquet files to DuckDB, which would otherwise read meaning into their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

_GLOB = re.compile(r"([\[*?])")


def parquet_rows(paths: Sequence[Path]) -> str:
    """The rows of Parquet files as a SQL table function; the column ``filename`` says which file a row is from.

    DuckDB takes ``[ ] * ?`` in a name as a pattern of many files, and ``key=value`` in a folder's name as a column.
    Here a path is that one file and nothing else.

    Args:
        paths: the files, one or more.

    Returns:
        SQL to stand after FROM. ``filename`` is the absolute path, without symbolic links.
    """
    listed = ", ".join(quoted(_GLOB.sub(r"[\1]", str(path.resolve()))) for path in paths)
    return f"read_parquet([{listed}], filename = true, hive_partitioning = false)"


def quoted(text: str) -> str:
    """Text as a SQL literal."""
    return "'" + text.replace("'", "''") + "'"
