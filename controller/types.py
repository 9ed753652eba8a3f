"""The words the controller, the plants and the record share. Everything here is frozen.

Time inside the controller is counted in integer planning *steps*; ``Motion.step_s`` is the one place that says how many
seconds a step lasts (a SUMO step, or one tick of the discrete plant). Seconds carry the suffix ``_s``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import Final, Literal, NewType

import numpy as np
from numpy.typing import NDArray

from sumo_nets.graph import Graph, IntArray
from sumo_nets.numbering import NO_VERTEX, EdgeIndex, Vertex, numbered

#: Number of an AGV, and of its agent in planning: its position in the fleet.
AgvNumber = NewType("AgvNumber", int)
NO_AGV: Final = AgvNumber(-1)

#: Number of a request, and of its task: its position among all requests of the run.
RequestNumber = NewType("RequestNumber", int)
NO_REQUEST: Final = RequestNumber(-1)

#: "For ever": later than any step of a run, small enough to add durations to without overflow of int32.
FOREVER = 1 << 29

#: Added to an AGV's number for the places it still holds on its way to the end of its authority.
TRAIL: Final = 1 << 20

#: Steps of a turn that no AGV makes: so dear that no way with one in it is ever the best.
NEVER = 1 << 20


class AgvMode(StrEnum):
    """The eight states of an AGV (thesis 2025, section III)."""

    IDLE = "idle"
    GOING_TO_PARK = "going_to_park"
    RETURNING_HOME_EMPTY = "returning_home_empty"
    GOING_TO_COLLECT = "going_to_collect"
    RETURNING_WITH_CAR = "returning_with_car"
    GOING_TO_CHARGE = "going_to_charge"
    CHARGING = "charging"
    RETURNING_HOME_MAINTENANCE = "returning_home_maintenance"


class Action(StrEnum):
    """What an AGV can do while it stands."""

    TURN = "turn"
    LIFT = "lift"
    LOWER = "lower"
    CHARGE = "charge"


class RequestKind(StrEnum):
    """What a customer wants."""

    PARK = "park"
    RETRIEVE = "retrieve"


@dataclass(frozen=True, slots=True)
class Request:
    """One customer's wish.

    Attributes:
        time_s: when it is made, seconds from the start of the run.
        kind: park or retrieve.
        car: name of the car; a retrieval asks for this very car.
        zone: name prefix of the slots preferred for this car, or "" for any.
    """

    time_s: float
    kind: RequestKind
    car: str
    zone: str = ""


@dataclass(frozen=True, slots=True)
class AgvState:
    """What the plant sees of one AGV. Counts run over all vertices ever granted to it; its start vertex is number 0.

    Attributes:
        agv: number of the AGV.
        reached: number of the last granted vertex that its front has reached.
        left: number of the first granted vertex that its body may still touch; all before it are free of it.
        standing: it stands at the last granted vertex and no action is under way.
        soc: state of charge of the battery, 0 to 1.
        able: it can take orders; a fault that it reports makes it unable.
    """

    agv: AgvNumber
    reached: int
    left: int
    standing: bool
    soc: float = 1.0
    able: bool = True


@dataclass(frozen=True, eq=False)
class Motion:
    """How long moves take, in planning steps, for empty (row 0) and loaded (row 1) AGVs.

    Attributes:
        step_s: seconds a planning step lasts.
        edge_steps: steps to drive each edge, shape (2, m).
        turn_steps: steps to turn in place between an edge and each edge that leaves its head, shape (2, t);
            the transitions of edge ``e`` start at ``first_transition[e]`` and follow the order of the out-edges.
            Planning counts all the time that a turn costs, stopping and starting included.
        rotation_steps: the part of ``turn_steps`` in which the AGV stands and rotates, same shape.
        first_transition: shape (m + 1,).
        following: True when a vertex may be entered in the very step in which it is left (discrete plant); False
            when the body needs both vertices while it drives (SUMO).
    """

    step_s: float
    edge_steps: IntArray
    turn_steps: IntArray
    rotation_steps: IntArray
    first_transition: IntArray
    following: bool

    def seconds(self, steps: int) -> float:
        """Seconds that ``steps`` last, to the millisecond: SUMO counts in these, and so no error adds up."""
        return round(steps * self.step_s, 3)

    def transition(self, graph: Graph, edge_in: EdgeIndex, edge_out: EdgeIndex) -> int:
        """Column of an edge and a next edge in the turn tables."""
        return int(self.first_transition[edge_in]) + edge_out - int(graph.first_out[graph.head[edge_in]])

    def turn(self, graph: Graph, edge_in: EdgeIndex, edge_out: EdgeIndex, loaded: bool) -> int:
        """Steps to turn from one edge to the next; 0 without an edge to come from (``edge_in`` -1)."""
        return 0 if edge_in < 0 else int(self.turn_steps[int(loaded), self.transition(graph, edge_in, edge_out)])


def whole_steps(seconds: float, step_s: float) -> int:
    """The fewest whole steps that last ``seconds`` or longer."""
    return math.ceil(round(seconds / step_s, 9))


def make_motion(
    graph: Graph,
    step_s: float,
    edge_steps: Callable[[float, bool], int],
    turn_steps: Callable[[float, bool], int],
    following: bool,
    rotation_steps: Callable[[float, bool], int] | None = None,
) -> Motion:
    """Tabulate durations over a graph.

    Args:
        graph: the garage.
        step_s: seconds a planning step lasts.
        edge_steps: steps (at least 1) for an edge of so many metres, loaded or not.
        turn_steps: steps for a turn of so many degrees, loaded or not: 0 to 90, or 180 for a reversal.
        following: see ``Motion``.
        rotation_steps: steps of standing rotation in a turn, same arguments; ``turn_steps`` unless given.

    Returns:
        The tables.
    """
    m = len(graph.tail)
    degree = np.diff(graph.first_out)
    first = np.concatenate(([0], np.cumsum(degree[graph.head]))).astype(np.int32)
    angles = np.zeros(int(first[-1]))
    for e, (_, head) in numbered(graph.ends):
        for k, f in enumerate(graph.out_edges(head), start=int(first[e])):
            turned = 180.0 if f == graph.reverse[e] else round(graph.turn_deg(e, f), 3)
            angles[k] = turned if graph.leads_on(e, f) else np.inf
    kinds, which = np.unique(angles, return_inverse=True)

    def table(steps: Callable[[float, bool], int]) -> IntArray:
        rows = [[NEVER if np.isinf(a) else steps(float(a), loaded) for a in kinds] for loaded in (False, True)]
        return np.array(rows, dtype=np.int32).reshape(2, -1)[:, which].reshape(2, len(angles))

    driving = [[edge_steps(float(x), loaded) for x in graph.length_m] for loaded in (False, True)]
    edges = np.array(driving, dtype=np.int32)
    turns = table(turn_steps)
    rotations = turns if rotation_steps is None else table(rotation_steps)
    return Motion(step_s, edges.reshape(2, m), turns, rotations, first, following)


@dataclass(frozen=True, slots=True)
class Path:
    """One agent's way. ``vertices[0]`` is where it stands at step 0.

    It leaves ``vertices[i]`` at step ``depart[i]`` and its front reaches ``vertices[i + 1]`` at ``arrive[i + 1]``;
    turning happens before the departure. ``vertices[i]`` belongs to it from ``depart[i - 1]`` (``arrive[i]`` when
    following is allowed) until ``arrive[i + 1]``, the last vertex until ``until``.

    Attributes:
        agv: number of the AGV.
        vertices: visited vertices, neighbours in the graph, at least one.
        arrive: step of arrival at each vertex, ``arrive[0]`` is 0.
        depart: step of departure from each vertex but the last.
        until: end of the last vertex's occupation: the window's end, or ``FOREVER`` when it may rest there.

    Example:
        AGV 3 leaves vertex 10 at once, and is at vertex 11 from step 4 on:

        >>> path = Path(AgvNumber(3), (Vertex(10), Vertex(11)), arrive=(0, 4), depart=(0,))
        >>> path.vertices[-1], path.arrive[-1]
        (11, 4)
    """

    agv: AgvNumber
    vertices: tuple[Vertex, ...]
    arrive: tuple[int, ...]
    depart: tuple[int, ...]
    until: int = FOREVER


@dataclass(frozen=True, slots=True)
class PlanAgent:
    """An agent as the planner sees it.

    Attributes:
        agv: number of the AGV.
        vertex: where the authority already granted to it ends: the plan starts there.
        in_edge: edge by which it comes to ``vertex``, -1 at the start of a run (its first move needs no turn).
        ready_step: first step at which it can leave ``vertex`` (it may still drive, turn or lift until then).
        goal: vertex it has to reach; equal to ``vertex`` when it has nothing to do.
        loaded: it carries a car.
        dwell_steps: steps it will stay at the goal (lifting, lowering).
        priority: higher goes first.
        turned_to: vertex it has turned towards already, -1 when it has not.
        avoids_slots: it may not pass through slots, but for its start and goal; heeded by the thesis's planners only.

    Example:
        >>> from controller.planners.contract import random_problem
        >>> agent = random_problem(17).agents[0]
        >>> isinstance(agent, PlanAgent), agent.ready_step >= 0
        (True, True)
    """

    agv: AgvNumber
    vertex: Vertex
    in_edge: EdgeIndex
    ready_step: int
    goal: Vertex
    loaded: bool
    _: KW_ONLY
    dwell_steps: int = 0
    priority: int = 0
    turned_to: Vertex = NO_VERTEX
    avoids_slots: bool = False


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """Everything a planner may know. It never sees the simulator.

    Attributes:
        graph, motion: the garage and how long moves take.
        agents: the agents to plan for.
        fixed: paths of agents that are not to be replanned; plans must keep clear of them.
        blocked: shape (n,), 1 where no AGV may drive (a parked car, a fault); a goal or start is exempt for its
            own agent.
        no_rest: shape (n,), 1 where no agent may come to rest but the one whose goal it is.
        window_steps: planning horizon in steps, ``FOREVER`` for complete paths.
        seed: for planners that draw random numbers.
        carrying: agents whose path in ``fixed`` ends at their goal; a planner of complete paths may give them another.
        carried: what agents to plan for carry out so far, by the clock of now; for planners that keep plans in windows.

    Example:
        A planner by which every AGV keeps its place, asked a random problem:

        >>> from controller.planners.contract import random_problem
        >>> def stay(problem: PlanningProblem) -> PlanResult:
        ...     return PlanResult(Status.PARTIAL, {}, {agent.agv: NO_AGV for agent in problem.agents})
        >>> problem = random_problem(17)
        >>> len(stay(problem).failed) == len(problem.agents)
        True
    """

    graph: Graph
    motion: Motion
    agents: tuple[PlanAgent, ...]
    fixed: tuple[Path, ...]
    blocked: NDArray[np.uint8]
    no_rest: NDArray[np.uint8]
    window_steps: int
    seed: int = 0
    carrying: tuple[PlanAgent, ...] = ()
    carried: tuple[Path, ...] = ()


class Status(StrEnum):
    """How a planning call ended. "No solution" is a status, not an exception.

    Example:
        >>> Status("partial") is Status.PARTIAL
        True
    """

    SOLVED = "solved"
    PARTIAL = "partial"
    INFEASIBLE = "infeasible"
    TIMEOUT = "timeout"


@dataclass(slots=True)
class Counters:
    """Search work, one meaning for every planner.

    Attributes:
        expanded: states taken from an open list and expanded.
        heap_moves: pushes, pops and swaps inside heaps.
        generated: states put on an open list.
        valid: expanded states that were not stale (not reached better before).
        slot_choice: states expanded while choosing a slot, kept apart from ``expanded``.
    """

    expanded: int = 0
    heap_moves: int = 0
    generated: int = 0
    valid: int = 0
    slot_choice: int = 0

    def add(self, other: Counters) -> None:
        """Add another count to this one."""
        self.expanded += other.expanded
        self.heap_moves += other.heap_moves
        self.generated += other.generated
        self.valid += other.valid
        self.slot_choice += other.slot_choice


@dataclass(frozen=True, slots=True)
class PlanResult:
    """A planner's answer.

    Attributes:
        status: SOLVED when every agent has a conflict-free path as far as the window; PARTIAL when some agents only
            hold their place (named in ``failed``); INFEASIBLE or TIMEOUT when there is no plan at all.
        paths: by AGV number; with PARTIAL only of those that got one, agents without one keep their place.
        failed: for each agent without a path the AGV that is in its way, or -1 if unknown.
        counters: search work of this call.
        waits: wait-for edges the planner met while planning, as (AGV that waits, AGV it waits for), one for each
            conflict; empty under planners that keep no wait-for graph of their own.

    Example:
        >>> keeps_place = PlanResult(Status.PARTIAL, {}, failed={AgvNumber(0): NO_AGV})
        >>> keeps_place.failed[AgvNumber(0)]
        -1
    """

    status: Status
    paths: Mapping[AgvNumber, Path]
    failed: Mapping[AgvNumber, AgvNumber] = field(default_factory=dict)
    counters: Counters = field(default_factory=Counters)
    waits: tuple[tuple[AgvNumber, AgvNumber], ...] = ()


#: A planner is anything that answers a problem. Those with search memory are objects with ``__call__``.
Planner = Callable[[PlanningProblem], PlanResult]


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two agents that may not do what they plan.

    Attributes:
        kind: "vertex" (one place, one time), "swap" (one edge, opposite ways) or "following" (a vertex entered
            before the body of the one ahead has left it).
        agents: the two AGV numbers.
        vertex: where; for a swap the vertex the first agent enters.
        step: first step at which they meet.
    """

    kind: Literal["vertex", "swap", "following"]
    agents: tuple[AgvNumber, AgvNumber]
    vertex: Vertex
    step: int


@dataclass(frozen=True, slots=True)
class Advance:
    """Command: drive on to these vertices, granted in this order, and stop at the last."""

    agv: AgvNumber
    vertices: tuple[Vertex, ...]


@dataclass(frozen=True, slots=True)
class Act:
    """Command: do this while standing, for so many steps. ``request`` is whose car is lifted or lowered, -1: none."""

    agv: AgvNumber
    action: Action
    steps: int
    request: RequestNumber = NO_REQUEST


@dataclass(frozen=True, slots=True)
class CallForward:
    """Command: send the customer who waits in the street to this bay's inbound place."""

    request: RequestNumber
    bay: Vertex


@dataclass(frozen=True, slots=True)
class HandOver:
    """Command: a retrieved car stands at the bay's outbound place, its customer gets in."""

    request: RequestNumber
    bay: Vertex


@dataclass(frozen=True, slots=True)
class DriveOff:
    """Command: the customer of a retrieved car leaves the bay's outbound place."""

    request: RequestNumber
    bay: Vertex


Command = Advance | Act | CallForward | HandOver | DriveOff
