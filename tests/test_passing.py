"""Whether AGVs can let each other pass, against a search over all places of all AGVs, each with its name."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Collection
from pathlib import Path

import networkx as nx
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sumo_nets.doors import lanes_by_doors
from sumo_nets.graph import Graph, make_graph
from sumo_nets.numbering import Vertex
from sumo_nets.passing import Passing, crowded
from sumo_nets.plan import plan_garage
from sumo_nets.ways import cut_off, shut_in

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import garages

Fleet = tuple[Vertex, ...]


@st.composite
def floors(draw: st.DrawFn) -> Graph:
    """Strongly connected floors of one-way and two-way lanes with leaves; slots are leaves, too."""
    n = draw(st.integers(2, 7))
    lanes = set()
    for v in range(1, n):
        u = draw(st.integers(0, v - 1))
        lanes |= {(u, v), (v, u)}
    vertex = st.integers(0, n - 1)
    lanes |= set(draw(st.lists(st.tuples(vertex, vertex).filter(lambda p: p[0] != p[1]), max_size=n)))
    for lane in sorted(lanes):
        if draw(st.booleans()) and draw(st.booleans()):
            lanes.discard(lane)
    slots = [(n + k, draw(vertex)) for k in range(draw(st.integers(1, 2)))]
    lanes |= {lane for slot, door in slots for lane in ((slot, door), (door, slot))}
    order = draw(st.permutations(range(n)))
    homes = [str(v) for v in order[: draw(st.integers(1, min(3, n)))]]
    roles = {"slot": [str(slot) for slot, _ in slots], "home": homes, "bay": [str(draw(vertex))]}
    vertices = [(str(v), 0.0, 0.0) for v in range(n + len(slots))]  # no turn is too sharp
    graph = make_graph("floor", vertices, [(f"{u}>{v}", str(u), str(v), 1.0) for u, v in sorted(lanes)], roles)
    assume(not list(cut_off(graph)))
    return graph


def works(graph: Graph, agvs: int, more: Collection[Vertex] = ()) -> bool:
    """Whether each AGV gets to each place, and to some more, and all get back to where they began, whatever they did.

    One AGV moves at a time, along lanes, to a free vertex. All slots are full: an AGV drives in to the car that it
    fetches, and out again by the same lane before anybody else moves.
    """
    start = tuple(graph.homes[:agvs])
    slots = {*graph.slots}
    been: list[set[Vertex]] = [set() for _ in start]
    model: nx.DiGraph[Fleet] = nx.DiGraph()
    model.add_node(start)
    todo = [start]
    while todo:
        fleet = todo.pop()
        for n, v in enumerate(fleet):
            been[n] |= {v, *(s for s in slots.intersection(graph.successors[v]) if v in graph.successors[s])}
            for w in {*graph.successors[v]} - slots - {*fleet}:
                moved = (*fleet[:n], w, *fleet[n + 1 :])
                if moved not in model:
                    todo.append(moved)
                model.add_edge(fleet, moved)
    ends = {*graph.slots, *graph.bays, *graph.chargers} - {*graph.homes}
    every = all(been[n] >= {*ends, *more, start[n]} for n in range(agvs))
    return every and nx.is_strongly_connected(model)


@settings(max_examples=150, deadline=None)
@given(floors())
def test_the_same_as_a_search_over_all_fleets(graph: Graph) -> None:
    for agvs in range(1, len(graph.homes) + 1):
        assert (Passing(graph).shut_off(agvs) is None) == works(graph, agvs)


def test_random_garages_are_refused_if_and_only_if_they_cannot_work() -> None:
    verdicts = Counter()
    for number in range(50):
        drawn = garages.draw(number)
        plan, agvs = plan_garage(drawn.layout), min(3, drawn.keys["agvs"])
        lanes = [(lane.name, lane.tail, lane.head, 1.0) for lane in plan.lanes.values()]
        vertices = [(name, x, y) for name, (x, y) in plan.vertices.items()]
        graph = make_graph(plan.name, vertices, lanes, plan.roles)
        driven = graph.with_edges(lanes_by_doors(graph))
        ways = [*shut_in(graph), *cut_off(driven)]
        crowd = "" if ways else crowded(driven, agvs)
        verdicts["no way" if ways else "crowded" if crowd else "fine"] += 1
        usable = works(graph, 1, {*graph.homes}) and works(graph, agvs)
        assert (not ways and not crowd) == usable, (number, ways, crowd)
    assert set(verdicts) == {"fine", "crowded", "no way"}
