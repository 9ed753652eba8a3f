"""The exact shortest route, to compare with: Dijkstra over edges, so that reversals and folds can be left out."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from controller.routing.binary_tree import Route
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, EdgeIndex, Vertex


def shortest_route(graph: Graph, start: Vertex, goal: Vertex) -> Route | None:
    """The route of fewest metres without a reversal or a fold on the way; ties by edge number. None if there is none.

    Args:
        graph: the floor.
        start, goal: vertices.
    """
    if start == goal:
        return Route((start,), 0.0)
    OPEN = [(float(graph.length_m[e]), e, NO_EDGE) for e in graph.out_edges(start)]
    heapq.heapify(OPEN)
    came_by: dict[EdgeIndex, EdgeIndex] = {}
    while OPEN:
        metres, edge, before = heapq.heappop(OPEN)
        if edge in came_by:
            continue
        came_by[edge] = before
        if graph.head[edge] == goal:
            return Route((start, *_trace(graph, edge, came_by)), metres)
        for f in graph.out_edges(graph.ends[edge][1]):
            if f not in came_by and f != graph.reverse[edge] and graph.leads_on(edge, f):
                heapq.heappush(OPEN, (metres + float(graph.length_m[f]), f, edge))
    return None


def _trace(graph: Graph, edge: EdgeIndex, came_by: dict[EdgeIndex, EdgeIndex]) -> Iterator[Vertex]:
    edges = [edge]
    while (edge := came_by[edge]) >= 0:
        edges.append(edge)
    return (graph.ends[e][1] for e in reversed(edges))
