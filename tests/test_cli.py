"""The command line: bad input is one line and exit code 2, and leaves nothing behind."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from analysis.run_files import RUN_FILE
from analysis.runs import load_run
from parking_sim import cli
from parking_sim.demo import RUNS, comparison, complaints_of, results_table
from parking_sim.example_files import copy_examples, example_files
from parking_sim.folders import check_folder, clear_run
from parking_sim.plants.discrete import DiscretePlant
from parking_sim.plants.sumo import SumoPlant
from parking_sim.plants.sumo_api import PlantError
from parking_sim.simulation import Summary
from sumo_nets.errors import InputError

SMALL = "garage: map1\nagvs: 2\nplant: discrete\nworkload: {kind: park_exit, cars: 3}\n"
CSV = "garage: map1\nagvs: 2\nworkload: {kind: csv, path: log.csv}\n"
NO_BAYS = '<net version="1.20"><location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1"/></net>'

FILES = {
    "small.yaml": SMALL,
    "csv.yaml": CSV,
    "unknown_key.yaml": SMALL + "plannner: x\n",
    "no_agvs.yaml": "garage: map1\n",
    "bad.yaml": "garage: [\n",
    "too_many_cars.yaml": "garage: map1\nagvs: 1\nworkload: {kind: park_exit, cars: 62}\n",
    "unknown_zone.yaml": "garage: map1\nagvs: 1\nworkload: {kind: zones, arrivals_per_h: 60, zones: {roof: 1}}\n",
    "bad_option.yaml": SMALL + "planner_options: {no_such: 1}\n",
    "broken.py": "def plan(problem)\n",
    "empty.net.xml": NO_BAYS,
    "empty.add.xml": "<additional/>",
    "layout.yaml": "name: [\n",
    "taken/run.json": "{}",
    "other/notes.txt": "mine",
    "file": "",
}


def words(text: str) -> list[str]:
    return text.split()


#: command line -> what its one line must say
MISTAKES: list[tuple[str, str]] = [
    ("runn", "No such command 'runn'. Did you mean 'run'"),
    ("simulate-it", "No such command 'simulate-it': give one of "),
    ("reproduce nothing", "No such command 'nothing': give one of thesis, "),
    ("reproduce", "Missing command: give one of thesis, "),
    ("run map1 --out a,b", "SUMO reads a comma as the end of a path"),
    ("run map1 --out 50%", "SUMO reads a per cent sign"),
    ("run map1 --out a\\b", "DuckDB reads a backslash"),
    ("run", "scenario"),
    ("run map1 --agv", "No such option"),
    ("run map1 --agvs", "--agvs"),
    ("run map1 --agvs two", "--agvs"),
    ("run map1 --plant moon", "--plant"),
    ("run map1 --agvs -1", "agvs: -1: must be greater than or equal to 1"),
    ("run map1 --agvs 0", "agvs: 0: must be greater than or equal to 1"),
    ("run map1 --seed -1", "seed: -1: must be"),
    ("run map1 --planner best", "planner: 'best': give one of whca"),
    ("run map1 --planner mine.py:plan", "planner: 'mine.py:plan': no such file"),
    ("run map9", "map9: give a scenario (.yaml), a net (.net.xml.gz) or a shipped garage: map1,"),
    ("run nowhere.yaml", "nowhere.yaml: can't be read: No such file"),
    ("run nowhere.net.xml --agvs 1", "garage: 'nowhere.net.xml': no such file"),
    ("run unknown_key.yaml", "unknown_key.yaml: plannner: unknown key; did you mean planner?"),
    ("run no_agvs.yaml", "no_agvs.yaml: agvs: missing"),
    ("run bad.yaml", "bad.yaml: line 2: not YAML"),
    ("run small.yaml --out taken", "--out: taken: holds an earlier run; give another folder, or --force"),
    ("run small.yaml --out other", "--out: other: holds files that are not a run's"),
    ("run small.yaml --out other --force", "--out: other: holds files that are not a run's"),
    ("run small.yaml --out file", "--out: file: can't be written"),
    ("run small.yaml --out file/deeper", "--out: file/deeper: can't be written"),
    ("run small.yaml --out /proc/none/x", "--out: /proc/none/x: can't be written"),
    ("demo --out file", "can't be written"),
    ("build-net", "give one layout file, or --all"),
    ("build-net layout.yaml --all", "give one layout file, or --all"),
    ("build-net nowhere.yaml", "nowhere.yaml"),
    ("build-net layout.yaml", "layout.yaml"),
    ("check-net map9", "map9"),
    ("check-net empty.net.xml", "empty.net.xml"),
    ("draw-net map9 --out a.svg", "map9"),
    ("draw-net map1 --out a.doc", "--out: a.doc: give a file name that ends with .svg or .png"),
    ("draw-net map1", "--out"),
]

#: the same for what only the simulation's set-up can know
SETUP_MISTAKES: list[tuple[str, str]] = [
    ("run map1 --agvs 99", "99"),
    ("run map1 --agvs 99 --plant discrete", "99"),
    ("run map1 --agvs 99 --out taken --force", "99"),
    ("run csv.yaml", "log.csv: row 3: car: 'b': never came"),
    ("run too_many_cars.yaml", "workload.cars: 62: the garage has 61 slots"),
    ("run unknown_zone.yaml", "roof"),
    ("run bad_option.yaml", "planner_options.no_such"),
    ("run small.yaml --planner broken.py:plan", "broken.py"),
    ("run empty.net.xml --agvs 1", "empty.net.xml"),
    ("run small.yaml --gui", "--gui"),
]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder full of mistakes, and the working directory."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (tmp_path / "log.csv").write_text("time_s,kind,car\n0,park,a\n9,retrieve,b\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in folder.rglob("*")}


def call(arguments: Sequence[str]) -> int | str | None:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    return caught.value.code


def check_mistake(workplace: Path, capfd: pytest.CaptureFixture[str], command: str, complaint: str) -> None:
    before = files_in(workplace)
    assert call(words(command)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert files_in(workplace) == before


@pytest.mark.parametrize(("command", "complaint"), MISTAKES, ids=[command for command, _ in MISTAKES])
def test_a_mistake_is_one_line(
    workplace: Path, capfd: pytest.CaptureFixture[str], command: str, complaint: str
) -> None:
    check_mistake(workplace, capfd, command, complaint)


@pytest.mark.parametrize(("command", "complaint"), SETUP_MISTAKES, ids=[command for command, _ in SETUP_MISTAKES])
def test_a_mistake_seen_at_set_up_is_one_line(
    workplace: Path, capfd: pytest.CaptureFixture[str], command: str, complaint: str
) -> None:
    check_mistake(workplace, capfd, command, complaint)


@pytest.mark.parametrize("command", ["run map1 --agvs -1", "run nowhere.yaml", "check-net map9"])
def test_a_mistake_in_a_process_of_its_own(workplace: Path, command: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "parking_sim", *words(command)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("error: ")


@pytest.mark.parametrize("command", ["", "--help", "run --help", "demo --help", "build-net --help"])
def test_help(capfd: pytest.CaptureFixture[str], command: str) -> None:
    assert call(words(command)) == 0
    out, err = capfd.readouterr()
    assert out.startswith("Usage: parking-sim")
    assert err == ""


def test_schema_is_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert call(["schema"]) == 0
    assert "agvs" in json.loads(capfd.readouterr().out)["properties"]


def test_nets_are_listed(capfd: pytest.CaptureFixture[str]) -> None:
    assert call(["nets"]) == 0
    assert {"map1", "map2", "map3"} <= set(capfd.readouterr().out.split())


def test_columns_are_explained(capfd: pytest.CaptureFixture[str]) -> None:
    assert call(["columns"]) == 0
    rows = [line.split("\t") for line in capfd.readouterr().out.splitlines()]
    assert {len(row) for row in rows} == {4}
    assert {("tasks", "done_s"), ("metrics", "throughput")} <= {(row[0], row[1]) for row in rows}


def test_doctor_finds_what_a_run_needs(capfd: pytest.CaptureFixture[str]) -> None:
    assert call(["doctor"]) == 0
    out = capfd.readouterr().out
    assert "MISSING" not in out
    assert "SUMO: SUMO 1.28" in out


def test_a_folder_check_leaves_nothing(tmp_path: Path) -> None:
    check_folder(tmp_path / "a" / "b", force=False)
    assert list(tmp_path.iterdir()) == []


def test_clearing_takes_a_run_and_nothing_else(tmp_path: Path) -> None:
    for name in (RUN_FILE, "tasks.parquet", "report.html", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "old.json").touch()
    clear_run(tmp_path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["kept", "notes.txt", "old.json"]
    clear_run(tmp_path)
    assert (tmp_path / "kept" / "old.json").exists()


def test_a_folder_of_other_files_is_never_cleared(tmp_path: Path) -> None:
    (tmp_path / "precious.json").touch()
    clear_run(tmp_path)
    assert (tmp_path / "precious.json").exists()
    with pytest.raises(InputError):
        check_folder(tmp_path, force=True)


FINISHED = {
    "tasks_done": 4,
    "tasks_wanted": 4,
    "simulated_s": 1800.0,
    "sumo_collisions": 0,
    "footprint_overlaps": 0,
    "least_clearance_m": 0.51,
    "deadlocks_found": 1,
    "deadlocks_resolved": 1,
    "deadlocks_unresolved": 0,
    "retrieval_wait_p95_s": 250.0,
    "requests_conserved": 1,
    "cars_conserved": 1,
    "wall_speed": 900.0,
}


def test_the_demo_complains_of_all_that_is_incomplete_or_unsafe() -> None:
    assert complaints_of(Summary("finished", FINISHED, None)) == []
    failed = "No collision in SUMO: no (2 collisions)"
    assert complaints_of(Summary("stalled", FINISHED, None, (failed,))) == ["ended with status 'stalled'", failed]


def test_the_demo_table_fits_a_narrow_terminal() -> None:
    text = results_table({name: Summary("finished", FINISHED, None) for name in RUNS})
    assert max(map(len, text.split("\n"))) <= 80
    for words_in_it in ("4 / 4", "0.51", "1 / 1", "8.0", "250", "900"):
        assert words_in_it in text


def test_the_demo_names_the_planner_that_was_faster() -> None:
    hours = {"map1": 2.0, "map1-whca": 2.5, "map2": 3.0, "map2-whca": 2.0, "map3": 9.0}
    runs = {name: Summary("finished", {"simulated_s": 3600 * h}, None) for name, h in hours.items()}
    assert comparison(runs) == [
        "map1: token won, token took 2.00 h and whca 2.50 h (-20.0%)",
        "map2: whca won, token took 3.00 h and whca 2.00 h (+50.0%)",
    ]


def test_a_run_writes_its_record_and_says_where(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(words("run small.yaml --out run")) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert out.startswith("finished\n")
    assert "report: run/report.html" in out
    assert json.loads((workplace / "run" / RUN_FILE).read_text())["status"] == "finished"
    assert (workplace / "run" / "report.html").is_file()


def test_a_run_says_how_many_customers_were_turned_away(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A hundred cars come at once to the 61 slots of map1; none that was turned away counts as done."""
    rows = [*(f"0,park,c{k}" for k in range(100)), "30,retrieve,c99"]
    (workplace / "rush.csv").write_text("time_s,kind,car\n" + "\n".join(rows) + "\n")
    (workplace / "rush.yaml").write_text(
        "garage: map1\nagvs: 2\nplant: discrete\nduration_s: 60\nworkload: {kind: csv, path: rush.csv}\n"
    )
    assert call(words("run rush.yaml --out rush --no-replay")) == 0
    out, err = capfd.readouterr()
    assert err == ""
    said = "39 of 100 customers were turned away (39 %): every slot is taken or promised 39"
    assert f"  {said}\nrecord: rush\n" in out
    assert (workplace / "rush" / "report.html").read_text(encoding="utf-8").count(said) == 2
    metrics = json.loads((workplace / "rush" / "metrics.json").read_text())
    assert (metrics["customers_turned_away"], metrics["requests_void"]) == (39, 1)
    assert metrics["tasks_done"] < 10


def test_a_run_in_which_a_check_failed_exits_with_1(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("controller.garage.Garage.audit", lambda garage: ["a car is lost"])
    assert call(words("run small.yaml --out run -q --no-report")) == 1
    assert capfd.readouterr() == ("", "check failed: Every car is accounted for: no (a car is lost)\n")


def test_a_quiet_run_says_nothing(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(words("run small.yaml --out run -q --no-report")) == 0
    assert capfd.readouterr() == ("", "")
    assert not (workplace / "run" / "report.html").exists()


def test_without_a_folder_each_run_gets_a_new_one(workplace: Path) -> None:
    assert call(words("run small.yaml -q --no-report")) == 0
    (folder,) = (workplace / "runs").iterdir()
    assert folder.name.startswith("small-")


def test_force_replaces_a_run(workplace: Path) -> None:
    (workplace / "taken" / "fcd.xml.gz").touch()
    assert call(words("run small.yaml --out taken --force -q --no-report")) == 0
    assert not (workplace / "taken" / "fcd.xml.gz").exists()
    assert json.loads((workplace / "taken" / RUN_FILE).read_text())["status"] == "finished"


def test_ctrl_c_leaves_a_readable_record(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    step, steps = DiscretePlant.step, []

    def interrupted(plant: DiscretePlant) -> None:
        steps.append(1)
        if len(steps) == 50:
            raise KeyboardInterrupt
        step(plant)

    monkeypatch.setattr(DiscretePlant, "step", interrupted)
    assert call(words("run small.yaml --out run -q")) == 130
    assert json.loads((workplace / "run" / RUN_FILE).read_text())["status"] == "interrupted"
    assert (workplace / "run" / "report.html").is_file()


def test_a_run_without_sumo_gui_is_one_line(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("parking_sim.plants.sumo_api.shutil.which", lambda name, path=None: None)
    monkeypatch.setenv("DISPLAY", ":0")
    assert call(words("run map1 --agvs 1 --gui --out run -q")) == 1
    assert capfd.readouterr().err == "error: sumo-gui is not installed: install parking-sim with the extra 'nets'\n"
    assert not (workplace / "run").exists()


def test_a_run_that_sumo_fails_is_one_line_and_leaves_its_record_so_far(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    step = SumoPlant.step

    def failing(plant: SumoPlant) -> None:
        if plant.time_s > 150:
            raise PlantError("SUMO at 150.5 s: no more")
        step(plant)

    monkeypatch.setattr(SumoPlant, "step", failing)
    assert call(words("run map1 --agvs 1 --out run -q")) == 1
    assert capfd.readouterr().err == "error: SUMO at 150.5 s: no more\n"
    left = load_run(workplace / "run")
    assert left.meta["status"] == "killed"
    assert 100 < left.meta["simulated_s"] <= 150
    assert len(left.trajectory)


@pytest.mark.parametrize(
    ("duration", "code"), [("max_time_s: 60", 1), ("duration_s: 60", 0)], ids=["given up", "end asked for"]
)
def test_only_an_end_that_was_asked_for_is_a_success(workplace: Path, duration: str, code: int) -> None:
    (workplace / "short.yaml").write_text(f"{SMALL}{duration}\n", encoding="utf-8")
    assert call(words("run short.yaml --out run -q --no-report")) == code


EXAMPLES = {path.name: path for path in example_files()}
PAGES = ("README.md", "docs/nets.md", "docs/own_planner.md", "docs/scenarios.md")


@pytest.mark.parametrize("page", PAGES)
def test_a_page_shows_the_example_as_it_is(page: str) -> None:
    text = (Path(__file__).parent.parent / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```\w+\n# ([\w.]+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert blocks
    for name, body in blocks:
        assert EXAMPLES[name].read_text(encoding="utf-8").endswith(f"\n{body}")


@pytest.mark.parametrize(
    "command",
    [
        "run rush.yaml --out rush -q",
        "run rush.yaml --planner loaded_first.py:plan --out rush -q",
        "draw-net corner.net.xml.gz --out corner.svg",
        "check-net corner.net.xml.gz",
        "run corner.net.xml.gz --agvs 2 --out corner -q",
        "check-net loop.net.xml.gz",
        "run loop.net.xml.gz --agvs 4 --out loop -q",
        "check-planner own_planner.py:plan --problems 20",
    ],
)
def test_what_the_pages_show_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(tmp_path)
    copy_examples(tmp_path)
    for name in ("corner", "loop"):
        if name in command:
            assert call(["build-net", f"{name}.yaml"]) == 0
    assert call(words(command)) == 0
