"""Plants: what carries the controller's commands out. One in SUMO, one in discrete ticks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from analysis.record import AgvSample
from controller.faults import FaultReport
from controller.types import AgvNumber, AgvState, Command, Motion, RequestNumber
from sumo_nets.graph import Graph
from sumo_nets.numbering import Numbered, Vertex

if TYPE_CHECKING:
    from parking_sim.footprint import Bodies


@dataclass(frozen=True, slots=True)
class CarAtBay:
    """The car of a customer stands at a bay's inbound place."""

    request: RequestNumber
    bay: Vertex


@dataclass(frozen=True, slots=True)
class CarLeft:
    """A retrieved car has left the garage and its bay's outbound place is free."""

    request: RequestNumber
    bay: Vertex


PlantEvent = CarAtBay | CarLeft | FaultReport


@dataclass(frozen=True, slots=True)
class StreetState:
    """Customers who wait.

    Attributes:
        queued: cars that stand on the queue edge.
        spilled: cars that stand on the street before it, or have found no room there yet.
    """

    queued: int
    spilled: int


class Plant(Protocol):
    """The seam between the simulation loop and the world.

    A step of the loop: ``states`` and ``events`` are read, commands are given to ``execute``, ``step`` runs.
    """

    graph: Graph
    motion: Motion

    @property
    def battery_wh(self) -> float:
        """Capacity of an AGV's battery; 0 in a plant that counts no energy."""

    @property
    def collisions(self) -> int:
        """Collisions that SUMO has reported."""

    @property
    def sumo_s(self) -> float:
        """Wall-clock seconds that SUMO has taken for its own steps."""

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""

    def states(self) -> Numbered[AgvNumber, AgvState]:
        """One state for each AGV, in their order."""

    def events(self) -> Sequence[PlantEvent]:
        """What happened with customers' cars in the last step, and which faults began or ended."""

    def arrive(self, request: RequestNumber) -> None:
        """A customer comes to the garage and joins the queue in the street."""

    def execute(self, command: Command) -> None:
        """Carry out one command."""

    def step(self) -> None:
        """Advance the world by one step of ``motion.step_s`` seconds."""

    def samples(self) -> Sequence[AgvSample]:
        """Where each AGV is now."""

    def street(self) -> StreetState | None:
        """Customers waiting in the street now; None in a plant that has no street."""

    def bodies(self) -> Bodies | None:
        """All AGVs as rectangles; None in a plant where they have no bodies."""

    def ending(self, before_s: float) -> frozenset[int]:
        """Numbers of the faults under way that end before a time in seconds; none in a plant without faults."""

    def still(self, before_s: float) -> frozenset[AgvNumber] | None:
        """AGVs that faults keep from moving until a time.

        Args:
            before_s: the time, seconds.

        Returns:
            Their numbers, none in a plant without faults; None if a fault may begin or end before that time, or a
            command is on its way.
        """

    def close(self) -> None:
        """Release what the plant holds; safe to call twice."""
