"""The ladder: how a deadlock is resolved, stage by stage, until there is progress.

Stages, after the thesis (2025, III-4), each over the reservations of all AGVs outside the group:

1. *partial CBS*: the group's conflicts are searched with bounded effort; every member gets a path to its goal.
2. *leader*: the member of highest priority goes on while the others keep their places.
3. *pull-over*: a leader goes on and the others clear the way, to their goals or to any place where they are in no AGV's
   way; every member is tried as the leader, in order of priority.
4. *widen*: the AGV that cut off the last possibility joins the group, and the stages are tried again.
5. *lacam*: when no AGV is left that could join, LaCAM* moves all of the group together, as in a sliding puzzle, where a
   leader has to give way as well before it can go on. Where it finds no plan that brings all to their goals, one is
   looked for that brings a leader to its own. After a climb in vain it may search for four times as long,
   up to 256 times (but for an obstruction, where the fault ends by itself); then the time to the next climb doubles.
   Where the search has shown that moves which are no rings cannot help, the deadlock is left alone until an AGV, a goal
   or a closed place changes.
6. *homes*: AGVs without a task exchange homes, and LaCAM* moves the group together. That is the way out where AGVs have
   passed each other in a slot that was empty, and parked cars now keep them from passing each other back.

A resolution counts only if it is progress that nothing can undo: its leader is an AGV that has not been at its goal
since the goal was set, and it arrives there. An AGV that was pushed off its goal does not lead while there is another
one; if there is none, a plan counts that brings the whole group to its goals. A resolution is carried out to its end
before its members are planned for again, so that a window cannot undo it, and an AGV that stands aside stays there
until the others have passed. A stage whose plan was carried out in vain is left out the next time. When no stage is
left, the deadlock stays open and the ladder is climbed again with another leader, until its members move on. The
thesis's own program lacks this demand for progress.

An *obstruction* is resolved in the same way, but is not counted as a deadlock: a fault is the reason for it. One of its
members is under tow, or cut off by a fault, and stands in the way of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, permutations
from operator import ne

from controller.deadlock.case import Deadlock, DeadlockCause, DeadlockKind, Resolution, Stage, situation_of
from controller.deadlock.cut_off import CutOff
from controller.deadlock.waits import Headway, WaitGraph
from controller.events import Event, EventKind, Log
from controller.executor import Executor
from controller.fleet import FREE_MODES, Agv
from controller.planners.cbs import Cbs, CbsLimits
from controller.planners.lacam import Lacam, LacamOptions
from controller.retiming import retime
from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import FOREVER, NO_AGV, AgvNumber, Path, PlanAgent, PlanningProblem, Status
from controller.visits import Barred
from sumo_nets.numbering import NO_VERTEX, Numbered

#: After each of the first climbs in vain, LaCAM* may propose this many times more configurations.
_MORE = 4
#: Number of these climbs; after them, the time to the next climb doubles instead.
_RAISES = 4
#: Number of home exchanges to try, those that move the fewest AGVs' homes first.
_EXCHANGES = 24

#: A leader, the group by priority, the problem, the AGVs found in the way -> a path for each AGV of the group, or None.
_Attempt = Callable[[PlanAgent, list[PlanAgent], PlanningProblem, set[AgvNumber]], dict[AgvNumber, Path] | None]

_FOUND: Mapping[DeadlockKind, EventKind] = {"deadlock": "deadlock_found", "obstruction": "obstruction_found"}
_RESOLVED: Mapping[DeadlockKind, EventKind] = {"deadlock": "deadlock_resolved", "obstruction": "obstruction_resolved"}


@dataclass(frozen=True, slots=True)
class LadderLimits:
    """Limits of deadlock resolution.

    Attributes:
        patience_steps: the ladder is climbed again so long after it was climbed in vain, later twice as long each time.
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

    def raised(self, times: float) -> LadderLimits:
        """Limits with this many times the group size and the effort of partial CBS."""
        return replace(self, group=round(times * self.group), cbs=self.cbs.raised(times))


class Ladder:
    """Finds deadlocks in the wait-for graph and has them resolved.

    Args:
        limits: see ``LadderLimits``.
        executor: takes the plans.
        agvs: the fleet, read only, but for AGVs that exchange homes.
        progress: since when each AGV has come no nearer to its goal.
        log: takes events.

    Attributes:
        limits: may change during a run; those of LaCAM* are taken at the start.
    """

    def __init__(
        self, limits: LadderLimits, executor: Executor, agvs: Numbered[AgvNumber, Agv], progress: Headway, log: Log
    ) -> None:
        self.limits = limits
        self._executor = executor
        self._agvs = agvs
        self._progress = progress
        self._log = log
        space = Space(executor.graph, executor.motion)
        distances = Distances(space)
        self._search = PathSearch(distances)
        self._cbs = Cbs(distances, limits.cbs)
        self._lacam = Lacam(space, limits.lacam)
        self._table = ReservationTable(len(executor.graph.names), executor.motion.following)
        self._open: list[Deadlock] = []
        self._count: dict[DeadlockKind, int] = {"deadlock": 0, "obstruction": 0}

    @property
    def resolving(self) -> bool:
        """Whether some deadlock is not over yet."""
        return bool(self._open)

    @property
    def locked(self) -> set[AgvNumber]:
        """AGVs that carry out a resolution; they must not be planned."""
        return {n for d in self._open for n in d.locked}

    @property
    def concerned(self) -> set[AgvNumber]:
        """AGVs in a deadlock that is not over yet, and AGVs that carry out a resolution."""
        return {n for d in self._open for n in (*d.members, *d.locked)}

    def step(self, step: int, waits: WaitGraph, problem: Callable[[], PlanningProblem], cut_off: CutOff) -> None:
        """Look after running resolutions, find new deadlocks and resolve them.

        Args:
            step: now.
            waits: which AGV waits for which.
            problem: makes the planning problem of this step: blocked vertices, and all AGVs that can move and carry out
                no resolution.
            cut_off: the AGVs that faults keep from their goals.
        """
        waiting = {n for group in (*waits.rings, *waits.blocked_by_idle) for n in group}
        waiting.update(self._progress.stuck(step, self.limits.stuck_steps))
        for deadlock in list(self._open):
            if deadlock.stage:
                self._supervise(deadlock, step)
            elif not waiting.intersection(deadlock.members) and self._is_dissolved(deadlock):
                deadlock.stage, deadlock.leader = "replanned", deadlock.members[0]
                self._close(deadlock, step)
            elif step - deadlock.moved >= self._patience(deadlock) and not self.locked.intersection(deadlock.members):
                self._resolve(deadlock, step, problem())
        taken = self.concerned
        for members, cause in self._candidates(step, waits):
            if not taken.intersection(members):
                deadlock = self._found(self._kind(members, cut_off), members, cause, step, waits)
                self._open.append(deadlock)
                self._resolve(deadlock, step, problem())
                taken.update(deadlock.members, deadlock.locked)

    def _is_dissolved(self, deadlock: Deadlock) -> bool:
        """Whether a member has advanced since the deadlock was found, or all are at their goals.

        Driving to and fro is no advance.
        """
        at_goals = all(self._agvs[n].goal == self._executor.agvs[n].last for n in deadlock.members)
        return at_goals or self._progress.reached(deadlock.members) != deadlock.reached

    def _patience(self, deadlock: Deadlock) -> int:
        """Steps from a climb in vain to the next one."""
        return int(self.limits.patience_steps * 2 ** max(0, deadlock.failures - _RAISES))

    # --- finding --------------------------------------------------------------------------------------------------

    def _candidates(self, step: int, waits: WaitGraph) -> list[tuple[tuple[AgvNumber, ...], DeadlockCause]]:
        """Groups that have stopped, with the cause: rings and chains at once, AGVs that are stuck when time is up."""
        found: list[tuple[tuple[AgvNumber, ...], DeadlockCause]] = [(ring, "ring") for ring in waits.rings]
        found += [(chain, "idle") for chain in waits.blocked_by_idle]
        taken = {n for members, _ in found for n in members}
        for n in self._progress.stuck(step, self.limits.stuck_steps):
            line = self._waiting_line(n, waits)
            if n not in taken and not (len(line) > 1 and self._moves(line[-1])):
                found.append((line, "stuck"))
        return found

    def _moves(self, n: AgvNumber) -> bool:
        """Whether the AGV drives, acts or is broken: AGVs behind it stand in a queue, not in a deadlock."""
        return not self._executor.agvs[n].standing or self._agvs[n].immobile

    @staticmethod
    def _waiting_line(first: AgvNumber, waits: WaitGraph) -> tuple[AgvNumber, ...]:
        line = [first]
        while line[-1] in waits.edges and waits.edges[line[-1]] not in line:
            line.append(waits.edges[line[-1]])
        return tuple(line)

    def _kind(self, members: tuple[AgvNumber, ...], cut_off: CutOff) -> DeadlockKind:
        held = cut_off.by_fault | cut_off.barred
        return "obstruction" if any(n in held or self._agvs[n].off_duty for n in members) else "deadlock"

    def _found(
        self, kind: DeadlockKind, members: tuple[AgvNumber, ...], cause: DeadlockCause, step: int, waits: WaitGraph
    ) -> Deadlock:
        since = step - self.limits.stuck_steps
        if cause != "stuck":
            since = min((self._executor.agvs[n].since for n in members if n in waits.edges), default=step)
        deadlock = Deadlock(kind, self._count[kind], members, cause, since, self._progress.reached(members))
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
        self._log(Event(_FOUND[kind], members[0], vertex=vertex, detail=detail))
        return deadlock

    # --- carrying out ---------------------------------------------------------------------------------------------

    def _supervise(self, deadlock: Deadlock, step: int) -> None:
        """Unlock AGVs that are through, close the deadlock once its leader has arrived, drop plans without headway."""
        ex = self._executor
        granted = sum(ex.agvs[n].granted for n in deadlock.members)
        busy = any(not ex.agvs[n].standing for n in deadlock.locked)
        if granted != deadlock.granted or busy:
            deadlock.granted, deadlock.moved = granted, step
        through = {n for n in deadlock.locked if not ex.agvs[n].pending}
        wanted = {v for n in deadlock.locked - through for v in ex.agvs[n].pending}
        if deadlock.leader in through:
            deadlock.arrived = ex.agvs[deadlock.leader].last == deadlock.goal
        deadlock.locked -= {n for n in through if wanted.isdisjoint(deadlock.aside.get(n, ()))}
        if (not deadlock.locked and deadlock.arrived) or self._have_passed(deadlock):
            self._close(deadlock, step)
        elif not deadlock.locked:
            self._in_vain(deadlock, "the plan was cut short", step)
        elif step - deadlock.moved >= 3 * self.limits.patience_steps:
            self._in_vain(deadlock, "the plan made no progress", step)

    def _have_passed(self, deadlock: Deadlock) -> bool:
        """All are nearer to their goals together than ever before, and none wants another one's place any more."""
        group = deadlock.carried[1]
        if deadlock.locked & deadlock.aside.keys() or self._progress.now(group) >= deadlock.best:
            return False
        ways = [{self._executor.agvs[n].last, *self._executor.agvs[n].pending} for n in group]
        return len(set().union(*ways)) == sum(map(len, ways))

    def _in_vain(self, deadlock: Deadlock, reason: str, step: int) -> None:
        """A plan was carried out without progress: its stage is left out from now on."""
        self._failed(deadlock, deadlock.stage, reason)
        deadlock.in_vain.add(deadlock.carried)
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
        self._log(Event(_RESOLVED[deadlock.kind], deadlock.leader, detail=detail))

    def _failed(self, deadlock: Deadlock, stage: Stage, reason: str) -> None:
        if deadlock.kind == "obstruction":
            return
        detail = {"deadlock": deadlock.number, "stage": stage, "reason": reason}
        self._log(Event("stage_failed", deadlock.members[0], detail=detail))

    # --- resolving ------------------------------------------------------------------------------------------------

    def _resolve(self, deadlock: Deadlock, step: int, problem: PlanningProblem) -> None:
        situation = situation_of(problem)
        if deadlock.hopeless == situation:
            deadlock.moved = step
            return
        agents = {a.agv: a for a in problem.agents}
        group = [n for n in deadlock.members if n in agents]
        while group:
            members = frozenset(group)
            outside = self._outside(group, step, problem)
            whole = replace(problem, fixed=tuple(outside), window_steps=FOREVER)
            resolution, blockers = self._stages(deadlock, [agents[n] for n in group], whole)
            if resolution and self._take(deadlock, resolution, whole, step):
                return
            joining = sorted((blockers & agents.keys()) - members)
            joining = [n for n in joining if agents[n].goal == agents[n].vertex] or joining
            if not joining or len(group) + len(joining) > self.limits.widen:
                joining = [n for n in agents if n not in group]
            if not joining:
                self._failed(deadlock, "widen", "nobody else can join")
                together, proven = self._together(deadlock, [agents[n] for n in group], whole)
                if together is None and (proven or deadlock.failures >= _RAISES):
                    together = self._exchange(deadlock, [agents[n] for n in group], whole)
                if not (together and self._take(deadlock, together, whole, step)):
                    deadlock.hopeless = situation if proven else None
                    deadlock.in_vain.clear()
                    self._give_up(deadlock, step)
                return
            group += joining

    def _outside(self, group: Iterable[AgvNumber], step: int, problem: PlanningProblem) -> list[Path]:
        """Paths of all AGVs outside the group, as the accepted orders have them."""
        timed = retime(self._executor, step)
        inside = set(group)
        trails = [p for p in problem.fixed if p.agv not in timed]
        return trails + [path for n, path in timed.items() if n not in inside]

    def _stages(
        self, deadlock: Deadlock, group: list[PlanAgent], problem: PlanningProblem
    ) -> tuple[Resolution | None, set[AgvNumber]]:
        blockers: set[AgvNumber] = set()
        by_priority = sorted(group, key=lambda a: (-a.priority, a.agv))
        leaders = self._leaders(by_priority, deadlock.failures)
        members = frozenset(a.agv for a in group)
        if leaders and 2 <= len(group) <= self.limits.group and ("partial_cbs", members) not in deadlock.in_vain:
            self._cbs.limits = self.limits.cbs
            result = self._cbs(replace(problem, agents=tuple(group)))
            if len(result.paths) == len(group):
                return Resolution("partial_cbs", leaders[0].agv, result.paths), blockers
            self._failed(deadlock, "partial_cbs", result.status.value)
        self._search.begin(problem)
        attempts: dict[Stage, _Attempt] = {"leader": self._leader, "pull_over": self._pull_over}
        for stage, attempt in attempts.items():
            if (stage, members) in deadlock.in_vain:
                continue
            for leader in leaders:
                paths = attempt(leader, by_priority, problem, blockers)
                if paths and self._is_progress(leader, group, paths):
                    return Resolution(stage, leader.agv, paths), blockers
            self._failed(deadlock, stage, "no way for any leader")
        return None, blockers

    def _leaders(self, by_priority: Sequence[PlanAgent], shift: int) -> list[PlanAgent]:
        """AGVs that may lead: AGVs that never were at their goal, or else AGVs that are not at their goal now."""
        away = [a for a in by_priority if a.goal != a.vertex]
        leaders = [a for a in away if not self._progress.has_arrived(a.agv)] or away
        shift = shift % len(leaders) if leaders else 0
        return leaders[shift:] + leaders[:shift]

    def _is_progress(self, leader: PlanAgent, group: Iterable[PlanAgent], paths: Mapping[AgvNumber, Path]) -> bool:
        """The leader was never at its goal before, or the plan brings all to their goals."""
        return not self._progress.has_arrived(leader.agv) or all(
            a.agv in paths and paths[a.agv].vertices[-1] == a.goal for a in group
        )

    def _together(
        self, deadlock: Deadlock, group: list[PlanAgent], problem: PlanningProblem
    ) -> tuple[Resolution | None, bool]:
        """All move together until all are at their goals, or where that is too hard a leader is at its own.

        Returns:
            The resolution, and whether it is proven that there is none.
        """
        limits = self.limits.lacam
        raises = 0 if deadlock.kind == "obstruction" else min(deadlock.failures, _RAISES)
        self._lacam.options = replace(limits, proposals=limits.proposals * _MORE**raises)
        whole = replace(problem, agents=tuple(group))
        leaders = self._leaders(sorted(group, key=lambda a: (-a.priority, a.agv)), deadlock.failures)
        alone = [a.agv for a in leaders if not self._progress.has_arrived(a.agv)]
        proven = True
        for aim in (NO_AGV, *alone):
            result = self._lacam.resolve(whole, aim)
            for leader in leaders:
                there = leader.agv in result.paths and leader.agv not in result.failed
                if there and self._is_progress(leader, group, result.paths):
                    return Resolution("lacam", leader.agv, result.paths), False
            proven &= result.status is not Status.TIMEOUT
            if not proven and aim != NO_AGV:
                break
        self._failed(deadlock, "lacam", "no solution" if proven else "timeout")
        return None, proven

    def _exchange(self, deadlock: Deadlock, group: list[PlanAgent], problem: PlanningProblem) -> Resolution | None:
        """AGVs without a task exchange homes, so that all of the group can get to their goals."""
        free = [a for a in group if self._agvs[a.agv].mode in FREE_MODES and a.goal == self._agvs[a.agv].home]
        homes = [a.goal for a in free]
        self._lacam.options = self.limits.lacam  # many ways are tried, so that each gets little effort
        ways = islice(permutations(homes), 1, _EXCHANGES)
        for way in sorted(ways, key=lambda way: sum(map(ne, way, homes))):
            new = {a.agv: home for a, home in zip(free, way, strict=True)}
            agents = tuple(replace(a, goal=new.get(a.agv, a.goal)) for a in group)
            result = self._lacam.resolve(replace(problem, agents=agents))
            if result.status is Status.SOLVED:
                return Resolution("homes", free[0].agv, result.paths, new)
        if len(free) > 1:
            self._failed(deadlock, "homes", "no way for any exchange")
        return None

    def _leader(
        self, leader: PlanAgent, group: list[PlanAgent], problem: PlanningProblem, blockers: set[AgvNumber]
    ) -> dict[AgvNumber, Path] | None:
        """The leader goes on, and the other AGVs keep their places."""
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
        """The leader goes on, and the other AGVs clear its way: to their goals if possible, otherwise aside."""
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

    def _take(self, deadlock: Deadlock, resolution: Resolution, problem: PlanningProblem, step: int) -> bool:
        ex = self._executor
        keep = {p.agv: p for p in problem.fixed if p.agv < len(ex.agvs)}
        goals = {a.agv: resolution.homes.get(a.agv, a.goal) for a in problem.agents if a.agv in resolution.paths}
        refusal = ex.accept({**keep, **resolution.paths}, Barred(problem.blocked, goals))
        if refusal:
            self._failed(deadlock, resolution.stage, refusal.reason)
            return False
        for n, home in resolution.homes.items():
            self._agvs[n].home = self._agvs[n].goal = home
        if resolution.homes:
            names = {n: ex.graph.names[home] for n, home in resolution.homes.items()}
            detail = {deadlock.kind: deadlock.number, "homes": names}
            self._log(Event("homes_exchanged", resolution.leader, detail=detail))
        deadlock.stage, deadlock.leader = resolution.stage, resolution.leader
        deadlock.carried = resolution.key
        deadlock.best = self._progress.best(resolution.paths)
        ends = {n: self._agvs[n].heads_for for n in resolution.paths}
        deadlock.aside = {
            n: frozenset(path.vertices) for n, path in resolution.paths.items() if path.vertices[-1] != ends[n]
        }
        way = resolution.paths[resolution.leader].vertices
        deadlock.goal, deadlock.arrived = way[-1], len(way) == 1
        deadlock.locked = {n for n, path in resolution.paths.items() if len(path.vertices) > 1}
        deadlock.moved, deadlock.granted = step, 0
        return True
