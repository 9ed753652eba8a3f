"""Floors generated from a few numbers, for experiments: graphs only, without a SUMO net."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from sumo_nets.graph import Graph, make_graph

#: Column and row on a floor's raster.
Spot = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ForkFloor:
    """A floor like that of Do et al. (2010, section 4.1). The paper prints its size and its numbers of nodes.

    A one-way ring, driven counter-clockwise, and a one-way aisle across it; storage lanes, driven both ways, are dead
    ends off their nodes. In the paper's table the two routes of a query differ by nothing, or by 11 nodes, once by 9:
    their floor, too, offers hardly more than one choice, which makes such a ring with one aisle across it likely. With
    the defaults the ways over the top and across differ by 12.

    Attributes:
        columns, rows: aisles' nodes less one, from west to east and from south to north.
        across: row of the aisle across the ring.
        lanes: storage lanes; on the three long aisles first, then half-way on the short ones.
        depth: two-way nodes of a storage lane.
        lane_pitch_m: metres between them.
        width_m, height_m: the floor.
        margin_m: metres between ring and walls.
    """

    columns: int = 16
    rows: int = 11
    across: int = 5
    lanes: int = 49
    depth: int = 3
    lane_pitch_m: float = 1.4
    width_m: float = 70.0
    height_m: float = 36.0
    margin_m: float = 2.0

    def graph(self) -> Graph:
        """The floor as a graph. One-way nodes are called ``x,y``, those of storage lanes ``x,y+k``; lanes are slots."""
        at = {f"{x},{y}": self._metres((x, y)) for x, y in self._one_way()}
        pairs = [(f"{a[0]},{a[1]}", f"{b[0]},{b[1]}") for a, b in self._aisles()]
        slots = []
        for (x, y), (dx, dy) in list(self._lane_mouths())[: self.lanes]:
            names = [f"{x},{y}", *(f"{x},{y}+{k}" for k in range(1, self.depth + 1))]
            x_m, y_m = at[names[0]]
            for k, name in enumerate(names[1:], 1):
                at[name] = (x_m + dx * k * self.lane_pitch_m, y_m + dy * k * self.lane_pitch_m)
            pairs += [pair for a, b in pairwise(names) for pair in ((a, b), (b, a))]
            slots += names[1:]
        return _floor("fork floor", at, pairs, slots)

    def _metres(self, spot: Spot) -> tuple[float, float]:
        across_m, along_m = self.width_m - 2 * self.margin_m, self.height_m - 2 * self.margin_m
        return (self.margin_m + spot[0] * across_m / self.columns, self.margin_m + spot[1] * along_m / self.rows)

    def _one_way(self) -> list[Spot]:
        return sorted({spot for pair in self._aisles() for spot in pair})

    def _aisles(self) -> Iterator[tuple[Spot, Spot]]:
        east, north = self.columns, self.rows
        corners = [(0, 0), (east, 0), (east, north), (0, north), (0, 0)]
        for a, b in [*pairwise(corners), ((east, self.across), (0, self.across))]:
            yield from pairwise(_line(a, b))

    def _lane_mouths(self) -> Iterator[tuple[Spot, Spot]]:
        """Where storage lanes may begin, and the direction in which they go."""
        for y, dy in ((0, 1), (self.across, 1), (self.rows, -1)):
            yield from (((x, y), (0, dy)) for x in range(1, self.columns))
        for y in ((self.across + 1) // 2, (self.across + self.rows) // 2):
            yield (0, y), (1, 0)
            yield (self.columns, y), (-1, 0)


def one_way_lattice(columns: int = 18, rows: int = 12, pitch_m: float = 4.0) -> Graph:
    """One-way streets, each against the one beside it; with even numbers every node can be reached from every other.

    Args:
        columns, rows: nodes from west to east and from south to north.
        pitch_m: metres between them.

    Returns:
        The graph; nodes are called ``x,y`` and numbered row by row from the south-west.
    """
    at = {f"{x},{y}": (x * pitch_m, y * pitch_m) for y in range(rows) for x in range(columns)}
    streets = [_line((0, y), (columns - 1, y))[:: -1 if y % 2 else 1] for y in range(rows)]
    streets += [_line((x, 0), (x, rows - 1))[:: 1 if x % 2 else -1] for x in range(columns)]
    return _floor("lattice", at, [(f"{a[0]},{a[1]}", f"{b[0]},{b[1]}") for s in streets for a, b in pairwise(s)], [])


def _line(a: Spot, b: Spot) -> list[Spot]:
    """The spots from a to b, both included, which share a column or a row."""
    length = abs(b[0] - a[0]) + abs(b[1] - a[1])
    dx, dy = (b[0] - a[0]) // max(1, length), (b[1] - a[1]) // max(1, length)
    return [(a[0] + k * dx, a[1] + k * dy) for k in range(length + 1)]


def _floor(name: str, at: dict[str, tuple[float, float]], pairs: list[tuple[str, str]], slots: list[str]) -> Graph:
    """A graph of straight edges."""
    edges = [(f"{a}>{b}", a, b, abs(at[a][0] - at[b][0]) + abs(at[a][1] - at[b][1])) for a, b in pairs]
    return make_graph(name, [(v, x, y) for v, (x, y) in at.items()], edges, {"slot": slots})
