"""Planners of a user's own are guests: whatever they do, the program says one line and the garage holds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hostile_planners import DEFECTS, cheat, trial
from test_executor import LINE, bodies, way

from controller.executor import Executor
from controller.flags import FLAGS, Flags
from controller.planners.contract import random_problem
from controller.planners.guest import Guest, PlannerError
from controller.types import NO_AGV, PlanningProblem, PlanResult, Status
from controller.types import Path as Way
from controller.visits import Barred
from parking_sim.cli import main
from sumo_nets.numbering import Vertex

GUESTS = """
import time
from dataclasses import replace
from functools import cache

from controller.planners.table import load_planner
from controller.types import Path, PlanResult, Status


@cache
def whca(graph, motion):
    return load_planner("whca", graph, motion, {})


def good(problem):
    return whca(problem.graph, problem.motion)(problem)


def half(problem):
    result = good(problem)
    return replace(result, paths=dict(list(result.paths.items())[::2]))


def empty(problem):
    return PlanResult(Status.SOLVED, {}, {})


def unknown(problem):
    return PlanResult(Status.SOLVED, {99: Path(99, (0,), (0,), ())})


def senseless(problem):
    return PlanResult(Status.SOLVED, {problem.agents[0].agv: Path(problem.agents[0].agv, (), (), ())})


def jump(problem):
    return PlanResult(Status.SOLVED, {a.agv: Path(a.agv, (a.vertex, 0), (0, 1), (0,)) for a in problem.agents})


def elsewhere(problem):
    return PlanResult(Status.SOLVED, {a.agv: Path(a.agv, (0,), (0,), ()) for a in problem.agents})


def leaves(problem):
    raise SystemExit(3)


def text(problem):
    return replace(good(problem), status="solved")


def uncounted(problem):
    return replace(good(problem), counters=None)


def listed(problem):
    return PlanResult(Status.PARTIAL, {}, [a.agv for a in problem.agents])


def writes(problem):
    problem.blocked[:] = 1
    return good(problem)


def forces(problem):
    problem.graph.length_m.flags.writeable = True
    problem.graph.length_m[:] = 1
    return good(problem)


def spins(problem):
    while True:
        pass


def clings(problem):
    while True:
        try:
            time.sleep(1)
        except BaseException:
            pass


def no_arguments():
    return None
"""


@pytest.fixture
def guests(tmp_path: Path) -> Path:
    file = tmp_path / "guests.py"
    file.write_text(GUESTS, encoding="utf-8")
    return file


def scenario(folder: Path, planner: str) -> Path:
    """A small run in ticks; a planner that spins has half a second, others have the time to be compiled."""
    limit_s = 0.5 if planner.endswith((":spins", ":clings")) else 60
    file = folder / "scenario.yaml"
    keys = f"garage: map1\nagvs: 4\nplant: discrete\nduration_s: 100\nplanner: {planner}\n"
    file.write_text(keys + f"control: {{planner_limit_s: {limit_s}}}\nrecord: {{replay: false}}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("function", "says"),
    [
        ("half", "returns neither a path for AGV 1 nor its number in failed"),
        ("empty", "returns neither a path for AGV 0 nor its number in failed"),
        ("unknown", "returns paths[99], but was not asked about this AGV; give one of 0, 1, 2, 3"),
        ("senseless", "returns no path: AGV 0: 0 vertices, 0 arrivals and 0 departures"),
        ("jump", "which no lane joins"),
        ("elsewhere", "that starts at vertex 0: give"),
        ("leaves", "raises SystemExit: 3 (guests.py, line 45)"),
        ("text", "returns status 'solved': give one of Status.SOLVED, Status.PARTIAL"),
        ("uncounted", "returns counters None: give Counters()"),
        ("listed", "returns failed [0, 1, 2, 3]: give a mapping by number of AGV"),
        ("writes", "raises ValueError: assignment destination is read-only (guests.py, line 61)"),
        ("forces", "changes the problem's graph.length_m"),
        ("spins", "takes longer than control.planner_limit_s, 0.5 s (guests.py, line"),
        ("no_arguments", "raises TypeError: no_arguments() takes 0 positional arguments but 1 was given (guests.py)"),
    ],
)
def test_what_is_no_plan_ends_the_run_with_one_line_and_leaves_nothing(tmp_path, guests, capsys, function, says):
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as end:
        main(["run", str(scenario(tmp_path, f"guests.py:{function}")), "--out", str(out), "--no-report"])
    said = capsys.readouterr()
    assert (end.value.code, said.out, out.exists()) == (2, "", False)
    assert said.err.count("\n") == 1
    assert said.err.startswith(f"error: {guests}:{function} ")
    assert says in said.err


def test_a_planner_that_catches_whatever_is_raised_in_it_is_ended_all_the_same(tmp_path, guests):
    command = [sys.executable, "-m", "parking_sim", "run", str(scenario(tmp_path, f"{guests}:clings")), "-q"]
    ended = subprocess.run([*command, "--out", str(tmp_path / "out")], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "clings takes longer than control.planner_limit_s, 0.5 s (guests.py, line " in ended.stderr


def test_check_planner_says_what_a_run_would_say(guests, capsys):
    with pytest.raises(SystemExit) as end:
        main(["check-planner", f"{guests}:forces", "--problems", "5"])
    assert end.value.code == 1
    assert "changes the problem's graph.length_m" in capsys.readouterr().out


@pytest.mark.parametrize("number", range(5, len(DEFECTS) + 60, 14))
def test_planners_that_cheat_in_any_way_are_told_or_do_no_harm(tmp_path, number):
    """A sample of ``benchmarks/hostile_planners.py``, where each kind of defect has its turn."""
    assert trial(number, 0, "discrete", tmp_path)["wrong"] == "", cheat(number)


def test_the_trials_see_a_garage_that_lets_planners_drive_through_parked_cars(tmp_path, monkeypatch):
    monkeypatch.setattr(Barred, "on", lambda _self, _path: -1)
    monkeypatch.setattr(Executor, "_shut", lambda self, _agv, vertex: vertex in self.closed)
    through = next(n for n in range(200) if cheat(n).defects == ("all_through_cars",))
    assert "with a car that it has nothing to do with" in trial(through, 0, "discrete", tmp_path)["wrong"]


def guest(function) -> tuple[Guest, PlanningProblem]:
    problem = random_problem(17)
    return Guest("mine.py:plan", function, problem.graph, problem.motion), problem


def stay(problem: PlanningProblem) -> PlanResult:
    return PlanResult(Status.PARTIAL, {}, {agent.agv: NO_AGV for agent in problem.agents})


def test_a_guest_shares_nothing_with_the_books():
    """Agents and paths can be forced to change, and so can a graph's tables: those of the garage stay as they are."""
    seen: list[PlanningProblem] = []

    def forces(given: PlanningProblem) -> PlanResult:
        seen.append(given)
        object.__setattr__(given.agents[0], "vertex", -7)
        given.graph.edge_index.clear()
        return stay(given)

    forced, problem = guest(forces)
    before = problem.agents, dict(problem.graph.edge_index)
    forced(problem)
    assert (problem.agents, problem.graph.edge_index) == before
    assert not any(np.shares_memory(a, b) for a, b in ((seen[0].blocked, problem.blocked),
                                                      (seen[0].graph.head, problem.graph.head)))  # fmt: skip


def test_an_answer_is_taken_in_numpys_numbers_as_well():
    def answer(given: PlanningProblem) -> PlanResult:
        paths = {np.int64(a.agv): Way(np.int32(a.agv), [np.int64(a.vertex)], (np.int8(0),), ()) for a in given.agents}
        return PlanResult(Status.SOLVED, paths)

    asked, problem = guest(answer)
    paths = asked(problem).paths
    assert {type(key) for key in paths} == {int}
    assert {type(v) for path in paths.values() for v in (*path.vertices, *path.arrive, path.agv)} == {int}


def test_an_answer_is_a_copy_that_later_changes_do_not_reach():
    kept: list[PlanResult] = []

    def answer(given: PlanningProblem) -> PlanResult:
        kept.append(PlanResult(Status.PARTIAL, {}, {agent.agv: NO_AGV for agent in given.agents}))
        return kept[0]

    asked, problem = guest(answer)
    result = asked(problem)
    kept[0].counters.expanded = 99
    kept[0].failed.clear()
    assert (result.counters.expanded, len(result.failed)) == (0, len(problem.agents))


def test_a_guest_in_another_thread_is_told_of_its_time_when_it_returns():
    import threading
    import time

    problem = random_problem(17)
    late = Guest("mine.py:plan", lambda p: (time.sleep(0.05), stay(p))[1], problem.graph, problem.motion, 0.01)
    said: list[str] = []

    def ask() -> None:
        try:
            late(problem)
        except PlannerError as error:
            said.append(str(error))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert said == ["mine.py:plan takes longer than control.planner_limit_s, 0.01 s"]


def test_flags_that_raise_are_told():
    class Shy:
        @property
        def complete(self) -> bool:
            raise OSError("not now")

        __call__ = staticmethod(stay)

    problem = random_problem(17)
    with pytest.raises(PlannerError, match=r"mine\.py:plan raises OSError: not now"):
        Guest("mine.py:plan", Shy(), problem.graph, problem.motion)


def test_every_flag_has_its_default():
    asked, _ = guest(stay)
    assert {name: getattr(asked, name) for name in FLAGS} == {name: getattr(Flags(), name) for name in FLAGS}


# --- the executor and parked cars -------------------------------------------------------------------------------------


def test_a_plan_through_a_blocked_vertex_is_refused_but_for_ones_own_goal():
    executor = Executor(LINE, bodies(LINE), [LINE.index["a"]])
    blocked = np.zeros(4, dtype=np.uint8)
    blocked[LINE.index["c"]] = 1
    path = {0: way(LINE, 0, "abcd")}
    refusal = executor.accept(path, Barred(blocked, {0: LINE.index["d"]}))
    assert (refusal.kind, refusal.vertex) == ("blocked", LINE.index["c"])
    assert executor.accept(path, Barred(blocked, {})) is None, "a path that was taken before is not looked at"
    assert executor.accept({0: way(LINE, 0, "abc")}, Barred(blocked, {0: LINE.index["c"]})) is None


def test_a_vertex_where_a_car_was_parked_after_the_plan_is_not_granted():
    parked: set[Vertex] = set()
    executor = Executor(LINE, bodies(LINE), [LINE.index["a"]], barred=lambda _agv, vertex: vertex in parked)
    assert executor.accept({0: way(LINE, 0, "abcd")}) is None
    parked.add(LINE.index["c"])
    granted = [v for command in executor.grants(0) for v in command.vertices]
    assert granted == [LINE.index["b"]]
    parked.clear()
    executor.reconsider(0)
    assert [v for command in executor.grants(1) for v in command.vertices] == [LINE.index["c"], LINE.index["d"]]
