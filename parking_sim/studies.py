"""The commands over many runs: sweep, compare, size, tune; and those on demand profiles."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sumo_nets.errors import InputError
from sumo_nets.wording import one_of

if TYPE_CHECKING:
    from analysis.figures import Drawing
    from analysis.size_curve import Sizing
    from demand.profiles import Profile
    from parking_sim.config import Scenario

_UNFINISHED = 1

Workers = Annotated[int | None, typer.Option(help="Processes on this machine; default: one a core.")]
Scheduler = Annotated[str | None, typer.Option(help="A dask scheduler instead, such as tcp://host:8786.")]
Report = Annotated[bool, typer.Option(help="Write an HTML report.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]


def sweep(
    plan: Annotated[Path, typer.Argument(help="A sweep file (.yaml): base, grid, list, seeds.")],
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the sweep; default: runs/ and the file's name.")] = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Run many scenarios; what is done already is skipped, so that a stopped sweep goes on."""
    from parking_sim.many_runs import sweep as run_sweep
    from parking_sim.progress import SweepBar
    from parking_sim.sweep_plan import load_sweep
    from parking_sim.workers import open_executor

    specs = load_sweep(plan)
    folder = out or Path("runs") / plan.stem
    with open_executor(workers, scheduler) as executor, SweepBar(quiet) as bar:
        failures = run_sweep(specs, folder, executor, bar.update)
    for failure in failures:
        seed = failure.spec.scenario.seed
        print(f"failed: {failure.spec.variant.name}, seed {seed}: {failure.error}", file=sys.stderr)
    done = len(specs) - len(failures)
    _say(quiet, f"{done} of {len(specs)} runs: {folder}")
    if report and done:
        _report(folder, quiet)
    raise typer.Exit(_UNFINISHED if failures else 0)


def compare(
    a: Annotated[str, typer.Argument(help="Runs of a variant: a folder, or FOLDER:key=value,... to pick one in it.")],
    b: Annotated[str, typer.Argument(help="Runs of another variant, with the same seeds.")],
    warmup: Annotated[float, typer.Option(help="Minutes at the start that don't count.", min=0)] = 0.0,
    measure: Annotated[list[str] | None, typer.Option(help="Measure to compare instead; may be repeated.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Picture to write, .svg or .png.")] = None,
) -> None:
    """Compare two variants, seed by seed: differences with 95 % intervals, in words, and whether the seeds do."""
    from analysis.compare import HEADLINES, in_words, select_runs, split_choice, table_rows, variant_names
    from analysis.compare import compare as compare_runs
    from analysis.damage import readable
    from analysis.measures import MEASURES
    from parking_sim.terminal import print_table

    _check_finite({"--warmup": warmup})
    for key in measure or ():
        if key not in MEASURES:
            raise InputError(f"--measure: {key!r}: {one_of(MEASURES, key)}")
    if figure is not None and figure.suffix not in (".svg", ".png"):
        raise InputError(f"--figure: {figure}: give a file name that ends with .svg or .png")
    names = variant_names(a, b)
    with readable(Path(split_choice(a)[0])), readable(Path(split_choice(b)[0])):
        found = compare_runs(select_runs(a), select_runs(b), names, 60 * warmup, measure or HEADLINES)
    print_table(table_rows(found), f"{names[1]} against {names[0]}, {len(found.seeds)} seeds")
    for line in in_words(found):
        print(line)
    if figure is not None:
        from analysis.compare import write_comparison

        print(f"figure: {write_comparison(found, figure)}")


def size(
    scenario: Annotated[str, typer.Argument(help="A shipped garage, a scenario file (.yaml) or a net file.")],
    target: Annotated[str, typer.Option(help="What to reach, such as 'retrieval p95 < 5 min'.")],
    profile: Annotated[str | None, typer.Option(help="Demand profile; default: the scenario's own traffic.")] = None,
    start: Annotated[float | None, typer.Option(help="Hour of the day; default: of the busiest hours.")] = None,
    hours: Annotated[float, typer.Option(help="Hours of the profile.", min=0.1, max=24)] = 3.0,
    scale: Annotated[float, typer.Option(help="Factor on the cars of the profile.", min=0.001)] = 1.0,
    max_agvs: Annotated[int | None, typer.Option(help="Greatest fleet; default: all homes.", min=1)] = None,
    max_seeds: Annotated[int, typer.Option(help="Most seeds for a fleet size.", min=3)] = 30,
    also: Annotated[str, typer.Option(help="What to size after the fleet: bays, chargers, or both by a comma.")] = "",
    planner: Annotated[str | None, typer.Option(help="Planner: a name, or file.py:function.")] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the runs; default: a name of its own in runs/.")] = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Find the smallest fleet that meets a target with 95 % confidence."""
    from parking_sim.progress import SweepBar
    from parking_sim.sizing import LOOKS, answer, parse_target, size_garage
    from parking_sim.workers import open_executor

    wanted = parse_target(target)
    base = _scenario_to_size(scenario, planner, profile, (start, hours, scale), wanted.goes_on_s)
    most = _most(base, scenario, max_agvs, also)
    name = Path(scenario).name.split(".")[0]
    where = _where(name, base)
    folder = out or Path("runs") / f"size-{name}-{profile or 'own'}".replace("/", "-")
    looks = (*(look for look in LOOKS if look < max_seeds), max_seeds)
    answers: list[tuple[Sizing, str]] = []
    try:
        with open_executor(workers, scheduler) as executor, SweepBar(quiet) as bar:
            for sizing in size_garage(base, wanted, most, folder, executor, looks, bar.update):
                answers.append((sizing, answer(sizing, where)))
                _keep_sizing(answers, folder)
    finally:  # an answer that was found is told, whatever happens to the next one
        if answers:
            _tell_sizing(answers, where, folder, report, quiet)
    raise typer.Exit(0 if answers[0][0].number else _UNFINISHED)


def tune(
    scenario: Annotated[str, typer.Argument(help="A shipped garage, a scenario file (.yaml) or a net file.")],
    vary: Annotated[list[str], typer.Option(help="Key and range, such as control.period_s=2..10; may be repeated.")],
    measure: Annotated[str, typer.Option(help="What to make small (or great, where that is good).")] = (
        "retrieval_wait_p95_s"
    ),
    trials: Annotated[int, typer.Option(help="Settings to try.", min=1)] = 20,
    seeds: Annotated[str, typer.Option(help="Seeds of each setting.")] = "1..5",
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the runs; default: runs/tune- and the name.")] = None,
    quiet: Quiet = False,
) -> None:
    """Tune parameters of the controller with optuna, on the same seeds for every setting."""
    from analysis.variants import label
    from parking_sim.sweep_plan import parse_seeds
    from parking_sim.terminal import print_table
    from parking_sim.tuning import parse_ranges, tune_scenario
    from parking_sim.workers import open_executor

    name = Path(scenario).name.split(".")[0]
    folder = out or Path("runs") / f"tune-{name}"
    with open_executor(workers, scheduler) as executor:
        results = tune_scenario(
            scenario, parse_ranges(vary), measure, trials, parse_seeds(seeds, "--seeds"), folder, executor
        )
    rows = [
        {"setting": label(r.values), measure: _finite(r.mean.mean, 5), "±": _finite(r.mean.half, 3)}
        for r in results[:10]
    ]
    print_table(rows, f"{name}: the best of {len(results)} settings")
    if results and math.isinf(results[0].mean.mean):
        print(
            "Every setting turns too many customers away for this measure; --measure turned_away_share tells them apart"
        )
    _say(quiet, f"runs: {folder}")


def _finite(value: float, figures: int) -> str:
    """A value with ``figures`` digits, or "endless": customers turned away count as waits without end."""
    return "endless" if math.isinf(value) else f"{value:.{figures}g}"


def profiles(
    name: Annotated[str | None, typer.Argument(help="A profile's name or file; default: list all.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Picture to write, .svg or .png.")] = None,
) -> None:
    """List the demand profiles with their sources, or show the hours of one."""
    from demand.profiles import PROFILES, find_profile
    from parking_sim.terminal import print_table

    if figure is not None and figure.suffix not in (".svg", ".png"):
        raise InputError(f"--figure: {figure}: give a file name that ends with .svg or .png")
    chosen: Mapping[str, Profile] = PROFILES if name is None else {name: find_profile(name)}
    for key, profile in chosen.items():
        daily = profile.arrivals_between(profile.hours[0], profile.hours[-1])
        print(f"{key}: {profile.words}; {daily:.2f} cars a day for each slot")
        print(f"    source: {profile.source}")
        print(f"    licence: {profile.licence or 'not stated'}")
    if name is not None:
        print_table(_hour_rows(chosen[name]), name)
    if figure is not None:
        from analysis.profile_figure import write_profiles_figure

        print(f"figure: {write_profiles_figure(chosen, figure)}")


def _scenario_to_size(
    source: str, planner: str | None, profile: str | None, stretch: tuple[float | None, float, float], goes_on_s: float
) -> Scenario:
    """The scenario with the hours of a profile. It goes on for ``goes_on_s`` seconds after the last request."""
    from demand.profiles import find_profile
    from parking_sim.config import load_scenario, scenario_keys

    keys, _ = scenario_keys(source)
    given: dict[str, object] = {} if "agvs" in keys else {"agvs": 1}  # what is sized need not be known
    if planner is not None:
        given["planner"] = planner
    if profile is not None:
        start, hours, scale = stretch
        _check_finite({"--start": start, "--hours": hours, "--scale": scale})
        found = find_profile(profile)
        hours = min(hours, found.hours[-1] - found.hours[0])
        begin = found.busiest(hours) if start is None else start
        own = profile != Path(profile).name or Path(profile).is_file()
        name = str(Path(profile).resolve()) if own else profile
        given["workload"] = {"kind": "profile", "name": name, "start_h": begin, "hours": hours, "scale": scale}
        given["duration_s"] = 3600 * hours + goes_on_s
    return load_scenario(source, given)


def _most(scenario: Scenario, name: str, max_agvs: int | None, also: str) -> dict[str, int]:
    """What to size, in order, and the greatest number of each, with which the scenario fits its garage."""
    from parking_sim.assembly import assemble
    from sumo_nets.in_use import chosen_homes
    from sumo_nets.read import read_net

    net = chosen_homes(read_net(scenario.garage_source), scenario.homes)
    homes = len(net.graph.homes)
    if max_agvs is not None and max_agvs > homes:
        raise InputError(f"--max-agvs: {max_agvs}: {name} has homes for 1 to {homes}")
    there = {"bays": len(net.bay_sites), "chargers": len(net.graph.chargers)}
    most = {"agvs": max_agvs or homes}
    for what in also.split(",") if also else ():
        if what not in there:
            raise InputError(f"--also: {what!r}: {one_of(there)}, or both with a comma between them")
        if not there[what]:
            raise InputError(f"--also: {what}: {name} has none")
        most[what] = there[what]
    assemble(scenario.model_copy(update=dict(most)))
    return most


def _check_finite(options: Mapping[str, float | None]) -> None:
    for option, value in options.items():
        if value is not None and not math.isfinite(value):
            raise InputError(f"{option}: {value}: give a finite number")


def _where(name: str, scenario: Scenario) -> str:
    from analysis.clock import hour_text
    from demand.profile_traffic import ProfileTraffic

    traffic = scenario.workload
    if not isinstance(traffic, ProfileTraffic):
        return f"{name} with {getattr(traffic, 'kind', 'its')} traffic"
    begin = traffic.day_start_h(scenario.base_dir)
    times = "" if traffic.scale == 1 else f" times {traffic.scale:g}"
    hours = f"{hour_text(begin)} to {hour_text(begin + (traffic.hours or 0.0))}"
    return f"{name}, {Path(traffic.name).stem}{times} from {hours}"


def _sizing_rows(sizing: Sizing) -> list[dict[str, str]]:
    from analysis.size_curve import SIZED

    target, what = sizing.target, sizing.target.words.partition(" <")[0]
    return [
        {
            SIZED[sizing.what]: str(tried.number),
            f"{what}, {target.unit}": target.shown(tried.mean.mean),
            "95 % interval": f"{target.shown(tried.mean.low)} .. {target.shown(tried.mean.high)}"
            if math.isfinite(tried.mean.mean)
            else "–",
            "turned away": f"{sizing.away[tried.number].number} of {sizing.away[tried.number].came}",
            "seeds": str(len(tried.values)),
            "meets it": "yes" if tried.meets else "no",
        }
        for tried in sizing.tried
    ]


def _keep_sizing(answers: Sequence[tuple[Sizing, str]], folder: Path) -> None:
    """The answers so far as JSON."""
    from analysis.record import write_json

    target = answers[0][0].target
    sized = [
        {
            "what": sizing.what,
            "number": sizing.number,
            "answer": sentence,
            "tried": [
                {
                    "number": tried.number,
                    "meets": tried.meets,
                    "values": tried.values,
                    "customers_came": sizing.away[tried.number].came,
                    "customers_turned_away": sizing.away[tried.number].number,
                }
                for tried in sizing.tried
            ],
        }
        for sizing, sentence in answers
    ]
    asked = {"words": target.words, "measure": target.key, "limit": target.limit}
    write_json(folder / "sizing.json", {"target": asked, "sized": sized})


def _tell_sizing(answers: Sequence[tuple[Sizing, str]], where: str, folder: Path, report: bool, quiet: bool) -> None:
    """The answers on the terminal, as curves and as a report."""
    from analysis.size_curve import size_curve, write_curve
    from parking_sim.terminal import print_table

    curves = []
    for sizing, sentence in answers:
        print_table(_sizing_rows(sizing), where)
        print(sentence)
    for sizing, _ in answers:
        curves.append(size_curve(sizing))
        path = folder / f"curve-{sizing.what}.svg"
        write_curve(curves[-1], path)
        _say(quiet, f"curve: {path}")
    if report:
        _report(folder, quiet, [sentence for _, sentence in answers], curves)


def _report(folder: Path, quiet: bool, answers: Sequence[str] = (), drawings: Sequence[Drawing] = ()) -> None:
    from analysis.sweep_report import write_sweep_report

    _say(quiet, f"report: {write_sweep_report(folder, answers, drawings)}")


def _hour_rows(profile: Profile) -> list[dict[str, str]]:
    from analysis.clock import hour_text

    rows = []
    for begin, end in zip(profile.hours, profile.hours[1:], strict=False):
        rows.append(
            {
                "from": hour_text(begin),
                "to": hour_text(end),
                "arrive, % of slots": f"{100 * profile.arrivals_between(begin, end):.1f}",
                "leave, % of slots": f"{100 * profile.departures_between(begin, end):.1f}",
                "occupied at the end, %": f"{100 * profile.occupancy_at(end):.1f}",
                "source says, %": f"{100 * profile.observed[end]:.1f}" if end in profile.observed else "",
            }
        )
    return rows


def _say(quiet: bool, text: str) -> None:
    if not quiet:
        print(text)
