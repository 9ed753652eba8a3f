"""The thirty layouts of the RRT-GRID experiment: five categories of six, 960 x 640 pixels.

Paper 001 shows its layouts as pictures only (figures 6 to 10); these are ours, drawn from the parameters below after
the paper's words. Start and goal are the same in all of them, near opposite corners.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from sumo_nets.freespace.floor import Floor, Point, rectangle
from sumo_nets.graph import FloatArray

WIDTH, HEIGHT = 960.0, 640.0
START: Point = (30.0, 610.0)
GOAL: Point = (930.0, 30.0)
#: Free border around everything that stands on the floor.
_MARGIN = 60.0

Obstacles = Iterator[FloatArray]


@dataclass(frozen=True, eq=False)
class Scene:
    """One layout.

    Attributes:
        category: 1 basic, 2 fulfilment centre, 3 warehouse, 4 cells, 5 lines.
        number: 1 to 6 within the category.
        floor: its obstacles.
    """

    category: int
    number: int
    floor: Floor


def blocks(columns: int, rows: int, share: float) -> Obstacles:
    """Category 1: a grid of blocks, each ``share`` of its field wide and high; few or none."""
    for x, y, w, h in _fields(columns, rows):
        yield _centred(x, y, w * share, h * share)


def fulfilment(columns: int, rows: int, aisle: float, belt: float) -> Obstacles:
    """Category 2: shelves everywhere, ``aisle`` pixels apart, and a belt ``belt`` wide from the centre to the east.

    Customers' orders are picked from many small shelves and leave over the belt: the most complex category.
    """
    low, high = HEIGHT / 2 - belt / 2, HEIGHT / 2 + belt / 2
    yield rectangle(WIDTH / 2, low, WIDTH, high)
    for x, y, w, h in _fields(columns, rows):
        shelf = _centred(x, y, w - aisle, h - aisle)
        if shelf[:, 0].max() < WIDTH / 2 - aisle or shelf[:, 1].max() < low - aisle or shelf[:, 1].min() > high + aisle:
            yield shelf


def warehouse(racks: int, depth: float, columns: int, rows: int, share: float) -> Obstacles:
    """Category 3: ``racks`` of storage along the north and the south wall, processes on the wide floor between."""
    pitch = (WIDTH - 4 * _MARGIN) / racks
    for i in range(racks):
        x = 2 * _MARGIN + (i + 0.5) * pitch
        for y in (depth / 2, HEIGHT - depth / 2):
            yield _centred(x, y, pitch * 0.45, depth)
    for x, y, w, h in _fields(columns, rows, depth + 40.0):
        yield _centred(x, y, w * share, h * share)


def cells(columns: int, rows: int, share: float, wall: float) -> Obstacles:
    """Category 4: U-shaped work cells, open to the north and to the south by turns."""
    for i, (x, y, w, h) in enumerate(_fields(columns, rows)):
        half_w, half_h = w * share / 2, h * share / 2
        back = 1 if (i + i // columns) % 2 else -1
        yield _centred(x, y + back * (half_h - wall / 2), 2 * half_w, wall)
        yield _centred(x - half_w + wall / 2, y, wall, 2 * half_h)
        yield _centred(x + half_w - wall / 2, y, wall, 2 * half_h)


def lines(number: int, thickness: float, gap: float) -> Obstacles:
    """Category 5: long production lines, one above the other, every other one cut in the middle by ``gap`` pixels."""
    for i, (x, y, w, _) in enumerate(_fields(1, number)):
        if i % 2 == 0 or gap == 0:
            yield _centred(x, y, w, thickness)
        else:
            half = (w - gap) / 2
            for side in (-1, 1):
                yield _centred(x + side * (gap + half) / 2, y, half, thickness)


#: For each category its name, how it is drawn, and the parameters of its six layouts.
CATEGORIES: tuple[tuple[str, Callable[..., Obstacles], tuple[tuple[Any, ...], ...]], ...] = (
    ("basic", blocks, ((0, 0, 0), (1, 1, 0.35), (2, 1, 0.4), (2, 2, 0.4), (3, 2, 0.4), (3, 3, 0.4))),
    (
        "fulfilment centre",
        fulfilment,
        ((6, 5, 40, 60), (7, 5, 40, 60), (8, 6, 36, 60), (9, 7, 34, 80), (10, 8, 30, 80), (12, 9, 26, 60)),
    ),
    (
        "warehouse",
        warehouse,
        (
            (8, 110, 3, 1, 0.5),
            (10, 110, 3, 2, 0.55),
            (8, 140, 4, 2, 0.6),
            (12, 130, 4, 2, 0.65),
            (10, 120, 5, 3, 0.65),
            (14, 120, 6, 3, 0.65),
        ),
    ),
    (
        "cells",
        cells,
        ((3, 2, 0.7, 14), (4, 2, 0.7, 14), (4, 3, 0.7, 12), (5, 3, 0.7, 12), (5, 4, 0.68, 10), (6, 4, 0.66, 10)),
    ),
    (
        "lines",
        lines,
        ((2, 50, 0), (3, 40, 120), (3, 60, 0), (4, 40, 100), (5, 36, 90), (6, 30, 80)),
    ),
)  # fmt: skip


def scenes() -> tuple[Scene, ...]:
    """All thirty layouts, by category."""
    return tuple(
        Scene(category, number, Floor(WIDTH, HEIGHT, tuple(draw(*parameters))))
        for category, (_, draw, layouts) in enumerate(CATEGORIES, start=1)
        for number, parameters in enumerate(layouts, start=1)
    )


def _fields(columns: int, rows: int, border: float = _MARGIN) -> Iterator[tuple[float, float, float, float]]:
    """Centre, width and height of equal fields inside the border, row by row."""
    for j in range(rows):
        for i in range(columns):
            w, h = (WIDTH - 2 * _MARGIN) / columns, (HEIGHT - 2 * border) / rows
            yield _MARGIN + (i + 0.5) * w, border + (j + 0.5) * h, w, h


def _centred(x: float, y: float, w: float, h: float) -> FloatArray:
    return rectangle(x - w / 2, y - h / 2, x + w / 2, y + h / 2)
