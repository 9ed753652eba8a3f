"""Paper 004, tables 1 and 2 and figure 5: one stage, two stages and CBS on the same instances.

All three plan each instance, and both genetic algorithms begin with the same population, so that differences are
within pairs. The paper's CBS had 600 s an instance in MATLAB on an i9 at 5.8 GHz; ours has a shorter limit, named in
the table. Seconds are the process's CPU time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

from analysis.measures import Interval, interval
from controller.genetic.evolution import Options, Stage, single_stage, two_stage
from controller.genetic.lattice import LatticePlan, plan_genetic, random_instance
from controller.genetic.lattice_cbs import plan_cbs
from parking_sim.reproduce.findings import Finding, findings_table, make_folder, settled, write_findings
from parking_sim.reproduce.published import published
from parking_sim.reproduce.statistics import fewer, is_less, wilson
from parking_sim.workers import open_executor
from sumo_nets.graph import FloatArray
from sumo_nets.whole_file import whole_file

GENERATIONS = 1000
#: Instances for each number of robots, and seconds that CBS has for one.
FULL, QUICK = (100, 3.0), (4, 0.5)

SINGLE, TWO, CBS = "single", "two-stage", "CBS"
STAGES: Mapping[str, tuple[Stage, ...]] = {SINGLE: single_stage(GENERATIONS), TWO: two_stage(GENERATIONS)}
_MEASURES = {"collisions": "collisions", "work": "work time, steps", "stop": "stop time, steps", "seconds": "seconds"}
#: The number of robots whose seconds we compare, and the share of the paper's that ours may take.
TIMED_ROBOTS, TIMED_SHARE = 20, 0.1


def reproduce(folder: Path, full: bool, first: int | None = None) -> None:
    """Run the experiment, print the table and write it with the runs and the figure.

    Args:
        folder: where ``two-stage-ga.csv``, ``.md``, ``-runs.csv`` and ``.svg`` go.
        full: 100 instances for each number of robots as in the paper, and 3 s for CBS; else 4 and 0.5 s.
        first: only so many of these instances, the first ones.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    instances, limit_s = FULL if full else QUICK
    runs, histories = run_experiment(min(instances, first or instances), limit_s)
    findings = [*compare(runs, limit_s)]
    runs.to_csv(folder / "two-stage-ga-runs.csv", index=False, float_format="%.6g")
    write_findings(findings, folder, "two-stage-ga", full)
    draw(runs, histories, folder / "two-stage-ga.svg")
    print(findings_table(findings, full), end="")
    print(f"table and figure: {folder}")


@dataclass(frozen=True, slots=True)
class Task:
    """An instance to plan: number of robots, number of the instance, and seconds that CBS has."""

    robots: int
    instance: int
    limit_s: float
    seed: int


#: Robots, instance, method, collisions, mean work and stop steps, CPU seconds, timeout, nodes of CBS.
Row = tuple[int, int, str, int, float, float, float, bool, int]
_COLUMNS = ["robots", "instance", "method", "collisions", "work", "stop", "seconds", "timeout", "nodes"]


def run_experiment(
    instances: int, limit_s: float, robots: Sequence[int] | None = None, workers: int | None = None, seed: int = 1
) -> tuple[pd.DataFrame, dict[str, FloatArray]]:
    """Plan every instance with all three.

    Args:
        instances: for each number of robots.
        limit_s: seconds that CBS has for one.
        robots: numbers of robots; the paper's by default.
        workers: processes; one for each core by default.
        seed: each instance, and chance within the genetic algorithms, has its own generator that follows from it.

    Returns:
        A row a plan, see ``Row``, and the mean history of the genetic algorithms with 20 robots, or the largest
        number, by method.
    """
    numbers = robots or published("two_stage_ga")["robots"]
    shown = TIMED_ROBOTS if TIMED_ROBOTS in numbers else max(numbers)
    tasks = [Task(n, k, limit_s, seed) for n in numbers for k in range(instances)]
    with open_executor(workers) as executor:
        answers = list(executor.map(plan_instance, tasks))
    rows = [row for rows, _ in answers for row in rows]
    of_shown = [histories for task, (_, histories) in zip(tasks, answers, strict=True) if task.robots == shown]
    courses = {name: np.mean([histories[name] for histories in of_shown], axis=0) for name in STAGES}
    return pd.DataFrame(rows, columns=_COLUMNS), courses


def plan_instance(task: Task) -> tuple[list[Row], dict[str, FloatArray]]:
    """Plan one instance with all three; a row each, and the histories of the genetic algorithms."""
    _warm_up()
    n, k = task.robots, task.instance
    instance = random_instance(n, np.random.default_rng([task.seed, n, k]))
    rows: list[Row] = []
    histories = {}
    for name, stages in STAGES.items():
        began = process_time()
        plan, outcome = plan_genetic(instance, stages, Options(), np.random.default_rng([task.seed, n, k, 1]))
        rows.append((n, k, name, *_figures(plan), process_time() - began, False, 0))
        histories[name] = outcome.history
    began = process_time()
    answer = plan_cbs(instance, task.limit_s)
    rows.append((n, k, CBS, *_figures(answer.plan), process_time() - began, answer.timeout, answer.nodes))
    return rows, histories


def _figures(plan: LatticePlan) -> tuple[int, float, float]:
    return plan.collisions, plan.work_steps, plan.stop_steps


@cache
def _warm_up() -> None:
    """Compile everything before anything is timed."""
    plan_genetic(random_instance(2, np.random.default_rng(0)), two_stage(2), Options(), np.random.default_rng(0))


def compare(runs: pd.DataFrame, limit_s: float) -> Iterator[Finding]:
    """The paper's figures beside those of the runs.

    Args:
        runs: the frame of :func:`run_experiment`.
        limit_s: seconds that CBS had.
    """
    paper = published("two_stage_ga")
    for i, n in enumerate(paper["robots"]):
        for column, words in _MEASURES.items():
            for method in (SINGLE, TWO, CBS):
                printed = paper[column].get(method)
                ours = interval(_values(runs, method, column, n).tolist())
                yield Finding(f"{n} robots: {words}, {method}", f"{printed[i]:g}" if printed else "", *_words(ours))
        yield _timeouts(runs, n, limit_s, str(paper["timeouts_at_25"]) if n == 25 else "")
    for column in ("collisions", "work", "stop"):
        yield from _claims(runs, column, TWO, SINGLE, paper)
    yield from _claims(runs, "collisions", TWO, CBS, paper)
    yield from _claims(runs, "work", CBS, TWO, paper)
    i = paper["robots"].index(TIMED_ROBOTS)
    median, printed = float(np.median(_values(runs, TWO, "seconds", TIMED_ROBOTS))), paper["seconds"][TWO][i]
    what = f"{TIMED_ROBOTS} robots: median seconds, {TWO}, at most a tenth of the paper's"
    yield Finding(what, f"{printed:g}", f"{median:.2f}", "", settled(median <= TIMED_SHARE * printed))


def _timeouts(runs: pd.DataFrame, robots: int, limit_s: float, printed: str) -> Finding:
    timeouts = _values(runs, CBS, "timeout", robots)
    low, high = wilson(int(timeouts.sum()), len(timeouts))
    what = f"{robots} robots: CBS out of time, % (paper 600 s, ours {limit_s:g} s)"
    return Finding(what, printed, f"{100 * timeouts.mean():.0f}", f"{100 * low:.0f} to {100 * high:.0f}")


def _claims(
    runs: pd.DataFrame, column: str, better: str, worse: str, paper: Mapping[str, Mapping[str, Sequence[float]]]
) -> Iterator[Finding]:
    """Where the paper prints less for one method: the difference within pairs, and whether a test finds it here."""
    for i, n in enumerate(paper["robots"]):
        printed = paper[column][better][i] - paper[column][worse][i]
        if printed < 0:
            a, b = (_values(runs, method, column, int(n)) for method in (better, worse))
            p, shown = fewer(a.tolist(), b.tolist()), is_less(a.tolist(), b.tolist())
            what = f"{n} robots: {_MEASURES[column]}, {better} less {worse}; Wilcoxon p = {p:.2g}"
            yield Finding(what, f"{printed:+.2f}", *_words(interval((a - b).tolist()), "+"), shown)


def _values(runs: pd.DataFrame, method: str, column: str, robots: int) -> FloatArray:
    """By instance."""
    chosen = runs[(runs["method"] == method) & (runs["robots"] == robots)].sort_values("instance")
    return chosen[column].to_numpy(dtype=np.float64)


def _words(value: Interval, sign: str = "") -> tuple[str, str]:
    form = f"{{:{sign}.2f}}"
    return form.format(value.mean), f"{form.format(value.low)} to {form.format(value.high)}"


def draw(runs: pd.DataFrame, histories: Mapping[str, FloatArray], path: Path) -> None:
    """Draw table 1 and 2 against the paper, and the course of the generations (the paper's figure 5)."""
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, GREEN, ORANGE, WIDTH_IN, style

    paper = published("two_stage_ga")
    colours = {SINGLE: ORANGE, TWO: BLUE, CBS: GREEN}
    with style():
        figure = Figure(figsize=(WIDTH_IN, 6.0))
        tables, courses = figure.subplots(2, 3)
        for axes, column in zip(tables, ("collisions", "work", "stop"), strict=True):
            for method, colour in colours.items():
                ours = [interval(_values(runs, method, column, n).tolist()) for n in paper["robots"]]
                axes.plot(paper["robots"], paper[column][method], "--", color=colour, alpha=0.5)
                means, halves = [v.mean for v in ours], [v.half for v in ours]
                axes.errorbar(paper["robots"], means, halves, color=colour, marker="o", markersize=3, label=method)
            axes.set(title=f"{_MEASURES[column]} (dashed: paper)", xlabel="robots")
        tables[0].set_yscale("symlog", linthresh=0.1)
        tables[1].legend()
        for k, (axes, title) in enumerate(zip(courses, ("fitness", "collisions", "Hamming distance"), strict=True)):
            for method, history in histories.items():
                axes.plot(history[:, k], color=colours[method], label=method)
            axes.set(title=f"{title}, {TIMED_ROBOTS} robots", xlabel="generation")
            if k < 2:
                axes.set_yscale("symlog", linthresh=0.1)
        with whole_file(path) as part:
            figure.savefig(part, metadata={"Date": None})
