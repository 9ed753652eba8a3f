"""Paper 001, table 2 and figures 11 and 12: RRT-GRID against RRT and RRT* on thirty layouts.

Lengths are in pixels, times are ratios to RRT within the same process (CPU seconds): the paper's seconds say as much
about its notebook as about the method. Samples drawn are compared too, they don't depend on the machine. A replicate is
one run on each of a category's six layouts; intervals are Student's t over replicates.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from analysis.measures import Interval, interval
from parking_sim.reproduce.findings import Finding, contrary, findings_table, make_folder, write_findings
from parking_sim.reproduce.statistics import is_below
from sumo_nets.freespace.floor import Floor
from sumo_nets.freespace.rrt import FreePath, rrt, rrt_star
from sumo_nets.freespace.rrt_grid import rrt_grid
from sumo_nets.freespace.scenes import CATEGORIES, GOAL, START, scenes
from sumo_nets.freespace.visibility import VisibilityGraph
from sumo_nets.graph import FloatArray
from sumo_nets.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Length and seconds of the paper's table 2, by planner, for categories 1 to 5.
PAPER: Mapping[str, tuple[tuple[float, float], ...]] = {
    "RRT": ((1183.75, 260.96), (1350.66, 1688.63), (1276.09, 1767.04), (1251.07, 1239.36), (1214.69, 573.33)),
    "RRT*": ((1086.44, 370.92), (1250.15, 2454.07), (1164.75, 2340.52), (1140.11, 1813.12), (1135.17, 839.60)),
    "RRT-GRID": ((1107.07, 209.62), (1223.19, 1031.80), (1163.42, 1137.99), (1127.47, 849.03), (1112.40, 400.67)),
}
#: Runs a layout, and how many of them RRT* repeats with all its samples.
FULL_RUNS, QUICK_RUNS = 100, 8
ALL_SAMPLES_RUNS = 3

Planner = Callable[[Floor, tuple[float, float], tuple[float, float], np.random.Generator], FreePath]
PLANNERS: Mapping[str, Planner] = {"RRT": rrt, "RRT*": rrt_star, "RRT-GRID": rrt_grid}
ALL_SAMPLES, VISIBILITY = "RRT*, all samples", "visibility graph"


def reproduce(folder: Path, full: bool) -> None:
    """Run the experiment, print the table and write it with the runs and the figures.

    Args:
        folder: where ``rrt-grid.csv``, ``rrt-grid.md``, ``rrt-grid-runs.csv`` and two figures go.
        full: 100 runs a layout as in the paper, and RRT* with all its samples; else 8 runs and without.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    _warm_up()
    runs, paths = run_experiment(FULL_RUNS if full else QUICK_RUNS, ALL_SAMPLES_RUNS if full else 0)
    findings = list(compare(runs))
    runs.to_csv(folder / "rrt-grid-runs.csv", index=False, float_format="%.6g")
    write_findings(findings, folder, "rrt-grid", full)
    draw_ratios(runs, folder / "rrt-grid.svg")
    draw_paths(paths, folder / "rrt-grid-paths.svg")
    print(findings_table(findings, full), end="")
    print(f"tables and figures: {folder}")


def run_experiment(
    runs: int, all_samples_runs: int = 0, seed: int = 1
) -> tuple[pd.DataFrame, dict[tuple[int, int], dict[str, FloatArray]]]:
    """Every planner on every layout.

    Args:
        runs: runs a layout of RRT, RRT* and RRT-GRID; the visibility graph needs one.
        all_samples_runs: runs of RRT* with all its samples.
        seed: each planner, layout and run has its own generator that follows from it.

    Returns:
        A row for each run (category, layout, run, planner, length in pixels, CPU seconds, samples; an infinite length
        if no path was found), and the paths of each layout's first run by (category, layout) and planner.
    """
    rows: list[tuple[int, int, int, str, float, float, int]] = []
    paths: dict[tuple[int, int], dict[str, FloatArray]] = {}
    for scene in scenes():
        where = scene.category, scene.number
        paths[where] = {}
        for kind, (name, planner, times) in enumerate(_field(runs, all_samples_runs)):
            for run in range(times):
                rng = np.random.default_rng([seed, kind, *where, run])
                began = time.process_time()
                path = planner(scene.floor, START, GOAL, rng)
                rows.append((*where, run, name, path.length, time.process_time() - began, path.samples))
                paths[where].setdefault(name, path.points)
    columns = ["category", "layout", "run", "planner", "length_px", "cpu_s", "samples"]
    return pd.DataFrame(rows, columns=columns), paths


def _field(runs: int, all_samples_runs: int) -> Iterator[tuple[str, Planner, int]]:
    """The planners, with the number of runs of each."""
    for name, planner in PLANNERS.items():
        yield name, planner, runs
    yield VISIBILITY, lambda floor, start, goal, rng: VisibilityGraph(floor).shortest(start, goal), 1
    yield ALL_SAMPLES, lambda floor, start, goal, rng: rrt_star(floor, start, goal, rng, use_all=True), all_samples_runs


def _warm_up() -> None:
    """Compile everything before anything is timed."""
    floor = scenes()[1].floor
    for _, planner, _ in _field(1, 1):
        planner(floor, START, GOAL, np.random.default_rng(0))


def compare(runs: pd.DataFrame) -> Iterator[Finding]:
    """The paper's figures beside those of the runs, category by category.

    Args:
        runs: the frame of :func:`run_experiment`.
    """
    names = [name for name, _, _ in CATEGORIES]
    for name in PAPER:
        for i, category in enumerate(names):
            ours = interval(_lengths(runs, name, i + 1).tolist())
            yield Finding(
                f"length of {name}, C{i + 1} {category}, px", f"{PAPER[name][i][0]:.0f}", *_words(ours, "{:.0f}")
            )
    for planner, rival, column in _CLAIMS:
        what = f"{_WORDS[column]}, {planner} to {rival}"
        ratios = np.array([_ratios(runs, planner, rival, column, c) for c in range(1, 6)])
        paper = [_paper_ratio(planner, rival, column, i) for i in range(5)]
        for i, values in enumerate(ratios):
            yield _claim(f"{what}, C{i + 1}", paper[i], values, column)
        yield _claim(f"{what}, mean", float(np.mean(paper)), ratios.mean(axis=0), column)
    yield from _beside_today(runs)
    found = np.isfinite(runs["length_px"]).groupby(runs["planner"]).mean()
    for name in PLANNERS:
        yield Finding(f"runs of {name} that found a path, %", "", f"{100 * found[name]:.1f}")


#: Ratios that the paper has or that stand in for them: planner, rival, column.
_CLAIMS = (
    ("RRT-GRID", "RRT", "length_px"),
    ("RRT-GRID", "RRT*", "length_px"),
    ("RRT-GRID", "RRT", "cpu_s"),
    ("RRT*", "RRT", "cpu_s"),
    ("RRT-GRID", "RRT", "samples"),
)
_WORDS = {"length_px": "length in %", "cpu_s": "time ratio", "samples": "ratio of samples"}


def _claim(what: str, paper: float, ratios: FloatArray, column: str) -> Finding:
    """A ratio; the claim is that it is below 1, or above, as in the paper."""
    ours = interval(ratios.tolist())
    if column == "length_px":
        paper_words = f"{100 * (paper - 1):+.1f}"
        words = _words(interval((100 * (ratios - 1)).tolist()), "{:+.1f}")
    else:
        paper_words = "" if np.isnan(paper) else f"{paper:.2f}"
        words = _words(ours, "{:.2f}")
    if np.isnan(paper):
        return Finding(what, "", *words)
    below = is_below(ours, 1.0)
    return Finding(what, paper_words, *words, below if paper < 1 else contrary(below))


def _beside_today(runs: pd.DataFrame) -> Iterator[Finding]:
    """How much longer than the shortest path each planner's paths are."""
    for name in [*PLANNERS, ALL_SAMPLES]:
        if (runs["planner"] == name).any():
            excess = [_lengths(runs, name, c) / _lengths(runs, VISIBILITY, c).mean() for c in range(1, 6)]
            change = interval((100 * (np.mean(excess, axis=0) - 1)).tolist())
            yield Finding(f"length in %, {name} to the visibility graph, mean", "", *_words(change, "{:+.1f}"))


def _lengths(runs: pd.DataFrame, planner: str, category: int) -> FloatArray:
    return _replicates(runs, planner, "length_px", category)


def _replicates(runs: pd.DataFrame, planner: str, column: str, category: int) -> FloatArray:
    """Mean over the category's layouts in each run; without the runs that found no path."""
    chosen = runs[(runs["planner"] == planner) & (runs["category"] == category) & np.isfinite(runs["length_px"])]
    return np.asarray(chosen.groupby("run")[column].mean(), dtype=np.float64)


def _ratios(runs: pd.DataFrame, planner: str, rival: str, column: str, category: int) -> FloatArray:
    return _replicates(runs, planner, column, category) / _replicates(runs, rival, column, category)


def _paper_ratio(planner: str, rival: str, column: str, i: int) -> float:
    if column == "samples":
        return float("nan")
    k = 0 if column == "length_px" else 1
    return PAPER[planner][i][k] / PAPER[rival][i][k]


def _words(value: Interval, form: str) -> tuple[str, str]:
    return form.format(value.mean), f"{form.format(value.low)} to {form.format(value.high)}"


def draw_ratios(runs: pd.DataFrame, path: Path) -> None:
    """Draw length and time against RRT, the paper's bars beside ours (the paper's figures 11 and 12)."""
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, GREY, ORANGE, WIDTH_IN, style

    with style():
        figure = Figure(figsize=(WIDTH_IN, 5.0))
        for axes, column, title in zip(
            figure.subplots(2, 1), ("length_px", "cpu_s"), ("length / RRT", "CPU time / RRT"), strict=True
        ):
            for k, (name, colour) in enumerate((("RRT*", ORANGE), ("RRT-GRID", BLUE))):
                _bars(axes, runs, name, column, k, colour)
            axes.axhline(1.0, color=GREY, linewidth=1)
            axes.set_xticks(range(5), [f"C{i + 1} {name}" for i, (name, _, _) in enumerate(CATEGORIES)])
            axes.set_title(title)
        figure.axes[0].set_ylim(0.6, 1.05)
        figure.axes[1].set_yscale("log")
        figure.axes[0].legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.25))
        with whole_file(path) as part:
            figure.savefig(part, metadata={"Date": None})


def _bars(axes: Axes, runs: pd.DataFrame, name: str, column: str, k: int, colour: str) -> None:
    paper = [_paper_ratio(name, "RRT", column, i) for i in range(5)]
    ours = [interval(_ratios(runs, name, "RRT", column, i + 1).tolist()) for i in range(5)]
    x = np.arange(5) + 0.4 * k - 0.3
    axes.bar(x, paper, 0.18, color=colour, alpha=0.4, label=f"{name}, paper")
    axes.bar(x + 0.19, [v.mean for v in ours], 0.18, yerr=[v.half for v in ours], color=colour, label=f"{name}, ours")


def draw_paths(paths: Mapping[tuple[int, int], Mapping[str, FloatArray]], path: Path) -> None:
    """Draw the thirty layouts with the paths of their first runs."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, GREEN, GREY, ORANGE, style

    colours = {"RRT": GREY, "RRT*": ORANGE, "RRT-GRID": BLUE, VISIBILITY: GREEN}
    with style():
        figure = Figure(figsize=(12, 7.2))
        grid = figure.subplots(5, 6)
        for scene in scenes():
            axes = grid[scene.category - 1, scene.number - 1]
            axes.set(xlim=(0, scene.floor.width), ylim=(scene.floor.height, 0), xticks=[], yticks=[], aspect="equal")
            axes.grid(visible=False)
            axes.spines[:].set_visible(True)
            axes.add_collection(PolyCollection(list(scene.floor.obstacles), facecolors="#5b6270"))
            for name, colour in colours.items():
                points = paths[scene.category, scene.number][name]
                axes.plot(*points.T, color=colour, linewidth=1.2, label=name)
        for row, (name, _, _) in zip(grid, CATEGORIES, strict=True):
            row[0].set_ylabel(name)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        with whole_file(path) as part:
            figure.savefig(part, metadata={"Date": None})
