"""The answer of a planner of a user's own, read into plain values of the right types.

Whatever such a planner returns is looked at once: types, ranges, and whether the status says what is there. Every move
of a path needs a lane. Whether paths collide is for the executor to find.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from itertools import islice, pairwise
from operator import index

import numpy as np

from controller.types import FOREVER, NO_AGV, TRAIL, AgvNumber, Counters, Path, PlanningProblem, PlanResult, Status
from controller.visits import malformed
from sumo_nets.numbering import Vertex
from sumo_nets.wording import one_of, shown

#: A path may visit as many vertices as the garage has, so many times over.
_ROUNDS = 64
#: A planner may name as many wait-for edges as there are agents, so many times over.
_WAITS = 1000


class NoPlanError(Exception):
    """What is wrong with an answer, beginning with a verb."""


def read_answer(answer: object, problem: PlanningProblem) -> PlanResult:
    """An answer made anew of plain values.

    Args:
        answer: what a planner returned.
        problem: what it was asked.

    Returns:
        The same answer.

    Raises:
        NoPlanError: it is no plan.
    """
    if not isinstance(answer, PlanResult):
        raise NoPlanError(f"returns {type(answer).__name__} instead of PlanResult")
    agents = {agent.agv: agent for agent in (*problem.carrying, *problem.agents)}
    others = {AgvNumber(path.agv % TRAIL) for path in problem.fixed}
    paths: dict[AgvNumber, Path] = {}
    for key, value in _items(answer.paths, "paths", len(agents)):
        agv = _asked(key, agents, "paths")
        if not isinstance(value, Path):
            raise NoPlanError(f"returns {type(value).__name__} instead of Path for AGV {agv}")
        paths[agv] = _path(value, agv, agents[agv].vertex, problem)
    known = {*agents, *others, NO_AGV}
    failed = {
        _asked(key, agents, "failed"): _agv(value, known, f"failed[{shown(key)}]")
        for key, value in _items(answer.failed, "failed", len(agents))
    }
    result = PlanResult(_status(answer.status), paths, failed, _counters(answer.counters), _waits(answer.waits, known))
    _check_meaning(result, [agent.agv for agent in problem.agents])
    return result


def _check_meaning(result: PlanResult, asked: Collection[AgvNumber]) -> None:
    """Make sure that the status says what is there."""
    status = result.status
    if status in (Status.INFEASIBLE, Status.TIMEOUT):
        if result.paths:
            raise NoPlanError(f"returns {len(result.paths)} paths with status {status}: give none, or Status.PARTIAL")
        return
    if status is Status.SOLVED and result.failed:
        raise NoPlanError(f"names {len(result.failed)} agents as failed with status solved: give Status.PARTIAL")
    without = [agv for agv in asked if agv not in result.paths and agv not in result.failed]
    if without:
        raise NoPlanError(f"returns neither a path for AGV {without[0]} nor its number in failed")


def _path(path: Path, agv: AgvNumber, start: Vertex, problem: PlanningProblem) -> Path:
    """A path whose every move has a lane."""
    where = f"paths[{agv}]"
    n = len(problem.graph.names)
    most = _ROUNDS * (n + 1)
    vertices = tuple(Vertex(v) for v in _numbers(path.vertices, f"{where}.vertices", n - 1, most))
    arrive = _numbers(path.arrive, f"{where}.arrive", FOREVER, most)
    depart = _numbers(path.depart, f"{where}.depart", FOREVER, most)
    whole = Path(
        AgvNumber(_number(path.agv, f"{where}.agv", TRAIL)), vertices, arrive, depart,
        _number(path.until, f"{where}.until", FOREVER),
    )  # fmt: skip
    if wrong := malformed(agv, whole):
        raise NoPlanError(f"returns no path: {wrong}")
    if vertices[0] != start:
        raise NoPlanError(f"returns a path of AGV {agv} that starts at vertex {vertices[0]}: give {start} first")
    for u, v in pairwise(vertices):
        if (u, v) not in problem.graph.edge_index:
            raise NoPlanError(f"returns a path of AGV {agv} from vertex {u} to {v}, which no lane joins")
    return whole


def _status(status: object) -> Status:
    if not isinstance(status, Status):
        raise NoPlanError(
            f"returns status {shown(status)}: give one of {', '.join(f'Status.{s.name}' for s in Status)}"
        )
    return status


def _counters(counters: object) -> Counters:
    if not isinstance(counters, Counters):
        raise NoPlanError(f"returns counters {shown(counters)}: give Counters()")
    return Counters(
        **{f.name: _number(getattr(counters, f.name), f"counters.{f.name}", 2**53) for f in fields(counters)}
    )


def _waits(waits: object, known: Collection[AgvNumber]) -> tuple[tuple[AgvNumber, AgvNumber], ...]:
    pairs = _listed(waits, "waits", _WAITS * (len(known) + 1))
    return tuple(_wait(pair, f"waits[{i}]", known) for i, pair in enumerate(pairs))


def _wait(pair: object, where: str, known: Collection[AgvNumber]) -> tuple[AgvNumber, AgvNumber]:
    both = _listed(pair, where, 2)
    if len(both) != 2 or NO_AGV in both:
        raise NoPlanError(f"returns {where} {shown(pair)}: give two numbers of AGVs")
    return _agv(both[0], known, where), _agv(both[1], known, where)


def _asked(key: object, agents: Collection[AgvNumber], where: str) -> AgvNumber:
    agv = AgvNumber(_number(key, f"a key of {where}", 2**31))
    if agv not in agents:
        raise NoPlanError(f"returns {where}[{agv}], but was not asked about this AGV; {_some(agents)}")
    return agv


def _agv(value: object, known: Collection[AgvNumber], where: str) -> AgvNumber:
    agv = AgvNumber(_number(value, where, 2**31, -1))
    if agv not in known:
        raise NoPlanError(f"returns {where} {agv}: there is no such AGV in the problem; {_some(known)}")
    return agv


def _some(agvs: Collection[AgvNumber]) -> str:
    return one_of([str(agv) for agv in sorted(agvs)]) if agvs else "it was asked about none"


def _items(value: object, where: str, most: int) -> list[tuple[object, object]]:
    """The pairs of a mapping, of which there may be no end."""
    if not isinstance(value, Mapping):
        raise NoPlanError(f"returns {where} {shown(value)}: give a mapping by number of AGV")
    pairs = list(islice(value.items(), most + 1))
    if len(pairs) > most:
        raise NoPlanError(f"returns {where} with more than {most} entries: it was asked about {most} AGVs")
    return pairs


def _listed(value: object, where: str, most: int) -> tuple[object, ...]:
    if not isinstance(value, tuple | list):
        raise NoPlanError(f"returns {where} {shown(value)}: give a tuple")
    if len(value) > most:
        raise NoPlanError(f"returns {where} with {len(value)} entries: give {most} at most")
    return tuple(value)


def _numbers(values: object, where: str, greatest: int, most: int) -> tuple[int, ...]:
    return tuple(_number(value, where, greatest) for value in _listed(values, where, most))


def _number(value: object, where: str, greatest: int, least: int = 0) -> int:
    """A whole number; numpy's are whole numbers, too, and truth values are none."""
    if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
        raise NoPlanError(f"returns {where} {shown(value)}: give a whole number")
    number = index(value)
    if not least <= number <= greatest:
        raise NoPlanError(f"returns {where} {shown(number)}: give {least} to {greatest}")
    return number
