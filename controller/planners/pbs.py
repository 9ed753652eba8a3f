"""PBS: priority-based search (Ma, Harabor, Stuckey, Li and Koenig 2019) in a rolling window (RHCR, Li et al. 2021).

The planner searches partial orders of priority, depth first. The root plans each agent as if it were alone. The first
meeting of two agents inside the window gives two children: in each child one of the two agents goes before the other.
The lower agent, and all agents below it, are planned again around the agents above them. The cheaper child is searched
first.

Guarantee: SOLVED paths are free of conflicts up to the window. Limits: incomplete in any case (some problems have no
solution by priorities), and not optimal. Agents may give way to each other for ever, from window to window; deadlock
handling detects and resolves such cases.

Departures from the papers: the low level is SIPP over intervals instead of steps (``search.sipp``). The search ends
after ``nodes`` nodes. A problem without a solution so far is planned as by WHCA*, in order of ``PlanAgent.priority``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controller.planners.whca import Round
from controller.search.distances import Distances
from controller.search.groups import Group, empty_group, load, unload, with_path
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import FOREVER, AgvNumber, Counters, Motion, Path, PlanAgent, PlanningProblem, PlanResult, Status
from sumo_nets.graph import Graph, IntArray


@dataclass(frozen=True, slots=True)
class PbsOptions:
    """Options of PBS.

    Attributes:
        nodes: nodes of the priority tree per call at most.
        raises: see ``WhcaOptions``; for problems that the tree does not solve.
    """

    nodes: int = field(default=256, metadata={"least": 1})
    raises: int = 10


@dataclass(slots=True)
class _Node:
    """A node of the priority tree.

    Attributes:
        above: for each agent the set of those before it, transitively closed, as bits.
        group: the paths, and which agents meet.
        paths: the paths; None before the first one is found.
        costs: steps to the goal of each agent.
    """

    above: list[int]
    group: Group
    paths: list[Path | None]
    costs: list[int]

    def copy(self) -> _Node:
        return _Node(self.above.copy(), self.group.copy(), self.paths.copy(), self.costs.copy())


class Pbs:
    """The planner, with the search memory it keeps between calls.

    Attributes:
        nodes: nodes of the priority tree in the last call.
    """

    def __init__(self, space: Space, options: PbsOptions) -> None:
        self.options = options
        self.distances = Distances(space)
        self.table = ReservationTable(len(space.graph.names), space.motion.following)
        self.nodes = 0
        self._search = PathSearch(self.distances)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Plan for all agents of a problem.

        Returns:
            SOLVED with a path for each agent, or PARTIAL as from WHCA*. Counters are those of this call, distance
            searches included.
        """
        self.distances.counters[:] = 0
        self._search.begin(problem)
        self.table.reset(problem.fixed)
        tree = _Tree(problem, self.table, self._search, self.options.nodes)
        solution = tree.run()
        self.nodes = tree.nodes
        if solution is None:
            round_ = Round(problem, self.table, self._search, self.options.raises)
            round_.run()
            status, paths, failed = round_.status, round_.paths, round_.failed
        else:
            status, paths, failed = Status.SOLVED, solution, {}
        return PlanResult(status, paths, failed, Counters(*self.distances.counters.tolist()))


class _Tree:
    """The search of one call."""

    def __init__(self, problem: PlanningProblem, table: ReservationTable, search: PathSearch, most: int) -> None:
        self.problem = problem
        self.table = table
        self.search = search
        self.most = most
        self.nodes = 1
        self.agents = sorted(problem.agents, key=lambda agent: (-agent.priority, agent.agv))
        self.agvs: IntArray = np.array([agent.agv for agent in self.agents], dtype=np.int32)
        self.window = min(problem.window_steps, FOREVER)

    def run(self) -> dict[AgvNumber, Path] | None:
        """The paths of the first node without a meeting; None if the node limit is reached first."""
        n = len(self.agents)
        root = _Node([0] * n, empty_group(n), [None] * n, [0] * n)
        if not all(self._plan(root, i) for i in range(n)):
            return None
        STACK = [root]
        while STACK:
            N = STACK.pop()
            pair = self._first_meeting(N)
            if pair is None:
                return {path.agv: path for path in N.paths if path is not None}
            if self.nodes >= self.most:
                return None
            self.nodes += 2
            i, j = pair
            children = [child for child in (self._child(N, i, j), self._child(N, j, i)) if child]
            STACK += sorted(children, key=lambda child: -sum(child.costs))  # the cheaper child on top
        return None

    def _child(self, N: _Node, i: int, j: int) -> _Node | None:
        """The node in which ``i`` also goes before ``j``; None if some agent then finds no path."""
        child = N.copy()
        new = N.above[i] | 1 << i
        for k in range(len(self.agents)):
            if k == j or N.above[k] >> j & 1:
                child.above[k] |= new
        return child if self._update(child, j) else None

    def _update(self, N: _Node, j: int) -> bool:
        """Plan ``j`` again, and all agents below it that meet an agent above them, in order of priority."""
        below = [k for k in range(len(self.agents)) if k == j or N.above[k] >> j & 1]
        for k in sorted(below, key=lambda k: (N.above[k].bit_count(), k)):
            above = _members(N.above[k])
            if (k == j or (N.group.meets[k, above] < FOREVER).any()) and not self._plan(N, k):
                return False
        return True

    def _plan(self, N: _Node, i: int) -> bool:
        """Find a path of an agent around all agents above it."""
        above = _members(N.above[i])
        agent = self.agents[i]
        group = N.group
        load(self.table, group, above, self.agvs)
        path = self.search.find_path(self.problem, agent, self.table)
        unload(self.table, group, above, self.agvs)
        if path is None:
            return False
        N.paths[i] = path
        N.costs[i] = self._cost(agent, path)
        N.group = with_path(group, i, path, self.problem.motion.following, self.window)
        return True

    def _cost(self, agent: PlanAgent, path: Path) -> int:
        """Steps to the goal: those of the path, and what is left beyond the window."""
        last = path.vertices[-1]
        if last == agent.goal:
            return path.arrive[-1]
        index = self.problem.graph.edge_index
        edge = index[path.vertices[-2], last] if len(path.vertices) > 1 else agent.in_edge
        h = self.search.distances.distance(last, edge, agent.goal, agent.loaded)
        return max(path.arrive[-1], self.window) + h

    def _first_meeting(self, N: _Node) -> tuple[int, int] | None:
        """The two agents that meet first, the agent of higher priority first."""
        meets = N.group.meets
        if len(self.agents) > 1:
            k = int(meets.argmin())
            i, j = divmod(k, len(self.agents))
            if meets[i, j] < FOREVER:
                return i, j
        return None


def _members(bits: int) -> IntArray:
    members = []
    while bits:
        low = bits & -bits
        members.append(low.bit_length() - 1)
        bits ^= low
    return np.array(members, dtype=np.int32)


def make_pbs(graph: Graph, motion: Motion, options: PbsOptions | None = None) -> Pbs:
    """A PBS planner for one garage.

    Args:
        graph, motion: the garage and how long moves take; all problems must be of these.
        options: see ``PbsOptions``.

    Returns:
        The planner; call it with a problem.
    """
    return Pbs(Space(graph, motion), options or PbsOptions())
