"""Paper 000, experiment: ten robots make ten round trips on a one-line grid, with and without replanning.

The paper repeats each form three times; ours are the first three seeds, and thirty for the share of runs that lock up.
The robots and the floor are told in ``one_line_robots``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.measures import interval
from parking_sim.reproduce.findings import Finding, Verdict, findings_table, make_folder, settled, write_findings
from parking_sim.reproduce.one_line_robots import Setting, drive
from parking_sim.reproduce.published import published
from parking_sim.reproduce.statistics import is_less, is_most, wilson
from parking_sim.workers import open_executor
from sumo_nets.whole_file import whole_file

REPEATS = 3
#: Round trips and seeds of each form.
FULL, QUICK = (10, 30), (1, 2)
WITHOUT, WITH = "without", "with"
#: Other sigmas for which the share of deadlocks without replanning is looked at in the full form, and their seeds.
NOISES, NOISE_SEEDS = (0.05, 0.3), 10


@dataclass(frozen=True, slots=True)
class Task:
    """One run: the experiment, with or without replanning, and the seed."""

    setting: Setting
    form: str
    seed: int


def reproduce(folder: Path, full: bool) -> None:
    """Run the experiment, print the table and write it with the runs and the figure.

    Args:
        folder: where ``lg.csv``, ``.md``, ``-runs.csv`` and ``.svg`` go.
        full: ten round trips and thirty seeds; else one round trip and two seeds.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    round_trips, seeds = FULL if full else QUICK
    setting = Setting(round_trips=round_trips)
    runs = run_experiment(setting, seeds, NOISE_SEEDS if full else 0)
    findings = [*compare(runs, setting)]
    runs.to_csv(folder / "lg-runs.csv", index=False, float_format="%.6g")
    write_findings(findings, folder, "lg", full)
    draw(runs, setting, folder / "lg.svg")
    print(findings_table(findings, full), end="")
    print(f"table and figure: {folder}")


def run_experiment(setting: Setting, seeds: int, noise_seeds: int, workers: int | None = None) -> pd.DataFrame:
    """All runs.

    Args:
        setting: the experiment.
        seeds: of each form.
        noise_seeds: of the form without replanning for each of the other ``NOISES``.
        workers: processes; one for each core by default.

    Returns:
        A row a run: form, noise, seed, deadlock, ended_s, plans, predicted, and arrivals by robot, ``a0`` and so on.
    """
    tasks = [Task(setting, form, seed) for seed in range(seeds) for form in (WITH, WITHOUT)]
    tasks += [Task(replace(setting, noise=noise), WITHOUT, seed) for noise in NOISES for seed in range(noise_seeds)]
    with open_executor(workers) as executor:
        return pd.DataFrame(executor.map(run_one, tasks))


def run_one(task: Task) -> dict[str, object]:
    """One run as a row, see :func:`run_experiment`."""
    o = drive(task.setting, task.form == WITH, task.seed)
    row: dict[str, object] = {"form": task.form, "noise": task.setting.noise, "seed": task.seed}
    row |= {"deadlock": o.deadlock, "ended_s": o.ended_s, "plans": o.plans, "predicted": o.predicted}
    return row | {f"a{n}": arrivals for n, arrivals in enumerate(o.arrivals)}


def compare(runs: pd.DataFrame, setting: Setting) -> Iterator[Finding]:
    """The paper's figures beside those of the runs.

    Args:
        runs: the frame of :func:`run_experiment`.
        setting: the experiment.
    """
    paper, most = published("lg"), 2 * setting.round_trips
    for form in (WITHOUT, WITH):
        rows = _rows(runs, form, setting)
        arrivals = _arrivals(rows)
        for n, printed in enumerate(paper[form]):
            what = f"robot {chr(ord('A') + n)}: arrivals of {most}, {form} replanning"
            yield _mean(what, f"{printed:.1f} of 20", arrivals[:, n].tolist())
        mean = sum(paper[form]) / len(paper[form])
        what = f"all robots: arrivals of {most}, {form} replanning"
        yield _mean(f"{what}, {REPEATS} repeats", f"{mean:.1f} of 20", arrivals[:REPEATS].mean(axis=1).tolist())
        yield _mean(what, f"{mean:.1f} of 20", arrivals.mean(axis=1).tolist())
    without, with_ = (_rows(runs, form, setting)["deadlock"].tolist() for form in (WITHOUT, WITH))
    locked = f"{paper['deadlocks_without']} of {REPEATS}"
    free = f"{paper['deadlocks_with']} of {REPEATS}"
    yield _share("most runs in deadlock, without replanning", locked, without, is_most(sum(without), len(without)))
    yield _share("no run in deadlock, with replanning", free, with_, _never(with_))
    less = is_less([float(d) for d in with_], [float(d) for d in without])
    ours = f"{sum(with_)} and {sum(without)} of {len(without)}"
    yield Finding("fewer runs in deadlock with replanning, by seed", f"{free} and {locked}", ours, "", less)
    for noise in NOISES:
        rows = _rows(runs, WITHOUT, replace(setting, noise=noise))
        if len(rows):
            yield _share(f"runs in deadlock, without replanning, noise sigma {noise:g}", "", rows["deadlock"].tolist())
    rows = _rows(runs, WITH, setting)
    yield _mean("with replanning: calls for a predicted collision, a run", "", rows["predicted"].tolist())
    yield _mean("with replanning: minutes until all are done", "", (rows["ended_s"] / 60).tolist())


def _never(deadlocks: Sequence[bool]) -> Verdict:
    """Whether there are no deadlocks at all: runs so few that half of all may lock up can't tell."""
    few = is_most(0, len(deadlocks)) is Verdict.TOO_FEW
    return Verdict.TOO_FEW if few else settled(not any(deadlocks))


def _rows(runs: pd.DataFrame, form: str, setting: Setting) -> pd.DataFrame:
    return runs[(runs["form"] == form) & (runs["noise"] == setting.noise)]


def _arrivals(rows: pd.DataFrame) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Arrivals of the robots, a row a run."""
    return rows.filter(regex="^a[0-9]").to_numpy(dtype=np.float64)


def _mean(what: str, paper: str, values: Sequence[float]) -> Finding:
    ours = interval(values)
    return Finding(what, paper, f"{ours.mean:.1f}", f"{ours.low:.1f} to {ours.high:.1f}")


def _share(what: str, paper: str, deadlocks: Sequence[bool], holds: Verdict = Verdict.NO_CLAIM) -> Finding:
    low, high = wilson(sum(deadlocks), len(deadlocks))
    words = f"{100 * low:.0f} to {100 * high:.0f} %"
    return Finding(what, paper, f"{sum(deadlocks)} of {len(deadlocks)}", words, holds)


def draw(runs: pd.DataFrame, setting: Setting, path: Path) -> None:
    """Draw the arrivals per robot beside the paper's."""
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, ORANGE, WIDTH_IN, style

    paper = published("lg")
    names = [chr(ord("A") + n) for n in range(setting.line.robots)]
    x = np.arange(len(names))
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.0))
        axes = figure.subplots()
        for form, colour, side in ((WITHOUT, ORANGE, -0.2), (WITH, BLUE, 0.2)):
            arrivals = _arrivals(_rows(runs, form, setting))
            means = [interval(arrivals[:, n].tolist()) for n in range(len(names))]
            label = f"{form} replanning, {len(arrivals)} runs"
            axes.bar(x + side, [m.mean for m in means], 0.38, color=colour, label=label)
            axes.errorbar(x + side, [m.mean for m in means], [m.half for m in means], fmt="none", ecolor="#555555")
            axes.plot(x + side, paper[form], "D", color=colour, markeredgecolor="#555555", label=f"paper, {form}")
        axes.set(xticks=x, xticklabels=names, xlabel="robot, first in the file to last", ylim=(0, 21))
        axes.set_title(f"arrivals of {2 * setting.round_trips} (paper: of 20)")
        axes.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.06))
        with whole_file(path) as part:
            figure.savefig(part, metadata={"Date": None})
