"""The floor of the replay: lanes and places as they are drawn, and where cars stand on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from analysis.replay_data import Floats, Ints, Pose, cm, tenths
from analysis.tables import Run
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered

if TYPE_CHECKING:
    import pandas as pd

#: Drawn in this order, so that a charger or home shows on top of a slot.
_ROLES: Final = ("slot", "refuge", "charger", "bay", "home")
#: From a bay's nearest point of the street to where arriving and leaving cars stand: along it, and to the bay's side.
_ALONG_M, _BESIDE_M = 4.5, 2.4
#: Kinds of places where cars stand.
SLOT, INBOUND, OUTBOUND = range(3)


@dataclass(frozen=True)
class Floor:
    """The floor plan.

    Attributes:
        index: number of each vertex by name.
        drawn: what the page draws, coordinates in centimetres.
        places: role -> numbers of the vertices that have it, in the layout's order.
        bodies: where an AGV stands that came by a lane into a vertex: x, y (cm) and angle (0.1 degrees).
        streets: centre lines of the street but for its entry.
        xy: vertices in metres.
    """

    index: Mapping[str, Vertex]
    drawn: Mapping[str, Any]
    places: Mapping[str, Sequence[Vertex]]
    bodies: Mapping[Vertex, Pose]
    streets: Sequence[Floats]
    xy: Floats

    def standing(self, name: str) -> Pose:
        """Where a car stands in a slot."""
        vertex = self.index[name]
        x, y = cm(self.xy[vertex]).tolist()
        return self.bodies.get(vertex, (x, y, 0))

    def street_place(self, bay: str, place: int) -> Pose | None:
        """Where a customer's car stands at a bay; None without a street or bay."""
        if bay not in self.index or not self.streets:
            return None
        at = self.xy[self.index[bay]]
        gap, foot, along = min((_foot(line, at) for line in self.streets), key=lambda found: found[0])
        aside = (at - foot) / max(gap, 1e-9) * _BESIDE_M
        x, y = cm(foot + aside + along * (_ALONG_M if place == OUTBOUND else -_ALONG_M)).tolist()
        return x, y, tenths(along)


def read_floor(run: Run) -> Floor:
    """The floor of a recorded run."""
    names = run.vertices["vertex"].tolist()
    xy = run.vertices[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    places = _places(run.vertices)
    ends = run.edges[["tail", "head"]].to_numpy(dtype=np.int64)
    lines = _lines(run.shapes)
    lanes = {edge: line for edge, _, line in lines if edge >= 0}
    streets = [(part, line) for edge, part, line in lines if edge < 0]
    spurs = _spur_ends(ends, places["slot"])
    length = ((run.meta.get("scenario") or {}).get("agv") or {}).get("length_m", 4.7)
    bodies = {Vertex(int(head)): _body(lanes[EdgeIndex(e)], length) for e, (_, head) in enumerate(ends) if e in lanes}
    drawn = {
        "names": names,
        "xy": cm(xy).tolist(),
        "lanes": _drawn_lanes(xy, ends, lanes, spurs),
        "places": [
            [role, v, *(bodies[v] if v in spurs and v in bodies else (*cm(xy[v]).tolist(), 0)), int(v in spurs), number]
            for role in _ROLES for number, v in enumerate(places[role], start=1)
        ],
        "streets": [[part, cm(line).ravel().tolist()] for part, line in streets],
    }  # fmt: skip
    near = [line for part, line in streets if part != "entry"]
    return Floor({name: Vertex(v) for v, name in enumerate(names)}, drawn, places, bodies, near, xy)


def _places(vertices: pd.DataFrame) -> dict[str, list[Vertex]]:
    """Role -> vertices that have it, in the layout's order."""
    found: dict[str, dict[int, Vertex]] = {role: {} for role in _ROLES}
    texts: Numbered[Vertex, tuple[str, str]] = list(zip(vertices["roles"], vertices["numbers"], strict=True))
    for v, (roles, numbers) in numbered(texts):
        for role, number in zip(roles.split(","), numbers.split(","), strict=True):
            if role:
                found[role][int(number)] = v
    return {role: [by_number[number] for number in sorted(by_number)] for role, by_number in found.items()}


def _lines(shapes: pd.DataFrame) -> list[tuple[EdgeIndex, str, Floats]]:
    """Edge, part of the street and points of each line."""
    first = np.flatnonzero(np.diff(shapes["line"].to_numpy(), prepend=-1))
    points = np.split(shapes[["x_m", "y_m"]].to_numpy(dtype=np.float64), first[1:])
    heads = shapes.iloc[first]
    return list(zip(heads["edge"].tolist(), heads["part"].tolist(), points, strict=bool(len(first))))


def _spur_ends(ends: Ints, slots: Iterable[Vertex]) -> set[Vertex]:
    """Vertices with one lane in and one out, by the same neighbour; none on an open floor, where slots are aisle."""
    tails: dict[Vertex, list[Vertex]] = {}
    heads: dict[Vertex, list[Vertex]] = {}
    for tail, head in ends.tolist():
        heads.setdefault(tail, []).append(head)
        tails.setdefault(head, []).append(tail)
    found = {v for v, onward in heads.items() if len(onward) == 1 and tails.get(v) == onward}
    return found if found.issuperset(slots) else set()


def _drawn_lanes(xy: Floats, ends: Ints, lanes: Mapping[EdgeIndex, Floats], spurs: set[Vertex]) -> list[list[int]]:
    """Kind (0 two-way, 1 one-way, 2 spur), ends and points of each lane; both directions of one lane once."""
    directed = {(int(tail), int(head)) for tail, head in ends}
    rows = []
    for e, (tail, head) in enumerate(ends.tolist()):
        two_way = (head, tail) in directed
        if two_way and tail > head:
            continue
        spur = two_way and (tail in spurs or head in spurs)
        points = lanes.get(EdgeIndex(e), xy[[tail, head]]) if spur else xy[[tail, head]]
        rows.append([2 if spur else 0 if two_way else 1, tail, head, *cm(points).ravel().tolist()])
    return rows


def _body(lane: Floats, length_m: float) -> Pose:
    """Where an AGV stands with its front at the end of a lane."""
    along = (lane[-1] - lane[-2]) / max(float(np.hypot(*(lane[-1] - lane[-2]))), 1e-9)
    x, y = cm(lane[-1] - along * length_m / 2).tolist()
    return x, y, tenths(along)


def _foot(line: Floats, at: Floats) -> tuple[float, Floats, Floats]:
    """Distance to a line, its nearest point, and its direction there."""
    best: tuple[float, Floats, Floats] | None = None
    for a, b in pairwise(line):
        step = b - a
        share = float(np.clip((at - a) @ step / max(float(step @ step), 1e-9), 0.0, 1.0))
        foot = a + share * step
        found = float(np.hypot(*(at - foot))), foot, step / max(float(np.hypot(*step)), 1e-9)
        best = found if best is None or found[0] < best[0] else best
    if best is None:
        raise ValueError("a line has two points at least")
    return best
