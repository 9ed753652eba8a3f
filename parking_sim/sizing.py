"""The smallest fleet that meets a target, by as few runs as it takes; then, if wanted, the fewest bays and chargers.

Numbers are tried by doubling until one meets the target, then by halving the gap below it. Each number is run with
one seed after another, the same for all, until it is clear on which side of the target the mean over the seeds lies.
One looks after 3, 5, 8, 12, 18 and 30 seeds. To meet the target takes one-sided confidence of 99.8 % at a look and of
96 % at the last: added up (Bonferroni), a number is said to meet it wrongly with a probability of at most 5 %, however
often one has looked. To miss it 95 % are enough, for that errs to the safe side. A number that remains unclear after
the last seed does not meet the target.

Customers who are turned away count as missed: each waits without end in the measure of a seed. Where the quantile falls
among them, or the target is about a mean or a maximum, the seed's value is infinite, and so is the mean over seeds.

That is right if more AGVs never make the wait longer up to the answer. Where they get in each other's way the curve
turns up again, so that a target that the greatest fleet misses is also looked for around the best number seen.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.measures import Interval, interval
from analysis.size_curve import SIZED, Sizing, Target, Tried, count_of
from analysis.turned_away import TurnedAway, turned_away, turned_away_words
from analysis.variants import variant_of
from parking_sim.config import Scenario
from parking_sim.errors import RunFailedError
from parking_sim.many_runs import Tell, open_folder, run_folder, run_missing, write_plan
from parking_sim.sweep_plan import RunSpec, make_runs
from sumo_nets.errors import InputError

if TYPE_CHECKING:
    from analysis.runs import Runs

#: Seeds after which a number is looked at.
LOOKS = (3, 5, 8, 12, 18, 30)
#: One-sided confidence that a number meets the target, at a look and at the last one; and that it misses it.
LOOK_CONFIDENCE, LAST_CONFIDENCE, MISS_CONFIDENCE = 0.998, 0.96, 0.95

_WHAT = {
    "retrieval total": "retrieval_total",
    "retrieval": "retrieval_wait",
    "queue": "park_queue",
    "parking": "park_total",
}
_TARGET = re.compile(rf"({'|'.join(_WHAT)}) (mean|p50|p90|p95|p99|max) < (\d+(?:\.\d+)?) ?(s|min)")
_SHARE_TARGET = re.compile(r"turned away < (\d+(?:\.\d+)?) ?%")


#: Gives the measure of a number of AGVs, bays or chargers for seeds.
Measure = Callable[[int, Sequence[int]], Sequence[float]]


def parse_target(text: str) -> Target:
    """Read a target.

    Args:
        text: such as ``retrieval p95 < 5 min``: what (retrieval, retrieval total, queue, parking), its mean, p50, p90,
            p95, p99 or max, and the limit in s or min; or ``turned away < 1 %``.

    Returns:
        The target.

    Raises:
        InputError: anything else.
    """
    words = " ".join(text.split())
    share = _SHARE_TARGET.fullmatch(words)
    if share is not None and float(share[1]) > 0:
        return Target(words, "turned_away_share", float(share[1]) / 100)
    match = _TARGET.fullmatch(words)
    if match is None or float(match[3]) == 0:
        raise InputError(
            f"--target: {text!r}: give such as 'retrieval p95 < 5 min': one of {', '.join(sorted(_WHAT))};"
            " mean, p50, p90, p95, p99 or max; a limit in s or min; or 'turned away < 1 %'"
        )
    limit_s = float(match[3]) * (60 if match[4] == "min" else 1)
    return Target(match[0], f"{_WHAT[match[1]]}_{match[2]}_s", limit_s)


def find_least(target: Target, most: int, measure: Measure, looks: Sequence[int] = LOOKS) -> Sizing:
    """Search for the least number, of AGVs unless something else is filled in.

    Args:
        target: what it shall reach.
        most: greatest number to try, 1 or more.
        measure: runs a number with seeds; asked for the seeds from 1 on, never for one twice.
        looks: numbers of seeds after which a number is looked at, rising.

    Returns:
        The answer and how it was found.
    """
    tried: dict[int, Tried] = {}

    def meets(number: int) -> bool:
        if number not in tried:
            tried[number] = _judge(number, target.limit, measure, looks)
        return tried[number].meets

    low, high = 0, 1
    while not meets(high) and high < most:
        low, high = high, min(2 * high, most)
    if not meets(high):
        found = _around_best(tried, meets)
        low, high = (0, 0) if found is None else (max(n for n in tried if n < found), found)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if meets(middle) else (middle, high)
    return Sizing(target, high or None, tuple(tried[number] for number in sorted(tried)))


def size_garage(
    scenario: Scenario,
    target: Target,
    most: Mapping[str, int],
    folder: Path,
    executor: Executor,
    looks: Sequence[int] = LOOKS,
    tell: Tell | None = None,
) -> Iterator[Sizing]:
    """Find the smallest fleet of a scenario that meets a target, then the fewest bays and chargers with which it does.

    An answer is given as soon as it is found: what goes wrong with bays or chargers takes nothing from the fleet's.

    Args:
        scenario: what to run; what is sized and the seed are replaced.
        target: what shall be reached.
        most: greatest number of each to try, by key of ``SIZED``, in the order in which they are sized.
        folder: for the runs, kept as those of a sweep over these keys: runs done already are not done again.
        executor: what does the runs, see ``parking_sim.workers``.
        looks: numbers of seeds after which a number is looked at.
        tell: called with the progress of the runs asked for so far.

    Yields:
        An answer for each; none after one that meets the target with no number.

    Raises:
        InputError: the folder can't be used, or the scenario does not fit its garage.
        RunFailedError: a run failed twice.
    """
    settings, known = dict(most), dict[str, RunSpec]()

    def measure(what: str, done: dict[int, list[RunSpec]], number: int, seeds: Sequence[int]) -> Sequence[float]:
        varied = {**settings, what: number}
        specs = make_runs([scenario.model_copy(update=varied)], [variant_of(varied)], seeds)
        known.update((spec.key, spec) for spec in specs)
        done.setdefault(number, []).extend(specs)
        write_plan(sorted(known.values(), key=lambda spec: [spec.variant.shown[key] for key in most]), folder)
        return measure_specs(specs, target.key, folder, executor, tell)

    given: dict[str, int] = {}
    with open_folder(folder):
        for what, limit in most.items():
            done: dict[int, list[RunSpec]] = {}
            found = find_least(target, limit, partial(measure, what, done), looks)
            away = {number: _turned_away(specs, folder) for number, specs in done.items()}
            yield replace(found, what=what, given=dict(given), away=away)
            if found.number is None:
                return
            settings[what] = given[what] = found.number


def measure_specs(
    specs: Sequence[RunSpec], key: str, folder: Path, executor: Executor, tell: Tell | None = None
) -> list[float]:
    """Do runs and take a measure of each.

    Args:
        specs: the runs.
        key: one of ``analysis.measures.MEASURES``.
        folder: folder of the sweep.
        executor: what does the runs.
        tell: called with the progress.

    Returns:
        The measure of each run, in their order, in which each customer who was turned away waits without end; infinite
        where these decide, NaN where there was nothing to measure.

    Raises:
        InputError: a scenario does not fit its garage.
        RunFailedError: a run failed twice.
    """
    from analysis.measures import measure_runs

    failures = run_missing(specs, folder, executor, tell)
    if failures:
        first = failures[0]
        raise (InputError if first.is_input else RunFailedError)(
            f"{first.spec.variant.name}, seed {first.spec.scenario.seed}: {first.error}"
        )
    return [float(value) for value in measure_runs(_runs_of(specs, folder), endless=True)[key]]


def _runs_of(specs: Sequence[RunSpec], folder: Path) -> Runs:
    from analysis.runs import Runs

    return Runs({spec.key: run_folder(spec, folder) for spec in specs})


def _turned_away(specs: Sequence[RunSpec], folder: Path) -> TurnedAway:
    """The customers turned away in some runs together."""
    return turned_away(_runs_of(specs, folder).sql("SELECT kind, state, reason FROM tasks").df())


def answer(sizing: Sizing, where: str) -> str:
    """The answer in a sentence, and one more on the customers turned away.

    Args:
        sizing: see :func:`size_garage`.
        where: what was sized, such as ``map1, mall-saturday 13 to 16 h``.
    """
    if sizing.number is None:
        best = min(sizing.tried, key=_badness)
        return (
            f"No fleet of 1 to {sizing.tried[-1].number} {SIZED[sizing.what]} meets '{sizing.target.words}' in {where}:"
            f" the best tried, {best.number}, has {_span(best.mean, sizing.target)} ({sizing.runs} runs)."
            f"{_away_words(sizing, best.number)}"
        )
    by_number = {tried.number: tried for tried in sizing.tried}
    given = " and ".join(count_of(number, what) for what, number in sizing.given.items())
    below = by_number.get(sizing.number - 1)
    less = ""
    if below is not None:
        less = f"; {below.number} {'does' if below.number == 1 else 'do'} not, with {_span(below.mean, sizing.target)}"
    return (
        f"{f'With {given}, ' if given else ''}{count_of(sizing.number, sizing.what)}"
        f" {'meets' if sizing.number == 1 else 'meet'} '{sizing.target.words}' in {where} with 95 % confidence:"
        f" {_span(by_number[sizing.number].mean, sizing.target)}{less} ({sizing.runs} runs)."
        f"{_away_words(sizing, sizing.number)}"
    )


def _away_words(sizing: Sizing, number: int) -> str:
    """A sentence on the customers turned away with this number, with a space before; empty if that is not known."""
    away = sizing.away.get(number)
    if away is None:
        return ""
    missed = "; each counts as one who waits without end" if away.number and sizing.target.unit == "s" else ""
    return f" With {count_of(number, sizing.what)}, {turned_away_words(away)}{missed}."


def _judge(number: int, limit: float, measure: Measure, looks: Sequence[int]) -> Tried:
    """Run a number until it is clear on which side of the limit it lies."""
    values: list[float] = []
    for look in looks:
        values.extend(measure(number, range(len(values) + 1, look + 1)))
        asked = LAST_CONFIDENCE if look == looks[-1] else LOOK_CONFIDENCE
        if interval(values, 2 * asked - 1).high < limit:
            return Tried(number, True, tuple(values))
        if interval(values, 2 * MISS_CONFIDENCE - 1).low > limit:
            break
    return Tried(number, False, tuple(values))


def _around_best(tried: dict[int, Tried], meets: Callable[[int], bool]) -> int | None:
    """Halve the gaps beside the best number, until one meets the target or there are no gaps."""
    while True:
        sizes = sorted(tried)
        best = sizes.index(min(sizes, key=lambda number: _badness(tried[number])))
        pairs = [pair for pair in itertools.pairwise(sizes) if sizes[best] in pair and pair[1] - pair[0] > 1]
        if not pairs:
            return None
        for low, high in pairs:
            if meets((low + high) // 2):
                return (low + high) // 2


def _badness(tried: Tried) -> tuple[float, int]:
    """What sorts numbers, the best first; of those that all turn too many away the greatest is the best."""
    mean = tried.mean.mean
    return (math.inf if math.isnan(mean) else mean), -tried.number


def _span(value: Interval, target: Target) -> str:
    if value.runs == 0:
        return "nothing to measure"
    if math.isinf(value.mean):
        return f"waits without end ({value.runs} seeds)"
    mean = f"{target.shown(value.mean)} {target.unit}"
    if value.runs < 2:
        return mean
    return f"{mean} (95 %: {target.shown(value.low)} to {target.shown(value.high)}, {value.runs} seeds)"
