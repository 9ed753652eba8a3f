"""The modified binary tree: routes on mostly one-way floors (Do et al. 2010, sections 3.1 to 3.3).

The floor is compiled once. One-way sections keep one node a vertex. A two-way section has one node for each direction
of travel, so that a loading node at a dead end becomes an entering node, where a search ends, and a leaving node, where
one begins. Every node has a left and a right child; there is no root and cycles are allowed, so that a query starts at
any node. It searches depth first twice, left child first and right child first; the shorter of the two routes wins.

Departures from the paper, which is silent about them: left and right are by heading; where more than two ways lead on,
the right child is a further node at the same vertex for the rest of them; "shorter" is in metres; bends that fold the
body (``FOLD_DEG``) are no way on.
Guarantee: a route is found if there is one without a reversal on the way, in O(n) for n nodes.
Limits: the route is the shortest only where the choices on the floor are few: neither search compares routes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Vertex

#: Columns of ``BinaryTree.child`` and ``BinaryTree.edge``.
LEFT, RIGHT = 0, 1


@dataclass(frozen=True, eq=False)
class BinaryTree:
    """A floor compiled for searching.

    Attributes:
        graph: the floor.
        child: left and right child of each node, -1 for none, shape (N, 2).
        edge: edge driven to get to that child, -1 to a further node at the same vertex, shape (N, 2).
        vertex: vertex of each node, shape (N,).
        start: node to start from for an AGV that came over each edge, then for one that stands at each vertex and may
            leave it any way, shape (m + n,). Unlike a node on the way it allows a reversal.
    """

    graph: Graph
    child: IntArray
    edge: IntArray
    vertex: IntArray
    start: IntArray


@dataclass(frozen=True, slots=True)
class Route:
    """A way through the floor.

    Attributes:
        vertices: from start to goal.
        length_m: metres driven.
    """

    vertices: tuple[Vertex, ...]
    length_m: float


class _Compiler:
    """Nodes by (vertex, ways on in their order from left to right); equal ones are shared."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.numbers: dict[tuple[Vertex, tuple[EdgeIndex, ...]], int] = {}
        self.todo: list[tuple[Vertex, tuple[EdgeIndex, ...]]] = []

    def number(self, vertex: Vertex, ways: tuple[EdgeIndex, ...]) -> int:
        """The node of a vertex with these ways on."""
        key = (vertex, ways)
        if key not in self.numbers:
            self.numbers[key] = len(self.numbers)
            self.todo.append(key)
        return self.numbers[key]

    def arrival(self, edge: EdgeIndex, reversal: bool = False) -> int:
        """The node for arriving over an edge; it leads on without reversing unless ``reversal``."""
        g = self.graph
        v = g.ends[edge][1]
        ways = [f for f in g.out_edges(v) if (reversal or f != g.reverse[edge]) and g.leads_on(edge, f)]
        return self.number(v, self._left_to_right(ways, float(g.heading_deg[edge])))

    def standing(self, vertex: Vertex) -> int:
        """The node of an AGV that may leave a vertex any way, seen as if it had come from the south."""
        ways = self.graph.out_edges(vertex)
        return self.number(vertex, self._left_to_right(ways, 90.0))

    def children(self, vertex: Vertex, ways: tuple[EdgeIndex, ...]) -> tuple[int, int, int, int]:
        """Left and right child and the edges to them."""
        if not ways:
            return -1, -1, -1, -1
        left = self.arrival(ways[0])
        if len(ways) == 1:
            return left, -1, ways[0], -1
        if len(ways) == 2:
            return left, self.arrival(ways[1]), ways[0], ways[1]
        return left, self.number(vertex, ways[1:]), ways[0], -1

    def _left_to_right(self, ways: Sequence[EdgeIndex], heading_deg: float) -> tuple[EdgeIndex, ...]:
        def bend(f: EdgeIndex) -> float:
            """Counter-clockwise change of heading, above -180 and up to 180 degrees."""
            return 180.0 - (heading_deg - float(self.graph.heading_deg[f]) + 180.0) % 360.0

        return tuple(sorted(ways, key=lambda f: (-round(bend(f), 6), f)))


def compile_tree(graph: Graph) -> BinaryTree:
    """Compile a floor into the rootless binary tree; O(n).

    Args:
        graph: the floor, with one-way and two-way sections.

    Returns:
        The tree, for any number of queries.
    """
    compiler = _Compiler(graph)
    start = [compiler.arrival(e, reversal=True) for e in graph.edges]
    start += [compiler.standing(v) for v in graph.vertices]
    vertex: list[int] = []
    child: list[tuple[int, int]] = []
    edge: list[tuple[int, int]] = []
    for v, ways in compiler.todo:  # grows while it is walked through
        left, right, to_left, to_right = compiler.children(v, ways)
        vertex.append(v)
        child.append((left, right))
        edge.append((to_left, to_right))
    return BinaryTree(graph, *(np.array(rows, dtype=np.int32) for rows in (child, edge, vertex, start)))


def find_routes(
    tree: BinaryTree,
    vertex: Vertex,
    goal: Vertex,
    in_edge: EdgeIndex = NO_EDGE,
    blocked: NDArray[np.uint8] | None = None,
) -> tuple[Route | None, Route | None]:
    """The routes of the left-first and of the right-first search.

    Args:
        tree: the compiled floor.
        vertex: where the AGV is.
        goal: where it shall go.
        in_edge: edge over which it came to ``vertex``, -1 if it may leave any way.
        blocked: shape (n,), 1 where no AGV may drive; the goal is exempt.

    Returns:
        Both routes; None, both at once, if there is none.
    """
    root = int(tree.start[in_edge] if in_edge >= 0 else tree.start[len(tree.graph.tail) + vertex])
    mask = np.zeros(len(tree.graph.names), dtype=np.uint8) if blocked is None else blocked
    return (
        _route(tree, vertex, _search(root, goal, tree.child, tree.edge, tree.vertex, mask, LEFT)),
        _route(tree, vertex, _search(root, goal, tree.child, tree.edge, tree.vertex, mask, RIGHT)),
    )


def find_route(
    tree: BinaryTree,
    vertex: Vertex,
    goal: Vertex,
    in_edge: EdgeIndex = NO_EDGE,
    blocked: NDArray[np.uint8] | None = None,
) -> Route | None:
    """The shorter of the two routes; arguments as for ``find_routes``."""
    left, right = find_routes(tree, vertex, goal, in_edge, blocked)
    return None if left is None or right is None else min(left, right, key=lambda route: route.length_m)


def _route(tree: BinaryTree, vertex: Vertex, edges: IntArray) -> Route | None:
    if len(edges) and edges[0] == -2:
        return None
    g = tree.graph
    return Route((vertex, *g.head[edges].tolist()), math.fsum(g.length_m[edges].tolist()))


@njit(cache=True)
def _search(
    root: int, goal: int, child: IntArray, edge: IntArray, vertex: IntArray, blocked: NDArray[np.uint8], first: int
) -> IntArray:
    """Edges of the route that the depth-first search with this child first finds; [-2] if there is none."""
    n = len(vertex)
    parent = np.full(n, -1, dtype=np.int32)
    came_by = np.full(n, -1, dtype=np.int32)
    visited = np.zeros(n, dtype=np.uint8)
    stack = np.empty((2 * n + 1, 3), dtype=np.int32)  # node, its parent, the edge between
    stack[0, 0], stack[0, 1], stack[0, 2] = root, -1, -1
    size = 1
    while size > 0:
        size -= 1
        node = stack[size, 0]
        if visited[node]:
            continue
        visited[node] = 1
        parent[node], came_by[node] = stack[size, 1], stack[size, 2]
        if vertex[node] == goal:
            return _trace(node, parent, came_by)
        for side in (1 - first, first):
            c = child[node, side]
            if c >= 0 and not visited[c] and (not blocked[vertex[c]] or vertex[c] == goal or edge[node, side] < 0):
                stack[size, 0], stack[size, 1], stack[size, 2] = c, node, edge[node, side]
                size += 1
    return np.full(1, -2, dtype=np.int32)


@njit(cache=True)
def _trace(node: int, parent: IntArray, came_by: IntArray) -> IntArray:
    length = 0
    n = node
    while n >= 0:
        length += came_by[n] >= 0
        n = parent[n]
    edges = np.empty(length, dtype=np.int32)
    n = node
    while n >= 0:
        if came_by[n] >= 0:
            length -= 1
            edges[length] = came_by[n]
        n = parent[n]
    return edges
