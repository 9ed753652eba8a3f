"""A graph and its durations as the flat arrays that the search kernels read."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.kernel import kernel
from controller.types import Motion
from sumo_nets.graph import FloatArray, Graph, IntArray

#: Columns of the counters array that all kernels add to (int64, shape (4,)), in the order of ``types.Counters``.
EXPANDED, HEAP_MOVES, GENERATED, VALID = 0, 1, 2, 3


class Lanes(NamedTuple):
    """What kernels read of a graph and its durations; all contiguous int32 but ``xy``.

    Attributes:
        tail, head, first_out: as in ``Graph``.
        first_in, in_edges: the edges that enter vertex ``v`` are ``in_edges[first_in[v]:first_in[v + 1]]``.
        edge_steps, turn_steps, first_transition: as in ``Motion``.
        longest_turn: the longest turn there is after each edge, shape (2, m); ``NEVER`` if one of them is impossible.
        xy: vertex positions in metres, shape (n, 2).
    """

    tail: IntArray
    head: IntArray
    first_out: IntArray
    first_in: IntArray
    in_edges: IntArray
    edge_steps: IntArray
    turn_steps: IntArray
    first_transition: IntArray
    longest_turn: IntArray
    xy: FloatArray


class Space:
    """A graph and a motion prepared for searching, once per garage and shared by all searches.

    Attributes:
        graph, motion: what it was made from.
        lanes: the arrays for the kernels.
        rates: steps per metre that no edge beats, by Manhattan and by Euclidean length of the edge, for empty
            (row 0) and loaded (row 1) AGVs, shape (2, 2).
    """

    def __init__(self, graph: Graph, motion: Motion) -> None:
        n = len(graph.names)
        self.graph = graph
        self.motion = motion
        self.lanes = Lanes(
            tail=_int32(graph.tail),
            head=_int32(graph.head),
            first_out=_int32(graph.first_out),
            first_in=_int32(np.concatenate(([0], np.cumsum(np.bincount(graph.head, minlength=n))))),
            in_edges=_int32(np.argsort(graph.head, kind="stable")),
            edge_steps=_int32(motion.edge_steps),
            turn_steps=_int32(motion.turn_steps),
            first_transition=_int32(motion.first_transition),
            longest_turn=_int32(_longest_turns(motion)),
            xy=np.array(graph.xy, dtype=np.float64),
        )
        self.rates = self._rates()

    def _rates(self) -> FloatArray:
        span = np.abs(self.lanes.xy[self.lanes.head] - self.lanes.xy[self.lanes.tail])
        rates = np.zeros((2, 2))
        for k, metres in enumerate((span.sum(axis=1), np.hypot(span[:, 0], span[:, 1]))):
            real = metres > 0
            if real.any():
                rates[:, k] = (self.lanes.edge_steps[:, real] / metres[real]).min(axis=1) * (1 - 1e-9)
        return rates


@kernel
def by_air(u: int, v: int, manhattan: float, euclidean: float, lanes: Lanes) -> int:
    """At least so many steps from one vertex to another, by the two rates of ``Space.rates``."""
    dx = abs(lanes.xy[u, 0] - lanes.xy[v, 0])
    dy = abs(lanes.xy[u, 1] - lanes.xy[v, 1])
    return int(max(manhattan * (dx + dy), euclidean * np.sqrt(dx * dx + dy * dy)))


def _longest_turns(motion: Motion) -> IntArray:
    """See ``Lanes.longest_turn``; 0 after edges that end where none begins."""
    first = motion.first_transition
    turns = np.zeros((2, len(first) - 1), dtype=np.int32)
    for e, (a, b) in enumerate(pairwise(first.tolist())):
        turns[:, e] = motion.turn_steps[:, a:b].max(axis=1, initial=0)
    return turns


def _int32(a: IntArray | NDArray[np.int64]) -> IntArray:
    """A contiguous, writable copy: kernels are compiled for one array type only."""
    return np.array(a, dtype=np.int32, order="C")
