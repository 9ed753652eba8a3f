"""Names and lists as a reader writes them."""

from __future__ import annotations

from collections.abc import Sequence


def words(name: object) -> str:
    """A name of the program (``partial_cbs``) as a reader writes it."""
    return str(name).replace("_", " ").replace("cbs", "CBS")


def listed(agvs: Sequence[int]) -> str:
    """AGVs by their numbers: "AGV 0, 3 and 5"."""
    numbers = [str(n) for n in agvs]
    return f"AGV {' and '.join([', '.join(numbers[:-1]), numbers[-1]] if len(numbers) > 1 else numbers)}"


def counted(n: int, what: str) -> str:
    """A number of things: "1 AGV", "2 AGVs"."""
    return f"{n:,} {what}{'' if n == 1 else 's'}"
