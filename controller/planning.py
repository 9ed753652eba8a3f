"""When to plan, what to plan, and the window: the slow clock of the ACS."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from controller.costs import Costs
from controller.deadlock.cut_off import find_cut_off
from controller.deadlock.ladder import Ladder, LadderLimits
from controller.deadlock.waits import Headway, wait_graph
from controller.events import Event, Log
from controller.executor import Executor
from controller.flags import flags_of
from controller.fleet import Agv, StuckBoost, priority
from controller.reordering import reorder
from controller.replanning import anybody_stands, waits_ahead, without_plan
from controller.retiming import retime
from controller.rules import Rules
from controller.types import (
    FOREVER,
    TRAIL,
    AgvMode,
    AgvNumber,
    Counters,
    Path,
    PlanAgent,
    Planner,
    PlanningProblem,
    PlanResult,
    Status,
)
from controller.visits import Barred
from controller.window import Window, WindowRange, WindowRule, count_sccs
from sumo_nets.numbering import Numbered, Vertex, numbered

Mask = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ControlOptions:
    """Clock, window and limits. The windows and limits are the thesis's (papers cited in the planners).

    Attributes:
        period_steps: replanning period.
        replanning: when to plan: "periodic" is every period and for a new goal; "events" is for a new goal, a predicted
            collision, a plan that has come to its end, and a time-out of AGVs that stand; "both" is all of these.
        look_ahead_steps: how far ahead collisions are predicted.
        timeout_steps: plan after so long while an AGV stands that has somewhere to go.
        watch_steps: how often events and orders are looked at.
        reorder: let AGVs that wait for a late one go first where that pays.
        window_cells, window_min, window_max: the planning window at the start, the least and the greatest one, in moves
            of ``Rules.cell_steps``; None for the planner's own, which gives way to those that are given. Planners of
            complete paths have no window.
        window: how the window adapts between these.
        boost: how far waiting raises an AGV's priority.
        ladder: limits of deadlock resolution.
        adapt_boost, adapt_cbs: how many times the boost, and the group and effort of partial CBS in the ladder, at the
            full level of traffic; in between in proportion. See ``window``.
    """

    period_steps: int
    replanning: str = "periodic"
    look_ahead_steps: int = 16
    timeout_steps: int = 10
    watch_steps: int = 2
    reorder: bool = False
    window_cells: int | None = None
    window_min: int | None = None
    window_max: int | None = None
    window: WindowRule = field(default_factory=WindowRule)
    boost: StuckBoost = field(default_factory=StuckBoost)
    ladder: LadderLimits = field(default_factory=LadderLimits)
    adapt_boost: float = 1.0
    adapt_cbs: float = 1.0


@dataclass(frozen=True, slots=True)
class PlanningCall:
    """One planning call, for the record. ``wall_s`` is the only value that differs between equal runs.

    ``window_cells`` is 0 for complete paths; ``wait_edges`` and ``rings`` (components of two or more) are those of the
    conflicts that the planner met, or, under planners that meet none, of the AGVs that really wait; ``score`` is the
    congestion score after them.
    """

    step: int
    agents: int
    status: Status
    window_steps: int
    counters: Counters
    wall_s: float
    window_cells: int = 0
    score: int = 0
    wait_edges: int = 0
    rings: int = 0


class Planning:
    """Builds planning problems, hands plans to the executor and has deadlocks resolved.

    Args:
        planner: answers planning problems.
        options: clock, window, limits.
        agvs: the fleet, read only.
        executor: takes the plans.
        rules: gives the steps of a move.
        costs: driving costs, shared with dispatch.
        log: takes events.
        clock: wall-clock seconds, for the record alone.

    Attributes:
        flags: what the planner says of itself.
        calls: planning calls since they were last taken.
        counters: search work of the whole run.
        slot_choice: vertices expanded for assignments since the last call; the next call's counters take them.
    """

    def __init__(
        self,
        planner: Planner,
        options: ControlOptions,
        agvs: Numbered[AgvNumber, Agv],
        executor: Executor,
        rules: Rules,
        costs: Costs,
        log: Log,
        clock: Callable[[], float],
    ) -> None:
        self._planner = planner
        self._clock = clock
        self.flags = flags_of(planner)
        self._options = options
        self._agvs = agvs
        self._executor = executor
        self._rules = rules
        self._costs = costs
        self._log = log
        self._progress = Headway(executor, agvs, costs, self.flags.complete)
        self._ladder = Ladder(options.ladder, executor, agvs, self._progress, log)
        self._window = Window(_moves(self.flags.window, options), options.window)
        self._raise()
        self._last = -options.period_steps
        self._changed = True
        self._expected: frozenset[tuple[AgvNumber, Vertex]] = frozenset()
        self._ended: frozenset[AgvNumber] = frozenset()
        self._meeting: frozenset[AgvNumber] = frozenset()
        self.calls: list[PlanningCall] = []
        self.counters = Counters()
        self.slot_choice = 0

    @property
    def resolving(self) -> bool:
        """Some deadlock is not over yet."""
        return self._ladder.resolving

    def take_calls(self) -> list[PlanningCall]:
        """The planning calls since this was last asked."""
        calls, self.calls = self.calls, []
        return calls

    def goal_changed(self) -> None:
        """An AGV has a new goal: plan in this step."""
        self._changed = True

    def step(self, step: int, blocked: Mask, no_rest: Callable[[], Mask]) -> None:
        """Plan if it is due.

        Args:
            step: now.
            blocked: vertices where no AGV may drive, shape (n,).
            no_rest: makes the mask of vertices where an AGV may rest only if the vertex is its goal.
        """
        if self._options.reorder and step % self._options.watch_steps == 0:
            self._reorder(step)
        if not self._due(step):
            return
        self._last = step
        if not (self._changed or self._under_way()):
            return
        self._changed = False
        problem = self._problem(step, blocked, no_rest())
        start = self._clock()
        result = self._planner(problem)
        result.counters.slot_choice, self.slot_choice = self.slot_choice, 0
        self._take(step, problem, result)
        met = self._watch(step, problem) if self._rules.resolve_deadlocks else (0, 0)
        if self.flags.meets_conflicts:
            met = len(result.waits), count_sccs(result.waits)
        window = self._window.cells
        self._adapt(*met)
        wall_s = self._clock() - start
        if self._options.replanning != "periodic":
            self._expect(step)
        self.calls.append(
            PlanningCall(
                step=step,
                agents=len(problem.agents),
                status=result.status,
                window_steps=problem.window_steps,
                counters=result.counters,
                wall_s=wall_s,
                window_cells=0 if self.flags.complete else window,
                score=self._window.score,
                wait_edges=met[0],
                rings=met[1],
            )
        )
        self.counters.add(result.counters)

    def _due(self, step: int) -> bool:
        """An event or the clock asks for a plan."""
        o = self._options
        if self._changed or (o.replanning != "events" and step - self._last >= o.period_steps):
            return True
        if o.replanning == "periodic" or step % o.watch_steps:
            return False
        waits = waits_ahead(self._executor, step, o.look_ahead_steps, self._rules.cell_steps)
        self._meeting = frozenset(agv for agv, _ in waits - self._expected)
        ended = without_plan(self._executor, self._agvs)
        timeout = step - self._last >= o.timeout_steps and anybody_stands(self._executor, self._agvs)
        return bool(self._meeting or ended - self._ended or timeout)

    def _expect(self, step: int) -> None:
        """Take note of what the plan has in it: it is no event when it comes."""
        self._expected = waits_ahead(self._executor, step, FOREVER, self._rules.cell_steps)
        self._ended = without_plan(self._executor, self._agvs)
        self._meeting = frozenset()

    def _reorder(self, step: int) -> None:
        cell = self._rules.cell_steps
        for first, behind, gain in reorder(self._executor, step, cell, self._ladder.locked):
            detail = {"before": behind, "gain_moves": round(gain / cell, 2)}
            self._log(Event("reordered", first, detail=detail))

    def _under_way(self) -> bool:
        if self._ladder.resolving:
            return True
        if self.flags.complete:
            return bool(self._to_plan())
        return any(agv.goal != a.last or a.pending for agv, a in zip(self._agvs, self._executor.agvs, strict=True))

    def _to_plan(self) -> list[Agv]:
        """AGVs to plan for: with complete paths those whose path does not end at their goal, else all that can."""
        locked = self._ladder.locked
        free = [agv for agv in self._agvs if agv.number not in locked and not agv.immobile]
        if not self.flags.complete:
            return free
        ends: Numbered[AgvNumber, Vertex] = [a.pending[-1] if a.pending else a.last for a in self._executor.agvs]
        return [agv for agv in free if ends[agv.number] != agv.heads_for or agv.number in self._meeting]

    def _problem(self, step: int, blocked: Mask, no_rest: Mask) -> PlanningProblem:
        ex, locked = self._executor, self._ladder.locked
        immobile = {agv.number for agv in self._agvs if agv.immobile}
        fixed = trails(ex, step, immobile)
        window = FOREVER if self.flags.complete else self._window.cells * self._rules.cell_steps
        asked = self._to_plan()
        carried: tuple[Path, ...] = ()
        if locked or immobile or self.flags.complete or self.flags.keeps:
            # an AGV that rests at the end of a window goes on in the next one: its way does not end there
            leaving = {} if self.flags.complete else {agv.number: window for agv in self._agvs}
            timed = retime(ex, step, {n: t for n, t in leaving.items() if n not in locked | immobile})
            fixed += [path for n, path in timed.items() if self.flags.complete or n in locked or n in immobile]
            carried = tuple(timed[agv.number] for agv in asked) if self.flags.keeps else ()
        agents = tuple(self._agent(agv, step) for agv in asked)
        carrying: tuple[PlanAgent, ...] = ()
        if self.flags.improves:
            given = {*locked, *(agent.agv for agent in agents)}
            carrying = tuple(self._agent(agv, step) for agv in self._agvs if agv.number not in given | immobile)
        return PlanningProblem(
            ex.graph, ex.motion, agents, tuple(fixed), blocked, no_rest, window, carrying=carrying, carried=carried
        )

    def _agent(self, agv: Agv, step: int) -> PlanAgent:
        a = self._executor.agvs[agv.number]
        stuck = 0
        if a.standing and a.acting_until < 0 and agv.goal != a.last:
            stuck = (step - a.since) // self._rules.cell_steps
        ready = self._executor.ready_step(agv.number, step)
        dwell = self._rules.lift_bay
        goal = a.last if agv.heads_for in self._executor.closed else agv.heads_for
        rank = priority(agv, stuck, self._boost)
        avoids = self._rules.empty_avoid_slots and agv.mode is AgvMode.RETURNING_HOME_EMPTY
        return PlanAgent(
            agv=agv.number,
            vertex=a.last,
            in_edge=a.in_edge,
            ready_step=ready,
            goal=goal,
            loaded=a.leaves_loaded,
            dwell_steps=dwell,
            priority=rank,
            turned_to=a.turned_to,
            avoids_slots=avoids,
        )

    def _take(self, step: int, problem: PlanningProblem, result: PlanResult) -> None:
        paths = {path.agv: path for path in problem.fixed if path.agv < TRAIL} | dict(result.paths)
        goals = {agent.agv: agent.goal for agent in (*problem.carrying, *problem.agents) if agent.agv in result.paths}
        refusal = self._executor.accept(paths, Barred(problem.blocked, goals))
        if refusal:
            detail = {"reason": refusal.reason}
            self._log(Event("plan_rejected", refusal.agents[0], vertex=refusal.vertex, detail=detail))
        elif result.failed:
            self._log(Event("plan_partial", detail={"failed": sorted(result.failed)}))

    def _watch(self, step: int, problem: PlanningProblem) -> tuple[int, int]:
        """Have deadlocks among AGVs that really wait resolved; return how many wait, and in how many rings."""
        waits = wait_graph(self._executor, self._agvs, self._costs, self._ladder.locked)
        cut_off = find_cut_off(self._executor, self._agvs, self._costs, problem.blocked)
        self._progress.update(step, cut_off.by_fault | self._ladder.concerned)
        self._ladder.step(step, waits, lambda: self._whole(step, problem), cut_off)
        return len(waits.edges), len(waits.rings)

    def _whole(self, step: int, problem: PlanningProblem) -> PlanningProblem:
        """The problem for the ladder: all AGVs that can move, whatever the planner was given."""
        locked = self._ladder.locked
        free = (agv for agv in self._agvs if agv.number not in locked and not agv.immobile)
        return replace(problem, agents=tuple(self._agent(agv, step) for agv in free), carrying=())

    def _adapt(self, edges: int, rings: int) -> None:
        """Let the window, and with it boost and CBS, follow the conflicts that the planner met, or the traffic."""
        if self.flags.meets_conflicts:
            self._window.take_conflicts(edges, rings)
        else:
            under_way = sum(agv.goal != a.last for agv, a in zip(self._agvs, self._executor.agvs, strict=True))
            self._window.take_traffic(under_way, len(self._agvs), self._ladder.resolving)
        self._raise()

    def _raise(self) -> None:
        """Let boost and partial CBS follow the level."""
        o, level = self._options, self._window.level
        self._boost = o.boost.raised(1 + level * (o.adapt_boost - 1))
        self._ladder.limits = o.ladder.raised(1 + level * (o.adapt_cbs - 1))


def _moves(own: WindowRange, options: ControlOptions) -> WindowRange:
    """The range of the window: what is given, and the planner's own as far as that agrees with it."""
    start, least, most = options.window_cells, options.window_min, options.window_max
    given = [moves for moves in (start, least, most) if moves is not None]
    if least is None:
        least = min(own.least, *given) if given else own.least
    if most is None:
        most = max(own.most, *given) if given else own.most
    return WindowRange(min(max(own.start, least), most) if start is None else start, least, most)


def trails(executor: Executor, step: int, immobile: Collection[AgvNumber] = ()) -> list[Path]:
    """What moving AGVs still hold before the end of their authority, as places that others must keep clear of.

    They stand under numbers of their own (``TRAIL`` + AGV), since the AGV's own path starts where its authority ends.
    AGVs that are ``immobile`` keep all of it for ever.
    """
    paths = []
    for agv, a in numbered(executor.agvs):
        if len(a.trail) > 1:
            held = list(zip(a.trail, executor.leave_steps(agv, step), strict=True))[:-1]
            stays = agv in immobile
            paths += [Path(AgvNumber(TRAIL + agv), (v,), (0,), (), FOREVER if stays else until) for v, until in held]
    return paths
