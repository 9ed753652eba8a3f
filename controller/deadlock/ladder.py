"""The ladder: how a deadlock is resolved, stage by stage, until there is progress.

Stages, after the thesis (2025, III-4), each over the reservations of everybody outside the group:

1. *partial CBS*: the group's conflicts are searched with bounded effort; every member gets a path to its goal.
2. *leader*: the member of highest priority goes on while the others keep their places.
3. *pull-over*: a leader goes on and the others clear the way, to their goals or to any place where they are in nobody's
   way; every member is tried as the leader, in order of priority.
4. *widen*: whoever cut off the last possibility joins the group, and the stages are tried again.
5. *lacam*: when nobody is left who could join, LaCAM* moves all of the group together, as in a sliding puzzle, where a
   leader has to give way as well before it can go on.

A resolution is a plan whose leader reaches its goal. It is carried out to its end before its members are planned for
again, so that a window cannot undo it. When no stage finds one, or one makes no progress, the deadlock stays open and
the ladder is climbed again with another leader, until its members move on. The thesis's own program lacks this demand
for progress.

An *obstruction* is resolved in the same way, but is not counted as a deadlock: a fault is the reason for it. One of its
members is under tow, or cut off by a fault, and stands in the way of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from controller.deadlock.cut_off import CutOff
from controller.deadlock.waits import Progress, WaitGraph
from controller.executor import Executor
from controller.fleet import Agv
from controller.planners.cbs import CbsLimits, cbs
from controller.planners.lacam import Lacam, LacamOptions
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import FOREVER, NO_AGV, AgvNumber, Log, Path, PlanAgent, PlanningProblem
from controller.visits import retime
from sumo_nets.numbering import NO_VERTEX, Numbered, Vertex


@dataclass(frozen=True, slots=True)
class LadderLimits:
    """Limits of deadlock resolution.

    Attributes:
        patience_steps: a ring of waits must last so long to count as a deadlock.
        stuck_steps: an AGV that came no nearer to its goal for so long is stuck.
        group: partial CBS handles at most so many AGVs.
        cbs: its limits.
        widen: at most so many AGVs may join a group.
        lacam: effort of LaCAM*, when all else has failed.
    """

    patience_steps: int = 20
    stuck_steps: int = 60
    group: int = 5
    cbs: CbsLimits = field(default_factory=CbsLimits)
    widen: int = 12
    lacam: LacamOptions = field(default_factory=lambda: LacamOptions(proposals=2000, improve=0.5))


@dataclass(slots=True)
class Deadlock:
    """A deadlock that is not over yet.

    Attributes:
        kind: "deadlock" or "obstruction".
        number: count of its kind in the run.
        members: AGVs found in it.
        cause: "ring", "idle" or "stuck".
        since: step at which the waiting began.
        stage: the stage whose plan is being carried out, "" while there is none.
        leader, goal, arrived: the AGV whose arrival is the progress, where it goes, and whether it is there.
        locked: AGVs that still carry the plan out.
        moved: last step at which one of them made headway, or at which the ladder was climbed in vain.
        granted: vertices granted to the members when last looked at.
        failures: how often the ladder was climbed in vain; each time another leader is tried first.
    """

    kind: str
    number: int
    members: tuple[AgvNumber, ...]
    cause: str
    since: int
    stage: str = ""
    leader: AgvNumber = NO_AGV
    goal: Vertex = NO_VERTEX
    arrived: bool = False
    locked: set[AgvNumber] = field(default_factory=set)
    moved: int = 0
    granted: int = 0
    failures: int = 0


@dataclass(frozen=True, slots=True)
class Resolution:
    """A plan for a group, and the stage that found it."""

    stage: str
    leader: AgvNumber
    paths: Mapping[AgvNumber, Path]


class Ladder:
    """Finds deadlocks in the wait-for graph and has them resolved.

    Args:
        limits: see ``LadderLimits``.
        executor: takes the plans.
        agvs: the fleet, read only.
        progress: since when each AGV has come no nearer to its goal.
        log: takes events.
    """

    def __init__(
        self, limits: LadderLimits, executor: Executor, agvs: Numbered[AgvNumber, Agv], progress: Progress, log: Log
    ) -> None:
        self._limits = limits
        self._executor = executor
        self._agvs = agvs
        self._progress = progress
        self._log = log
        space = Space(executor.graph, executor.motion)
        self._search = PathSearch(Distances(space))
        self._lacam = Lacam(space, limits.lacam)
        self._table = ReservationTable(len(executor.graph.names), executor.motion.following)
        self._open: list[Deadlock] = []
        self._seen: dict[tuple[AgvNumber, ...], int] = {}
        self._count = {"deadlock": 0, "obstruction": 0}

    @property
    def resolving(self) -> bool:
        """Some deadlock is not over yet."""
        return bool(self._open)

    @property
    def locked(self) -> set[AgvNumber]:
        """AGVs that carry out a resolution and must not be planned for."""
        return {n for d in self._open for n in d.locked}

    def step(self, step: int, waits: WaitGraph, problem: Callable[[], PlanningProblem], cut_off: CutOff) -> None:
        """Look after running resolutions, find new deadlocks and resolve them.

        Args:
            step: now.
            waits: who waits for whom.
            problem: makes the planning problem of this step: blocked vertices, and all AGVs that can move and carry out
                no resolution.
            cut_off: the AGVs that faults keep from their goals.
        """
        waiting = {n for group in (*waits.rings, *waits.blocked_by_idle) for n in group}
        waiting.update(self._progress.stuck(step, self._limits.stuck_steps))
        patience = self._limits.patience_steps
        for deadlock in list(self._open):
            if deadlock.stage:
                self._supervise(deadlock, step)
            elif not waiting.intersection(deadlock.members):
                deadlock.stage, deadlock.leader = "replanned", deadlock.members[0]
                self._close(deadlock, step)
            elif step - deadlock.moved >= patience and not self.locked.intersection(deadlock.members):
                self._resolve(deadlock, step, problem())
        taken = {n for d in self._open for n in (*d.members, *d.locked)}
        for members, cause in self._candidates(step, waits):
            if not taken.intersection(members):
                deadlock = self._found(self._kind(members, cut_off), members, cause, step, waits)
                self._open.append(deadlock)
                self._resolve(deadlock, step, problem())
                taken.update(deadlock.members, deadlock.locked)

    # --- finding --------------------------------------------------------------------------------------------------

    def _candidates(self, step: int, waits: WaitGraph) -> list[tuple[tuple[AgvNumber, ...], str]]:
        """Groups that have stopped for long enough, with the cause."""
        patterns = [(ring, "ring") for ring in waits.rings] + [(chain, "idle") for chain in waits.blocked_by_idle]
        self._seen = {members: self._seen.get(members, step) for members, _ in patterns}
        found = [(m, cause) for m, cause in patterns if step - self._seen[m] >= self._limits.patience_steps]
        taken = {n for members, _ in found for n in members}
        for n in self._progress.stuck(step, self._limits.stuck_steps):
            line = self._waiting_line(n, waits)
            if n not in taken and not (len(line) > 1 and self._moves(line[-1])):
                found.append((line, "stuck"))
        return found

    def _moves(self, n: AgvNumber) -> bool:
        """It drives, acts or is broken, so that those behind it stand in a queue and in no deadlock."""
        return not self._executor.agvs[n].standing or self._agvs[n].immobile

    @staticmethod
    def _waiting_line(first: AgvNumber, waits: WaitGraph) -> tuple[AgvNumber, ...]:
        line = [first]
        while line[-1] in waits.edges and waits.edges[line[-1]] not in line:
            line.append(waits.edges[line[-1]])
        return tuple(line)

    def _kind(self, members: tuple[AgvNumber, ...], cut_off: CutOff) -> str:
        held = cut_off.by_fault | cut_off.barred
        return "obstruction" if any(n in held or self._agvs[n].off_duty for n in members) else "deadlock"

    def _found(self, kind: str, members: tuple[AgvNumber, ...], cause: str, step: int, waits: WaitGraph) -> Deadlock:
        since = self._seen.get(members, step - self._limits.stuck_steps)
        deadlock = Deadlock(kind, self._count[kind], members, cause, since)
        self._count[kind] += 1
        wants = {n: self._executor.graph.names[waits.vertices[n]] for n in members if n in waits.vertices}
        waits_for = {n: waits.edges[n] for n in members if n in waits.edges}
        vertex = waits.vertices.get(members[0], NO_VERTEX)
        names, ex = self._executor.graph.names, self._executor
        detail: dict[str, object] = {
            kind: deadlock.number,
            "members": members,
            "cause": cause,
            "waits": waits_for,
            "wants": wants,
            "holds": {n: [names[v] for v in ex.agvs[n].trail] for n in members},
            "goals": {n: names[self._agvs[n].goal] for n in members},
            "since_s": since * ex.motion.step_s,
        }
        self._log(f"{kind}_found", members[0], "", vertex, detail)
        return deadlock

    # --- carrying out ---------------------------------------------------------------------------------------------

    def _supervise(self, deadlock: Deadlock, step: int) -> None:
        """Unlock who is through; close the deadlock when its leader is there; give up what makes no headway."""
        ex = self._executor
        granted = sum(ex.agvs[n].granted for n in deadlock.members)
        busy = any(not ex.agvs[n].standing for n in deadlock.locked)
        if granted != deadlock.granted or busy:
            deadlock.granted, deadlock.moved = granted, step
        through = {n for n in deadlock.locked if not ex.agvs[n].pending}
        if deadlock.leader in through:
            deadlock.arrived = ex.agvs[deadlock.leader].last == deadlock.goal
        deadlock.locked -= through
        if not deadlock.locked and deadlock.arrived:
            self._close(deadlock, step)
        elif not deadlock.locked:
            self._failed(deadlock, deadlock.stage, "the plan was cut short")
            self._give_up(deadlock, step)
        elif step - deadlock.moved >= 3 * self._limits.patience_steps:
            self._failed(deadlock, deadlock.stage, "the plan made no progress")
            self._give_up(deadlock, step)

    @staticmethod
    def _give_up(deadlock: Deadlock, step: int) -> None:
        deadlock.stage = ""
        deadlock.locked = set()
        deadlock.moved = step
        deadlock.failures += 1

    def _close(self, deadlock: Deadlock, step: int) -> None:
        self._open.remove(deadlock)
        detail = {
            deadlock.kind: deadlock.number,
            "members": deadlock.members,
            "cause": deadlock.cause,
            "stage": deadlock.stage,
            "cost_s": self._executor.motion.seconds(step - deadlock.since),
        }
        self._log(f"{deadlock.kind}_resolved", deadlock.leader, "", NO_VERTEX, detail)

    def _failed(self, deadlock: Deadlock, stage: str, reason: str) -> None:
        if deadlock.kind == "obstruction":
            return
        detail = {"deadlock": deadlock.number, "stage": stage, "reason": reason}
        self._log("stage_failed", deadlock.members[0], "", NO_VERTEX, detail)

    # --- resolving ------------------------------------------------------------------------------------------------

    def _resolve(self, deadlock: Deadlock, step: int, problem: PlanningProblem) -> None:
        agents = {a.agv: a for a in problem.agents}
        group = [n for n in deadlock.members if n in agents]
        while group:
            outside = self._outside(group, step, problem)
            whole = replace(problem, fixed=tuple(outside), window_steps=FOREVER)
            resolution, blockers = self._stages(deadlock, [agents[n] for n in group], whole)
            if resolution and self._take(deadlock, resolution, outside, step):
                return
            joining = sorted((blockers & agents.keys()) - set(group))
            if not joining or len(group) + len(joining) > self._limits.widen:
                joining = [n for n in agents if n not in group] if len(group) < len(agents) else []
            if not joining:
                self._failed(deadlock, "widen", "nobody else can join")
                together = self._together(deadlock, [agents[n] for n in group], whole)
                if not (together and self._take(deadlock, together, outside, step)):
                    self._give_up(deadlock, step)
                return
            group += joining

    def _outside(self, group: Iterable[AgvNumber], step: int, problem: PlanningProblem) -> list[Path]:
        """Paths of everybody outside the group, as the accepted orders have them."""
        timed = retime(self._executor, step)
        inside = set(group)
        trails = [p for p in problem.fixed if p.agv not in timed]
        return trails + [path for n, path in timed.items() if n not in inside]

    def _stages(
        self, deadlock: Deadlock, group: list[PlanAgent], problem: PlanningProblem
    ) -> tuple[Resolution | None, set[AgvNumber]]:
        blockers: set[AgvNumber] = set()
        by_priority = sorted(group, key=lambda a: (-a.priority, a.agv))
        movers = [a for a in by_priority if a.goal != a.vertex]
        shift = deadlock.failures % len(movers) if movers else 0
        movers = movers[shift:] + movers[:shift]
        if 2 <= len(group) <= self._limits.group:
            result = cbs(replace(problem, agents=tuple(group)), self._limits.cbs)
            if len(result.paths) == len(group):
                return Resolution("partial_cbs", movers[0].agv if movers else group[0].agv, result.paths), blockers
            self._failed(deadlock, "partial_cbs", result.status.value)
        self._search.begin(problem)
        for stage, attempt in (("leader", self._leader), ("pull_over", self._pull_over)):
            for leader in movers:
                paths = attempt(leader, by_priority, problem, blockers)
                if paths:
                    return Resolution(stage, leader.agv, paths), blockers
            self._failed(deadlock, stage, "no way for any leader")
        return None, blockers

    def _together(self, deadlock: Deadlock, group: list[PlanAgent], problem: PlanningProblem) -> Resolution | None:
        """All move together until as many as possible are at their goals."""
        result = self._lacam.resolve(replace(problem, agents=tuple(group)))
        there = [a for a in group if a.agv in result.paths and a.goal != a.vertex and a.agv not in result.failed]
        if not there:
            self._failed(deadlock, "lacam", result.status.value)
            return None
        leader = max(there, key=lambda a: (a.priority, -a.agv))
        return Resolution("lacam", leader.agv, result.paths)

    def _leader(
        self, leader: PlanAgent, group: list[PlanAgent], problem: PlanningProblem, blockers: set[AgvNumber]
    ) -> dict[AgvNumber, Path] | None:
        """The leader goes on, the others keep their places."""
        self._table.reset(problem.fixed)
        for agent in group:
            if agent is not leader:
                self._table.hold(agent.vertex, 0, FOREVER, agent.agv)
        path = self._search.find_path(problem, leader, self._table)
        if path is None:
            blockers.add(self._search.blocker)
            return None
        return {leader.agv: path, **{a.agv: Path(a.agv, (a.vertex,), (0,), ()) for a in group if a is not leader}}

    def _pull_over(
        self, leader: PlanAgent, group: list[PlanAgent], problem: PlanningProblem, blockers: set[AgvNumber]
    ) -> dict[AgvNumber, Path] | None:
        """The leader goes on, the others clear its way: to their goals if they can, else out of the way."""
        order = [leader] + [a for a in group if a is not leader]
        for _ in range(2 * len(group)):
            paths, failed = self._plan_in_order(order, problem)
            if failed is None:
                return paths
            blockers.add(self._search.blocker)
            if failed is leader or order.index(failed) == 1:
                return None
            order.remove(failed)
            order.insert(1, failed)
        return None

    def _plan_in_order(
        self, order: list[PlanAgent], problem: PlanningProblem
    ) -> tuple[dict[AgvNumber, Path], PlanAgent | None]:
        self._table.reset(problem.fixed)
        motion, graph = problem.motion, problem.graph
        for a in order:
            out = graph.out_edges(a.vertex)
            least = min((motion.turn(graph, a.in_edge, e, a.loaded) + int(motion.edge_steps[int(a.loaded), e])
                         for e in out), default=1)  # fmt: skip
            self._table.hold(a.vertex, 0, a.ready_step + least, a.agv)
        paths: dict[AgvNumber, Path] = {}
        for a in order:
            self._table.remove(a.agv)
            path = self._search.find_path(problem, a, self._table)
            if path is None and a is not order[0]:
                path = self._search.find_refuge(problem, a, self._table)
            if path is None:
                return paths, a
            paths[a.agv] = path
            self._table.add(path)
        return paths, None

    def _take(self, deadlock: Deadlock, resolution: Resolution, outside: Sequence[Path], step: int) -> bool:
        ex = self._executor
        keep = {p.agv: p for p in outside if p.agv < len(ex.agvs)}
        refusal = ex.accept({**keep, **resolution.paths})
        if refusal:
            self._failed(deadlock, resolution.stage, refusal.reason)
            return False
        deadlock.stage, deadlock.leader = resolution.stage, resolution.leader
        way = resolution.paths[resolution.leader].vertices
        deadlock.goal, deadlock.arrived = way[-1], len(way) == 1
        deadlock.locked = {n for n, path in resolution.paths.items() if len(path.vertices) > 1}
        deadlock.moved, deadlock.granted = step, 0
        return True
