"""Well-formed garages, against every pair of end points looked at one by one; maps to try them on."""

from __future__ import annotations

import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sumo_nets.graph import make_graph
from sumo_nets.movingai import grid_graph
from sumo_nets.read import read_net
from sumo_nets.well_formed import blocked_ways, describe


@st.composite
def floors(draw):
    """Small directed graphs in which some vertices are slots, bays or homes."""
    n = draw(st.integers(3, 8))
    lanes = draw(st.sets(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda p: p[0] != p[1])))
    kinds = draw(st.lists(st.sampled_from(["", "", "slot", "bay", "home"]), min_size=n, max_size=n))
    roles = {role: [str(v) for v in range(n) if kinds[v] == role] for role in ("slot", "bay", "home")}
    vertices = [(str(v), float(v), 0.0) for v in range(n)]
    return make_graph("floor", vertices, [(f"{u}>{v}", str(u), str(v), 1.0) for u, v in sorted(lanes)], roles)


@given(floors())
def test_the_same_as_looking_at_every_pair(graph):
    points = {*graph.slots, *graph.bays, *graph.homes}
    model = graph.to_networkx()
    slow = [
        (u, v)
        for u in sorted(points)
        for v in sorted(points - {u})
        if not nx.has_path(model.subgraph(set(model) - points | {u, v}), u, v)
    ]
    assert blocked_ways(graph) == slow


@pytest.mark.parametrize("name", ["map1", "map2", "map3"])
def test_our_garages_are_well_formed(name):
    assert blocked_ways(read_net(name).graph) == []


def test_a_slot_in_the_aisle_is_named():
    graph = grid_graph("aisle", ["e.e.e"])
    assert describe(graph) == (
        "not well-formed: every way from 0,0 to 4,0 leads through another end point (slot 2,0), and so for 1 more pairs"
    )
