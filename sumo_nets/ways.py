"""Whether every place of a garage can be reached and left, by the turns that the net connects.

Places are slots, bays, homes and chargers. In SUMO an AGV and the car it leaves stand on the lane by which they came,
so slots are not driven through (:mod:`sumo_nets.doors`), and the lane by which an AGV came decides where it can go on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import networkx as nx

from sumo_nets.doors import doors
from sumo_nets.graph import ROLES, Graph
from sumo_nets.numbering import EdgeIndex, Vertex, numbered

#: Names listed in one complaint.
_LISTED = 3


def shut_in(graph: Graph) -> Iterator[str]:
    """Complain of places that can only be reached by driving through slots, where parked cars shut them in.

    Args:
        graph: the garage with all its lanes.
    """
    model = graph.to_networkx()
    passed = model.copy()
    for slot, door in doors(graph).items():
        passed.remove_edges_from([(slot, v) for v in graph.successors[slot] if v != door])
        passed.remove_edges_from([(v, slot) for v in model.predecessors(slot) if v != door])
    ends = places(graph)
    open_floor = max(nx.strongly_connected_components(passed), key=lambda part: (len(part & ends), len(part)))
    beyond = model.subgraph(set(model) - open_floor).to_undirected()
    for part in sorted(nx.connected_components(beyond), key=min):
        gates = {slot for slot in open_floor.intersection(graph.slots) if part.intersection(model[slot])}
        behind = sorted(part & ends)
        if not gates and len(part) > 1:  # the slot that closes the way may lie on this side of it
            own = part.intersection(graph.slots)
            gates = {
                slot for slot in own if open_floor.intersection({*model.successors(slot), *model.predecessors(slot)})
            }
            behind = sorted((part & ends) - gates)
        if behind and gates:
            yield (
                f"no way to {_listed(graph, behind)} but through slots: cars parked in {_listed(graph, sorted(gates))}"
                " would shut them in"
            )
        elif len(part) == 1 and part <= set(graph.slots) and model.degree(behind[0]):
            yield (
                f"slot {graph.names[behind[0]]} has no two-way lane to an aisle: a car is fetched by the lane by which"
                " it was brought"
            )


def cut_off(graph: Graph) -> Iterator[str]:
    """Complain of places without a way to them or back, of lanes that lead nowhere, and of the turns that are missing.

    Args:
        graph: the garage as AGVs drive in it, each slot with one door.
    """
    lanes: nx.DiGraph[EdgeIndex] = nx.DiGraph()
    lanes.add_nodes_from(graph.edges)
    for e, (_, v) in numbered(graph.ends):
        lanes.add_edges_from((e, f) for f in graph.out_edges(v) if graph.leads_on(e, f))
    stops = places(graph)

    def ends(edges: Iterable[EdgeIndex]) -> set[Vertex]:
        return {graph.ends[e][1] for e in edges}

    core: set[EdgeIndex] = max(
        nx.strongly_connected_components(lanes), key=lambda part: (len(ends(part) & stops), len(part)), default=set()
    )
    some = next(iter(core), None)
    entered = set() if some is None else nx.descendants(lanes, some) | core
    complaints = []
    unreached, stuck = sorted(stops - ends(entered)), sorted((stops & ends(entered)) - ends(core))
    if unreached:
        complaints.append(f"no way to {_listed(graph, unreached)}")
    if stuck:
        complaints.append(f"no way back from {_listed(graph, stuck)}")
    traps = sorted(entered - core)
    if traps and not stuck:
        more = f" and {len(traps) - 1} more lanes" if len(traps) > 1 else ""
        complaints.append(f"{graph.edge_names[traps[0]]}{more}: an AGV that drives there has no way back")
    if complaints and graph.unconnected:
        yield f"AGVs can't turn {unconnected_turns(graph)}: the net has no connection there"
    yield from complaints


def unconnected_turns(graph: Graph) -> str:
    """The turns that the net does not connect, in words; the first ones by name."""
    pairs = sorted(graph.unconnected)
    named = ", ".join(f"from {graph.edge_names[e]} to {graph.edge_names[f]}" for e, f in pairs[:_LISTED])
    return named + (f" and {len(pairs) - _LISTED} more" if len(pairs) > _LISTED else "")


def places(graph: Graph) -> set[Vertex]:
    """Where AGVs have something to do: slots, bays, homes and chargers."""
    return {v for role in ROLES if role != "refuge" for v in graph.roles[role]}


def _listed(graph: Graph, vertices: list[Vertex]) -> str:
    named = ", ".join(graph.names[v] for v in vertices[:_LISTED])
    return named + (f" and {len(vertices) - _LISTED} more" if len(vertices) > _LISTED else "")
