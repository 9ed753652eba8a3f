"""The runs behind the docs' tables, and how each table shows them; ``remake.py`` makes both.

A set is a list of cases, a function from a case to its figures, and words. A table is a set and a function from its
rows to lines of Markdown.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

Row = dict[str, Any]
Rows = Sequence[Row]


@dataclass(frozen=True)
class RunSet:
    """Runs of one kind.

    Attributes:
        words: what they are.
        cases: what each is run with; all have the same keys.
        run: makes one, and returns its figures.
    """

    words: str
    cases: tuple[Row, ...]
    run: Callable[[Row], Row]


@dataclass(frozen=True)
class Table:
    """A table of the docs.

    Attributes:
        runs: the set that it shows.
        show: rows of the set -> lines of Markdown; none if what it needs is not there.
    """

    runs: str
    show: Callable[[Rows], list[str]]


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown; none without rows."""
    return [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)] if rows else []


def percent(share: float) -> str:
    """A share in whole per cent."""
    return f"{100 * share:.0f} %"


def groups(rows: Rows, *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some columns, in the order in which these come."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def mean(rows: Rows, key: str) -> float:
    """Mean of a column."""
    return float(np.mean([row[key] for row in rows]))


def total(rows: Rows, *keys: str) -> int:
    """Sum of some columns; what is not measured counts as 0."""
    return round(float(np.nansum([row[key] for row in rows for key in keys])))


# --- whole: every car parked, then every car brought back -------------------------------------------------------------

DEMO = (("map1", 4, "token"), ("map1", 4, "whca"), ("map2", 4, "token"), ("map2", 4, "whca"), ("map3", 8, "token"))


def run_whole(case: Row) -> Row:
    """Every car is parked, then every car is brought back."""
    from analysis.replay import write_replay
    from parking_sim.config import load_scenario
    from parking_sim.demo import complaints_of
    from parking_sim.simulation import simulate

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        summary = simulate(load_scenario(case["garage"], case_keys(case)), folder)
        replay = write_replay(folder, report=False).stat().st_size
    kept = (
        "tasks_done", "tasks_wanted", "sumo_collisions", "footprint_overlaps", "least_clearance_m", "deadlocks_found",
        "deadlocks_resolved", "deadlocks_unresolved", "simulated_s", "retrieval_wait_p95_s",
    )  # fmt: skip
    figures: Row = {key: summary.metrics[key] for key in kept}
    return figures | {"replay_mb": replay / 1e6, "complaints": "; ".join(complaints_of(summary))}


def case_keys(case: Row) -> Row:
    """A case's keys of a scenario."""
    return {key: value for key, value in case.items() if key in ("agvs", "planner", "plant", "seed")}


def show_demo(rows: Rows) -> list[str]:
    """A column a run."""
    runs = {(row["garage"], row["agvs"], row["planner"]): row for row in rows if row["plant"] == "sumo"}
    known = [runs[key] for key in DEMO if key in runs]
    lines: dict[str, Callable[[Row], str]] = {
        "AGVs": lambda row: f"{row['agvs']}",
        "tasks done": lambda row: f"{row['tasks_done']:,} of {row['tasks_wanted']:,}",
        "SUMO collisions, overlaps": lambda row: f"{row['sumo_collisions']:.0f}, {row['footprint_overlaps']:.0f}",
        "least clearance, m": lambda row: f"{row['least_clearance_m']:.2f}",
        "deadlocks found, resolved": lambda row: f"{row['deadlocks_found']}, {row['deadlocks_resolved']}",
        "tasks an hour": lambda row: f"{3600 * row['tasks_done'] / row['simulated_s']:.1f}",
        "simulated hours": lambda row: f"{row['simulated_s'] / 3600:.1f}",
    }
    names = [row["garage"] + ("" if row["planner"] == "token" else f", `{row['planner']}`") for row in known]
    return markdown(["", *names], [[name, *map(show, known)] for name, show in lines.items()] if known else [])


def show_fleets(rows: Rows) -> list[str]:
    """A line for each garage and plant of the default planner."""
    lines = []
    ours = sorted((row for row in rows if row["planner"] == "token"), key=lambda row: row["agvs"])
    for (garage, plant), own in sorted(groups(ours, "garage", "plant").items()):
        clearance = min(row["least_clearance_m"] for row in own)
        lines.append(
            [
                garage,
                " / ".join(str(row["agvs"]) for row in own),
                "SUMO" if plant == "sumo" else "ticks",
                " / ".join(f"{row['simulated_s']:,.0f}" for row in own),
                "" if math.isnan(clearance) else f"{clearance:.2f}",
                f"{total(own, 'deadlocks_found')}, {total(own, 'deadlocks_unresolved')}",
                f"{total(own, 'sumo_collisions', 'footprint_overlaps')}",
                "yes" if all(row["tasks_done"] == row["tasks_wanted"] for row in own) else "no",
            ]
        )
    headings = ["garage", "AGVs", "plant", "simulated s (ticks)", "least clearance, m", "deadlocks found, left"]
    return markdown([*headings, "collisions and overlaps", "all tasks done"], lines)


def show_replay_sizes(rows: Rows) -> list[str]:
    """Size of the replay's page."""
    lines = []
    for row in rows:
        if (row["garage"], row["agvs"], row["planner"]) in DEMO and (row["planner"], row["plant"]) == ("token", "sumo"):
            run = f"{row['garage']}, {row['agvs']} AGVs, {row['simulated_s'] / 3600:.1f} hours"
            lines.append([f"{run}, {row['tasks_done']:,} tasks", f"{row['replay_mb']:.2f} MB"])
    return markdown(["run", "file"], lines)


# --- poisson ----------------------------------------------------------------------------------------------------------

#: Two hours of requests for half-full garages; the run goes on until everybody has been served.
TRAFFIC = {
    "kind": "poisson",
    "arrivals_share_per_h": 0.1,
    "dwell_median_min": 40,
    "initial_occupancy": 0.5,
    "duration_min": 120,
}


def run_poisson(case: Row) -> Row:
    """Two hours of Poisson traffic with retrievals by name."""
    from parking_sim.config import load_scenario
    from parking_sim.demo import complaints_of
    from parking_sim.simulation import simulate

    summary = simulate(load_scenario(case["garage"], {**case_keys(case), "workload": TRAFFIC}), None)
    kept = (
        "requests",
        "tasks_done",
        "cars_arrived",
        "cars_left",
        "deadlocks_found",
        "deadlocks_resolved",
        "simulated_s",
    )
    figures: Row = {key: summary.metrics[key] for key in kept}
    return figures | {"complaints": "; ".join(complaints_of(summary))}


def show_poisson(rows: Rows) -> list[str]:
    """A line a garage."""
    lines = [
        [
            row["garage"],
            f"{row['agvs']}",
            f"{row['requests']}",
            f"{row['tasks_done']}",
            f"{row['cars_arrived']}, {row['cars_left']}",
            f"{row['deadlocks_found']}, {row['deadlocks_resolved']}",
            f"{row['simulated_s']:,.0f}",
            row["complaints"] or "all well",
        ]
        for row in rows
    ]
    headings = [
        "garage",
        "AGVs",
        "requests",
        "served",
        "cars arrived, left",
        "deadlocks found, resolved",
        "simulated s",
    ]
    return markdown([*headings, "checks"], lines)


# --- saturation -------------------------------------------------------------------------------------------------------

PLANNERS = ("token", "pbs", "whca")


def run_saturation(case: Row) -> Row:
    """More cars than can be served, both ways."""
    from planners import run

    return run((case["garage"], case["planner"], case["agvs"], case["seed"], case["minutes"], "nearest-job"))


def show_saturation(rows: Rows) -> list[str]:
    """Tasks an hour, with the deadlocks found and left."""
    planners = [planner for planner in PLANNERS if any(row["planner"] == planner for row in rows)]
    lines = []
    for (garage, agvs), own in sorted(groups(rows, "garage", "agvs").items()):
        by_planner = groups(own, "planner")
        lines.append([garage, f"{agvs}", *(_throughput(by_planner.get((planner,), [])) for planner in planners)])
    return markdown(["garage", "AGVs", *(f"`{planner}`" for planner in planners)], lines)


def _throughput(rows: Rows) -> str:
    if not rows:
        return ""
    found, left = total(rows, "deadlocks_found"), total(rows, "deadlocks_unresolved")
    words = f" ({found}{f', {left} left' if left else ''})" if found else ""
    return f"{mean(rows, 'tasks_per_h'):.0f}{words}"


def show_bound(rows: Rows) -> list[str]:
    """How near the default planner comes to the bound."""
    keys = ("bound_share", "alone_share", "cars_at_bay")
    ours = groups([row for row in rows if row["planner"] == "token"], "garage", "agvs")
    lines = [[key[0], f"{key[1]}", *(f"{mean(own, name):.2f}" for name in keys)] for key, own in sorted(ours.items())]
    return markdown(["garage", "AGVs", "`bound_share`", "`alone_share`", "cars at a bay"], lines)


# --- speed ------------------------------------------------------------------------------------------------------------

PARTS = {
    "sumo": "SUMO's own step",
    "plant": "rest of the plant: reading, granting, stops",
    "planning": "planning",
    "execution": "execution: orders, dispatch, garage",
    "record": "recording",
    "check": "footprint check",
}


def run_speed(case: Row) -> Row:
    """Seconds of each part of a run; a short one first compiles the kernels."""
    from speed import measure

    measure(case["garage"], {**case_keys(case), "max_time_s": 200.0})
    found = measure(case["garage"], {**case_keys(case), "max_time_s": case["seconds"]})
    return {f"{part}_s": found["wall_s"][part] for part in PARTS} | {"simulated_s": found["simulated_s"]}


def show_speed(rows: Rows) -> list[str]:
    """Medians of each part as a ratio to SUMO alone."""
    by_planner = {planner: own for (planner,), own in groups(rows, "planner").items()}
    ratios = {
        planner: [float(np.median([row[f"{part}_s"] / row["sumo_s"] for row in own])) for part in PARTS]
        for planner, own in by_planner.items()
    }
    speeds = [
        float(np.median([row["simulated_s"] / sum(row[f"{part}_s"] for part in PARTS) for row in own]))
        for own in by_planner.values()
    ]
    lines = [[words, *(f"{own[n]:.2f}" for own in ratios.values())] for n, words in enumerate(PARTS.values())]
    lines.append(["**all but SUMO**", *(f"**{sum(own) - 1:.2f}**" for own in ratios.values())])
    lines.append(["simulated seconds a wall second, beside other work", *(f"{speed:.0f}" for speed in speeds)])
    return markdown(["part, as a ratio to SUMO alone", *(f"`{planner}`" for planner in by_planner)], lines)


# --- departures -------------------------------------------------------------------------------------------------------


def run_departures(case: Row) -> Row:
    """Batches of loaded departures, planned at once."""
    from departures import measure

    return measure(case["garage"], case["agvs"], case["planner"])


def show_departures(rows: Rows) -> list[str]:
    """A line a garage and fleet, then the time."""
    by_planner = {planner: own for (planner,), own in groups(rows, "planner").items()}
    lines = []
    for garage, agvs in groups(rows, "garage", "agvs"):
        fleet = [row for row in rows if (row["garage"], row["agvs"]) == (garage, agvs)]
        delays = {row["planner"]: f"{row['delay']:.2f}" for row in fleet}
        lines.append([f"{garage}, {agvs} AGVs: delay in moves", *(delays.get(planner, "") for planner in by_planner)])
    times = [[row["cpu_ms"] for row in own] for own in by_planner.values()]
    lines.append(["CPU milliseconds a batch", *(f"{min(own):.1f} to {max(own):.0f}" for own in times)])
    lines.append(["agents that hold their place", *(f"{total(own, 'held')}" for own in by_planner.values())])
    return markdown(["means of 10 batches, 40 moves ahead", *(f"`{planner}`" for planner in by_planner)], lines)


# --- faults -----------------------------------------------------------------------------------------------------------


def run_noise(case: Row) -> Row:
    """All cars wanted in at once, with noise on the time of every move."""
    from stops import in_sumo

    control = {"replanning": case["replanning"], "reorder": case["reorder"]}
    faults = {"travel_noise": case["sigma"]}
    return in_sumo(case["garage"], case["agvs"], case["planner"], case["seed"], math.inf, faults, control)


def show_noise(rows: Rows) -> list[str]:
    """Tasks done by noise and way to answer it."""
    sigmas = sorted({row["sigma"] for row in rows})
    lines = []
    for (replanning, reorder), own in groups(rows, "replanning", "reorder").items():
        by_sigma = groups(own, "sigma")
        cells = [f"{mean(by_sigma[sigma,], 'done'):.1f}" if (sigma,) in by_sigma else "" for sigma in sigmas]
        lines.append([replanning, "switched" if reorder else "kept", *cells])
    return markdown(["replanning", "orders", *(f"sigma {sigma:g}" for sigma in sigmas)], lines)


def run_soak(case: Row) -> Row:
    """An hour with every fault on at once, or with none."""
    from soak import run

    row = run(
        (case["garage"], case["agvs"], case["demand"], case["minutes"]), case["seed"], case["planner"], case["rate"]
    )
    kept = ("tasks_per_h", "agv_steps", "sumo_collisions", "footprint_overlaps", "lost", "deadlocks_found")
    figures: Row = {key: row[key] for key in (*kept, "deadlocks_unresolved", "status")}
    return figures | {"faults": json.dumps({kind: [round(s) for s in row["faults"][kind]] for kind in row["faults"]})}


def show_soak(rows: Rows) -> list[str]:
    """What is kept of the throughput, and what must not happen."""
    lines = []
    for (garage, agvs, demand), own in groups(rows, "garage", "agvs", "demand").items():
        hard, calm = [row for row in own if row["rate"]], [row for row in own if not row["rate"]]
        if hard and calm:
            with_faults, without = mean(hard, "tasks_per_h"), mean(calm, "tasks_per_h")
            lines.append(
                [
                    garage,
                    f"{agvs}",
                    "steady" if demand == "poisson" else demand,
                    f"{total(hard, 'agv_steps'):,}",
                    f"{total(hard, 'sumo_collisions', 'footprint_overlaps')}",
                    f"{total(hard, 'lost')}",
                    f"{total(hard, 'deadlocks_found')}, {total(hard, 'deadlocks_unresolved')}",
                    f"{with_faults:.1f}",
                    f"{without:.1f}",
                    percent(with_faults / without),
                ]
            )
    headings = [
        "garage",
        "AGVs",
        "demand",
        "AGV-steps",
        "collisions, overlaps",
        "requests, cars lost",
        "deadlocks found, left",
    ]
    return markdown([*headings, "tasks an hour with faults", "without", "kept"], lines)


def show_recovery(rows: Rows) -> list[str]:
    """How long faults last, by kind."""
    seconds: dict[str, list[float]] = {}
    for row in rows:
        for kind, found in json.loads(row["faults"]).items():
            seconds.setdefault(kind.replace("_", " "), []).extend(found)
    lines = [
        [kind, f"{len(found):,}", *(f"{value:,.0f}" for value in np.quantile(found, (0.5, 0.95)))]
        for kind, found in sorted(seconds.items())
        if found
    ]
    return markdown(["fault", "times", "seconds from begin to end, p50", "p95"], lines)


# --- sizing -----------------------------------------------------------------------------------------------------------


def run_sizing(case: Row) -> Row:
    """Sizing beside a grid of all fleets with 30 seeds."""
    from sizing import SEEDS, both, grid, scenario, spread

    from parking_sim.sizing import parse_target

    given = argparse_of(case)
    target = parse_target(case["target"])
    values = grid(scenario(given, target.goes_on_s), [target], given)[target.key]
    found, best = both(target, values)
    whole = len(SEEDS) * case["most"]
    pairs = [both(one, values) for one in spread(target.key, values, 60)]
    shares = [one.runs / whole for one, _ in pairs]
    return {
        "grid": "none" if best is None else str(best),
        "answer": "none" if found.number is None else str(found.number),
        "runs": found.runs,
        "grid_runs": whole,
        "limits_agree": sum(best == one.number for one, best in pairs),
        "limits": len(pairs),
        "share_mean": float(np.mean(shares)),
        "share_most": max(shares),
    }


def argparse_of(case: Row) -> Any:
    """The options of ``sizing.py``."""
    from argparse import Namespace

    return Namespace(
        garage=case["garage"], most=case["most"], profile="mall-saturday", scale=case["scale"], hours=0.5,
        plant=case["plant"], folder=Path(tempfile.gettempdir()) / "parking-sim-sizing", workers=1,
    )  # fmt: skip


def show_sizing(rows: Rows) -> list[str]:
    """The answers side by side, and how many runs they took."""
    lines = [
        [
            f"{row['garage']}, 1 to {row['most']} AGVs, {row['grid_runs']} runs",
            row["target"],
            f"{row['grid']}",
            f"{row['answer']}",
            f"{row['runs']}",
            percent(row["runs"] / row["grid_runs"]),
            f"{row['limits_agree']} of {row['limits']}",
            f"{percent(row['share_mean'])}, {percent(row['share_most'])}",
        ]
        for row in rows
    ]
    headings = ["garage, grid", "target", "grid", "sizing", "runs", "of the grid", "other limits: answers agree"]
    return markdown([*headings, "of the grid, mean and most"], lines)


# --- grids, lifelong, optimality, stops, large: without bays, or by the clock -----------------------------------------


def run_grids(case: Row) -> Row:
    """The default planner on a grid of the thesis, in ticks."""
    from grids import measure

    return measure(case["garage"], case["agvs"], case["park_only"])


def show_grids(rows: Rows) -> list[str]:
    """A line a grid."""
    lines = []
    for (garage, agvs), own in groups(rows, "garage", "agvs").items():
        by_end = {row["park_only"]: row for row in own}
        if len(by_end) == 2:
            whole, parking = by_end[False], by_end[True]
            figures = (whole["steps"], whole["nodes_expanded"], parking["nodes_expanded"])
            lines.append([garage.removesuffix("_thesis").upper(), f"{agvs}", *(f"{value:,}" for value in figures)])
    return markdown(["grid", "AGVs", "ticks", "nodes expanded", "while parking"], lines)


#: Map and fleet -> figures of public solvers: share of the ideal of PBS, WHCA* and PIBT.
PUBLIC: Mapping[tuple[str, int], tuple[str, str, str]] = {
    ("garage", 4): (".96", ".97", ".49"),
    ("garage", 8): (".91", ".89", ".52"),
    ("garage", 16): (".92", ".84", ".31"),
    ("garage", 32): (".83", ".69", ".23"),
    ("garage", 64): (".65", "jams", ".07"),
    ("warehouse", 10): (".96", ".98", ".94"),
    ("warehouse", 50): (".88", ".80", ".77"),
    ("warehouse", 100): (".76", ".61", ".54"),
    ("warehouse", 200): ("jams", "jams", ".31"),
}
LIFELONG = ("token", "pbs", "whca", "pibt")
#: Fleets from which on PBS, which takes long, is given one seed.
PBS_ONE_SEED = {"garage": 64, "long_garage": 64, "warehouse": 100}


def run_lifelong(case: Row) -> Row:
    """Lifelong tasks on a grid, one move a tick."""
    from lifelong import MAPS, OPTIONS, measure

    graph, planner = MAPS[case["map"]](), case["planner"]
    options = OPTIONS.get(planner, {})
    measure(graph, 2, planner, 1, 20, options)
    row = measure(graph, case["agents"], planner, case["seeds"], 1000, options, case["repeats"])
    return {key: value for key, value in row.items() if key not in case} | {
        "share": float(str(row["tasks_per_tick"])) / float(str(row["ideal"]))
    }


def show_lifelong(rows: Rows) -> list[str]:
    """Shares of the ideal beside public ones, and milliseconds of planning a tick."""
    lines = []
    for (name, agents), own in groups(rows, "map", "agents").items():
        found = {row["planner"]: row for row in own}
        shares = [f"{found[p]['share']:.2f}".removeprefix("0") if p in found else "" for p in LIFELONG]
        times = [_brief(found[p]["planning_ms"]) if p in found else "" for p in LIFELONG[:3]]
        lines.append(
            [name.replace("_", " "), f"{agents}", *PUBLIC[name.removeprefix("long_"), agents], *shares, *times]
        )
    headings = ["map", "AGVs", "public PBS", "public WHCA*", "public PIBT", *(f"`{planner}`" for planner in LIFELONG)]
    return markdown([*headings, "ms a tick: `token`", "`pbs`", "`whca`"], lines)


def _brief(value: float) -> str:
    """Two digits that tell."""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def run_optimality(case: Row) -> Row:
    """Ratios to CBS of some random problems, of those that CBS solves; null where a planner finds no plan."""
    from optimality import PLANNERS as ASKED
    from optimality import rows

    done = list(rows(range(case["first"], case["first"] + case["problems"])))
    found = {name: [None if math.isnan(r := float(str(row[name]))) else r for row in done] for name in ASKED}
    return {"solved": len(done), "ratios": json.dumps(found)}


def show_optimality(rows: Rows) -> list[str]:
    """A line a planner."""
    ratios: dict[str, list[float]] = {}
    for row in rows:
        for planner, found in json.loads(row["ratios"]).items():
            ratios.setdefault(planner, []).extend(math.nan if ratio is None else ratio for ratio in found)
    lines = []
    for planner, every in ratios.items():
        solved = np.array([ratio for ratio in every if not math.isnan(ratio)])
        shares = [f"{share:.2f}".removeprefix("0") for share in (len(solved) / len(every), np.mean(solved < 1 + 1e-9))]
        worst = [f"{value:.2f}" for value in (*np.quantile(solved, (0.9, 0.99)), solved.max())]
        lines.append([f"`{planner}`", *shares, f"{solved.mean():.3f}", *worst])
    known, asked = total(rows, "solved"), total(rows, "problems")
    headings = ["solves", "optimal, of what it solves", "mean ratio", "p90", "p99", "worst"]
    return markdown([f"of {known} of {asked} problems, solved by CBS", *headings], lines)


def run_stops(case: Row) -> Row:
    """The warehouse grid without stops, with stops, and with stops when fewer tasks come."""
    from stops import DEFAULT, EVERYTHING, SHARE, in_warehouse

    def done(share: float, answer: tuple[str, bool], tasks: float = math.inf) -> Row:
        control = {"replanning": answer[0], "reorder": answer[1]}
        return in_warehouse("token", case["agvs"], share, case["seed"], tasks, control)

    calm, hard, switched = done(0.0, DEFAULT), done(SHARE, DEFAULT), done(SHARE, EVERYTHING)
    kept = {
        f"kept_at_{load:.0%}": done(SHARE, DEFAULT, load * calm["done"])["done"]
        / done(0.0, DEFAULT, load * calm["done"])["done"]
        for load in (0.8, 0.9)
    }
    return {"calm": calm["done"], "hard": hard["done"], "switched": switched["done"], "stopped": hard["stopped"]} | kept


def show_stops(rows: Rows) -> list[str]:
    """A line a fleet."""
    lines = []
    for (agvs,), own in groups(rows, "agvs").items():
        calm, hard, stopped = mean(own, "calm"), mean(own, "hard"), mean(own, "stopped")
        shares = [
            hard / calm,
            1 - stopped,
            mean(own, "switched") / calm,
            mean(own, "kept_at_80%"),
            mean(own, "kept_at_90%"),
        ]
        lines.append([f"{agvs}", percent(stopped), f"{calm:,.0f}", f"{hard:,.0f}", *map(percent, shares)])
    headings = ["AGVs", "stopped", "tasks without", "with stops", "kept", "ceiling", "kept, switched"]
    return markdown([*headings, "kept at 80 % of the load", "at 90 %"], lines)


def run_large(case: Row) -> Row:
    """A garage of 10,000 slots in SUMO."""
    from large import net_in, run

    row = run(net_in(Path(tempfile.gettempdir()) / "parking-sim-large"), case["agvs"], "token", "sumo", case["minutes"])
    return {key: value for key, value in row.items() if key not in case}


def show_large(rows: Rows) -> list[str]:
    """A line a fleet."""
    lines = [
        [
            f"{row['agvs']}",
            f"{row['cpu_ms']:.1f}",
            f"{row['cpu_us_per_agv']:.0f}",
            f"{row['cpu_times_real']:.0f}",
            f"{row['memory_mb']:,}",
            f"{row['deadlocks']}",
        ]
        for row in rows
    ]
    return markdown(
        ["AGVs", "CPU a step, ms", "of an AGV, microseconds", "times real time, by CPU", "memory, MB", "deadlocks"],
        lines,
    )


def _whole(garage: str, fleets: Sequence[int], plant: str = "sumo", planner: str = "token") -> list[Row]:
    return [{"garage": garage, "agvs": n, "plant": plant, "planner": planner} for n in fleets]


#: In the order in which they are made.
SETS: Mapping[str, RunSet] = {
    "whole": RunSet(
        "every car parked, then every car brought back",
        (
            *_whole("map1", (1, 2, 3, 4)),
            *_whole("map1", (4,), planner="whca"),
            *_whole("map1_thesis", (1, 2, 3, 4)),
            *_whole("map1_thesis", (1, 2, 3, 4), "discrete"),
            *_whole("map3", (8,)),
            *_whole("map2", (4,)),
            *_whole("map2", (4,), planner="whca"),
            *_whole("map2_thesis", (4,), "discrete"),
            *_whole("map3_thesis", (8,), "discrete"),
        ),
        run_whole,
    ),
    "poisson": RunSet(
        "two hours of Poisson traffic, in SUMO",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": "token", "seed": 3}
            for garage, agvs in (("map1", 4), ("map2", 4), ("map3", 8), ("map1_thesis", 4))
        ),
        run_poisson,
    ),
    "saturation": RunSet(
        "mixed traffic, more cars than any fleet could serve, in SUMO",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": planner, "seed": seed, "minutes": 20}
            for garage, fleets in (("map1", (2, 4, 8)), ("map2", (4, 8, 16)))
            for seed in (1, 2, 3)
            for agvs in fleets
            for planner in PLANNERS
        ),
        run_saturation,
    ),
    "speed": RunSet(
        "seconds of each part of a run on map3 with 8 AGVs",
        tuple(
            {"garage": "map3", "agvs": 8, "planner": planner, "seconds": 5000, "repeat": repeat}
            for planner in ("token", "whca")
            for repeat in (1, 2, 3)
        ),
        run_speed,
    ),
    "noise": RunSet(
        "all cars wanted in at once on map2 with 16 AGVs, 20 minutes, noise on the time of each move, in SUMO",
        tuple(
            {
                "garage": "map2",
                "agvs": 16,
                "planner": "token",
                "sigma": sigma,
                "replanning": replanning,
                "reorder": reorder,
                "seed": seed,
            }
            for seed in (1, 2, 3)
            for replanning, reorder in (("periodic", False), ("events", False), ("both", True))
            for sigma in (0.0, 0.2, 0.4)
        ),
        run_noise,
    ),
    "soak": RunSet(
        "all faults at once, in SUMO",
        tuple(
            {
                "garage": garage,
                "agvs": agvs,
                "demand": demand,
                "minutes": 60.0,
                "planner": "token",
                "seed": 0,
                "rate": rate,
            }
            for garage, agvs in (("map1", 8), ("map2", 8), ("map2", 16))
            for demand in ("poisson", "bursts")
            for rate in (0.0, 1.0)
        ),
        run_soak,
    ),
    "departures": RunSet(
        "batches of departures planned at once",
        tuple(
            {"garage": garage, "agvs": agvs, "planner": planner}
            for garage, agvs in (("map1", 4), ("map1", 8), ("map2", 8), ("map2", 16))
            for planner in ("whca", "ga_single", "ga_two_stage", "binary_tree")
        ),
        run_departures,
    ),
    "grids": RunSet(
        "the default planner on the thesis's grids, in ticks",
        tuple(
            {"garage": garage, "agvs": agvs, "park_only": park_only}
            for garage, agvs in (("map1_thesis", 4), ("map2_thesis", 4), ("map3_thesis", 8))
            for park_only in (True, False)
        ),
        run_grids,
    ),
    "stops": RunSet(
        "lifelong tasks on a warehouse grid with AGVs that stop",
        tuple({"agvs": agvs, "seed": seed} for agvs in (8, 16, 32, 64) for seed in (1, 2, 3)),
        run_stops,
    ),
    "optimality": RunSet(
        "random small garages, sum of arrivals over the optimum",
        tuple({"first": first, "problems": 20} for first in range(0, 200, 20)),
        run_optimality,
    ),
    "large": RunSet(
        "a garage of 10,000 slots, in SUMO",
        tuple({"agvs": agvs, "minutes": 10} for agvs in (8, 50, 200, 500)),
        run_large,
    ),
    "lifelong": RunSet(
        "lifelong tasks on grids",
        tuple(
            {
                "map": name,
                "agents": agents,
                "planner": planner,
                "seeds": 1 if planner == "pbs" and agents >= PBS_ONE_SEED[name] else 3,
                "repeats": 3 if planner in ("token", "whca") else 1,
            }
            for name, fleets in (
                ("garage", (4, 8, 16, 32, 64)),
                ("long_garage", (4, 8, 16, 32, 64)),
                ("warehouse", (10, 50, 100, 200)),
            )
            for agents in fleets
            for planner in LIFELONG
        ),
        run_lifelong,
    ),
    "sizing": RunSet(
        "sizing against a grid of all fleets, in ticks",
        tuple(
            {"garage": "map1", "most": 8, "scale": 0.25, "plant": "discrete", "target": target}
            for target in (
                "retrieval p95 < 60 s",
                "retrieval p95 < 52 s",
                "retrieval mean < 50 s",
                "retrieval p95 < 45 s",
            )
        ),
        run_sizing,
    ),
}

TABLES: Mapping[str, Table] = {
    "demo": Table("whole", show_demo),
    "fleets": Table("whole", show_fleets),
    "replay-sizes": Table("whole", show_replay_sizes),
    "poisson": Table("poisson", show_poisson),
    "saturation": Table("saturation", show_saturation),
    "bound": Table("saturation", show_bound),
    "speed": Table("speed", show_speed),
    "departures": Table("departures", show_departures),
    "noise": Table("noise", show_noise),
    "soak": Table("soak", show_soak),
    "recovery": Table("soak", show_recovery),
    "sizing": Table("sizing", show_sizing),
    "grids": Table("grids", show_grids),
    "stops": Table("stops", show_stops),
    "optimality": Table("optimality", show_optimality),
    "large": Table("large", show_large),
    "lifelong": Table("lifelong", show_lifelong),
}
