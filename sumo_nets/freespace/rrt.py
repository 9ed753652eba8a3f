"""Rapidly exploring random trees: RRT, RRT-Connect, RRT* and RRT*-Smart.

Source: paper 001 (RRT-GRID, 2023), section 2, which builds on LaValle's RRT, Kuffner and LaValle's RRT-Connect
(2000), Karaman and Frazzoli's RRT* (2011) and Islam and others' RRT*-Smart (2012). The paper gives no step, bias or
radius: :class:`Tuning` holds ours.

RRT, RRT* and RRT*-Smart are one tree: RRT* rewires it, RRT*-Smart goes on after the first path, pulls the path tight
and samples around its corners, the beacons. RRT and RRT* end with their first path, as the paper's seconds suggest
(RRT* takes 1.4 times as long as RRT), but for RRT* told to use all its iterations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sumo_nets.freespace.floor import Floor, Point, is_clear, path_length
from sumo_nets.graph import FloatArray

IntArray = NDArray[np.int64]

#: RRT*-Smart takes every other sample at a beacon.
_BEACON_EVERY = 2


@dataclass(frozen=True, slots=True)
class Tuning:
    """Parameters of the trees; lengths in the floor's unit, defaults for 960 x 640 pixels.

    Attributes:
        step: longest edge that a tree grows by.
        goal_bias: share of samples that are the goal itself.
        iterations: samples after which a search gives up.
        radius: nodes within it are looked at for a better parent, and rewired.
        beacon_radius: RRT*-Smart samples this near a beacon.
        smart_iterations: samples that RRT*-Smart takes after its first path.
    """

    step: float = 20.0
    goal_bias: float = 0.05
    iterations: int = 20_000
    radius: float = 60.0
    beacon_radius: float = 30.0
    smart_iterations: int = 200

    def scaled(self, factor: float) -> Tuning:
        """The same parameters in another unit of length; one pixel is ``factor`` of these units."""
        return Tuning(
            self.step * factor,
            self.goal_bias,
            self.iterations,
            self.radius * factor,
            self.beacon_radius * factor,
            self.smart_iterations,
        )


@dataclass(frozen=True, eq=False)
class FreePath:
    """What a planner found.

    Attributes:
        points: the path from start to goal, shape (k, 2); empty if none was found.
        length: its length; infinite without a path.
        samples: random samples taken.
    """

    points: FloatArray
    length: float
    samples: int

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return len(self.points) > 0


def free_path(points: FloatArray, samples: int) -> FreePath:
    """A path with its length, or none for no points."""
    return FreePath(points, path_length(points) if len(points) else np.inf, samples)


_DEFAULT = Tuning()


def rrt(floor: Floor, start: Point, goal: Point, rng: np.random.Generator, tuning: Tuning = _DEFAULT) -> FreePath:
    """RRT: grow a tree towards random samples until it meets the goal.

    Args:
        floor: the obstacles.
        start, goal: free points.
        rng: source of the samples.
        tuning: parameters.

    Returns:
        The first path, or none after ``tuning.iterations`` samples. Source: paper 001, section 2.1.
    """
    return _plant(floor, start, goal, rng, tuning, 0.0, 0, 0.0)


def rrt_star(
    floor: Floor,
    start: Point,
    goal: Point,
    rng: np.random.Generator,
    tuning: Tuning = _DEFAULT,
    use_all: bool = False,
) -> FreePath:
    """RRT*: every new node takes the best parent near it, and becomes the parent of those it shortens.

    Args:
        floor: the obstacles.
        start, goal: free points.
        rng: source of the samples.
        tuning: parameters.
        use_all: take all ``tuning.iterations`` samples and return the shortest path; else the first path ends it.

    Returns:
        The path, or none. Source: Karaman and Frazzoli (2011); baseline of paper 001.
    """
    return _plant(floor, start, goal, rng, tuning, tuning.radius, tuning.iterations if use_all else 0, 0.0)


def rrt_smart(floor: Floor, start: Point, goal: Point, rng: np.random.Generator, tuning: Tuning = _DEFAULT) -> FreePath:
    """RRT*-Smart: RRT* that pulls its path tight and then samples around the corners that remain.

    Args:
        floor: the obstacles.
        start, goal: free points.
        rng: source of the samples.
        tuning: parameters.

    Returns:
        The shortest tightened path, or none. Source: Islam and others (2012); paper 001, section 2.2.
    """
    return _plant(floor, start, goal, rng, tuning, tuning.radius, tuning.smart_iterations, tuning.beacon_radius)


def rrt_connect(
    floor: Floor, start: Point, goal: Point, rng: np.random.Generator, tuning: Tuning = _DEFAULT
) -> FreePath:
    """RRT-Connect: a tree at either end; each new node of one is run towards by the other.

    Args:
        floor: the obstacles.
        start, goal: free points.
        rng: source of the samples.
        tuning: parameters.

    Returns:
        The first path, or none. Source: Kuffner and LaValle (2000); paper 001 uses it to tell what can be reached.
    """
    points, samples = _connect(
        floor.edges,
        floor.clearance,
        floor.width,
        floor.height,
        np.array(start, dtype=np.float64),
        np.array(goal, dtype=np.float64),
        rng,
        tuning.step,
        tuning.iterations,
    )
    return free_path(points, samples)


def _plant(
    floor: Floor,
    start: Point,
    goal: Point,
    rng: np.random.Generator,
    tuning: Tuning,
    radius: float,
    after: int,
    beacon_radius: float,
) -> FreePath:
    points, samples = _grow(
        floor.edges,
        floor.clearance,
        floor.width,
        floor.height,
        np.array(start, dtype=np.float64),
        np.array(goal, dtype=np.float64),
        rng,
        tuning.step,
        tuning.goal_bias,
        tuning.iterations,
        radius,
        after,
        beacon_radius,
    )
    return free_path(points, samples)


@njit(cache=True)
def _grow(
    edges: FloatArray,
    clearance: float,
    width: float,
    height: float,
    start: FloatArray,
    goal: FloatArray,
    rng: np.random.Generator,
    step: float,
    goal_bias: float,
    iterations: int,
    radius: float,
    after: int,
    beacon_radius: float,
) -> tuple[FloatArray, int]:
    """Grow one tree; the points of the best path and the number of samples.

    ``radius`` 0 never rewires (RRT). ``after`` samples follow the first path; with a ``beacon_radius`` paths are
    pulled tight and half of those samples are taken around their corners (RRT*-Smart).
    """
    V = np.empty((iterations + 1, 2))
    parent = np.full(iterations + 1, -1)
    first_child = np.full(iterations + 1, -1)
    next_sibling = np.full(iterations + 1, -1)
    cost = np.zeros(iterations + 1)
    V[0] = start
    n = 1
    at_goal = np.empty(iterations + 1, dtype=np.int64)
    n_at_goal = 0
    best = np.empty((0, 2))
    c_best = np.inf
    c_tree = np.inf
    last = iterations
    k = 0
    while k < last:
        beacons = len(best) - 2 if beacon_radius > 0 else 0
        q_rand = _sample(rng, width, height, goal, goal_bias)
        if beacons > 0 and k % _BEACON_EVERY == 0:
            q_rand = _sample_near(rng, best[1 + rng.integers(0, beacons)], beacon_radius)
        k += 1
        q_near = _nearest(V, n, q_rand)
        x, y = _steer(V[q_near], q_rand, step)
        if not (0 <= x <= width and 0 <= y <= height):
            continue
        if not is_clear(edges, clearance, V[q_near, 0], V[q_near, 1], x, y):
            continue
        q_new = n
        V[q_new] = (x, y)
        _adopt(q_new, q_near, cost[q_near] + _apart(V[q_near], V[q_new]), parent, first_child, next_sibling, cost)
        n += 1
        if radius > 0:
            _rewire(edges, clearance, V, n, radius, parent, first_child, next_sibling, cost)
        if _apart(V[q_new], goal) <= step and is_clear(edges, clearance, x, y, goal[0], goal[1]):
            at_goal[n_at_goal] = q_new
            n_at_goal += 1
            if last == iterations:
                last = min(iterations, k + after)
        if n_at_goal == 0:
            continue
        q_best = _best_at_goal(V, cost, at_goal, n_at_goal, goal)
        c_new = cost[q_best] + _apart(V[q_best], goal)
        if c_new < c_tree - 1e-9:
            c_tree = c_new
            path = _path_to(V, parent, q_best, goal)
            if beacon_radius > 0:
                path = _pull_tight(edges, clearance, path)
            c_path = _length(path)
            if c_path < c_best:
                best, c_best = path, c_path
    return best, k


@njit(cache=True)
def _connect(
    edges: FloatArray,
    clearance: float,
    width: float,
    height: float,
    start: FloatArray,
    goal: FloatArray,
    rng: np.random.Generator,
    step: float,
    iterations: int,
) -> tuple[FloatArray, int]:
    """Grow a tree at either end by turns; the first path and the number of samples. Trees are bounded like samples."""
    V = np.empty((2, iterations + 1, 2))
    parent = np.full((2, iterations + 1), -1)
    V[0, 0] = start
    V[1, 0] = goal
    n = np.ones(2, dtype=np.int64)
    k = 0
    while k < iterations and n.max() <= iterations:
        a, b = k % 2, 1 - k % 2
        k += 1
        q_rand = _sample(rng, width, height, goal, 0.0)
        if not _extend(edges, clearance, V[a], parent[a], n[a], _nearest(V[a], n[a], q_rand), q_rand, step):
            continue
        q_new = V[a, n[a]]
        n[a] += 1
        q = _nearest(V[b], n[b], q_new)
        while n[b] <= iterations and _extend(edges, clearance, V[b], parent[b], n[b], q, q_new, step):
            q = n[b]
            n[b] += 1
            if _apart(V[b, q], q_new) < 1e-9:
                meet_a, meet_b = (n[a] - 1, q) if a == 0 else (q, n[a] - 1)
                there = _path_to(V[0], parent[0], meet_a, V[0, meet_a])
                back = _path_to(V[1], parent[1], meet_b, V[1, meet_b])
                return np.concatenate((there[:-1], back[:-2][::-1])), k
    return np.empty((0, 2)), k


@njit(cache=True)
def _extend(
    edges: FloatArray,
    clearance: float,
    V: FloatArray,
    parent: IntArray,
    n: int,
    q: int,
    towards: FloatArray,
    step: float,
) -> bool:
    """Put one step from node q at place n of the tree, if it is free."""
    if n >= len(V):
        return False
    x, y = _steer(V[q], towards, step)
    if not is_clear(edges, clearance, V[q, 0], V[q, 1], x, y):
        return False
    V[n] = (x, y)
    parent[n] = q
    return True


@njit(cache=True)
def _sample(rng: np.random.Generator, width: float, height: float, goal: FloatArray, goal_bias: float) -> FloatArray:
    if rng.random() < goal_bias:
        return goal
    return np.array((rng.random() * width, rng.random() * height))


@njit(cache=True)
def _sample_near(rng: np.random.Generator, beacon: FloatArray, radius: float) -> FloatArray:
    """A point of the disc around a beacon, all of it equally likely."""
    angle, r = rng.random() * 2 * np.pi, radius * np.sqrt(rng.random())
    return np.array((beacon[0] + r * np.cos(angle), beacon[1] + r * np.sin(angle)))


@njit(cache=True)
def _nearest(V: FloatArray, n: int, q: FloatArray) -> int:
    nearest, least = 0, np.inf
    for i in range(n):
        d = (V[i, 0] - q[0]) ** 2 + (V[i, 1] - q[1]) ** 2
        if d < least:
            nearest, least = i, d
    return nearest


@njit(cache=True)
def _steer(q: FloatArray, towards: FloatArray, step: float) -> tuple[float, float]:
    d = _apart(q, towards)
    share = min(1.0, step / d) if d > 0 else 0.0
    if share == 1.0:
        return towards[0], towards[1]
    return q[0] + (towards[0] - q[0]) * share, q[1] + (towards[1] - q[1]) * share


@njit(cache=True)
def _apart(a: FloatArray, b: FloatArray) -> float:
    return float(np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2))


@njit(cache=True)
def _adopt(
    child: int,
    q: int,
    c: float,
    parent: IntArray,
    first_child: IntArray,
    next_sibling: IntArray,
    cost: FloatArray,
) -> None:
    """Make q the parent of a node, and hand the change of its cost down to all its descendants."""
    old = parent[child]
    if old >= 0:
        if first_child[old] == child:
            first_child[old] = next_sibling[child]
        else:
            before = first_child[old]
            while next_sibling[before] != child:
                before = next_sibling[before]
            next_sibling[before] = next_sibling[child]
    parent[child] = q
    next_sibling[child] = first_child[q]
    first_child[q] = child
    change = c - cost[child]
    cost[child] = c
    node = first_child[child]
    while node >= 0:
        # depth first: down, else to the next sibling of the nearest ancestor that has one
        cost[node] += change
        if first_child[node] >= 0:
            node = first_child[node]
            continue
        while node != child and next_sibling[node] < 0:
            node = parent[node]
        if node == child:
            return
        node = next_sibling[node]


@njit(cache=True)
def _rewire(
    edges: FloatArray,
    clearance: float,
    V: FloatArray,
    n: int,
    radius: float,
    parent: IntArray,
    first_child: IntArray,
    next_sibling: IntArray,
    cost: FloatArray,
) -> None:
    """Give the newest node its best parent within the radius, and make it the parent of nodes that it shortens."""
    q_new = n - 1
    near = np.empty(n, dtype=np.int64)
    m = 0
    for i in range(q_new):
        if _apart(V[i], V[q_new]) <= radius:
            near[m] = i
            m += 1
    for q in near[:m]:
        c = cost[q] + _apart(V[q], V[q_new])
        if c < cost[q_new] and is_clear(edges, clearance, V[q, 0], V[q, 1], V[q_new, 0], V[q_new, 1]):
            _adopt(q_new, q, c, parent, first_child, next_sibling, cost)
    for q in near[:m]:
        c = cost[q_new] + _apart(V[q], V[q_new])
        if c < cost[q] - 1e-9 and is_clear(edges, clearance, V[q, 0], V[q, 1], V[q_new, 0], V[q_new, 1]):
            _adopt(q, q_new, c, parent, first_child, next_sibling, cost)


@njit(cache=True)
def _best_at_goal(V: FloatArray, cost: FloatArray, at_goal: IntArray, n: int, goal: FloatArray) -> int:
    best, least = -1, np.inf
    for q in at_goal[:n]:
        c = cost[q] + _apart(V[q], goal)
        if c < least:
            best, least = q, c
    return best


@njit(cache=True)
def _path_to(V: FloatArray, parent: IntArray, q: int, goal: FloatArray) -> FloatArray:
    """Points from the root to node q, and the goal."""
    k = 2
    node = q
    while parent[node] >= 0:
        node = parent[node]
        k += 1
    path = np.empty((k, 2))
    path[k - 1] = goal
    node = q
    for i in range(k - 2, -1, -1):
        path[i] = V[node]
        node = parent[node]
    return path


@njit(cache=True)
def _pull_tight(edges: FloatArray, clearance: float, path: FloatArray) -> FloatArray:
    """Drop points that the path can do without, from the goal on: each kept point sees the one kept before it."""
    kept = np.empty(len(path), dtype=np.int64)
    kept[0] = len(path) - 1
    m = 1
    while kept[m - 1] > 0:
        here = kept[m - 1]
        there = here - 1
        while there > 0 and is_clear(
            edges, clearance, path[here, 0], path[here, 1], path[there - 1, 0], path[there - 1, 1]
        ):
            there -= 1
        kept[m] = there
        m += 1
    return path[kept[:m][::-1]]


@njit(cache=True)
def _length(path: FloatArray) -> float:
    total = 0.0
    for i in range(1, len(path)):
        total += _apart(path[i - 1], path[i])
    return total
