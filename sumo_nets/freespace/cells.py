"""Cells laid over a floor: which an AGV may drive on and turn in, and which way along them is nearest to a path."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping

import numpy as np

from sumo_nets.bodies import AGV_LENGTH_M, AGV_WIDTH_M, MIN_GAP_M, driving_bodies
from sumo_nets.freespace.floor import Floor, Point, room_around
from sumo_nets.graph import FloatArray
from sumo_nets.layout import STEP, Side

#: Room between bodies and walls is not measured beyond this.
ROOM_REACH_M = 3.0
#: Laying a guide path on cells, a lane that is there already costs this share of a new one.
_REUSE = 0.5
OPPOSITE: Mapping[Side, Side] = {"north": "south", "south": "north", "east": "west", "west": "east"}

Cell = tuple[int, int]


class Cells:
    """The cells an AGV may drive on and turn in every way, and which of them are joined."""

    def __init__(self, walls: Floor, floor: Floor, origin: Point, pitch: float) -> None:
        self.origin, self.pitch, self.walls = origin, pitch, walls
        columns, rows = (
            range(-int(o // pitch), int((size - o) // pitch) + 1)
            for size, o in zip((walls.width, walls.height), origin, strict=True)
        )
        free = {(x, y) for x in columns for y in rows if floor.holds(self.centre((x, y)))}
        self.beside = {
            cell: [there for there in neighbours(cell) if there in free and self._sees(floor, cell, there)]
            for cell in sorted(free)
        }
        for cell in self._tight():
            for there in self.beside.pop(cell):
                if there in self.beside:
                    self.beside[there].remove(cell)

    def centre(self, cell: Cell) -> Point:
        """Middle of a cell in the plan's metres."""
        return self.origin[0] + cell[0] * self.pitch, self.origin[1] + cell[1] * self.pitch

    def _sees(self, floor: Floor, here: Cell, there: Cell) -> bool:
        return floor.sees(self.centre(here), self.centre(there))

    def _tight(self) -> set[Cell]:
        """Cells in which some turn between joined cells comes too close to a wall."""
        index = {cell: i for i, cell in enumerate(self.beside)}
        lanes = [(here, there) for here, others in self.beside.items() for there in others]
        if not lanes:
            return set()
        tail, head = (np.array([index[lane[k]] for lane in lanes], dtype=np.int32) for k in (0, 1))
        shapes = [np.array([self.centre(here), self.centre(there)]) for here, there in lanes]
        tight: set[Cell] = set()
        for bodies, before, _ in driving_bodies(tail, head, shapes):
            room = room_of(bodies, self.walls)
            tight |= {lanes[e][1] for e in before[room < MIN_GAP_M].tolist()}
        return tight

    def lay(self, path: FloatArray, start: Cell, goal: Cell, lanes: set[frozenset[Cell]]) -> list[Cell]:
        """The cells along a path: the shortest way where leaving the path costs extra; none if there is no way."""
        OPEN: list[tuple[float, Cell]] = [(0.0, start)]
        g = {start: 0.0}
        parent: dict[Cell, Cell] = {}
        while OPEN:
            g_here, here = heapq.heappop(OPEN)
            if here == goal:
                way = [goal]
                while way[-1] in parent:
                    way.append(parent[way[-1]])
                return way[::-1]
            if g_here > g[here]:
                continue
            for there in self.beside[here]:
                a, b = self.centre(here), self.centre(there)
                aside = _distance(((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), path)
                share = _REUSE if frozenset((here, there)) in lanes else 1.0
                g_there = g_here + (self.pitch + aside) * share
                if g_there < g.get(there, np.inf):
                    g[there], parent[there] = g_there, here
                    heapq.heappush(OPEN, (g_there, there))
        return []


def neighbours(cell: Cell) -> Iterator[Cell]:
    """The four cells beside a cell."""
    for side in OPPOSITE:
        yield _step(cell, side)


def _step(cell: Cell, side: Side) -> Cell:
    return cell[0] + STEP[side][0], cell[1] + STEP[side][1]


def _distance(point: Point, path: FloatArray) -> float:
    """Distance of a point from a path."""
    a, u = path[:-1], np.diff(path, axis=0)
    t = ((np.array(point) - a) * u).sum(axis=1) / np.maximum((u * u).sum(axis=1), 1e-12)
    near = a + np.clip(t, 0, 1)[:, None] * u
    return float(np.hypot(*(near - point).T).min())


def room_of(bodies: FloatArray, walls: Floor) -> FloatArray:
    """Least room between each body, shape (n, 4), and walls or pillars, ``ROOM_REACH_M`` at most, shape (n,)."""
    room: FloatArray = room_around(bodies, AGV_LENGTH_M, AGV_WIDTH_M, walls.edges, ROOM_REACH_M)
    return room
