"""Tuning of a scenario's parameters with optuna (an extra): the same objective as sizing, the same seeds for all.

The sampler is seeded and every setting's runs are kept as those of a sweep, so that a tuning that was stopped repeats
its first settings without running them again, and goes on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.measures import MEASURES, Interval, interval
from analysis.variants import variant_of
from parking_sim.assembly import assemble
from parking_sim.config import Scenario, check_scenario, scenario_keys
from parking_sim.many_runs import open_folder, write_plan
from parking_sim.sizing import measure_specs
from parking_sim.sweep_plan import RunSpec, make_runs, set_keys
from sumo_nets.errors import InputError
from sumo_nets.wording import one_of


@dataclass(frozen=True, slots=True)
class Range:
    """Values of a key: from ``low`` to ``high``, whole numbers if both are."""

    low: float
    high: float
    whole: bool


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting that was tried, and the mean of the measure over the seeds."""

    values: Mapping[str, float]
    mean: Interval


def parse_ranges(texts: Sequence[str]) -> dict[str, Range]:
    """Read what to vary.

    Args:
        texts: such as ``control.period_s=2..10`` or ``control.window_cells=5..11``.

    Returns:
        Key -> range.

    Raises:
        InputError: anything else.
    """
    ranges = {}
    for text in texts:
        key, _, span = text.partition("=")
        low, dots, high = span.partition("..")
        try:
            found = Range(float(low), float(high), "." not in low + high)
        except ValueError:
            found = Range(math.nan, math.nan, False)
        if not dots or not -math.inf < found.low < found.high < math.inf:
            raise InputError(f"--vary: {text!r}: give such as control.period_s=2..10")
        if key == "seed":
            raise InputError(f"--vary: {text!r}: give the seeds of all settings as --seeds 1..5")
        ranges[key] = found
    return ranges


def tune_scenario(
    source: str,
    ranges: Mapping[str, Range],
    measure: str,
    trials: int,
    seeds: Sequence[int],
    folder: Path,
    executor: Executor,
) -> list[Setting]:
    """Try settings that optuna proposes.

    Args:
        source: a scenario, see ``parking_sim.config.load_scenario``.
        ranges: what to vary.
        measure: key of ``analysis.measures.MEASURES``; its mean over the seeds is made small, or great where that is
            good.
        trials: number of settings.
        seeds: seeds of each setting.
        folder: for the runs, kept as those of a sweep.
        executor: what does the runs.

    Returns:
        The settings, best first.

    Raises:
        InputError: optuna is not installed, an unknown measure, or a value that isn't valid.
        RunFailedError: a run failed twice.
    """
    if measure not in MEASURES:
        raise InputError(f"--measure: {measure!r}: {one_of(MEASURES, measure)}")
    try:
        import optuna
    except ImportError:
        raise InputError("tune: optuna is not installed: pip install 'parking-sim[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # a setting that fails is told once, by the exception
    lower = MEASURES[measure].lower_is_better
    keys, base_dir = scenario_keys(source)

    def scenario_with(values: Mapping[str, float]) -> Scenario:
        return check_scenario(set_keys(keys, values, source), source, base_dir.resolve())

    for end in ("low", "high"):  # what does not fit is seen before anything is written
        ends = {key: getattr(span, end) for key, span in ranges.items()}
        assemble(scenario_with({key: int(value) if ranges[key].whole else value for key, value in ends.items()}))
    all_specs: list[RunSpec] = []
    settings: list[Setting] = []

    def objective(trial: Any) -> float:
        values = {key: _suggest(trial, key, span) for key, span in ranges.items()}
        specs = make_runs([scenario_with(values)], [variant_of(values)], seeds)
        all_specs.extend(specs)
        write_plan(all_specs, folder)
        mean = interval(measure_specs(specs, measure, folder, executor))
        settings.append(Setting(values, mean))
        return mean.mean

    study = optuna.create_study(
        direction="minimize" if lower else "maximize", sampler=optuna.samplers.TPESampler(seed=0)
    )
    with open_folder(folder):
        study.optimize(objective, n_trials=trials)
    return sorted(settings, key=lambda setting: setting.mean.mean if lower else -setting.mean.mean)


def _suggest(trial: Any, key: str, span: Range) -> float:
    if span.whole:
        return int(trial.suggest_int(key, int(span.low), int(span.high)))
    return float(trial.suggest_float(key, span.low, span.high))
