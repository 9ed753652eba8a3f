"""The command line. What the user can put right is one line on stderr and exit code 2.

Everything heavy is imported where it is used, so that ``--help`` answers at once.
"""

from __future__ import annotations

import errno
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from parking_sim import gate_logs, planner_check, routes, studies
from parking_sim.command_groups import Grouped
from parking_sim.errors import RunFailedError
from parking_sim.interrupts import ended_like_by_ctrl_c
from parking_sim.reproduce import app as reproduce_app
from parking_sim.shadowing import require_own_packages
from parking_sim.terminal import open_standard_streams
from sumo_nets.errors import InputError
from sumo_nets.interrupted import as_interrupts
from sumo_nets.whole_file import write_whole
from sumo_nets.wording import cut, one_of

if TYPE_CHECKING:
    from analysis.clock import Clock
    from parking_sim.config import Scenario
    from parking_sim.simulation import RunProgress, Summary

#: Exit codes: a run did not finish its work, or a check of it failed; bad input; Ctrl-C.
UNFINISHED, BAD_INPUT, INTERRUPTED = 1, 2, 130

app = typer.Typer(
    name="parking-sim",
    help="Robotic parking garages in SUMO: AGVs park cars and bring them back.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    cls=Grouped,
    epilog="Help on one command, with an example: parking-sim COMMAND --help",
)
app.add_typer(reproduce_app, name="reproduce")


for _study in (studies.sweep, studies.compare, studies.size, studies.tune, studies.profiles):
    app.command()(_study)
app.command()(gate_logs.fit_profile)
app.command()(gate_logs.requests)
app.command()(planner_check.check_planner)
app.command()(routes.route)
app.command()(routes.turns)


def _print_version(wanted: bool) -> None:
    if wanted:
        import parking_sim

        print(f"parking-sim {parking_sim.__version__}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Robotic parking garages in SUMO: AGVs park cars and bring them back."""


class TraceMethod(StrEnum):
    """What traces guide paths."""

    RRT_GRID = "rrt-grid"
    VISIBILITY = "visibility"


class PlantName(StrEnum):
    """What moves the AGVs."""

    SUMO = "sumo"
    DISCRETE = "discrete"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    Args:
        arguments: words after the program's name; those of the process by default.

    Raises:
        SystemExit: always.
    """
    open_standard_streams()
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    usage_error = cast(type[Exception], typer.BadParameter.__bases__[0])
    came: list[int] = []
    try:
        if "doctor" not in words:  # which tells of hidden packages among all else
            require_own_packages()
        with ended_like_by_ctrl_c() as came, as_interrupts():
            code = app(words, prog_name=app.info.name, standalone_mode=False) or 0
        sys.stdout.flush()
    except usage_error as error:
        _complain(_usage(error))
        code = BAD_INPUT
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted", file=sys.stderr)
        code = INTERRUPTED
    except InputError as error:
        _complain(str(error))
        code = BAD_INPUT
    except RunFailedError as error:
        _complain(str(error))
        code = UNFINISHED
    except BrokenPipeError:  # whoever read our words has gone
        _mute()
        code = UNFINISHED
    except OSError as error:
        if error.filename is None:  # all errors of files have their names
            _mute()
        _complain(f"{cut(str(error.filename or 'standard output'), 4000)}: {error.strerror or error}")
        code = BAD_INPUT if error.errno == errno.ENAMETOOLONG else UNFINISHED
    raise SystemExit(128 + came[0] if came and code == INTERRUPTED else code)


def _mute() -> None:
    """Print no more, so that the end of the process does not try again to write what could not be written."""
    with suppress(OSError):  # it may have no number
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A scenario file (.yaml), a shipped garage, or a net file.")],
    agvs: Annotated[int | None, typer.Option(help="Number of AGVs.")] = None,
    planner: Annotated[str | None, typer.Option(help="Planner: a name, or file.py:function.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random stream.")] = None,
    plant: Annotated[PlantName | None, typer.Option(help="What moves the AGVs.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the record; default: a new one in runs/.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier run in that folder.")] = False,
    gui: Annotated[bool, typer.Option("--gui", help="Watch it in sumo-gui.")] = False,
    fcd: Annotated[bool, typer.Option("--fcd", help="Write SUMO's floating car data as well.")] = False,
    report: Annotated[bool, typer.Option(help="Write an HTML report.")] = True,
    replay: Annotated[
        bool | None, typer.Option("--replay/--no-replay", help="Write an HTML replay; default: as record.replay says.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run one scenario and write its record."""
    from parking_sim.config import load_scenario

    given = {"agvs": agvs, "planner": planner, "seed": seed, "plant": plant.value if plant else None}
    loaded = load_scenario(scenario, {key: value for key, value in given.items() if value is not None})
    if loaded.plant != "sumo" and (gui or fcd):
        raise InputError(f"{'--gui' if gui else '--fcd'}: plant is {loaded.plant}: only SUMO has it; give --plant sumo")
    if gui:
        from parking_sim.plants.sumo_api import check_display

        check_display()
    name = Path(scenario).name.split(".")[0]
    folder = out or Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    from parking_sim.folders import check_folder

    check_folder(folder, force)
    from parking_sim.simulation import simulate

    if not quiet:
        _warn_of_blocked_ways(loaded)
    with _progress_bar(name, quiet) as progress:
        summary = simulate(loaded, folder, gui=gui, fcd=fcd, progress=progress)
    replayed = loaded.record.replay if replay is None else replay
    pages = _write_pages(folder, report, replayed)
    if not quiet:
        _print_summary(summary, folder, pages)
    raise typer.Exit(_verdict(summary, loaded.duration_s is not None))


@app.command("replay")
def replay_(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    start: Annotated[
        str | None,
        typer.Option("--from", help="Show from here on: seconds, or h:mm:ss of its clock."),
    ] = None,
    end: Annotated[str | None, typer.Option("--to", help="Show up to this time.")] = None,
) -> None:
    """Write the replay of a run: one HTML file to watch it in a browser, offline."""
    from analysis.clock import Clock
    from analysis.damage import readable
    from analysis.replay import load_replayed, write_replay

    try:
        with readable(folder):
            clock = Clock.of(load_replayed(folder).meta)
            print(write_replay(folder, _moment("--from", start, clock), _moment("--to", end, clock)))
    except OSError as error:
        raise InputError(f"{folder}: can't be written: {error.strerror}") from None


Trust = Annotated[bool, typer.Option("--trust", help="Run the planner's file that the folder holds: it is code.")]


@app.command()
def resume(
    folder: Annotated[Path, typer.Argument(help="Folder of a run that was killed.")],
    trust: Trust = False,
    report: Annotated[bool, typer.Option(help="Write an HTML report.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Finish a run that was killed: simulated anew, compared with what it had recorded, to the same record."""
    from analysis.run_files import SCENARIO_FILE, did_not_end
    from parking_sim.config import load_scenario
    from parking_sim.inputs import check_trust
    from parking_sim.simulation import simulate

    if not did_not_end(folder):
        raise InputError(f"{folder}: no run that did not end; nothing to resume")
    if not (folder / SCENARIO_FILE).is_file():
        raise InputError(f"{folder}: the run was killed before it began; run its scenario again with --force")
    check_trust(folder, trust)
    loaded = load_scenario(folder / "scenario.yaml")
    with _progress_bar(folder.name, quiet) as progress:
        summary = simulate(loaded, folder, progress=progress, resumed=True)
    pages = _write_pages(folder, report, loaded.record.replay)
    if not quiet:
        _print_summary(summary, folder, pages)
    raise typer.Exit(_verdict(summary, loaded.duration_s is not None))


@app.command("rerun")
def rerun_(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the new record; default: none is kept.")] = None,
    trust: Trust = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but differences and errors.")] = False,
) -> None:
    """Run a record's scenario again, from the files in its folder, and compare the two records table by table."""
    from analysis.damage import readable
    from parking_sim.rerun import rerun

    if out is not None:
        from parking_sim.folders import check_folder

        check_folder(out, force=False)
    with _progress_bar(folder.name, quiet) as progress, readable(folder):
        found = rerun(folder, out, progress, trust=trust)
    for line in (*found.notes, *found.differences):
        print(line)
    if not found.differences and not quiet:
        print("the same record came out")
    raise typer.Exit(UNFINISHED if found.differences else 0)


@app.command()
def demo(
    out: Annotated[Path | None, typer.Option(help="Folder for records and report; default: runs/demo, anew.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace earlier runs in that folder.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, only the table.")] = False,
    cars: Annotated[
        int | None, typer.Option(help="Cars in each garage; default: as many as it has slots.", min=1, max=61)
    ] = None,
) -> None:
    """Park every car of map1, map2 and map3 in SUMO, bring every car back, and write a report."""
    from parking_sim.demo import run_demo

    raise typer.Exit(run_demo(out or Path("runs/demo"), force or out is None, quiet, cars))


@app.command()
def nets() -> None:
    """List the shipped garages."""
    from sumo_nets.read import shipped_nets

    for name in shipped_nets():
        print(name)


@app.command()
def build_net(
    layout: Annotated[Path | None, typer.Argument(help="A layout file (.yaml).")] = None,
    every: Annotated[bool, typer.Option("--all", help="Build every shipped layout.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the net; default: the layout's, or the shipped nets' with --all.")
    ] = None,
) -> None:
    """Build SUMO nets from layouts with netconvert."""
    import sumo_nets
    from sumo_nets.build import build_net as build
    from sumo_nets.layout import load_layout

    if (layout is None) != every:
        raise InputError("build-net: give one layout file, or --all")
    package = Path(sumo_nets.__file__).parent
    paths = sorted((package / "layouts").glob("*.yaml")) if layout is None else [layout]
    for path in paths:
        folder = out or (package / "nets" if every else path.parent)
        try:
            written = build(load_layout(path), folder, str(path))
        except OSError as error:
            raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None
        for file in written:
            print(file)


@app.command()
def trace_lanes(
    plan: Annotated[Path, typer.Argument(help="A floor plan (.yaml): walls, pillars, boxes for slots and bays.")],
    out: Annotated[Path | None, typer.Option(help="Layout to write; default: PLAN_layout.yaml beside it.")] = None,
    method: Annotated[TraceMethod, typer.Option(help="What traces the guide paths.")] = TraceMethod.RRT_GRID,
    seed: Annotated[int, typer.Option(min=0, help="Seed of RRT-GRID.")] = 1,
    draw: Annotated[Path | None, typer.Option(help="Also draw plan, paths and lanes: a .svg or .png file.")] = None,
) -> None:
    """Trace guide paths through a floor plan, and write them as lanes of a layout."""
    from sumo_nets.freespace.drawing import describe, draw_tracing, tracing_yaml
    from sumo_nets.freespace.floorplan import load_plan
    from sumo_nets.freespace.trace import trace_lanes as trace

    if draw is not None and draw.suffix not in (".svg", ".png"):
        raise InputError(f"--draw: {draw}: give a file name that ends with .svg or .png")
    floor_plan, walls = load_plan(plan)
    target = out or plan.with_name(f"{plan.stem}_layout.yaml")
    tracing = trace(floor_plan, walls, method.value, seed, str(plan))
    try:
        write_whole(target, tracing_yaml(tracing, plan.name))
        if draw is not None:
            draw_tracing(tracing, floor_plan, walls, draw)
    except OSError as error:
        raise InputError(f"{error.filename}: can't be written: {error.strerror}") from None
    print(describe(tracing))
    print(target)


@app.command()
def check_net(
    nets: Annotated[list[str] | None, typer.Argument(help="Shipped garages or net files.")] = None,
    scenario: Annotated[
        Path | None, typer.Option(help="A scenario (.yaml) whose AGVs drive there; without NETS its garage is checked.")
    ] = None,
    length: Annotated[float | None, typer.Option(help="Length of the AGVs, metres; default: the scenario's.")] = None,
    width: Annotated[float | None, typer.Option(help="Width of the AGVs, metres; default: the scenario's.")] = None,
) -> None:
    """Check nets: every place reachable and left, lanes whole, room for the AGVs, SUMO loads them silently."""
    from parking_sim.config import AgvConfig, load_scenario
    from sumo_nets.check import check_net as check
    from sumo_nets.check import describe_net
    from sumo_nets.read import read_net

    for option, value in (("--length", length), ("--width", width)):
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{option}: {value:g}: give metres above 0")
    loaded = load_scenario(scenario) if scenario else None
    if not nets and loaded is None:
        raise InputError("check-net: give a shipped garage, a net file or a --scenario")
    agv = loaded.agv if loaded else AgvConfig()
    size_m = (length or agv.length_m, width or agv.width_m)
    faults = 0
    for name in nets or [str(loaded.garage_source if loaded else "")]:
        garage = read_net(name)
        complaints = check(garage, size_m)
        faults += len(complaints)
        for line in complaints:
            print(f"{name}: {line}")
        if not complaints:
            print(f"{describe_net(garage)}; ok")
    raise typer.Exit(UNFINISHED if faults else 0)


@app.command()
def draw_net(
    net: Annotated[str, typer.Argument(help="A shipped garage or a net file.")],
    out: Annotated[Path, typer.Option(help="Picture to write, .svg or .png.")],
) -> None:
    """Draw a net as a picture."""
    from sumo_nets.draw import draw_net as draw
    from sumo_nets.read import read_net

    if out.suffix not in (".svg", ".png"):
        raise InputError(f"--out: {out}: give a file name that ends with .svg or .png")
    garage = read_net(net)
    try:
        draw(garage, out)
    except OSError as error:
        raise InputError(f"--out: {out}: can't be written: {error.strerror}") from None
    print(out)


@app.command()
def explain(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    number: Annotated[int | None, typer.Argument(help="Number of a deadlock, from 0; default: the whole run.")] = None,
    svg: Annotated[Path | None, typer.Option(help="Draw this deadlock into a file.")] = None,
) -> None:
    """Explain a run: what held it at its end, its deadlocks and what resolved them, and the longest waits of AGVs."""
    from analysis.damage import readable
    from analysis.explain import explain as explanation

    with readable(folder):
        print(explanation(folder, number, svg))


@app.command()
def schema() -> None:
    """Print the JSON schema of scenario files."""
    from parking_sim.config import Scenario

    print(json.dumps(Scenario.model_json_schema(), indent=2))


@app.command()
def columns() -> None:
    """Explain every column of a record's tables and every metric: table, name, unit, meaning, separated by tabs."""
    from analysis.metrics import METRICS
    from analysis.record import COLUMNS, EVENTS
    from parking_sim.columns import run_columns

    for table, entries in {**COLUMNS, "kinds": EVENTS, "metrics": METRICS, "runs": run_columns()}.items():
        for name, (unit, meaning) in entries.items():
            print(table, name, unit, meaning, sep="\t")


@app.command()
def examples(
    out: Annotated[Path | None, typer.Option(help="Folder to copy them to; default: only say where they are.")] = None,
) -> None:
    """List the example files that come with the program, or copy them: scenarios, a layout, a sweep and planners."""
    from parking_sim.example_files import copy_examples, example_files

    for path in example_files() if out is None else copy_examples(out):
        print(path)


@app.command()
def doctor() -> None:
    """Say whether this installation can run: versions, SUMO, compiled searches, netconvert."""
    from parking_sim.doctor import examine

    findings = examine()
    for finding in findings:
        mark = "ok" if finding.ok else "MISSING" if finding.needed else "absent"
        print(f"{mark:8}{finding.what}: {finding.detail}")
    raise typer.Exit(UNFINISHED if any(f.needed and not f.ok for f in findings) else 0)


def _verdict(summary: Summary, has_end: bool) -> int:
    """Say which checks of a run failed, and give its exit code: 0, 1 for one that is unfinished or wrong, or 130.

    ``has_end``: the scenario has a duration, so that reaching it is no failure.
    """
    if summary.status == "interrupted":
        return INTERRUPTED
    for line in summary.failed:
        print(f"check failed: {line}", file=sys.stderr)
    ended = summary.status == "finished" or (summary.status == "time_limit" and has_end)
    return 0 if ended and not summary.failed else UNFINISHED


def _warn_of_blocked_ways(scenario: Scenario) -> None:
    """One line if AGVs at their end points may be in others' way, which not every planner copes with.

    Raises:
        NetError: the run would be refused.
    """
    from sumo_nets.check import require_fit
    from sumo_nets.read import read_net
    from sumo_nets.well_formed import blocked_ways, describe

    net = read_net(scenario.garage_source)
    require_fit(net, scenario.agv.size_m)
    if blocked_ways(net.graph):
        print(f"warning: {net.name} is {describe(net.graph)}", file=sys.stderr)


def _usage(error: Exception) -> str:
    """What is wrong with the words given; typer itself names the valid commands only where one is like that given."""
    message: str = getattr(error, "format_message", error.__str__)().replace("Value error, ", "")
    commands = getattr(getattr(getattr(error, "ctx", None), "command", None), "commands", {})
    lacks_command = "command" in message and "Did you mean" not in message
    return f"{message.rstrip('.')}: {one_of(commands)}" if commands and lacks_command else message


def _complain(message: str) -> None:
    for line in message.splitlines() or [""]:
        print("error:", " ".join(line.split()), file=sys.stderr)


@contextmanager
def _progress_bar(name: str, quiet: bool) -> Iterator[Callable[[RunProgress], None] | None]:
    """What to call with a run's progress; nothing when it is quiet or stderr is not a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from parking_sim.progress import RunBars

    with RunBars([name]) as bars:
        yield lambda progress: bars.update(name, progress)


def _moment(option: str, text: str | None, clock: Clock) -> float | None:
    """Simulated seconds of a moment given on the command line."""
    try:
        return None if text is None else clock.seconds(text)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None


def _write_pages(folder: Path, report: bool, replay: bool) -> dict[str, Path]:
    """The pages asked for, by what they are; the replay first, so that the report finds it to link to."""
    from analysis.replay import write_replay
    from analysis.report import write_report

    pages = {}
    if replay:
        with suppress(InputError):  # stopped before the first sample: there is nothing to show
            pages["replay"] = write_replay(folder, report=report)
    return {"report": write_report(folder), **pages} if report else pages


def _print_summary(summary: Summary, folder: Path, pages: Mapping[str, Path]) -> None:
    from analysis.tables import load_run
    from analysis.turned_away import turned_away, turned_away_words

    shown = (
        ("tasks_done", "tasks done"),
        ("tasks_wanted", "of"),
        ("simulated_s", "simulated seconds"),
        ("retrieval_wait_p95_s", "retrieval wait, 95 % (s)"),
        ("deadlocks_found", "deadlocks found"),
        ("deadlocks_resolved", "deadlocks resolved"),
        ("sumo_collisions", "SUMO collisions"),
        ("footprint_overlaps", "footprint overlaps"),
        ("least_clearance_m", "least clearance (m)"),
    )
    print(summary.status)
    for key, words in shown:
        value = summary.metrics.get(key)
        if isinstance(value, int | float) and not math.isnan(value):
            print(f"  {words:26} {value:.6g}")
    print(f"  {turned_away_words(turned_away(load_run(folder).tasks))}")
    for line in summary.held:
        print(f"held: {line}")
    print(f"record: {folder}")
    for what, page in pages.items():
        print(f"{what}: {page}")
