"""A plant without SUMO: one cell a tick. For tests and for comparison with published grid results."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.record import AgvSample
from controller.types import (
    Act,
    Action,
    Advance,
    AgvNumber,
    AgvState,
    CallForward,
    Command,
    DriveOff,
    Motion,
    RequestNumber,
)
from parking_sim.plants import CarAtBay, CarLeft, PlantEvent
from parking_sim.rulesets import CHARGE_BELOW
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_VERTEX, Numbered, NumberedList, Vertex, numbered, numbers


class DiscretePlant:
    """AGVs jump from vertex to vertex, one edge a tick; customers take no time.

    Args:
        graph, motion: the garage and the ticks of its moves (all edges 1, following allowed).
        starts: start vertex of each AGV.
        charge_after_cells: cells after which the state of charge has fallen to where charging is due.
    """

    def __init__(
        self, graph: Graph, motion: Motion, starts: Numbered[AgvNumber, Vertex], charge_after_cells: int
    ) -> None:
        self.graph = graph
        self.motion = motion
        self.at: NumberedList[AgvNumber, Vertex] = list(starts)
        self._heading: NumberedList[AgvNumber, float] = [0.0] * len(starts)
        self._count: NumberedList[AgvNumber, int] = [0] * len(starts)
        self._target: NumberedList[AgvNumber, Vertex] = [NO_VERTEX] * len(starts)
        self._timer: NumberedList[AgvNumber, int] = [0] * len(starts)
        self._action: NumberedList[AgvNumber, Action | None] = list[Action | None]([None]) * len(starts)
        self._cells: NumberedList[AgvNumber, float] = [0.0] * len(starts)
        self._held: NumberedList[AgvNumber, bool] = [False] * len(starts)
        self._charge_after = charge_after_cells
        self._events: list[PlantEvent] = []
        self._next: list[PlantEvent] = []
        self.time_s = 0.0
        self.battery_wh, self.collisions, self.sumo_s = 0.0, 0, 0.0  # nothing of what SUMO has

    def states(self) -> Numbered[AgvNumber, AgvState]:
        """One state for each AGV, in their order."""
        rows = zip(self._count, self._timer, self._cells, strict=True)
        return [
            AgvState(i, n, n, t == 0, self._soc(cells)) for i, (n, t, cells) in zip(numbers(self.at), rows, strict=True)
        ]

    def _soc(self, cells: float) -> float:
        return round(1.0 - (1.0 - CHARGE_BELOW) * cells / self._charge_after, 9)

    def events(self) -> Sequence[PlantEvent]:
        """What happened with customers' cars in the last tick."""
        return self._events

    def arrive(self, request: RequestNumber) -> None:
        """A customer comes; without a street there is no queue to join."""

    def execute(self, command: Command) -> None:
        """Carry out one command.

        Raises:
            ValueError: an AGV is told to drive more than one edge a tick, where there is none, or while it acts.
        """
        if isinstance(command, Advance):
            self._advance(command)
        elif isinstance(command, Act):
            self._timer[command.agv] = command.steps
            self._action[command.agv] = command.action
        elif isinstance(command, CallForward):
            self._next.append(CarAtBay(command.request, command.bay))
        elif isinstance(command, DriveOff):
            self._next.append(CarLeft(command.request, command.bay))

    def _advance(self, command: Advance) -> None:
        agv = command.agv
        (vertex,) = command.vertices
        if self._target[agv] >= 0 or self._timer[agv] or (self.at[agv], vertex) not in self.graph.edge_index:
            names = self.graph.names
            raise ValueError(f"AGV {agv} can't move from {names[self.at[agv]]} to {names[vertex]}")
        self._target[agv] = vertex

    def step(self) -> None:
        """One tick: granted moves are made, actions go on."""
        for agv, target in numbered(self._target):
            if target >= 0:
                edge = self.graph.edge_index[self.at[agv], target]
                self._heading[agv] = float(self.graph.heading_deg[edge])
                self.at[agv] = target
                self._target[agv] = NO_VERTEX
                self._count[agv] += 1
                self._cells[agv] += 1
            elif self._timer[agv] and not self._held[agv]:
                self._timer[agv] -= 1
                if self._timer[agv] == 0 and self._action[agv] is Action.CHARGE:
                    self._cells[agv] = 0
        self._events, self._next = self._next, []
        self.time_s += self.motion.step_s

    def hold(self, agv: AgvNumber, held: bool) -> None:
        """Stop what an AGV does while it stands, or let it go on; a move already granted is made in any case."""
        self._held[agv] = held

    def limit(self, agv: AgvNumber, share: float) -> None:
        """Nothing: each move takes a tick, and a slower AGV waits before it."""

    def set_soc(self, agv: AgvNumber, soc: float) -> None:
        """Set the state of charge of an AGV's battery, 0 to 1."""
        self._cells[agv] = (1.0 - soc) / (1.0 - CHARGE_BELOW) * self._charge_after

    def street(self) -> None:
        """None: nobody drives up."""

    def bodies(self) -> None:
        """None: an AGV is a cell."""

    def samples(self) -> Sequence[AgvSample]:
        """Where each AGV is now."""
        xy = self.graph.xy
        return [AgvSample(i, float(xy[v, 0]), float(xy[v, 1]), self._heading[i], 0.0) for i, v in numbered(self.at)]

    def ending(self, before_s: float) -> frozenset[int]:
        """No fault: there are none in this plant."""
        return frozenset()

    def still(self, before_s: float) -> frozenset[AgvNumber]:
        """No AGV: no fault keeps one from moving."""
        return frozenset()

    def close(self) -> None:
        """Nothing to release."""
