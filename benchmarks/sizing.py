"""Sizing against brute force: the same answer as a grid of all fleets with 30 seeds, and how many runs it takes.

    python benchmarks/sizing.py [--garage map1] [--most 8] [--targets "retrieval p95 < 8 min,..."] [--hours 0.5]
        [--limits 60] [--plant sumo] [--folder DIR] [--workers 2]

The grid's runs are kept in the folder, and a second start goes on. The sizing's runs are counted as if there were none.
A fleet of the grid meets a target if the upper end of its one-sided interval is below it, at the confidence that sizing
asks for after its last seed. After the targets each of their measures gets ``--limits`` limits, spread evenly from
below the least to above the greatest mean of a fleet: how many of them agree, and the share of the grid's runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.measures import interval
from analysis.size_curve import Sizing, Target
from analysis.variants import variant_of
from demand.profile_traffic import ProfileTraffic
from parking_sim.config import Scenario, check_scenario
from parking_sim.many_runs import open_folder, write_plan
from parking_sim.sizing import LAST_CONFIDENCE, answer, find_least, measure_specs, parse_target
from parking_sim.sweep_plan import make_runs
from parking_sim.workers import open_executor

SEEDS = range(1, 31)


def main() -> None:
    """Print for each target the answer of both and the share of the runs."""
    given = arguments()
    targets = [parse_target(text) for text in given.targets.split(",")]
    values = grid(scenario(given, max(target.goes_on_s for target in targets)), targets, given)
    whole = len(SEEDS) * given.most
    print(f"{given.garage}: a grid of 1 to {given.most} AGVs with {len(SEEDS)} seeds is {whole} runs")
    for target in targets:
        found, best = both(target, values[target.key])
        verdict = "agrees" if best == found.number else f"DISAGREES with {best}"
        print(f"{target.words}: {verdict}; {found.runs} runs, {found.runs / whole:.0%} of the grid")
        print(f"    {answer(found, given.garage)}")
    for key, known in values.items():
        pairs = [both(target, known) for target in spread(key, known, given.limits)]
        agree = sum(best == found.number for found, best in pairs)
        shares = sorted(found.runs / whole for found, _ in pairs)
        print(
            f"{key}: {agree} of {len(pairs)} limits agree; {sum(shares) / len(pairs):.0%} of the grid on average,"
            f" {shares[-1]:.0%} at most, over a third in {sum(share > 1 / 3 for share in shares)}"
        )


def both(target: Target, known: dict[int, list[float]]) -> tuple[Sizing, int | None]:
    """The answers of sizing and of brute force, both from what the grid measured."""
    found = find_least(target, len(known), lambda agvs, seeds: [known[agvs][seed - 1] for seed in seeds])
    return found, brute_force(known, target)


def spread(key: str, known: dict[int, list[float]], count: int) -> list[Target]:
    """Targets with limits from below the least to above the greatest mean that is not infinite."""
    means = [mean for values in known.values() if np.isfinite(mean := interval(values).mean)]
    return [
        Target(f"{key} < {x:.0f} s", key, float(x)) for x in np.linspace(0.8 * min(means), 1.05 * max(means), count)
    ]


def arguments() -> argparse.Namespace:
    """Those of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--garage", default="map1")
    parser.add_argument("--most", type=int, default=8)
    parser.add_argument("--targets", default="retrieval p95 < 8 min,retrieval mean < 5 min,retrieval p95 < 1 min")
    parser.add_argument("--limits", type=int, default=60)
    parser.add_argument("--profile", default="mall-saturday")
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--hours", type=float, default=0.5)
    parser.add_argument("--plant", default="sumo")
    parser.add_argument("--folder", type=Path, default=Path("runs/benchmark-sizing"))
    parser.add_argument("--workers", type=int, default=2)
    return parser.parse_args()


def scenario(given: argparse.Namespace, limit_s: float) -> Scenario:
    """Some hours of the profile; the run goes on until the last request could have missed every target."""
    traffic = ProfileTraffic(name=given.profile, start_h=14, hours=given.hours, scale=given.scale)
    keys = {
        "garage": given.garage,
        "agvs": 1,
        "plant": given.plant,
        "workload": traffic.model_dump(),
        "duration_s": 3600 * given.hours + limit_s,
        "record": {"sample_s": 30.0},
    }
    return check_scenario(keys, "benchmark", Path())


def grid(base: Scenario, targets: Sequence[Target], given: argparse.Namespace) -> dict[str, dict[int, list[float]]]:
    """Measure -> fleet -> its value for each seed."""
    folder = given.folder / given.garage
    open_folder(folder)
    fleets = range(1, given.most + 1)
    specs = {n: make_runs([base.model_copy(update={"agvs": n})], [variant_of({"agvs": n})], SEEDS) for n in fleets}
    write_plan([spec for group in specs.values() for spec in group], folder)
    keys = {target.key for target in targets}
    with open_executor(given.workers) as executor:
        return {key: {n: measure_specs(specs[n], key, folder, executor) for n in fleets} for key in keys}


def brute_force(known: dict[int, list[float]], target: Target) -> int | None:
    """The smallest fleet whose 30 seeds meet the target."""
    good = (n for n in sorted(known) if interval(known[n], 2 * LAST_CONFIDENCE - 1).high < target.limit)
    return next(good, None)


if __name__ == "__main__":
    main()
