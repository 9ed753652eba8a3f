"""RRT-GRID: way points on a grid over the box between start and goal, joined by RRT*-Smart, chosen by Dijkstra.

Source: paper 001 (RRT-GRID, 2023), section 2.2, steps 1 to 8. The paper's figures show the way points without
coordinates: theirs are ours, and so is the direct arc when no way point can be reached.
"""

from __future__ import annotations

import heapq
from itertools import pairwise

import numpy as np

from sumo_nets.freespace.floor import Floor, Point
from sumo_nets.freespace.rrt import FreePath, Tuning, free_path, rrt_connect, rrt_smart
from sumo_nets.graph import FloatArray

#: Temporary way points as shares of the box from start to goal: phase 1, and phase 2 if too few of them are left.
PHASE_1: tuple[Point, ...] = ((1 / 2, 1 / 2), (1 / 4, 3 / 4), (3 / 4, 1 / 4))
PHASE_2: tuple[Point, ...] = ((1 / 4, 1 / 4), (3 / 4, 3 / 4), (1 / 2, 1 / 4), (1 / 2, 3 / 4))
#: With fewer way points than this phase 2 follows; more than the latter are never kept.
FEWEST, MOST = 2, 5

_DEFAULT = Tuning()


def rrt_grid(floor: Floor, start: Point, goal: Point, rng: np.random.Generator, tuning: Tuning = _DEFAULT) -> FreePath:
    """RRT-GRID: the shortest chain of RRT*-Smart paths from start over way points to goal.

    Args:
        floor: the obstacles.
        start, goal: free points.
        rng: source of the samples.
        tuning: parameters of all its trees.

    Returns:
        The path, or none if no chain of arcs was found. Source: paper 001, section 2.2.
    """
    way_points, samples = reachable_way_points(floor, start, goal, rng, tuning)
    arcs, more = _arcs(floor, start, goal, way_points, rng, tuning)
    return free_path(_cheapest_chain(arcs, len(way_points) + 1), samples + more)


def reachable_way_points(
    floor: Floor, start: Point, goal: Point, rng: np.random.Generator, tuning: Tuning = _DEFAULT
) -> tuple[list[Point], int]:
    """Way points that RRT-Connect reaches from the start (steps 1 to 4), and the samples that took."""
    kept: list[Point] = []
    samples = 0
    for phase in (PHASE_1, PHASE_2):
        for share_x, share_y in phase:
            point = (start[0] + share_x * (goal[0] - start[0]), start[1] + share_y * (goal[1] - start[1]))
            if floor.holds(point):
                probe = rrt_connect(floor, start, point, rng, tuning)
                samples += probe.samples
                if probe.found:
                    kept.append(point)
        if len(kept) >= FEWEST:
            break
    return kept[:MOST], samples


def _arcs(
    floor: Floor, start: Point, goal: Point, way_points: list[Point], rng: np.random.Generator, tuning: Tuning
) -> tuple[dict[tuple[int, int], FreePath], int]:
    """Arcs between the nodes start (0), way points and goal (last), steps 5 to 7."""
    nodes = [start, *way_points, goal]
    last = len(nodes) - 1
    arcs: dict[tuple[int, int], FreePath] = {}
    samples = 0
    for a in range(last):
        for b in range(a + 1, last + 1):
            if (a, b) == (0, last) and way_points:
                continue
            path = rrt_smart(floor, nodes[a], nodes[b], rng, tuning)
            samples += path.samples
            if path.found:
                arcs[a, b] = path
                if a > 0 and b < last:
                    arcs[b, a] = FreePath(path.points[::-1], path.length, 0)
    return arcs, samples


def _cheapest_chain(arcs: dict[tuple[int, int], FreePath], goal: int) -> FloatArray:
    """Points of the shortest chain of arcs from node 0 to the goal (Dijkstra, step 8); none if there is no chain."""
    OPEN: list[tuple[float, tuple[int, ...]]] = [(0.0, (0,))]
    CLOSED: set[int] = set()
    while OPEN:
        g, chain = heapq.heappop(OPEN)
        here = chain[-1]
        if here == goal:
            legs = [arcs[a, b].points for a, b in pairwise(chain)]
            return np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])
        if here in CLOSED:
            continue
        CLOSED.add(here)
        for a, b in arcs:
            if a == here:
                heapq.heappush(OPEN, (g + arcs[a, b].length, (*chain, b)))
    return np.empty((0, 2))
