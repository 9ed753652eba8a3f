"""How benchmarks give out their rows."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd


def give_out(rows: Iterable[dict[str, Any]], csv: Path | None) -> list[dict[str, Any]]:
    """Print each row as it comes, and with a path write it there together with those before it.

    Args:
        rows: a value for each column.
        csv: the file; None writes nothing.

    Returns:
        All rows.
    """
    done: list[dict[str, Any]] = []
    for row in rows:
        done.append(row)
        print(" ".join(f"{key}={_short(value)}" for key, value in row.items()), flush=True)
        if csv:
            pd.DataFrame(done).to_csv(csv, index=False)
    return done


def _short(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value
