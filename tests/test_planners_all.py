"""What holds for every planner: those of the table, and one of a user's own."""

from __future__ import annotations

import inspect
import random
import shutil
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path as FilePath

import numpy as np
import pytest
from whole_runs import run

from controller.flags import Flags, flags_of
from controller.planners.contract import check_planner, random_problem, violations
from controller.planners.table import ENTRY_POINTS, PLANNERS, load_planner
from controller.planners.whca import Whca
from controller.types import FOREVER, Path, PlanAgent, PlanningProblem, Status, make_motion
from controller.window import WindowRange
from parking_sim.cli import main
from parking_sim.config import load_scenario
from parking_sim.simulation import simulate
from sumo_nets.movingai import grid_graph

OWN = FilePath(__file__).parents[1] / "parking_sim" / "examples" / "own_planner.py"

#: A short run with AGVs in each other's way.
BUSY = {"garage": "map1", "agvs": 8, "plant": "discrete", "workload": {"kind": "park_exit", "cars": 6}}

#: Options that keep the tests quick.
QUICK = {"lacam": {"proposals": 100}, "cbs": {"expansions": 50}}
#: Those that need routes drawn for the garage, that cut complete paths on purpose, or that breed for long.
APART = {"binary_tree", "online_mapf", "ga_single", "ga_two_stage"}
#: Those whose answer in an empty garage brings one agent to the goal on a quickest way, if asked without a window.
QUICKEST = ("whca", "token", "pbs", "cbs")


def maker(name):
    return lambda graph, motion: load_planner(name, graph, motion, QUICK.get(name, {}))


def least_options(name):
    """The least value of each number among a planner's options, as it says itself."""
    module, _, options = PLANNERS[name]
    known = fields(getattr(import_module(module), options)) if options else ()
    return {f.name: type(f.default)(f.metadata.get("least", 0)) for f in known if type(f.default) in (int, float)}


@pytest.mark.parametrize("name", sorted(set(PLANNERS) - {"binary_tree"}))
def test_a_planner_works_with_the_least_of_its_options_and_refuses_less(name):
    problem, least = random_problem(7), least_options(name)
    assert violations(load_planner(name, problem.graph, problem.motion, least), problem) == []
    for key, value in least.items():
        with pytest.raises(ValueError, match=rf"planner_options\.{key}: {value - 1}: give {value:g} or more"):
            load_planner(name, problem.graph, problem.motion, {key: value - 1})


@pytest.mark.parametrize("name", [*sorted(set(PLANNERS) - APART), f"{OWN}:plan"])
def test_every_answer_keeps_to_the_contract(name):
    assert list(check_planner(maker(name), 40)) == []


@pytest.mark.parametrize("number", range(0, 60, 6))  # problems of one agent
def test_alone_all_planners_of_paths_find_one_as_quick(number):
    problem = random_problem(number, FOREVER)
    answers = [maker(name)(problem.graph, problem.motion)(problem) for name in QUICKEST]
    assert len({tuple(p.arrive[-1] for p in a.paths.values()) for a in answers}) == 1


@pytest.mark.parametrize("number", range(60))
def test_nobody_is_cheaper_than_cbs(number):
    problem = random_problem(number, FOREVER)
    best = maker("cbs")(problem.graph, problem.motion)(problem)
    for name in ("whca", "token", "pbs", "lacam"):
        other = maker(name)(problem.graph, problem.motion)(problem)
        if best.status is Status.SOLVED and other.status is Status.SOLVED:
            assert cost(other) >= cost(best)


def test_improvement_keeps_plans_free_of_conflicts_and_never_makes_them_later():
    """Those who have a path carry it out, and it may be planned again."""
    saved = 0
    graph = grid_graph("hall", ["." * 8] * 8)
    motion = make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)
    for seed in range(5):
        rng = random.Random(seed)
        pairs = zip(*(rng.sample(range(64), 16) for _ in range(2)), strict=True)
        agents = tuple(PlanAgent(agv, start, -1, 0, goal, False) for agv, (start, goal) in enumerate(pairs))
        fixed = tuple(Path(a.agv, (a.vertex,), (0,), ()) for a in agents)
        free = np.zeros(64, dtype=np.uint8)
        p = PlanningProblem(graph, motion, agents, fixed, free, free, FOREVER)
        plain = load_planner("token", p.graph, p.motion, {"slack_moves": 0})(p)
        carrying = tuple(a for a in agents if a.agv in plain.paths)
        fixed = tuple(plain.paths.get(path.agv, path) for path in fixed)
        late = replace(p, agents=tuple(a for a in agents if a not in carrying), carrying=carrying, fixed=fixed)
        exact = {"late_moves": 0, "slack_moves": 0}
        exact["detours"] = bool(seed % 2)
        results = [load_planner("token", p.graph, p.motion, exact | {"improvements": n})(late) for n in (0, 20)]
        assert [violations(lambda _, r=r: r, late) for r in results] == [[], []]
        assert results[0].failed.keys() == results[1].failed.keys()
        assert results[0].paths.keys() <= results[1].paths.keys()
        ends = [{path.agv: path.arrive[-1] for path in (*fixed, *r.paths.values())} for r in results]
        assert sum(ends[1].values()) <= sum(ends[0].values())
        saved += sum(ends[0].values()) - sum(ends[1].values())
    assert saved > 0


def test_improvement_finds_who_makes_an_agent_go_a_long_way_round():
    """The agent waits nowhere; on its short way, by the upper road, it would meet the other one."""
    graph = grid_graph("ring", [".........", *["@.@@@@@.@"] * 3, "@.......@"])
    motion = make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, True)
    round_by = ["0,0", *(f"1,{y}" for y in range(5)), *(f"{x},4" for x in range(2, 7)), "7,4", "7,3", "7,2", "7,1"]
    ways = [[*round_by, "7,0", "8,0"], ["7,1", *(f"{x},0" for x in range(7, 0, -1)), "1,1"]]
    fixed = tuple(
        Path(n, tuple(graph.index[name] for name in way), tuple(range(len(way))), tuple(range(len(way) - 1)))
        for n, way in enumerate(ways)
    )
    carrying = tuple(PlanAgent(p.agv, p.vertices[0], -1, 0, p.vertices[-1], False) for p in fixed)
    free = np.zeros(len(graph.names), dtype=np.uint8)
    p = PlanningProblem(graph, motion, (), fixed, free, free, FOREVER, carrying=carrying)
    assert load_planner("token", graph, motion, {})(p).paths == {}
    found = load_planner("token", graph, motion, {"detours": True})(p)
    assert [path.arrive[-1] for path in fixed] == [16, 8]
    assert sorted(path.arrive[-1] for path in found.paths.values()) == [8, 12]
    assert violations(lambda _: found, replace(p, agents=carrying, fixed=(), carrying=())) == []


def cost(result):
    return sum(path.arrive[-1] for path in result.paths.values())


def test_ones_own_planner_has_twenty_lines():
    planner = load_planner(f"{OWN}:plan", *(getattr(random_problem(0), part) for part in ("graph", "motion")), {})
    assert len(inspect.getsource(planner.function).splitlines()) <= 20


WRONG = """
from controller.types import Path, PlanResult, Status
def jump(problem):
    return PlanResult(Status.SOLVED, {a.agv: Path(a.agv, (a.vertex, a.goal), (0, 1), (0,)) for a in problem.agents})
def nothing(problem):
    return None
def crash(problem):
    return 1 / 0
def words(problem):
    return PlanResult(Status.SOLVED, {a.agv: "north" for a in problem.agents})
def careless(problem):
    problem.blocked[:] = 0
    return PlanResult(Status.PARTIAL, {}, {})
"""


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("jump", "which no lane joins"),
        ("nothing", "returns NoneType instead of PlanResult"),
        ("crash", "raises ZeroDivisionError"),
        ("careless", "assignment destination is read-only (wrong.py, line 12)"),
    ],
)
def test_what_a_planner_violates_is_told(tmp_path, capsys, function, reason):
    file = tmp_path / "wrong.py"
    file.write_text(WRONG, encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        main(["check-planner", f"{file}:{function}", "--problems", "10"])
    said = capsys.readouterr().out
    assert end.value.code == 1
    assert reason in said


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("nothing", "returns NoneType instead of PlanResult"),
        ("crash", "raises ZeroDivisionError: division by zero (wrong.py, line 8)"),
        ("words", "returns str instead of Path for AGV 0"),
    ],
)
def test_a_planner_that_fails_ends_a_run_with_one_line(tmp_path, capsys, function, reason):
    file = tmp_path / "wrong.py"
    file.write_text(WRONG, encoding="utf-8")
    arguments = ["run", "map1_thesis", "--plant", "discrete", "--agvs", "1", "--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--planner", f"{file}:{function}"])
    said = capsys.readouterr()
    assert (end.value.code, said.out) == (2, "")
    assert said.err == f"error: {file}:{function} {reason}\n"


FLAGS = """
from controller.planners.token import make_token
from controller.planners.whca import Whca, make_whca
from controller.types import Path, PlanResult, Status
from controller.window import WindowRange
class Wrapped:
    def __init__(self, make):
        self.make, self.made = make, None
    def __call__(self, problem):
        self.made = self.made or self.make(problem.graph, problem.motion)
        return self.made(problem)
whca, token, timid = Wrapped(make_whca), Wrapped(make_token), Wrapped(make_whca)
whca.window, whca.keeps = Whca.window, True
token.complete = token.rests = token.improves = True
timid.window, timid.meets_conflicts = WindowRange(4, 3, 6), True
def stay(problem):
    paths = {a.agv: Path(a.agv, (a.vertex,), (0,), (), until=1) for a in problem.agents}
    return PlanResult(Status.SOLVED, paths)
def move(problem):
    return stay(problem)
move.one_move = True
def number(problem): ...
number.window = 7
def word(problem): ...
word.complete = "no"
def alone(problem): ...
alone.rests = True
def both(problem): ...
both.complete = both.keeps = True
"""


@pytest.fixture
def flagged(tmp_path):
    """A file with planners of a user's own that say things of themselves."""
    file = tmp_path / "flagged.py"
    file.write_text(FLAGS, encoding="utf-8")
    return file


@pytest.mark.parametrize("name", ["whca", "token"])
def test_a_built_in_planner_in_a_users_file_makes_the_same_record(flagged, name):
    """It does only if its flags arrive: ``whca`` has another window and keeps plans, ``token`` has other problems."""
    runs = [run(flagged.parent / str(n), planner=p, **BUSY).meta for n, p in enumerate((name, f"{flagged}:{name}"))]
    assert runs[0]["digest"] == runs[1]["digest"]


def test_a_users_own_window_is_the_window(flagged):
    cells = run(flagged.parent / "run", planner=f"{flagged}:timid", **BUSY).planning.window_cells
    assert (cells.iloc[0], set(cells)) == (4, {4, 3}), "no conflicts are met, so that it shrinks to the least"


@pytest.mark.parametrize(("function", "complaints"), [("stay", 1), ("move", 0)])
def test_a_path_that_ends_with_the_move_is_whole_for_planners_of_one_move(flagged, function, complaints):
    problem = random_problem(7, 20)
    planner = load_planner(f"{flagged}:{function}", problem.graph, problem.motion, {})
    reasons = violations(planner, problem)
    assert any("is kept until step 1 only" in reason for reason in reasons) == bool(complaints)


def test_every_flag_arrives_and_has_its_line_in_the_page(flagged):
    page = FilePath(__file__).parents[1].joinpath("docs", "own_planner.md").read_text(encoding="utf-8")
    problem = random_problem(0)
    for flag in fields(Flags):
        assert f"`{flag.name}`" in page
    for name, flags in {
        "whca": Flags(keeps=True, window=Whca.window),
        "token": Flags(complete=True, rests=True, improves=True),
        "timid": Flags(meets_conflicts=True, window=WindowRange(4, 3, 6)),
        "stay": Flags(),
        "move": Flags(one_move=True),
    }.items():
        assert flags_of(load_planner(f"{flagged}:{name}", problem.graph, problem.motion, {})) == flags


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("number", "window = 7: give WindowRange(start, least, most)"),
        ("word", "complete = 'no': give True or False"),
        ("alone", "rests = True: needs complete = True"),
        ("both", "keeps = True: not with complete = True"),
    ],
)
def test_a_flag_that_cant_be_is_named(flagged, capsys, function, reason):
    with pytest.raises(SystemExit) as end:
        main(["check-planner", f"{flagged}:{function}"])
    assert (end.value.code, capsys.readouterr().err) == (2, f"error: check-planner: '{flagged}:{function}': {reason}\n")


SMALL = "garage: map1\nagvs: 2\nplant: discrete\nworkload: {kind: park_exit, cars: 3}\n"


def test_ones_own_planner_runs_a_garage(tmp_path):
    (tmp_path / "small.yaml").write_text(SMALL, encoding="utf-8")
    summary = simulate(load_scenario(str(tmp_path / "small.yaml"), {"planner": f"{OWN}:plan"}), None)
    assert (summary.status, summary.metrics["tasks_done"]) == ("finished", 6)


def test_a_package_offers_a_planner_by_an_entry_point(tmp_path, monkeypatch):
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[{ENTRY_POINTS}]\nprudent = mine_planner:plan\n", encoding="utf-8")
    shutil.copy(OWN, tmp_path / "mine_planner.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    problem = random_problem(1)
    planner = load_planner("prudent", problem.graph, problem.motion, {})
    assert violations(planner, problem) == []


def test_check_planner_passes_ones_own(tmp_path, capsys):
    file = tmp_path / "mine.py"
    shutil.copy(OWN, file)
    with pytest.raises(SystemExit) as end:
        main(["check-planner", f"{file}:plan", "--problems", "10"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"{file}:plan: 10 of 10 answers keep to the contract\n"


def test_a_planner_must_not_write_into_the_problem():
    problem = random_problem(3)
    planner = load_planner("whca", problem.graph, problem.motion, {})

    def careless(p):
        p.no_rest[:] = 1
        return planner(p)

    problem.no_rest[:] = 0
    assert "it changes the problem's arrays" in violations(careless, problem)
