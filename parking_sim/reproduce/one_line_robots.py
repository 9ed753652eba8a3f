"""Robots on a one-line grid that drive by their own plans, without the executor: the setting of paper 000.

A robot drives on as soon as the next cell is free, whoever was meant to be there first; that is what a robot with a
distance sensor does, and why late robots can meet head on. Plans are made by the product's ``online_mapf`` at the
paper's events: arrival at the current goal, a new goal, a time-out of those who have no path, and, with replanning, a
collision predicted from where everybody is now.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np
from numpy.random import Generator

from controller.planners.online_mapf import OnlineMapfOptions, current_goals, make_online_mapf
from controller.types import FOREVER, TRAIL, AgvNumber, Motion, Path, PlanAgent, PlanningProblem, make_motion
from demand.types import stream
from sumo_nets.graph import Graph, make_graph
from sumo_nets.numbering import NO_EDGE, NO_VERTEX, EdgeIndex, Numbered, Vertex
from sumo_nets.one_line import OneLine, one_line_layout
from sumo_nets.plan import plan_garage

#: Speeds of the paper's robots, m/s and degrees/s, and the length of a cell: the width one robot needs.
SPEED_MPS, TURN_DPS, PITCH_M = 1.1, 38.0, 1.5
STEP_S = 0.2
#: Metres that ``one_line_layout`` takes for a cell; a garage's cells are larger than these robots' ones.
_LAYOUT_PITCH_M = 7.0


@dataclass(frozen=True, slots=True)
class Setting:
    """One experiment.

    Attributes:
        line: the grid. Fewer places to pick from than robots: several want one place.
        round_trips: each robot's, out and back.
        noise: sigma of the log-normal factor on the time of each move.
        look_ahead_s: collisions are predicted so far ahead, once a second.
        timeout_s: robots without a path are planned for again after so long.
        permutations: orders of priority tried in one planning call.
        end_s: end of a run.
    """

    line: OneLine = field(default_factory=lambda: OneLine(robots=10, unloading=5, narrow=18, passing=2, picking=3))
    round_trips: int = 10
    noise: float = 0.15
    look_ahead_s: float = 8.0
    timeout_s: float = 2.0
    permutations: int = 50
    end_s: float = 3600.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Attributes:
        arrivals: at the final goals, by robot in the order of the file.
        deadlock: nobody drove any more, and no plan could change that, though somebody had somewhere to go.
        ended_s: when it ended.
        plans: planning calls.
        predicted: calls because of a predicted collision.
    """

    arrivals: tuple[int, ...]
    deadlock: bool
    ended_s: float
    plans: int
    predicted: int


def one_line_graph(line: OneLine) -> Graph:
    """The one-line grid as a graph with cells of ``PITCH_M``."""
    plan = plan_garage(one_line_layout("one_line", line, _LAYOUT_PITCH_M))
    scale = PITCH_M / _LAYOUT_PITCH_M
    places = [(name, x * scale, y * scale) for name, (x, y) in plan.vertices.items()]
    lanes = [(lane.name, tail, head, PITCH_M) for (tail, head), lane in plan.lanes.items()]
    return make_graph("one_line", places, lanes, plan.roles)


def robot_motion(graph: Graph) -> Motion:
    """How long the robots' moves take, in steps of ``STEP_S``."""

    def drive(metres: float, _loaded: bool) -> int:
        return math.ceil(metres / SPEED_MPS / STEP_S)

    def turn(degrees: float, _loaded: bool) -> int:  # they drive backwards as well, so a reversal costs nothing
        return 0 if degrees >= 180.0 else math.ceil(degrees / TURN_DPS / STEP_S)

    return make_motion(graph, STEP_S, drive, turn, following=False)


@dataclass(slots=True)
class _Robot:
    """One robot.

    Attributes:
        number: place in the file, the first one leaves first.
        at: cell it stands on or drives to.
        final, goal: where it has to go, and where it goes now (a way point before that).
        behind: cell it is leaving, -1 when it stands.
        in_edge: edge into ``at``.
        ways: cells still to visit.
        over, expected: steps at which its move ends, and at which it should.
        arrivals: at final goals.
    """

    number: AgvNumber
    at: Vertex
    final: Vertex = NO_VERTEX
    goal: Vertex = NO_VERTEX
    behind: Vertex = NO_VERTEX
    in_edge: EdgeIndex = NO_EDGE
    ways: deque[Vertex] = field(default_factory=deque)
    over: int = 0
    expected: int = 0
    arrivals: int = 0


class OneLineRun:
    """One run.

    Args:
        setting: the experiment.
        graph, motion: see ``one_line_graph`` and ``robot_motion``.
        replanning: predicted collisions are planned away.
        seed: of the moves' times; a robot's k-th move takes the same time with and without replanning.
    """

    def __init__(self, setting: Setting, graph: Graph, motion: Motion, replanning: bool, seed: int) -> None:
        self._setting, self._graph, self._motion = setting, graph, motion
        self._replanning = replanning
        self._planner = make_online_mapf(graph, motion, OnlineMapfOptions(permutations=setting.permutations))
        self._noise: Numbered[AgvNumber, Generator] = [
            stream(seed, f"one line {n}") for n in range(setting.line.robots)
        ]
        self._refuges = graph.roles["refuge"]
        self._unloading = self._refuges[: 2 * setting.line.unloading]
        self._none = np.zeros(len(graph.names), dtype=np.uint8)
        self._robots: Numbered[AgvNumber, _Robot] = [_Robot(AgvNumber(n), home) for n, home in enumerate(graph.homes)]
        self._owner = {robot.at: robot.number for robot in self._robots}
        self._step = 0
        self._planned = 0
        self._plans = self._predicted = 0

    def run(self) -> Outcome:
        """Drive until everybody is done, nobody can move any more, or time is up."""
        for robot in self._robots:
            self._new_goal(robot)
        news = {robot.number for robot in self._robots}
        while self._step * STEP_S < self._setting.end_s and any(map(self._under_way, self._robots)):
            self._plan(news)
            self._start_moves()
            if not self._driving():
                return self._outcome(deadlock=True)
            self._step += 1
            news = self._end_moves()
        return self._outcome(deadlock=False)

    def _outcome(self, deadlock: bool) -> Outcome:
        arrivals = tuple(r.arrivals for r in self._robots)
        return Outcome(arrivals, deadlock, self._step * STEP_S, self._plans, self._predicted)

    def _driving(self) -> bool:
        return any(r.behind >= 0 for r in self._robots)

    def _under_way(self, robot: _Robot) -> bool:
        return robot.arrivals < 2 * self._setting.round_trips

    def _has_to_drive(self, robot: _Robot) -> bool:
        """It is under way, or has made way for another one after its last trip."""
        return self._under_way(robot) or robot.at != robot.final

    # --- goals ----------------------------------------------------------------------------------------------------

    def _new_goal(self, robot: _Robot) -> None:
        """Out to the farthest of the places that fewest want, back to the farthest bay that nobody wants."""
        wanted = [r.final for r in self._robots if r is not robot]
        places = self._graph.slots if robot.arrivals % 2 == 0 else self._unloading
        x = self._graph.xy[:, 0]
        robot.final = min(places, key=lambda v: (wanted.count(v), -abs(x[v] - x[robot.at]), v))

    def _current_goals(self) -> None:
        """Who has to wait for a place goes to a bay on the way to it."""
        final = {r.number: r.final for r in self._robots if self._has_to_drive(r)}
        x = self._graph.xy[:, 0]
        away = {n: float(abs(x[self._robots[n].at] - x[v])) for n, v in final.items()}
        ways = {v: sorted(self._refuges, key=lambda p: abs(x[p] - x[v])) for v in set(final.values())}
        standing = {r.at: r.number for r in self._robots}
        for n, goal in current_goals(final, away, ways, standing).items():
            self._robots[n].goal = goal

    # --- planning -------------------------------------------------------------------------------------------------

    def _plan(self, news: set[AgvNumber]) -> None:
        """Plan at events: for robots that have arrived or have no path, and for robots that would meet."""
        due = (self._step - self._planned) * STEP_S >= self._setting.timeout_s or not self._driving()
        if news or due:
            self._current_goals()
        without = {r.number for r in self._robots if not r.ways and r.at != r.goal and self._has_to_drive(r)}
        agents = news | without if news or due else set()
        meeting = self._meeting() if self._replanning and self._step % round(1 / STEP_S) == 0 else set()
        if not agents and not meeting:
            return
        self._predicted += bool(meeting)
        self._planned = self._step
        if self._solve(agents | meeting) and meeting:
            self._solve({r.number for r in self._robots})

    def _solve(self, agents: set[AgvNumber]) -> bool:
        """New paths for these robots round all others; True if somebody got none and stands."""
        self._plans += 1
        robots = [self._robots[n] for n in sorted(agents)]
        fixed = [path for r in self._robots for path in self._ahead(r) if path.agv not in agents]
        asked = tuple(PlanAgent(r.number, r.at, r.in_edge, self._ready(r), r.goal, False) for r in robots)
        problem = PlanningProblem(self._graph, self._motion, asked, tuple(fixed), self._none, self._none, FOREVER)
        result = self._planner(problem)
        for robot in robots:
            path = result.paths.get(robot.number)
            robot.ways = deque(path.vertices[1:] if path else ())
        return bool(result.failed)

    def _ready(self, robot: _Robot) -> int:
        return max(robot.expected - self._step, 1) if robot.behind >= 0 else 0

    def _ahead(self, robot: _Robot) -> Iterator[Path]:
        """Where a robot will be when, if nothing delays it from now on."""
        ready = self._ready(robot)
        if robot.behind >= 0:
            yield Path(AgvNumber(TRAIL + robot.number), (robot.behind,), (0,), (), ready)
        vertices, arrive, depart, in_edge = [robot.at], [0], list[int](), robot.in_edge
        for u, v in pairwise((robot.at, *robot.ways)):
            edge = self._graph.edge_index[u, v]
            leave = ready + self._motion.turn(self._graph, in_edge, edge, False)
            ready, in_edge = leave + int(self._motion.edge_steps[0, edge]), edge
            vertices.append(v)
            depart.append(leave)
            arrive.append(ready)
        yield Path(robot.number, tuple(vertices), tuple(arrive), tuple(depart))

    def _meeting(self) -> set[AgvNumber]:
        """Robots that would meet within the look-ahead."""
        soon = round(self._setting.look_ahead_s / STEP_S)
        stays = {r.number: list(_stays(path)) for r in self._robots for path in self._ahead(r) if path.agv < TRAIL}
        driving = {r.number for r in self._robots if r.ways}
        found: set[AgvNumber] = set()
        for a, b in combinations(self._robots, 2):
            if driving & {a.number, b.number} and _meet(stays[a.number], stays[b.number], soon):
                found |= {a.number, b.number}
        return found

    # --- driving --------------------------------------------------------------------------------------------------

    def _start_moves(self) -> None:
        for robot in self._robots:
            if robot.behind < 0 and robot.ways and robot.ways[0] not in self._owner:
                to = robot.ways.popleft()
                edge = self._graph.edge_index[robot.at, to]
                steps = self._motion.turn(self._graph, robot.in_edge, edge, False)
                steps += int(self._motion.edge_steps[0, edge])
                factor = math.exp(self._setting.noise * float(self._noise[robot.number].standard_normal()))
                robot.behind, robot.at, robot.in_edge = robot.at, to, edge
                robot.expected, robot.over = self._step + steps, self._step + max(1, round(steps * factor))
                self._owner[to] = robot.number

    def _end_moves(self) -> set[AgvNumber]:
        """Robots that have arrived where they wanted to go now."""
        arrived = set()
        for robot in self._robots:
            if robot.behind >= 0 and robot.over <= self._step:
                del self._owner[robot.behind]
                robot.behind = NO_VERTEX
                if robot.at == robot.final and not robot.ways and self._under_way(robot):
                    robot.arrivals += 1
                    if self._under_way(robot):
                        self._new_goal(robot)
                if not robot.ways:
                    arrived.add(robot.number)
        return arrived


def _stays(path: Path) -> Iterator[tuple[Vertex, int, int]]:
    """Cell, from, until of a path."""
    ends = [*path.arrive[1:], path.until]
    for i, v in enumerate(path.vertices):
        yield v, 0 if i == 0 else path.depart[i - 1], ends[i]


def _meet(a: Sequence[tuple[Vertex, int, int]], b: Sequence[tuple[Vertex, int, int]], soon: int) -> bool:
    """Both are on one cell at one time, within ``soon`` steps."""
    cells: Mapping[Vertex, list[tuple[int, int]]] = {v: [] for v, _, _ in a}
    for v, start, end in a:
        cells[v].append((start, end))
    return any(max(start, begin) < min(end, until, soon) for v, begin, until in b for start, end in cells.get(v, ()))


def drive(setting: Setting, replanning: bool, seed: int) -> Outcome:
    """One run of an experiment.

    Args:
        setting: the experiment.
        replanning: predicted collisions are planned away.
        seed: of the moves' times.

    Returns:
        How it ended.
    """
    graph = one_line_graph(setting.line)
    return OneLineRun(setting, graph, robot_motion(graph), replanning, seed).run()
