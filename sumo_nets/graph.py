"""The directed graph an AGV moves on: plain arrays, no files, no SUMO.

Vertices are SUMO junctions, edges are SUMO edges. An AGV "at" a vertex stands with its front at the end of the edge
it came by. Edges are sorted by tail vertex, so the edges that leave vertex ``v`` are
``range(first_out[v], first_out[v + 1])``. The types of vertex and edge indices are in ``sumo_nets.numbering``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from sumo_nets.numbering import NO_EDGE, EdgeIndex, Numbered, Places, Vertex, numbered, numbers

IntArray = NDArray[np.int32]
FloatArray = NDArray[np.float64]

#: What a vertex can be for. A vertex may have several roles (in the thesis maps a home is also a bay) or none (aisle).
Role = Literal["slot", "bay", "home", "charger", "refuge"]
ROLES: tuple[Role, ...] = ("slot", "bay", "home", "charger", "refuge")

#: Bends sharper than this that are no reversal, as from one slot into the next one beside it, can't be driven: the body
#: would fold over both spurs.
FOLD_DEG = 135.0


@dataclass(frozen=True, eq=False)
class Graph:
    """A garage as vertices and directed edges.

    Attributes:
        name: name of the garage.
        names: vertex ids, shape (n,); the position in this tuple is the vertex index used everywhere else.
        xy: vertex positions in metres, shape (n, 2).
        tail, head: vertex indices of each edge's ends, shape (m,), sorted by (tail, head).
        length_m: driving length of each edge in metres, shape (m,).
        edge_names: SUMO edge ids, shape (m,).
        limit_mps: speed limit of each edge in metres a second, infinite where there is none, shape (m,).
        roles: for each role the vertices that have it, in the layout's order.
        unconnected: pairs of an edge and one that leaves its head onto which no AGV can drive; the edge back is one.
    """

    name: str
    names: Numbered[Vertex, str]
    xy: FloatArray
    tail: IntArray
    head: IntArray
    length_m: FloatArray
    edge_names: Numbered[EdgeIndex, str]
    limit_mps: FloatArray
    roles: Mapping[Role, Places]
    unconnected: frozenset[tuple[EdgeIndex, EdgeIndex]] = frozenset()
    first_out: IntArray = field(init=False)
    reverse: IntArray = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.names)
        counts = np.bincount(self.tail, minlength=n)
        object.__setattr__(self, "first_out", np.concatenate(([0], np.cumsum(counts))).astype(np.int32))
        twins = [self.edge_index.get((v, u), NO_EDGE) for u, v in self.ends]
        object.__setattr__(self, "reverse", np.array(twins, dtype=np.int32))

    @property
    def vertices(self) -> Sequence[Vertex]:
        """All vertex indices, in order."""
        return numbers(self.names)

    @property
    def edges(self) -> Sequence[EdgeIndex]:
        """All edge indices, in order."""
        return numbers(self.edge_names)

    def out_edges(self, vertex: Vertex) -> Sequence[EdgeIndex]:
        """Edges that leave a vertex."""
        return self.edges[int(self.first_out[vertex]) : int(self.first_out[vertex + 1])]

    def in_edges(self, vertex: Vertex) -> Sequence[EdgeIndex]:
        """Edges that lead to a vertex."""
        return [EdgeIndex(e) for e in np.flatnonzero(self.head == vertex).tolist()]

    @property
    def slots(self) -> Places:
        """Vertices where a car can be parked."""
        return self.roles["slot"]

    @property
    def bays(self) -> Places:
        """Vertices where a customer hands a car over and takes it back."""
        return self.roles["bay"]

    @property
    def homes(self) -> Places:
        """Vertices where an AGV starts and rests; the first ones are used first."""
        return self.roles["home"]

    @property
    def chargers(self) -> Places:
        """Vertices with a charging station."""
        return self.roles["charger"]

    @cached_property
    def index(self) -> dict[str, Vertex]:
        """Vertex index by name."""
        return {name: v for v, name in numbered(self.names)}

    @cached_property
    def ends(self) -> Numbered[EdgeIndex, tuple[Vertex, Vertex]]:
        """(Tail, head) of each edge."""
        return tuple((Vertex(u), Vertex(v)) for u, v in zip(self.tail.tolist(), self.head.tolist(), strict=True))

    @cached_property
    def edge_index(self) -> dict[tuple[Vertex, Vertex], EdgeIndex]:
        """Edge index by (tail, head)."""
        return {pair: e for e, pair in numbered(self.ends)}

    @cached_property
    def successors(self) -> Numbered[Vertex, tuple[Vertex, ...]]:
        """Heads of the edges that leave each vertex."""
        heads = [Vertex(v) for v in self.head.tolist()]
        return tuple(tuple(heads[self.first_out[v] : self.first_out[v + 1]]) for v in self.vertices)

    @cached_property
    def heading_deg(self) -> FloatArray:
        """Heading of each edge in degrees, straight from tail to head, counter-clockwise from east, shape (m,)."""
        d = self.xy[self.head] - self.xy[self.tail]
        return np.degrees(np.arctan2(d[:, 1], d[:, 0]))

    def turn_deg(self, edge_in: EdgeIndex, edge_out: EdgeIndex) -> float:
        """Degrees an AGV rotates in place between two edges.

        An AGV drives either way, so only its axis has to turn: a reversal is 0, a right angle 90, and no turn is
        more than 90.
        """
        change = self.bend_deg(edge_in, edge_out)
        return min(change, 180.0 - change)

    def bend_deg(self, edge_in: EdgeIndex, edge_out: EdgeIndex) -> float:
        """Change of heading between two edges in degrees: 0 straight on, 180 back."""
        change = abs(float(self.heading_deg[edge_out] - self.heading_deg[edge_in])) % 360.0
        return min(change, 360.0 - change)

    def leads_on(self, edge_in: EdgeIndex, edge_out: EdgeIndex) -> bool:
        """Whether an AGV can turn from an edge onto the next: the lanes are connected, and the body does not fold."""
        if (edge_in, edge_out) in self.unconnected:
            return False
        return edge_out == self.reverse[edge_in] or self.bend_deg(edge_in, edge_out) <= FOLD_DEG

    def with_edges(self, kept: Sequence[EdgeIndex]) -> Graph:
        """The same vertices with some of the edges, given in their order."""
        index = np.array(kept, dtype=np.int32)
        position = {e: EdgeIndex(i) for i, e in enumerate(kept)}
        return Graph(
            self.name,
            self.names,
            self.xy,
            self.tail[index],
            self.head[index],
            self.length_m[index],
            tuple(self.edge_names[e] for e in kept),
            self.limit_mps[index],
            self.roles,
            frozenset((position[e], position[f]) for e, f in self.unconnected if e in position and f in position),
        )

    def to_networkx(self) -> nx.DiGraph[Vertex]:
        """The same graph for model work outside the inner loops; edge attribute ``length_m``."""
        g: nx.DiGraph[Vertex] = nx.DiGraph(name=self.name)
        g.add_nodes_from(self.vertices)
        for (u, v), e in self.edge_index.items():
            g.add_edge(u, v, length_m=float(self.length_m[e]))
        return g


def make_graph(
    name: str,
    vertices: Sequence[tuple[str, float, float]],
    edges: Iterable[tuple[str, str, str, float]],
    roles: Mapping[Role, Sequence[str]] | None = None,
    limit_mps: Mapping[str, float] | None = None,
    connected: Callable[[str, str], bool] | None = None,
) -> Graph:
    """Build a graph from plain rows.

    Args:
        name: name of the garage.
        vertices: (id, x in metres, y in metres), in the order of their indices.
        edges: (edge id, tail vertex id, head vertex id, length in metres), one direction each, any order.
        roles: vertex ids by role; missing roles are empty.
        limit_mps: speed limits in metres a second by edge id; missing edges have none.
        connected: whether an AGV can drive from an edge, by id, onto one that leaves its head; always by default.

    Returns:
        The graph, edges sorted by (tail, head).

    Raises:
        KeyError: an edge or role names a vertex that is not in ``vertices``.
    """
    index = {vid: Vertex(i) for i, (vid, _, _) in enumerate(vertices)}
    rows = sorted((index[u], index[v], eid, length) for eid, u, v, length in edges)
    given, limits = roles or {}, limit_mps or {}
    graph = Graph(
        name=name,
        names=tuple(vid for vid, _, _ in vertices),
        xy=np.array([(x, y) for _, x, y in vertices], dtype=np.float64).reshape(-1, 2),
        tail=np.array([r[0] for r in rows], dtype=np.int32),
        head=np.array([r[1] for r in rows], dtype=np.int32),
        length_m=np.array([r[3] for r in rows], dtype=np.float64),
        edge_names=tuple(r[2] for r in rows),
        limit_mps=np.array([limits.get(r[2], np.inf) for r in rows], dtype=np.float64),
        roles={role: tuple(index[v] for v in given.get(role, ())) for role in ROLES},
    )
    if connected is None:
        return graph
    names = graph.edge_names
    pairs = ((e, f) for e, (_, v) in numbered(graph.ends) for f in graph.out_edges(v))
    return replace(graph, unconnected=frozenset((e, f) for e, f in pairs if not connected(names[e], names[f])))
