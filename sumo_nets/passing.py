"""Whether AGVs find room to let each other pass, so that each of them can get to every place.

One AGV asks the others to step aside. The others are like stones without names, since it does not matter which of them
stands where. The AGV's vertex splits the floor into parts. While the AGV stands there, the stones of a part can be
brought to any vertices of this part. So a state is the AGV's vertex and the number of stones in each part. Such
states are few, and the search over them is complete. A search over AGVs with names would be too large for a big garage.

One-way lanes change nothing. On a floor where every vertex can be reached from every other one, each lane lies on a
circle of lanes. Where a lane's end is free, all that stands on its circle can go round until only one AGV has changed
places: as if it had driven back (Wu and Grumbach, Discrete Applied Mathematics 2010).

Slots are no room: they may all be full. Turns that the net does not connect are not looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cached_property, lru_cache

import networkx as nx

from sumo_nets.graph import Graph
from sumo_nets.numbering import Vertex
from sumo_nets.ways import places

#: The AGV's vertex, and how many others stand in each part of the floor without it.
_State = tuple[Vertex, tuple[int, ...]]


@lru_cache(maxsize=64)
def crowded(graph: Graph, agvs: int) -> str:
    """Why a fleet is too large for its garage.

    Args:
        graph: a garage in which each slot is a leaf and every place can be reached and left.
        agvs: how many AGVs there are; the first homes are theirs.

    Returns:
        One line with the AGV, the place to which it can't get, and how many AGVs can work; empty if all is well.
    """
    passing = Passing(graph)
    shut_off = passing.shut_off(agvs)
    if shut_off is None:
        return ""
    home, place = (graph.names[v] for v in shut_off)
    fewer = passing.largest_fleet()
    return (
        f"the AGV whose home is {home} can't get to {place} when all slots are full: the others find no room to let it"
        f" pass; {'1 AGV' if fewer == 1 else f'1 to {fewer} AGVs'} can work"
    )


class Passing:
    """Whether each AGV of a fleet can get to its own home and to every place that is nobody's home.

    Args:
        graph: a garage in which each slot is a leaf and every place can be reached and left.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._parts: dict[Vertex, list[set[Vertex]]] = {}

    def largest_fleet(self) -> int:
        """How many AGVs can work: the first homes are used first."""
        low, high = 1, len(self._graph.homes)
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (low, middle - 1) if self.shut_off(middle) else (middle, high)
        return low

    def shut_off(self, agvs: int) -> tuple[Vertex, Vertex] | None:
        """An AGV and a place to which the others can't let it pass.

        Args:
            agvs: how many AGVs there are.

        Returns:
            The AGV's home and the place; None if each AGV can get everywhere.
        """
        homes = [*self._graph.homes[:agvs]]
        known: dict[_State, frozenset[Vertex]] = {}
        for home in homes:
            others = [other for other in homes if other != home]
            ends = [*sorted(places(self._graph) - {*self._graph.homes}), home]
            if self._shut_off(ends, nx.node_connected_component(self._without(others), home)) is None:
                continue  # the others need not leave their homes
            start = self._state(home, others)
            if start not in known:
                states = self._reached(start)
                known |= dict.fromkeys(states, frozenset(v for v, _ in states))
            end = self._shut_off(ends, known[start])
            if end is not None:
                return home, end
        return None

    def _shut_off(self, ends: Sequence[Vertex], reached: Collection[Vertex]) -> Vertex | None:
        """The first of some places that is not entered from any of the vertices reached."""
        return next((end for end in ends if self._door(end) not in reached), None)

    def _without(self, vertices: Sequence[Vertex]) -> nx.Graph[Vertex]:
        return self._floor.subgraph(set(self._floor).difference(vertices))

    @cached_property
    def _floor(self) -> nx.Graph[Vertex]:
        """Where AGVs may stand: the largest part without slots from which one can come back."""
        rooms = {v for role in ("bay", "home", "charger") for v in self._graph.roles[role]}
        model = self._graph.to_networkx()
        model.remove_nodes_from({*self._graph.slots} - rooms)
        core = max(nx.strongly_connected_components(model), key=lambda part: (len(part & rooms), len(part)))
        floor: nx.Graph[Vertex] = model.subgraph(core).to_undirected()
        return floor

    def _door(self, place: Vertex) -> Vertex:
        """The vertex of the floor from which a place is entered: itself, or a slot's neighbour."""
        return place if place in self._floor else self._graph.successors[place][0]

    @cached_property
    def _cuts(self) -> set[Vertex]:
        return set(nx.articulation_points(self._floor))

    def _split(self, v: Vertex) -> list[set[Vertex]]:
        """The parts of the floor without a vertex."""
        if v not in self._parts:
            rest = self._without([v])
            self._parts[v] = [*nx.connected_components(rest)] if v in self._cuts else [{*rest}] if rest else []
        return self._parts[v]

    def _state(self, v: Vertex, others: Sequence[Vertex]) -> _State:
        return v, tuple(len(part.intersection(others)) for part in self._split(v))

    def _reached(self, start: _State) -> set[_State]:
        seen, todo = {start}, [start]
        while todo:
            for state in self._moves(*todo.pop()):
                if state not in seen:
                    seen.add(state)
                    todo.append(state)
        return seen

    def _moves(self, v: Vertex, counts: tuple[int, ...]) -> Iterator[_State]:
        """The AGV drives on to a neighbour that the others have freed."""
        for part, count in zip(self._split(v), counts, strict=True):
            for u in part.intersection(self._floor[v]):
                if count < len(part):
                    behind, elsewhere = len(self._floor) - len(part), sum(counts) - count
                    split = self._split(u)
                    # the part with ``v`` holds all that stood in other parts, and its share of this one's
                    room = [len(other) - (behind if v in other else 0) for other in split]
                    for shares in _shares(count, room):
                        yield u, tuple(n + elsewhere * (v in other) for n, other in zip(shares, split, strict=True))


def _shares(count: int, room: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """All ways to distribute ``count`` AGVs over parts of the floor that have ``room`` for some each."""
    if not room:
        if not count:
            yield ()
        return
    for n in range(max(0, count - sum(room[1:])), min(count, room[0]) + 1):
        for rest in _shares(count - n, room[1:]):
            yield n, *rest
