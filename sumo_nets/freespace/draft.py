"""A layout in the making: lanes and spurs on cells, written as runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from sumo_nets.freespace.cells import Cell
from sumo_nets.freespace.floorplan import FloorPlan
from sumo_nets.graph import Role
from sumo_nets.layout import FIELD_OF_ROLE, Layout, Side

#: A spur: the aisle's cell and the side of it.
SpurKey = tuple[Cell, Side]


@dataclass
class Draft:
    """A layout in the making, on the tracer's own cells.

    Attributes:
        plan: the floor plan.
        lanes: pairs of neighbouring cells.
        spurs: role, number of places and the box's name of each spur.
        street: first and last cell of the street.
        low: the cell that becomes [0, 0].
    """

    plan: FloorPlan
    lanes: set[frozenset[Cell]]
    spurs: dict[SpurKey, tuple[Role, int, str]]
    street: tuple[Cell, Cell]
    low: Cell = field(init=False)

    def __post_init__(self) -> None:
        used = [cell for lane in self.lanes for cell in lane] + [cell for cell, _ in self.spurs] + [*self.street]
        self.low = min(x for x, _ in used), min(y for _, y in used)

    def at(self, cell: Cell) -> list[int]:
        """A cell as the layout counts it."""
        return [cell[0] - self.low[0], cell[1] - self.low[1]]

    def layout(self) -> Layout:
        """The layout as far as it is, every lane two-way."""
        data: dict[str, Any] = {"name": self.plan.name, "pitch_m": self.plan.pitch_m, "handover": "bay"}
        data["aisles"] = [
            {"from": self.at(run[0]), "to": self.at(run[-1]), "way": "two"} for run in _straight_runs(self.lanes)
        ]
        for role, key in FIELD_OF_ROLE.items():
            data[key] = list(self._spur_rows(role))
        data["street"] = {"from": self.at(self.street[0]), "to": self.at(self.street[1])}
        return Layout.model_validate(data)

    def _spur_rows(self, role: Role) -> Iterator[dict[str, Any]]:
        chosen = [(side, per_cell, cell) for (cell, side), (r, per_cell, _) in self.spurs.items() if r == role]
        for (side, per_cell), group in groupby(sorted(chosen), key=lambda spur: spur[:2]):
            along = 0 if side in ("north", "south") else 1
            for run in _runs([cell for _, _, cell in group], along):
                where = {"from": self.at(run[0]), "to": self.at(run[-1])} if len(run) > 1 else {"at": self.at(run[0])}
                yield {**where, "side": side, "per_cell": per_cell}


def _runs(cells: Sequence[Cell], along: int) -> Iterator[list[Cell]]:
    """Unbroken runs of cells along an axis (0: in a row, 1: in a column)."""
    run: list[Cell] = []
    for cell in sorted(cells, key=lambda c: (c[1 - along], c[along])):
        if run and (cell[1 - along], cell[along]) != (run[-1][1 - along], run[-1][along] + 1):
            yield run
            run = []
        run.append(cell)
    if run:
        yield run


def _straight_runs(lanes: set[frozenset[Cell]]) -> Iterator[list[Cell]]:
    """Lanes as straight runs of cells, as long as they go."""
    for along in (0, 1):
        firsts = [min(lane) for lane in lanes if len({cell[1 - along] for cell in lane}) == 1]
        for run in _runs(firsts, along):
            last = run[-1]
            yield [*run, (last[0] + 1 - along, last[1] + along)]
