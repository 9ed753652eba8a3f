"""The commands on a floor's ways: a route between two vertices, and turns that an AGV can drive."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from sumo_nets.errors import InputError
from sumo_nets.wording import one_of

if TYPE_CHECKING:
    from controller.routing.binary_tree import Route
    from sumo_nets.graph import Graph
    from sumo_nets.numbering import Vertex

_UNFINISHED = 1

Net = Annotated[str, typer.Argument(help="A shipped garage or a net file.")]


class Router(StrEnum):
    """How a route is found."""

    BINARY_TREE = "binary_tree"
    SHORTEST = "shortest"


def route(
    net: Net,
    start: Annotated[str, typer.Argument(metavar="FROM", help="Vertex to start from.")],
    goal: Annotated[str, typer.Argument(metavar="TO", help="Vertex to go to.")],
    router: Annotated[Router, typer.Option(help="How it is found.")] = Router.BINARY_TREE,
) -> None:
    """Find a route through an empty garage, and say how long the shortest one is."""
    from controller.routing.shortest import shortest_route
    from sumo_nets.read import read_net

    graph = read_net(net).graph
    ends = [_vertex(graph, net, name) for name in (start, goal)]
    shortest = shortest_route(graph, *ends)
    if shortest is None:
        print(f"no route from {start} to {goal} without a reversal on the way")
        raise typer.Exit(_UNFINISHED)
    found = {} if router is Router.SHORTEST else _tree_routes(graph, *ends)
    best = min(found.values(), key=lambda way: way.length_m, default=shortest)
    print(" > ".join(graph.names[v] for v in best.vertices))
    for words, way in {**found, "shortest": shortest}.items():
        print(f"{words:18} {len(way.vertices):4} vertices {way.length_m:8.1f} m")


def turns(
    net: Net,
    aisle: Annotated[float, typer.Option(help="Clear width of the aisles in metres.", min=0.1)] = 3.0,
    wheelbase: Annotated[float, typer.Option(help="Metres from the rear wheels to the drive wheel.", min=0.1)] = 1.4,
    steer: Annotated[float, typer.Option(help="Largest steering angle in degrees.", min=1, max=90)] = 75.0,
    front: Annotated[float, typer.Option(help="Metres of body ahead of the rear wheels.", min=0.1)] = 1.7,
    rear: Annotated[float, typer.Option(help="Metres of fork and load behind them.", min=0)] = 1.2,
    width: Annotated[float, typer.Option(help="Width of body and load in metres.", min=0.1)] = 1.0,
) -> None:
    """Say which turns of a garage a fork AGV, which steers instead of turning in place, can drive."""
    from controller.routing.kinematics import ForkAgv, check_turns
    from sumo_nets.read import read_net

    graph = read_net(net).graph
    agv = ForkAgv(wheelbase, steer, front, rear, width)
    found = list(check_turns(graph, agv, aisle))
    bad = [turn for turn in found if not turn.drivable]
    for turn in bad:
        way = " > ".join(graph.names[v] for v in turn.vertices)
        print(f"{way}: {turn.bend_deg:.0f} degrees, room for a radius of {turn.radius_m:.2f} m")
    print(
        f"{len(found) - len(bad)} of {len(found)} turns can be driven; least radius {agv.least_radius_m:.2f} m, "
        f"swept width there {agv.swept_width_m(agv.least_radius_m):.2f} m"
    )
    raise typer.Exit(_UNFINISHED if bad else 0)


def _vertex(graph: Graph, net: str, name: str) -> Vertex:
    if name not in graph.index:
        raise InputError(f"{net}: {name!r}: no such vertex; {one_of(graph.names, name)}")
    return graph.index[name]


def _tree_routes(graph: Graph, start: Vertex, goal: Vertex) -> Mapping[str, Route]:
    """The binary tree's routes by the search that found them."""
    from controller.routing.binary_tree import compile_tree, find_routes

    left, right = find_routes(compile_tree(graph), start, goal)
    return {words: way for words, way in (("left child first", left), ("right child first", right)) if way}
