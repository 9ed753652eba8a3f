"""Planners of a user's own are guests: they get copies, they have a time limit, and their answers are checked.

A guest gets its own copy of each problem, with arrays that can't be written to. Whatever it returns is read here, once,
within its time limit, into plain values of the right types. What is no plan at all ends the run with a
:class:`PlannerError`. A plan that collides, or leads through parked cars, is a plan: the executor refuses it.

This is no sandbox. A guest is Python code and can do whatever its user can do; see the page on security.
"""

from __future__ import annotations

import copy
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from traceback import extract_tb
from types import FrameType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from controller.flags import FLAGS, Flags
from controller.planners.answer import NoPlanError, read_answer
from controller.types import Motion, Planner, PlanningProblem, PlanResult
from sumo_nets.errors import InputError
from sumo_nets.graph import Graph
from sumo_nets.interrupted import as_interrupts
from sumo_nets.wording import cut

T = TypeVar("T")

#: Seconds that a guest has for an answer when nothing else is said.
LIMIT_S = 60.0
#: Seconds after its limit at which a guest that goes on all the same is ended together with its process.
_PATIENCE_S = 2.0
#: Seconds between two interruptions of a guest that goes on.
_AGAIN_S = 0.1


class PlannerError(InputError):
    """A planner of a user's own fails. The message is one line: the planner, its error and where it was raised."""


class _OverTimeError(BaseException):
    """Raised within a guest when its time is over; no ``except Exception`` of the guest's stops it."""


@dataclass(frozen=True, eq=False)
class Guest:
    """A planner of a user's own.

    Attributes:
        name: as it was asked for.
        function: from ``PlanningProblem`` to ``PlanResult``.
        graph, motion: the garage; the guest gets copies.
        limit_s: wall-clock seconds for an answer.
    """

    name: str
    function: Planner
    graph: Graph
    motion: Motion
    limit_s: float = LIMIT_S
    flags: Flags = field(init=False)
    _own: tuple[Graph, Motion] = field(init=False)

    def __post_init__(self) -> None:
        """Read its flags, and copy the garage for it.

        Raises:
            ValueError: see ``controller.flags.Flags``.
        """
        own = self.function
        given = guarded(
            self.name, lambda: {name: getattr(own, name) for name in FLAGS if hasattr(own, name)}, self.limit_s
        )
        try:
            flags = Flags(**given)
        except ValueError as error:
            raise ValueError(f"{self.name!r}: {error}") from None
        object.__setattr__(self, "flags", flags)
        object.__setattr__(self, "_own", (_frozen(self.graph), _frozen(self.motion)))

    def __getattr__(self, name: str) -> object:
        """Its flags are those of the function."""
        if name in FLAGS:
            return getattr(self.flags, name)
        raise AttributeError(name)

    def __call__(self, problem: PlanningProblem) -> PlanResult:
        """Have it plan.

        Raises:
            PlannerError: it raises, takes too long, writes into the problem, or what it returns is no plan.
        """
        given = self._copy(problem)

        def answer() -> PlanResult:
            return read_answer(self.function(given), problem)

        result = guarded(self.name, answer, self.limit_s)
        changed = _differences(problem, given)
        if changed:
            raise PlannerError(f"{self.name} changes the problem's {changed[0]}")
        return result

    def _copy(self, problem: PlanningProblem) -> PlanningProblem:
        """A problem of which nothing is shared with the garage's books."""
        own_graph, own_motion = self._own
        return replace(
            problem,
            graph=own_graph if problem.graph is self.graph else _frozen(problem.graph),
            motion=own_motion if problem.motion is self.motion else _frozen(problem.motion),
            agents=tuple(replace(agent) for agent in problem.agents),
            fixed=tuple(replace(path) for path in problem.fixed),
            blocked=_read_only(problem.blocked.copy()),
            no_rest=_read_only(problem.no_rest.copy()),
            carrying=tuple(replace(agent) for agent in problem.carrying),
            carried=tuple(replace(path) for path in problem.carried),
        )


def guarded(name: str, call: Callable[[], T], limit_s: float) -> T:
    """Call a guest's code.

    Args:
        name: the guest, ``file.py:function``.
        call: what calls it.
        limit_s: wall-clock seconds that it has. Python code in the main thread is interrupted; compiled code, and code
            in another thread, is told of when it returns.

    Returns:
        What ``call`` returns.

    Raises:
        PlannerError: the guest raises an error, ends the program, or takes too long.
    """
    began = time.perf_counter()
    try:
        with _time_limit(name, limit_s), as_interrupts():
            result = call()
    except _OverTimeError as error:
        raise PlannerError(_over_time(name, limit_s, str(error))) from None
    except NoPlanError as error:
        raise PlannerError(f"{name} {error}") from None
    except PlannerError:
        raise
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise PlannerError(f"{name} raises {_words(error)} ({_place(name, error)})") from error
    if time.perf_counter() - began > limit_s:
        raise PlannerError(_over_time(name, limit_s, ""))
    return result


# --- time -------------------------------------------------------------------------------------------------------------


@contextmanager
def _time_limit(name: str, limit_s: float) -> Iterator[None]:
    """Interrupt the code within after so many seconds, where that can be done: in the main thread."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return
    end = time.perf_counter() + limit_s
    over = threading.Event()

    def interrupt(_signal: int, frame: FrameType | None) -> None:
        if over.is_set():
            return
        place = _frame_place(name, frame)
        if time.perf_counter() > end + _PATIENCE_S:  # it catches whatever is raised in it
            print("error:", _over_time(name, limit_s, place), file=sys.stderr, flush=True)
            os._exit(2)
        raise _OverTimeError(place)

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, limit_s, _AGAIN_S)
    try:
        yield
    finally:
        try:
            over.set()
        finally:  # the time may have ended on the line before
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


def _over_time(name: str, limit_s: float, place: str) -> str:
    return f"{name} takes longer than control.planner_limit_s, {limit_s:g} s{f' ({place})' if place else ''}"


def _frame_place(name: str, frame: FrameType | None) -> str:
    """The innermost line of the guest's own file that is being run."""
    inner = frame
    while frame is not None and not _is_own(name, frame.f_code.co_filename):
        frame = frame.f_back
    at = frame or inner
    return f"{Path(at.f_code.co_filename).name}, line {at.f_lineno}" if at else ""


def _place(name: str, error: BaseException) -> str:
    """Where an error was raised: the innermost line of the guest's own file, else the file, else the innermost line."""
    trace = extract_tb(error.__traceback__)
    own = [entry for entry in trace if _is_own(name, entry.filename)]
    file = Path(name.rpartition(":")[0]).name
    if file and not own:
        return file
    where = (own or trace)[-1]
    return f"{Path(where.filename).name}, line {where.lineno}"


def _is_own(name: str, file: str) -> bool:
    return os.path.abspath(file) == os.path.abspath(name.rpartition(":")[0])


def _words(error: BaseException) -> str:
    """An error's type and message, which may be a hostile one."""
    try:
        message = cut(str(error), 200)
    except Exception:
        message = "(a message that can't be read)"
    return f"{type(error).__name__}: {message}"


# --- what a guest gets ------------------------------------------------------------------------------------------------

Books = TypeVar("Books", Graph, Motion)


def _frozen(books: Books) -> Books:
    """A copy whose arrays can't be written to."""
    twin = copy.deepcopy(books)
    for value in vars(twin).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return twin


def _read_only(array: NDArray[np.uint8]) -> NDArray[np.uint8]:
    array.flags.writeable = False
    return array


def _differences(problem: PlanningProblem, given: PlanningProblem) -> list[str]:
    """Names of the arrays that a guest has changed in its copy, read-only or not."""
    parts: list[tuple[str, object, object]] = [("", problem, given)]
    parts += [("graph.", problem.graph, given.graph), ("motion.", problem.motion, given.motion)]
    return [
        f"{part}{f.name}"
        for part, true, copied in parts
        for f in fields(true)  # type: ignore[arg-type]
        if isinstance(before := getattr(true, f.name), np.ndarray)
        and not np.array_equal(before, getattr(copied, f.name))
    ]
