"""Executors driven by hand: random plans, and a plant of no size that is late whenever a test likes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from brute_force import bodies, classic, garages
from hypothesis import strategies as st

from controller.executor import Executor
from controller.types import NEVER, Act, Action, Advance, AgvState, Motion, Path
from sumo_nets.graph import Graph

#: For each step a number whose binary digits say which AGVs are late in it; after the last one nobody is.
Delays = Sequence[int]

delays: st.SearchStrategy[Delays] = st.lists(st.integers(0, 15), max_size=40)


@dataclass(frozen=True, eq=False)
class Walks:
    """A plan that nobody checked: each AGV walks at random from a place of its own, waiting here and there."""

    graph: Graph
    motion: Motion
    paths: Mapping[int, Path]

    @property
    def starts(self) -> list[int]:
        return [path.vertices[0] for path in self.paths.values()]


@st.composite
def walks(draw: st.DrawFn, agvs: int = 4, moves: int = 5) -> Walks:
    graph = draw(garages(9))
    motion = classic(graph) if draw(st.booleans()) else bodies(graph)
    starts = draw(st.permutations(range(len(graph.names))))[: draw(st.integers(2, agvs))]
    paths = {}
    for agv, start in enumerate(starts):
        vertices, arrive, depart = [start], [0], []
        for _ in range(draw(st.integers(0, moves))):
            came = graph.edge_index.get((vertices[-2], vertices[-1]), -1) if len(vertices) > 1 else -1
            ways = [w for w in graph.successors[vertices[-1]] if _can_turn(graph, motion, came, vertices[-1], w)]
            if not ways:
                break
            there = draw(st.sampled_from(ways))
            depart.append(arrive[-1] + draw(st.integers(0, 4)))
            arrive.append(depart[-1] + int(motion.edge_steps[0, graph.edge_index[vertices[-1], there]]))
            vertices.append(there)
        paths[agv] = Path(agv, tuple(vertices), tuple(arrive), tuple(depart))
    return Walks(graph, motion, paths)


def _can_turn(graph: Graph, motion: Motion, came: int, here: int, there: int) -> bool:
    return motion.turn(graph, came, graph.edge_index[here, there], loaded=False) < NEVER


class LatePlant:
    """AGVs that carry grants out vertex by vertex, whenever the test lets them.

    Where the body needs both vertices while it drives, front and rear are moved one after the other, each as late as
    the test likes. Where following is allowed a granted move is made in the same step.
    """

    def __init__(self, graph: Graph, motion: Motion, starts: Sequence[int]) -> None:
        self.graph, self.motion = graph, motion
        self.way = [[v] for v in starts]
        self.front = [0] * len(starts)
        self.rear = [0] * len(starts)
        self.acting = [0] * len(starts)
        self.visits: dict[int, list[int]] = {}  # who was sent to each vertex, in this order

    def states(self) -> list[AgvState]:
        rows = zip(self.way, self.front, self.rear, self.acting, strict=True)
        return [
            AgvState(i, front, rear, rear == len(way) - 1 and not acting)
            for i, (way, front, rear, acting) in enumerate(rows)
        ]

    def execute(self, command: Advance | Act) -> None:
        if isinstance(command, Act):
            self.acting[command.agv] = command.steps
            return
        way = self.way[command.agv]
        for v in command.vertices:
            assert (way[-1], v) in self.graph.edge_index
            way.append(v)
            self.visits.setdefault(v, []).append(command.agv)

    def step(self, late: Iterable[int] = ()) -> None:
        """Everybody under way gets on by half a move, but for those that are late."""
        before = [way[front] for way, front in zip(self.way, self.front, strict=True)]
        for i in set(range(len(self.way))).difference(late):
            if self.motion.following:
                self.rear[i] = self.front[i] = len(self.way[i]) - 1
            elif self.rear[i] < self.front[i]:
                self.rear[i] += 1
            elif self.front[i] < len(self.way[i]) - 1:
                self.front[i] += 1
            self.acting[i] = max(0, self.acting[i] - 1)
        self._nobody_met(before)

    def _nobody_met(self, before: list[int]) -> None:
        """Bodies reach from the last vertex they may touch to the vertex ahead of their front."""
        ends = [front + 2 for front in self.front]
        bodies = [set(way[rear:end]) for way, rear, end in zip(self.way, self.rear, ends, strict=True)]
        now = [way[front] for way, front in zip(self.way, self.front, strict=True)]
        for i, j in combinations(range(len(self.way)), 2):
            assert bodies[i].isdisjoint(bodies[j]), f"AGVs {i} and {j} are both on {bodies[i] & bodies[j]}"
            assert (before[i], now[i]) != (now[j], before[j]), f"AGVs {i} and {j} passed through each other"


@dataclass
class Drive:
    """An executor and its plant, step by step."""

    executor: Executor
    plant: LatePlant
    step: int = 0
    arrivals: list[list[int]] = field(default_factory=list)

    @classmethod
    def of(cls, graph: Graph, motion: Motion, starts: Sequence[int]) -> Drive:
        executor, plant = Executor(graph, motion, starts), LatePlant(graph, motion, starts)
        return cls(executor, plant, arrivals=[[0] for _ in starts])

    def once(self, late: Iterable[int] = (), busy: Iterable[int] = ()) -> None:
        """One step: ``late`` AGVs get no further, ``busy`` ones start to do something where they stand."""
        ex = self.executor
        ex.update(self.plant.states(), self.step)
        for agv, arrived in enumerate(self.arrivals):
            arrived += [self.step] * (self.plant.front[agv] + 1 - len(arrived))
        for agv in busy:
            if ex.agvs[agv].standing and ex.agvs[agv].acting_until < 0:
                self.plant.execute(ex.act(agv, Action.LIFT, 2, self.step))
        for command in ex.grants(self.step):
            self.plant.execute(command)
        self._one_owner()
        self.plant.step(late)
        self.step += 1

    def run(self, delays: Delays, limit: int = 400) -> None:
        """To the end of all paths; AGVs are late by turns in driving and by being busy."""
        numbers = range(len(self.plant.way))
        for step, digits in enumerate(delays):
            who = [i for i in numbers if digits >> i & 1]
            # where following is allowed a grant is carried out at once: only work delays an AGV
            self.once(busy=who) if self.plant.motion.following or step % 3 == 2 else self.once(late=who)
        while any(a.pending or not a.standing for a in self.executor.agvs):
            assert self.step < limit, "the AGVs never got to the end of their paths"
            self.once()

    def _one_owner(self) -> None:
        """What the executor counts as an AGV's own covers its body."""
        for agv, a in enumerate(self.executor.agvs):
            assert all(self.executor.owner[v] == agv for v in a.trail)
            assert self.plant.way[agv][-1] == a.last
            if not self.plant.motion.following:
                assert set(self.plant.way[agv][self.plant.rear[agv] :]) <= set(a.trail)

    @property
    def ends(self) -> list[int]:
        return [way[-1] for way in self.plant.way]
