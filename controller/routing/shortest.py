"""The exact shortest route, to compare with: Dijkstra over edges, so that reversals and folds can be left out."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from controller.routing.binary_tree import Route
from controller.types import FOLD_DEG
from sumo_nets.graph import Graph


def shortest_route(graph: Graph, start: int, goal: int) -> Route | None:
    """The route of fewest metres without a reversal or a fold on the way; ties by edge number. None if there is none.

    Args:
        graph: the floor.
        start, goal: vertices.
    """
    if start == goal:
        return Route((start,), 0.0)
    OPEN = [(float(graph.length_m[e]), e, -1) for e in _ways(graph, start)]
    heapq.heapify(OPEN)
    came_by: dict[int, int] = {}
    while OPEN:
        metres, edge, before = heapq.heappop(OPEN)
        if edge in came_by:
            continue
        came_by[edge] = before
        if graph.head[edge] == goal:
            return Route((start, *_trace(graph, edge, came_by)), metres)
        for f in _ways(graph, int(graph.head[edge])):
            if f not in came_by and f != graph.reverse[edge] and graph.bend_deg(edge, f) <= FOLD_DEG:
                heapq.heappush(OPEN, (metres + float(graph.length_m[f]), f, edge))
    return None


def _ways(graph: Graph, vertex: int) -> range:
    return range(int(graph.first_out[vertex]), int(graph.first_out[vertex + 1]))


def _trace(graph: Graph, edge: int, came_by: dict[int, int]) -> Iterator[int]:
    edges = [edge]
    while (edge := came_by[edge]) >= 0:
        edges.append(edge)
    return (int(graph.head[e]) for e in reversed(edges))
