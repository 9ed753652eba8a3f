"""A garage as a text file that is pleasant to write by hand.

A layout is YAML. Positions are whole cells, ``[x, y]`` with x to the right and y down, as on a drawing; one cell is
``pitch_m`` metres. Aisles are either runs of cells or, for an open floor, a picture::

    name: corner
    pitch_m: 7.0
    handover: bay                 # customers hand over at bays; or `home`: where the AGVs live, without a street
    aisles:
      - {from: [2, 6], to: [2, 0], way: one}     # one-way: driven from `from` to `to`
      - {from: [2, 0], to: [9, 0], way: two}     # one lane for both directions
      - {from: [9, 0], to: [9, 6], way: one}
      - {from: [9, 6], to: [2, 6], way: one}
    slots:
      - {from: [4, 0], to: [7, 0], side: [north, south], per_cell: 2}
    bays:
      - {at: [2, 3], side: west}
    homes:
      - {at: [9, 2], side: east, per_cell: 2}
    chargers:
      - {at: [9, 5], side: east}
    refuges:
      - {at: [8, 0], side: north}                # a spur to give way in
    street: {from: [0, 6], to: [0, 0]}           # driven from `from` to `to`, bays on its right

Runs that share a cell cross there, and an AGV may turn there any way the runs allow. A slot, bay, home, charger or
refuge is a spur: a dead end on one ``side`` (north, east, south, west) of an aisle cell. ``per_cell`` 1 is a straight
spur, 10 m long to a slot and 7 m otherwise; 2 puts two of 10 m side by side. ``side: here`` makes the aisle cell itself
the slot, home or charger. The order of rows is the order in which homes are used.

A picture draws an open floor, all of it two-way: ``#`` is wall, ``.`` floor and ``S`` a slot, one character a cell,
the first character is cell ``[0, 0]``; cells side by side are connected::

    picture: |
      #SS#SS#
      .......
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, field_validator, model_validator

from sumo_nets.errors import InputError, in_lines
from sumo_nets.fields import all_errors
from sumo_nets.graph import Role
from sumo_nets.yaml_file import YamlError, parse_mapping, read_mapping

Side = Literal["north", "east", "south", "west", "here"]

#: One cell further in each direction; y grows downwards.
STEP: dict[Side, tuple[int, int]] = {"north": (0, -1), "east": (1, 0), "south": (0, 1), "west": (-1, 0)}

#: Cells are numbered from 0; the upper bound catches slips of the keyboard.
Coordinate = Annotated[int, Strict(), Field(ge=0, le=5000)]
Cell = tuple[Coordinate, Coordinate]
Metres = Annotated[float, Field(gt=0, le=2000, allow_inf_nan=False)]

#: The layout's key for the spurs of each role.
FIELD_OF_ROLE: dict[Role, str] = {
    "slot": "slots",
    "bay": "bays",
    "home": "homes",
    "charger": "chargers",
    "refuge": "refuges",
}
_PICTURE_CHARACTERS = "#.S"


#: What a layout begins with.
_SUCH_AS = "name: my_garage"


class LayoutError(InputError):
    """A layout that can't be built; the message is one line: file, field, value, what would be valid."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=False)


class Aisle(_Part):
    """A straight run of cells with one lane.

    Attributes:
        start, to: first and last cell (``from`` and ``to`` in the file), in one row or one column.
        way: ``one``: driven from ``from`` to ``to`` only; ``two``: a single-width lane for both directions.
    """

    start: Cell = Field(alias="from", description="First cell, [x, y].")
    to: Cell = Field(description="Last cell, in the same row or column.")
    way: Literal["one", "two"] = Field(
        description="one: driven from `from` to `to` only; two: a single lane for both directions."
    )

    @model_validator(mode="after")
    def _straight(self) -> Aisle:
        _check_run(self.start, self.to)
        if self.start == self.to:
            raise ValueError(f"an aisle needs two cells or more, but from and to are both {list(self.to)}")
        return self


class Spurs(_Part):
    """Dead ends of one role beside aisle cells.

    Attributes:
        at: the aisle cell, or
        start, to: first and last aisle cell of a run (``from`` and ``to`` in the file).
        side: side or sides of the aisle; ``here`` for the aisle cell itself.
        per_cell: 1 for a straight spur, 2 for two side by side.
    """

    at: Cell | None = Field(default=None, description="The aisle cell, [x, y]; or a run of cells with `from` and `to`.")
    start: Cell | None = Field(default=None, alias="from", description="First aisle cell of a run.")
    to: Cell | None = Field(default=None, description="Last aisle cell of a run.")
    side: tuple[Side, ...] = Field(description="Side or sides of the aisle; here: the aisle cell itself.")
    per_cell: Annotated[int, Strict(), Field(ge=1, le=2)] = Field(
        default=1, description="1: a straight spur; 2: two side by side."
    )

    @field_validator("side", mode="before")
    @classmethod
    def _one_or_many(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @model_validator(mode="after")
    def _placed(self) -> Spurs:
        if (self.at is None) == (self.start is None) or (self.start is None) != (self.to is None):
            raise ValueError("give either at: [x, y], or both from: [x, y] and to: [x, y]")
        if self.start is not None and self.to is not None:
            _check_run(self.start, self.to)
        if not self.side or len(set(self.side)) < len(self.side):
            raise ValueError(f"side must name each side once, not {list(self.side)}")
        if "here" in self.side and (len(self.side) > 1 or self.per_cell > 1):
            raise ValueError("side: here stands alone, with per_cell: 1")
        return self

    def cells(self) -> Iterator[tuple[int, int]]:
        """The aisle cells, from the first to the last."""
        if self.at is not None:
            yield self.at
        elif self.start is not None and self.to is not None:
            yield from run_cells(self.start, self.to)


class StreetPlan(_Part):
    """The one-way public street along the bays; customers pass it once, from its entry to its exit.

    Attributes:
        start, to: the part along the bays (``from`` and ``to`` in the file), straight; bays lie on its right.
        entry_m: length of public street before the garage's own hold lane.
        queue_m: length of the hold lane.
        exit_m: length of street after the bays.
    """

    start: Cell = Field(alias="from", description="First cell of the part along the bays.")
    to: Cell = Field(description="Last cell of that part; bays lie on the right of the street.")
    entry_m: Metres = Field(default=150.0, description="Length of public street before the hold lane, m.")
    queue_m: Metres = Field(default=70.0, description="Length of the hold lane, m.")
    exit_m: Metres = Field(default=80.0, description="Length of street after the bays, m.")

    @model_validator(mode="after")
    def _straight(self) -> StreetPlan:
        _check_run(self.start, self.to)
        if self.start == self.to:
            raise ValueError(f"a street needs two cells or more, but from and to are both {list(self.to)}")
        return self


class Layout(_Part):
    """A whole garage, as written in the file; the module's text explains every key.

    Example:
        >>> import parking_sim as ps
        >>> row = {"from": [0, 0], "to": [6, 0]}
        >>> layout = ps.load_layout({
        ...     "name": "row", "pitch_m": 7.0, "handover": "home", "aisles": [{**row, "way": "two"}],
        ...     "slots": [{"from": [1, 0], "to": [5, 0], "side": "north"}], "homes": [{"at": [0, 0], "side": "south"}],
        ... })
        >>> layout.changed(slots=[{"from": [1, 0], "to": [5, 0], "side": ["north", "south"]}])
        <Layout row: 1 aisle, 10 slots, 1 home, pitch 7 m>
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)] = Field(
        description="Name of the net: a letter, then letters, digits and _."
    )
    pitch_m: Annotated[float, Field(ge=6.0, le=20.0, allow_inf_nan=False)] = Field(description="Length of one cell, m.")
    handover: Literal["bay", "home"] = Field(
        description="Where customers hand over: bay: at bays along a street; home: where the AGVs live."
    )
    picture: str = Field(default="", description="An open floor: # wall, . floor, S slot, one character a cell.")
    aisles: tuple[Aisle, ...] = Field(default=(), description="Runs of cells with one lane.")
    slots: tuple[Spurs, ...] = Field(default=(), description="Places for parked cars.")
    bays: tuple[Spurs, ...] = Field(default=(), description="Places where customers hand over their cars.")
    homes: tuple[Spurs, ...] = Field(description="Places where AGVs wait, in the order in which they are used.")
    chargers: tuple[Spurs, ...] = Field(default=(), description="Places where AGVs charge.")
    refuges: tuple[Spurs, ...] = Field(default=(), description="Spurs to give way in.")
    street: StreetPlan | None = Field(default=None, description="The public street along the bays.")

    @field_validator("picture")
    @classmethod
    def _drawn(cls, value: str) -> str:
        for y, row in enumerate(value.splitlines()):
            for x, char in enumerate(row):
                if char not in _PICTURE_CHARACTERS:
                    raise ValueError(f"{char!r} in row {y}, column {x}: draw with # wall, . floor, S slot")
        return value

    @model_validator(mode="after")
    def _complete(self) -> Layout:
        if not self.aisles and not self.picture:
            raise ValueError("aisles: none given; give aisles, or a picture")
        if not self.homes:
            raise ValueError("homes: none given; at least one AGV needs a home")
        if self.handover == "bay" and (self.street is None or not self.bays):
            raise ValueError("handover: 'bay' needs bays and a street; without them write handover: home")
        if self.handover == "home" and (self.street is not None or self.bays):
            raise ValueError("handover: 'home' takes neither bays nor a street; with them write handover: bay")
        return self

    def __repr__(self) -> str:
        """Name, parts and pitch in one line."""
        parts = [_counted(len(self.aisles), "aisle")] if self.aisles else []
        for role in FIELD_OF_ROLE:
            number = sum(len(row.side) * row.per_cell for row in self.spurs(role) for _ in row.cells())
            number += sum(slot for _, slot in self.floor()) if role == "slot" else 0
            parts += [_counted(number, role)] if number else []
        return f"<Layout {self.name}: {', '.join(parts)}, pitch {self.pitch_m:g} m>"

    __str__ = __repr__

    def changed(self, **changes: Any) -> Layout:
        """A copy with other values, checked as a whole.

        Args:
            changes: key of the layout -> its new value, as in a layout file.

        Returns:
            The new layout; this one stays as it is.

        Raises:
            LayoutError: the parts do not fit together.
        """
        return _checked({**self.model_dump(by_alias=True, exclude_defaults=True), **changes}, self.name)

    def spurs(self, role: Role) -> tuple[Spurs, ...]:
        """The rows of one role."""
        rows: tuple[Spurs, ...] = getattr(self, FIELD_OF_ROLE[role])
        return rows

    def floor(self) -> Iterator[tuple[tuple[int, int], bool]]:
        """The picture's open cells, row by row, each with whether it is a slot."""
        for y, row in enumerate(self.picture.splitlines()):
            for x, char in enumerate(row):
                if char != "#":
                    yield (x, y), char == "S"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def run_cells(start: tuple[int, int], to: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Cells of a straight run, both ends included."""
    dx, dy = ((b > a) - (b < a) for a, b in zip(start, to, strict=True))
    for k in range(max(abs(to[0] - start[0]), abs(to[1] - start[1])) + 1):
        yield start[0] + k * dx, start[1] + k * dy


def _check_run(start: tuple[int, int], to: tuple[int, int]) -> None:
    if start[0] != to[0] and start[1] != to[1]:
        raise ValueError(f"from {list(start)} to {list(to)} is slanted; a run stays in one row or one column")


def parse_layout(text: str, source: str = "layout") -> Layout:
    """Read a layout from YAML text.

    Args:
        text: the YAML.
        source: what to call it in an error, usually the file's path.

    Returns:
        The layout; whether its parts fit together is checked by :func:`sumo_nets.plan.plan_garage`.

    Raises:
        LayoutError: bad YAML, an unknown or missing key, a value out of range; one line.
    """
    try:
        return _checked(parse_mapping(text, _SUCH_AS), source)
    except YamlError as err:
        raise LayoutError(f"{source}: {err}") from None


def load_layout(source: str | Path | Mapping[str, object]) -> Layout:
    """Read a layout from a file, or from a mapping with the keys of such a file.

    Args:
        source: a YAML file, or the mapping.

    Returns:
        The layout.

    Raises:
        LayoutError: the file can't be read, or a key or value is not valid; one line.

    Example:
        >>> import parking_sim as ps
        >>> ps.load_layout({
        ...     "name": "row", "pitch_m": 7.0, "handover": "home",
        ...     "aisles": [{"from": [0, 0], "to": [6, 0], "way": "two"}],
        ...     "slots": [{"from": [1, 0], "to": [5, 0], "side": "north"}], "homes": [{"at": [0, 0], "side": "south"}],
        ... })
        <Layout row: 1 aisle, 5 slots, 1 home, pitch 7 m>
    """
    if isinstance(source, Mapping):
        return _checked(source, str(source.get("name", "layout")))
    path = source
    try:
        return _checked(read_mapping(Path(path), _SUCH_AS), str(path))
    except YamlError as err:
        raise LayoutError(f"{path}: {err}") from None


def _checked(data: Mapping[str, object], source: str) -> Layout:
    try:
        return Layout.model_validate(data)
    except ValidationError as err:
        raise LayoutError(in_lines([f"{source}: {wrong}" for wrong in all_errors(err, Layout)])) from None
