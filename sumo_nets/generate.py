"""Regular garages of any size.

Parallel aisles, alternately one-way and single-width two-way, lie between pairs of opposite one-way cross roads, so
that every pair of roads is a loop. Bays and chargers open from the first road, next to the street; homes from the
second and, if there are many, from the last one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from sumo_nets.layout import FIELD_OF_ROLE, Layout, LayoutError

#: Aisles are this many cells apart: two depths of slots and a wall.
AISLE_SPACING = 3
#: A block of slots between cross roads is at most this many cells long.
LONGEST_BLOCK = 16
#: Two-way aisles get a refuge in the middle of blocks from this length on.
REFUGE_FROM = 8
_FIRST_ROAD, _FIRST_SLOT, _FIRST_AISLE = 2, 5, 2


@dataclass(frozen=True)
class _Frame:
    """Rows of the aisles, columns of the slot blocks, and the north-going road of each pair of cross roads."""

    rows: tuple[int, ...]
    blocks: tuple[range, ...]
    roads: tuple[int, ...]

    def is_two_way(self, i: int) -> bool:
        """The outer aisles close the loops of the roads in both directions, so they are two-way."""
        return i % 2 == 0 or i == len(self.rows) - 1


def generate_layout(
    name: str, slots: int, bays: int, homes: int, chargers: int, aisles: int | None = None, pitch_m: float = 7.0
) -> Layout:
    """Lay out a regular garage.

    Args:
        name: name of the layout.
        slots: number of slots, exactly.
        bays, homes, chargers: how many of each; there must be room along the roads.
        aisles: number of parallel aisles, 3 or more; by default the garage is about square.
        pitch_m: length of a cell.

    Returns:
        The layout.

    Raises:
        LayoutError: a number that is too small, or more bays, homes or chargers than there is room for.
    """
    for what, number, least in (("slots", slots, 1), ("bays", bays, 1), ("homes", homes, 1), ("chargers", chargers, 0)):
        if number < least:
            raise LayoutError(f"{name}: {what}: {number} is not valid: {least} or more")
    count = aisles if aisles is not None else 2 * math.ceil((math.sqrt(slots / 12) - 1) / 2) + 1
    if aisles is None:
        count = max(count, 3)
    if count < 3:
        raise LayoutError(f"{name}: aisles: {count} is not valid: 3 or more")
    frame = _frame_for(slots, count)
    data: dict[str, Any] = {
        "name": name,
        "pitch_m": pitch_m,
        "handover": "bay",
        "aisles": list(_aisles(frame)),
        "slots": list(_slot_rows(frame, slots)),
        "bays": _first(name, "bays", bays, _spread(list(_bay_rows(frame)), bays)),
        "homes": _first(name, "homes", homes, list(_home_rows(frame))),
        "chargers": _first(name, "chargers", chargers, _spread_chargers(frame, chargers)),
        "refuges": [{"at": [x, y], "side": "north"} for x, y in _refuges(frame)],
        "street": {"from": [0, frame.rows[-1] + 1], "to": [0, 0]},
    }
    return Layout.model_validate(data)


def layout_yaml(layout: Layout) -> str:
    """A layout as the YAML text that reads back as the same layout, one row a line."""
    data = layout.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    lines = [f"{key}: {data[key]}" for key in ("name", "pitch_m", "handover")]
    if layout.picture:
        lines += ["picture: |", *(f"  {row}" for row in layout.picture.splitlines())]
    for key in ("aisles", *FIELD_OF_ROLE.values()):
        if key in data:
            lines += [f"{key}:", *(f"  - {_flow(row)}" for row in data[key])]
    if "street" in data:
        lines.append(f"street: {_flow(data['street'])}")
    return "\n".join(lines) + "\n"


def _flow(row: dict[str, Any]) -> str:
    if len(row.get("side", ())) == 1:
        row = {**row, "side": row["side"][0]}
    parts = []
    for key, value in row.items():
        text = f"[{', '.join(str(v) for v in value)}]" if isinstance(value, list) else str(value)
        parts.append(f"{key}: {text}")
    return "{" + ", ".join(parts) + "}"


def _frame_for(slots: int, count: int) -> _Frame:
    """The shortest aisles that hold the slots."""
    length = math.ceil(slots / (4 * count))
    while True:
        frame = _frame(length, count)
        if 2 * len(list(_places(frame))) >= slots:
            return frame
        length += 1


def _frame(length: int, count: int) -> _Frame:
    rows = tuple(_FIRST_AISLE + AISLE_SPACING * i for i in range(count))
    blocks: list[range] = []
    roads = [_FIRST_ROAD]
    x = _FIRST_SLOT
    pieces = math.ceil(length / LONGEST_BLOCK)
    for k in range(pieces):
        cells = length // pieces + (k < length % pieces)
        blocks.append(range(x, x + cells))
        roads.append(x + cells)
        x += cells + 2
    return _Frame(rows, tuple(blocks), tuple(roads))


def _aisles(frame: _Frame) -> Iterator[dict[str, Any]]:
    top, bottom = frame.rows[0], frame.rows[-1]
    for x in frame.roads:
        yield {"from": [x, bottom], "to": [x, top], "way": "one"}
        yield {"from": [x + 1, top], "to": [x + 1, bottom], "way": "one"}
    west, east = frame.roads[0], frame.roads[-1] + 1
    for i, y in enumerate(frame.rows):
        if frame.is_two_way(i):
            yield {"from": [west, y], "to": [east, y], "way": "two"}
        else:
            ends = (west, east) if i % 4 == 1 else (east, west)
            yield {"from": [ends[0], y], "to": [ends[1], y], "way": "one"}


def _refuges(frame: _Frame) -> Iterator[tuple[int, int]]:
    for i, y in enumerate(frame.rows):
        for block in frame.blocks:
            if frame.is_two_way(i) and len(block) >= REFUGE_FROM:
                yield block[len(block) // 2], y


def _places(frame: _Frame) -> Iterator[tuple[int, int, str]]:
    """Cell and side of every pair of slots, from the bays' end on."""
    refuges = set(_refuges(frame))
    for block in frame.blocks:
        for x in block:
            for y in frame.rows:
                if (x, y) not in refuges:
                    yield x, y, "north"
                yield x, y, "south"


def _slot_rows(frame: _Frame, slots: int) -> Iterator[dict[str, Any]]:
    places = list(_places(frame))[: (slots + 1) // 2]
    single = places.pop() if slots % 2 else None
    for y in frame.rows:
        for side in ("north", "south"):
            columns = [x for x, row, s in places if row == y and s == side]
            for first, last in _runs(columns):
                yield {"from": [first, y], "to": [last, y], "side": side, "per_cell": 2}
    if single:
        yield {"at": list(single[:2]), "side": single[2]}


def _runs(columns: Sequence[int]) -> Iterator[tuple[int, int]]:
    """First and last of each unbroken run of numbers."""
    for _, group in groupby(enumerate(columns), key=lambda pair: pair[1] - pair[0]):
        run = [x for _, x in group]
        yield run[0], run[-1]


def _bay_rows(frame: _Frame) -> Iterator[dict[str, Any]]:
    for y in frame.rows[:-1]:
        yield {"at": [_FIRST_ROAD, y + 1], "side": "west"}


def _spread_chargers(frame: _Frame, chargers: int) -> list[dict[str, Any]]:
    """Where the aisles end first, spread over them; then between the bays."""
    at_aisles, between = (
        [{"at": [_FIRST_ROAD, y], "side": "west"} for y in rows]
        for rows in (frame.rows, [y + 2 for y in frame.rows[:-1]])
    )
    return _spread(at_aisles, chargers) + between


def _spread(rows: list[dict[str, Any]], number: int) -> list[dict[str, Any]]:
    """``number`` rows at even distances; all rows if there are fewer."""
    if number >= len(rows):
        return rows
    return [rows[len(rows) * (2 * i + 1) // (2 * number)] for i in range(number)]


def _home_rows(frame: _Frame) -> Iterator[dict[str, Any]]:
    """Pairs of homes; every other gap first, so that the first AGVs are spread along the bays."""
    gaps = [*frame.rows[:-1:2], *frame.rows[1:-1:2]]
    for x in (_FIRST_ROAD + 1, frame.roads[-1] + 1):
        for below in (1, 2):
            for y in gaps:
                yield {"at": [x, y + below], "side": "east", "per_cell": 2}


def _first(name: str, what: str, number: int, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The first rows that hold the number, the last row cut to fit."""
    taken: list[dict[str, Any]] = []
    left = number
    for row in rows:
        if left <= 0:
            break
        holds = min(row.get("per_cell", 1), left)
        taken.append({**row, "per_cell": holds})
        left -= holds
    if left > 0:
        room = sum(row.get("per_cell", 1) for row in rows)
        raise LayoutError(f"{name}: {what}: {number} is not valid: this garage has room for {room} at most")
    return taken
