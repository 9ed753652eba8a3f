"""One-line grids: a single row of cells with T-shaped bays to give way (Shin et al. 2022, section 3.2).

The line is one cell wide and driven both ways; robots can only pass each other where one of them stands in a bay. At
its beginning robots stand in single file, then come the bays of the unloading place, a narrow part with a bay here and
there, and the places to pick from at the far end. Bay ends are the places of interest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sumo_nets.layout import Layout, LayoutError


@dataclass(frozen=True, slots=True)
class OneLine:
    """Measures of a one-line grid, in cells.

    Attributes:
        robots: cells of the file at the beginning.
        unloading: pairs of bays at the unloading place, one north and one south of the line.
        narrow: cells of the narrow part.
        passing: bays in the narrow part, evenly spread.
        picking: pairs of bays at the far end.
    """

    robots: int = 10
    unloading: int = 5
    narrow: int = 18
    passing: int = 2
    picking: int = 5


def one_line_layout(name: str, line: OneLine, pitch_m: float = 7.0) -> Layout:
    """Lay out a one-line grid as a garage: bays at the far end are slots, those on the way refuges.

    Args:
        name: name of the layout.
        line: its measures.
        pitch_m: length of a cell, metres.

    Returns:
        The layout; the bays of the unloading place come first among its refuges, nearest to the file first.

    Raises:
        LayoutError: a measure below 1, or more passing bays than cells in the narrow part.
    """
    for what in ("robots", "unloading", "narrow", "picking"):
        if getattr(line, what) < 1:
            raise LayoutError(f"{name}: {what}: {getattr(line, what)} is not valid: 1 or more")
    if not 0 <= line.passing <= line.narrow:
        raise LayoutError(f"{name}: passing: {line.passing} is not valid: 0 to {line.narrow}")
    y = 2
    unloading = [line.robots + 1 + 2 * k for k in range(line.unloading)]
    start = unloading[-1] + 1
    passing = [start + (k + 1) * line.narrow // (line.passing + 1) for k in range(line.passing)]
    picking = [start + line.narrow + 1 + 2 * k for k in range(line.picking)]
    data: dict[str, Any] = {
        "name": name,
        "pitch_m": pitch_m,
        "handover": "home",
        "aisles": [{"from": [0, y], "to": [picking[-1], y], "way": "two"}],
        "slots": [{"at": [x, y], "side": ["north", "south"]} for x in picking],
        "homes": [{"at": [x, y], "side": "here"} for x in reversed(range(line.robots))],
        "refuges": [{"at": [x, y], "side": ["north", "south"]} for x in unloading]
        + [{"at": [x, y], "side": "north"} for x in passing],
    }
    return Layout.model_validate(data)
