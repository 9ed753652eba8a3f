"""A floor plan as a text file: walls, pillars, and where slots, bays, homes and chargers may be.

Lengths are metres, x to the right and y down, as on a drawing::

    name: corner_garage
    pitch_m: 8.1                          # length of a cell; 7.0 if not given
    outline: [[0, 0], [60, 0], [60, 30], [0, 30]]           # the walls around the floor
    walls:
      - [[20, 12], [26, 12], [26, 15], [20, 15]]            # polygons: stairs, shafts, inner walls
    pillars:
      - {from: [8.1, 8.1], to: [56.7, 24.3], every: 8.1, size: 0.6}
    slots:
      - {box: [8.1, 0, 56.7, 8.1], opens: south}            # [left, top, right, bottom]; the aisle is to the south
    bays:
      - {box: [0, 8.1, 4, 24.3], opens: east, per_cell: 1}
    homes: []                                               # and chargers: the same
    street: {from: [-8, 30], to: [-8, 0]}                   # cars pass the bays on their right

Instead of an outline, or with it, a picture may show the walls, dark on light::

    picture: {file: plan.png, metres_per_pixel: 0.1, threshold: 0.5}

A box holds as many places as fit: a place is in the box if its middle is. ``per_cell`` 2 (the default) puts two places
side by side on a cell's spur, 1 puts one. ``origin: [x, y]`` fixes where the middle of a cell lies; by default the
cells are shifted to where the most slots fit.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import chain, islice, product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sumo_nets.errors import in_lines
from sumo_nets.fields import all_errors
from sumo_nets.freespace.floor import Floor, rectangle
from sumo_nets.graph import FloatArray, Role
from sumo_nets.input_file import MEGABYTE, check_file
from sumo_nets.layout import FIELD_OF_ROLE, LayoutError
from sumo_nets.wording import cut
from sumo_nets.yaml_file import YamlError, read_mapping

Metre = Annotated[float, Field(ge=-1000, le=5000, allow_inf_nan=False)]
Spot = tuple[Metre, Metre]
Polygon = Annotated[tuple[Spot, ...], Field(min_length=3)]
#: A floor is at most this wide or high, in metres and in pixels of a picture.
_LARGEST_M, _LARGEST_PIXELS = 2000.0, 8000
#: A street may be this much out of line, and must be at least so long.
_STRAIGHT_M, _SHORTEST_STREET_M = 1.0, 21.0
#: A picture with more rectangles than this is no drawing of walls.
_MOST_SOLIDS = 5000
#: Bytes of a picture's file, its formats, and rows that are looked at together.
_MOST_BYTES, _FORMATS, _ROWS = 100 * MEGABYTE, ("PNG", "PPM", "JPEG", "BMP", "GIF", "TIFF"), 256


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Pillars(_Part):
    """Square pillars on a grid.

    Attributes:
        start, to: middle of the first and of the last pillar, metres (``from`` and ``to`` in the file).
        every: distance of their middles, metres.
        size: side of a pillar, metres.
    """

    start: Spot = Field(alias="from", description="middle of the first pillar, [x, y] in metres")
    to: Spot = Field(description="middle of the last pillar, [x, y] in metres")
    every: float = Field(ge=1, le=100, description="distance between the middles of two pillars, metres")
    size: float = Field(gt=0, le=5, description="side of a pillar, metres")

    def polygons(self) -> Iterator[FloatArray]:
        """Their corners."""
        half = self.size / 2
        counts = [round(abs(b - a) / self.every) + 1 for a, b in zip(self.start, self.to, strict=True)]
        steps = [self.every if b >= a else -self.every for a, b in zip(self.start, self.to, strict=True)]
        for i, j in product(range(counts[0]), range(counts[1])):
            x, y = self.start[0] + i * steps[0], self.start[1] + j * steps[1]
            yield rectangle(x - half, y - half, x + half, y + half)


class Box(_Part):
    """An area for places of one role.

    Attributes:
        box: left, top, right, bottom in metres.
        opens: the side on which the aisle runs.
        per_cell: places on one cell's spur.
    """

    box: tuple[Metre, Metre, Metre, Metre] = Field(description="[left, top, right, bottom] in metres, y down")
    opens: Literal["north", "east", "south", "west"] = Field(description="the side on which the aisle runs")
    per_cell: Literal[1, 2] = Field(default=2, description="places on the spur of one cell")

    @model_validator(mode="after")
    def _in_order(self) -> Box:
        left, top, right, bottom = self.box
        if left >= right or top >= bottom:
            raise ValueError(f"box {list(self.box)} is empty; give [left, top, right, bottom], y down")
        return self


class Picture(_Part):
    """Walls as the dark parts of a picture.

    Attributes:
        file: PNG, PGM, JPEG, BMP, GIF or TIFF; relative to the plan's folder.
        metres_per_pixel: scale.
        threshold: brightness below which a pixel is wall, 0 black to 1 white.
    """

    file: str = Field(description="PNG, PGM, JPEG, BMP, GIF or TIFF; relative to the plan's folder")
    metres_per_pixel: float = Field(ge=0.01, le=1, description="scale of the picture, metres")
    threshold: float = Field(default=0.5, gt=0, lt=1, description="a darker pixel is wall; 0 is black, 1 is white")


class Street(_Part):
    """The street along the bays, driven from ``from`` to ``to``, along one axis; bays lie on its right."""

    start: Spot = Field(alias="from", description="where customers enter the street, [x, y] in metres")
    to: Spot = Field(description="where customers leave the street, [x, y] in metres")

    @model_validator(mode="after")
    def _straight(self) -> Street:
        along, across = sorted((abs(a - b) for a, b in zip(self.start, self.to, strict=True)), reverse=True)
        if across > _STRAIGHT_M:
            raise ValueError(f"from {list(self.start)} to {list(self.to)} is slanted; a street is upright or level")
        if along < _SHORTEST_STREET_M:
            raise ValueError(f"from {list(self.start)} to {list(self.to)} is short; {_SHORTEST_STREET_M:g} m is valid")
        return self


class FloorPlan(_Part):
    """A whole plan, as written in the file; the module's text explains every key."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60, description="name of the garage")
    pitch_m: float = Field(default=7.0, ge=6.0, le=20.0, allow_inf_nan=False, description="side of a cell, metres")
    origin: Spot | None = Field(default=None, description="middle of a cell, [x, y] in metres; default: the best one")
    outline: Polygon | None = Field(default=None, description="corners of the hall, [[x, y], ...] in metres")
    picture: Picture | None = Field(default=None, description="walls as the dark parts of a picture")
    walls: tuple[Polygon, ...] = Field(default=(), description="walls as polygons, [[x, y], ...] in metres")
    pillars: tuple[Pillars, ...] = Field(default=(), description="pillars on grids")
    slots: tuple[Box, ...] = Field(min_length=1, description="areas for parked cars")
    bays: tuple[Box, ...] = Field(min_length=1, description="areas where customers hand cars over")
    homes: tuple[Box, ...] = Field(min_length=1, description="areas where AGVs rest")
    chargers: tuple[Box, ...] = Field(default=(), description="areas where AGVs charge")
    street: Street = Field(description="the street along the bays")

    @model_validator(mode="after")
    def _has_walls(self) -> FloorPlan:
        if self.outline is None and self.picture is None:
            raise ValueError("give outline: [[x, y], ...], or picture: {file, metres_per_pixel}")
        return self


def load_plan(path: str | Path) -> tuple[FloorPlan, Floor]:
    """Read a floor plan, and its picture if it has one.

    Args:
        path: a YAML file.

    Returns:
        The plan, and the floor with its walls and pillars in metres.

    Raises:
        LayoutError: a file can't be read or is not a valid plan; one line.
    """
    source = Path(path)
    if source.suffix.lower() in (".png", ".pgm"):
        raise LayoutError(
            f"{source}: a picture shows no bays and slots: write a .yaml with"
            f" picture: {{file: {source.name}, metres_per_pixel: 0.1}}, slots, bays, homes and street"
        )
    try:
        plan = FloorPlan.model_validate(read_mapping(source, "name: my_garage"))
    except YamlError as err:
        raise LayoutError(f"{source}: {err}") from None
    except ValidationError as err:
        raise LayoutError(in_lines([f"{source}: {wrong}" for wrong in all_errors(err, FloorPlan)])) from None
    return plan, _walls(plan, source)


def _walls(plan: FloorPlan, source: Path) -> Floor:
    solids = [np.array(wall, dtype=np.float64) for wall in plan.walls]
    found = chain.from_iterable(grid.polygons() for grid in plan.pillars)
    outline = np.array(plan.outline or np.empty((0, 2)), dtype=np.float64)
    if plan.picture is not None:
        dark = _dark(plan.picture, source)
        scale = plan.picture.metres_per_pixel
        found = chain(found, (scale * box for box in cover(dark)))
        if not len(outline):
            outline = rectangle(0, 0, dark.shape[1] * scale, dark.shape[0] * scale)
    if outline.min() < 0 or outline.max() > _LARGEST_M:
        raise LayoutError(f"{source}: outline: corners between 0 and {_LARGEST_M:g} m are valid")
    solids += islice(found, _MOST_SOLIDS + 1)
    if len(solids) > _MOST_SOLIDS:
        raise LayoutError(f"{source}: more than {_MOST_SOLIDS} walls and pillars: at most so many are valid")
    width, height = outline.max(axis=0).tolist()
    return Floor(width, height, tuple(solids), outline=outline)


def _dark(picture: Picture, source: Path) -> NDArray[np.bool_]:
    """Which pixels are wall, shape (rows, columns)."""
    where = f"{source}: picture.file: {cut(picture.file)}"
    path = source.parent / picture.file
    try:
        check_file(path, _MOST_BYTES)
        pixels = _pixels(path, where)
    except LayoutError:
        raise
    except Exception as err:  # Pillow fails on damaged pictures in many ways
        reason = err.strerror if isinstance(err, OSError) and err.strerror else "not a picture"
        raise LayoutError(f"{where}: can't be read: {reason}") from None
    parts = [_dark_rows(pixels[y : y + _ROWS], picture.threshold) for y in range(0, len(pixels), _ROWS)]
    return np.concatenate(parts)


def _pixels(path: Path, where: str) -> NDArray[Any]:
    """A picture's values, by rows, columns and channels; its size is looked at before it is read."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            opened = Image.open(path, formats=_FORMATS)
        largest = max(opened.size)
    except Image.DecompressionBombError:
        largest = _LARGEST_PIXELS + 1
    if largest > _LARGEST_PIXELS:
        raise LayoutError(f"{where}: at most {_LARGEST_PIXELS} pixels a side are valid")
    with opened as image:
        if image.mode.startswith("I"):
            return np.asarray(image).astype(np.uint16)
        return np.asarray(image if image.mode in ("L", "LA", "RGB", "RGBA") else image.convert("RGBA"))


def _dark_rows(pixels: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    bright = pixels / np.iinfo(pixels.dtype).max
    if bright.ndim == 3:
        # an alpha channel is no brightness: what is transparent is floor
        colour = bright[..., :3].mean(axis=2) if bright.shape[2] >= 3 else bright[..., 0]
        alpha = bright[..., -1] if bright.shape[2] in (2, 4) else np.ones(colour.shape)
        bright = 1 - alpha * (1 - colour)
    dark: NDArray[np.bool_] = bright < threshold
    return dark


def cover(dark: NDArray[np.bool_]) -> Iterator[FloatArray]:
    """Cover the dark pixels with upright rectangles that don't overlap, in pixels.

    Runs of a row that repeat in the rows below become one rectangle.
    """
    open_runs: dict[tuple[int, int], int] = {}
    for y in range(len(dark) + 1):
        row = dark[y] if y < len(dark) else np.zeros(dark.shape[1], dtype=np.bool_)
        ends = np.flatnonzero(np.diff(np.concatenate(([0], row.astype(np.int8), [0]))))
        runs = {(int(a), int(b)) for a, b in ends.reshape(-1, 2)}
        for run in [run for run in open_runs if run not in runs]:
            yield rectangle(run[0], open_runs.pop(run), run[1], y)
        for run in sorted(runs):
            open_runs.setdefault(run, y)


def boxes_of(plan: FloorPlan) -> Iterator[tuple[Role, str, Box]]:
    """Every box with its role and what to call it in an error."""
    roles: tuple[Role, ...] = ("bay", "slot", "home", "charger")
    for role in roles:
        for i, box in enumerate(getattr(plan, FIELD_OF_ROLE[role])):
            yield role, f"{FIELD_OF_ROLE[role]}[{i}]", box
