"""CBS with A* on the lattice, with a time limit: what the two-stage genetic algorithm is compared with (2025, V-2).

The constraint tree is searched best first by (sum of arrivals, collisions, order of creation); collisions are those of
``controller.genetic.lattice``. A robot goes any way, not only a shortest one, and waits as there: two steps at a time,
before it leaves or in the middle of an aisle. When time is up the plan of the node looked at last is returned with its
collisions, as in the paper.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from time import process_time
from typing import NamedTuple

from controller.genetic.lattice import Instance, LatticePlan

#: A place on the grid of intersections (both coordinates even) and middles of aisles.
Place = tuple[int, int]

#: Where a robot is in each step until it arrives, arrival included.
Way = tuple[Place, ...]

_DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0))


class Meeting(NamedTuple):
    """Two robots in one place at ``step``, or swapping places until ``step``: each comes ``before`` -> ``place``."""

    step: int
    robots: tuple[int, int]
    befores: tuple[Place | None, Place | None]
    places: tuple[Place, Place]


#: What a robot may not do: be in a place (before is None), or go there from ``before``, at a step.
Constraint = tuple[Place | None, Place, int]


class CbsAnswer(NamedTuple):
    """What CBS came to.

    Attributes:
        plan: figures of the plan.
        ways: the plan, by robot.
        nodes: nodes of the constraint tree looked at.
        timeout: time was up before a plan without collisions was found.
    """

    plan: LatticePlan
    ways: tuple[Way, ...]
    nodes: int
    timeout: bool


class _State(NamedTuple):
    """At a place in step ``t``, in an aisle with a direction; ``left`` the start or not; and the state before."""

    t: int
    place: Place
    direction: tuple[int, int] | None
    left: bool
    before: _State | None


class _Node(NamedTuple):
    constraints: Mapping[int, frozenset[Constraint]]
    ways: tuple[Way, ...]
    collisions: int


def plan_cbs(instance: Instance, limit_s: float) -> CbsAnswer:
    """Plan all robots by CBS.

    Args:
        instance: the robots.
        limit_s: seconds of the process's CPU time after which the last node's plan is returned.

    Returns:
        The plan of least sum of arrivals without collisions, or the last one looked at.
    """
    begin = process_time()
    tie = count()
    ways = tuple(way for i in range(len(instance.starts)) if (way := _a_star(instance, i, frozenset())))
    node = _Node({}, ways, count_collisions(ways))
    OPEN = [(_cost(ways), node.collisions, next(tie), node)]
    looked_at = 0
    while OPEN:
        node = heapq.heappop(OPEN)[3]
        looked_at += 1
        if not node.collisions or process_time() - begin > limit_s:
            break
        for robot, constraint in _split(min(meetings(node.ways), key=lambda meeting: meeting[:2])):
            own = node.constraints.get(robot, frozenset()) | {constraint}
            way = _a_star(instance, robot, own)
            if way is not None:
                ways = (*node.ways[:robot], way, *node.ways[robot + 1 :])
                child = _Node({**node.constraints, robot: own}, ways, count_collisions(ways))
                heapq.heappush(OPEN, (_cost(ways), child.collisions, next(tie), child))
    n = len(node.ways)
    work = _cost(node.ways) / n
    standing = sum(way[t] == way[t + 1] for way in node.ways for t in range(len(way) - 1)) / n
    return CbsAnswer(LatticePlan(node.collisions, work, standing), node.ways, looked_at, node.collisions > 0)


def meetings(ways: Sequence[Way]) -> Iterator[Meeting]:
    """Every meeting of two robots: shared places of robots under way, and swaps that both began under way."""
    for t in range(max(map(len, ways)) - 1):
        here: defaultdict[Place, list[int]] = defaultdict(list)
        moves: defaultdict[tuple[Place, Place], list[int]] = defaultdict(list)
        for i, way in enumerate(ways):
            if t < len(way) - 1:
                yield from (Meeting(t, (j, i), (None, None), (way[t], way[t])) for j in here[way[t]])
                here[way[t]].append(i)
                for j in moves.get((way[t + 1], way[t]), ()):
                    yield Meeting(t + 1, (j, i), (way[t + 1], way[t]), (way[t], way[t + 1]))
                if way[t + 1] != way[t]:
                    moves[way[t], way[t + 1]].append(i)


def count_collisions(ways: Sequence[Way]) -> int:
    """Number of ``meetings``."""
    here = Counter((t, way[t]) for way in ways for t in range(len(way) - 1))
    moves = Counter((t, way[t], way[t + 1]) for way in ways for t in range(len(way) - 1) if way[t] < way[t + 1])
    backs = Counter((t, way[t + 1], way[t]) for way in ways for t in range(len(way) - 1) if way[t] > way[t + 1])
    return sum(k * (k - 1) // 2 for k in here.values()) + sum(k * backs[move] for move, k in moves.items())


def _cost(ways: Sequence[Way]) -> int:
    return sum(len(way) - 1 for way in ways)


def _split(meeting: Meeting) -> Iterator[tuple[int, Constraint]]:
    for robot, before, place in zip(meeting.robots, meeting.befores, meeting.places, strict=True):
        yield robot, (before, place, meeting.step)


def _a_star(instance: Instance, robot: int, constraints: frozenset[Constraint]) -> Way | None:
    """The robot's quickest way under its constraints, None if it can neither stay nor go."""
    (x0, y0), (x1, y1) = instance.starts[robot].tolist(), instance.goals[robot].tolist()
    goal = (2 * x1, 2 * y1)
    tie = count()
    start = _State(0, (2 * x0, 2 * y0), None, False, None)
    OPEN = [(_steps(start.place, goal), 0, next(tie), start)]
    closed = set()
    while OPEN:
        state = heapq.heappop(OPEN)[3]
        if state.place == goal and state.left:
            return _way(state)
        if state[:4] in closed:
            continue
        closed.add(state[:4])
        for after in _successors(state, instance):
            if not _forbidden(state, after, goal, constraints):
                heapq.heappush(OPEN, (after.t + _steps(after.place, goal), -after.t, next(tie), after))
    return None


def _successors(state: _State, instance: Instance) -> Iterator[_State]:
    t, (x, y), direction, left, _ = state
    if direction is not None or not left:
        yield state._replace(t=t + 2, before=state)
    for dx, dy in _DIRECTIONS if direction is None else (direction,):
        place = (x + dx, y + dy)
        if 0 <= place[0] <= 2 * instance.columns - 2 and 0 <= place[1] <= 2 * instance.rows - 2:
            yield _State(t + 1, place, (dx, dy) if direction is None else None, True, state)


def _forbidden(state: _State, after: _State, goal: Place, constraints: frozenset[Constraint]) -> bool:
    if after.place == state.place:
        return (None, state.place, state.t + 1) in constraints or (None, state.place, state.t + 2) in constraints
    if (state.place, after.place, after.t) in constraints:
        return True
    return after.place != goal and (None, after.place, after.t) in constraints


def _steps(place: Place, goal: Place) -> int:
    """Steps that are left at least."""
    return abs(place[0] - goal[0]) + abs(place[1] - goal[1])


def _way(state: _State) -> Way:
    """The places in each step of the states up to this one."""
    places = [state.place]
    while state.before is not None:
        places += [state.before.place] * (state.t - state.before.t)
        state = state.before
    return tuple(reversed(places))
