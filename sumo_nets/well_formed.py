"""Whether the end points of a garage block nobody (well-formed, Ma, Li, Kumar and Koenig 2017).

End points are slots, bays, homes and chargers: where AGVs may stand for as long as they like. A garage is well-formed
if from every end point to every other one there is a way that passes no third. Then an AGV that has an end point of its
own can wait there for ever and nobody is cut off: token passing never deadlocks, if there are no more AGVs than homes.
"""

from __future__ import annotations

from collections import deque

import networkx as nx

from sumo_nets.graph import ROLES, Graph
from sumo_nets.numbering import Vertex


def blocked_ways(graph: Graph) -> list[tuple[Vertex, Vertex]]:
    """Pairs of end points whose every way leads through a third one; empty if the garage is well-formed."""
    points = sorted({*graph.slots, *graph.bays, *graph.homes, *graph.chargers})
    model = graph.to_networkx()
    aisles = model.subgraph(set(model) - set(points))
    core = max(nx.strongly_connected_components(aisles), key=len, default=set())
    leaves = _touching(core, model.reverse(copy=False), points)
    enters = _touching(core, model, points)
    pairs = set()
    for u in set(points) - leaves:
        pairs |= {(u, v) for v in set(points) - _touching({u}, model, points) - {u}}
    for v in set(points) - enters:
        pairs |= {(u, v) for u in set(points) - _touching({v}, model.reverse(copy=False), points) - {v}}
    return sorted(pairs)


def _touching(start: set[Vertex], model: nx.DiGraph[Vertex], points: list[Vertex]) -> set[Vertex]:
    """End points that can be reached from any of the start's vertices through vertices that are none."""
    ends = set(points)
    seen = set(start)
    queue = deque(start)
    while queue:
        for v in model.successors(queue.popleft()):
            if v not in seen:
                seen.add(v)
                if v not in ends:
                    queue.append(v)
    return seen & ends


def describe(graph: Graph) -> str:
    """The result in words, for the choice of a planner."""
    pairs = blocked_ways(graph)
    if not pairs:
        return "well-formed: end points block nobody"
    (u, v), model = pairs[0], graph.to_networkx()
    way = nx.shortest_path(model, u, v)[1:-1] if nx.has_path(model, u, v) else []
    roles = [role for role in ROLES if role != "refuge"]
    passed = [f" ({role} {graph.names[w]})" for w in way for role in roles if w in graph.roles[role]]
    more = f", and so for {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
    return (
        f"not well-formed: every way from {graph.names[u]} to {graph.names[v]} leads through another end point"
        f"{passed[0] if passed else ''}{more}"
    )
