"""What a run was worth, as numbers: the thesis' seven metrics and those a garage's owner asks for.

A wait that has not ended when the run does counts with its length so far, so that a garage that serves some customers
quickly and others never does not look good. Quantiles of samples (waits, planning times) interpolate linearly between
order statistics (numpy's default). Quantiles
over time (queue) are the least value that held for at least that share of the time; a sample holds until the next one.
A number that can't be known (no such task, not recorded) is NaN, null in ``metrics.json``. Keys that start with
``wall_`` are wall-clock times and differ from run to run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.record import ACTIVITIES, NAN
from analysis.statistic import statistic
from analysis.tables import Run
from analysis.turned_away import turned_away
from analysis.witness import WITNESSES

if TYPE_CHECKING:
    import pandas as pd

Metrics = dict[str, float | int]

#: Service levels of a retrieval, seconds.
SERVICE_LEVELS_S = (180, 300)
CARS = ("initial", "arrived", "parked", "left", "in_transit")

_WAITS = {
    "retrieval_wait": "from the request of a retrieval until the car is lowered at the bay",
    "retrieval_total": "from the request of a retrieval until the customer has driven off",
    "park_queue": "from a customer's arrival until the car stands at a bay",
    "park_wait": "from the car standing at a bay until it is on an AGV (with the customer's handling)",
    "park_total": "from a customer's arrival until the car is in its slot",
}
_STATISTICS = {
    "mean": "mean",
    "p50": "median",
    "p90": "90 % quantile",
    "p95": "95 % quantile",
    "p99": "99 % quantile",
    "max": "longest",
}

#: Key -> (unit, meaning), in the order of a report.
METRICS: Mapping[str, tuple[str, str]] = {
    "simulated_s": ("s", "simulated time"),
    "tasks_wanted": ("tasks", "tasks the scenario asks for"),
    "tasks_done": ("tasks", "tasks served"),
    "requests": ("", "requests made"),
    "requests_waiting": ("", "requests not yet served at the end"),
    "requests_void": ("", "requests that mean nothing, see analysis.record.COLUMNS, tasks, state"),
    "requests_conserved": ("0/1", "1 if every request ended in exactly one of served, waiting, turned away, void"),
    "customers_came": ("cars", "customers who came with a car, with those turned away; void requests don't count"),
    "customers_turned_away": ("cars", "those of them who were turned away: no slot for them, or a queue too long"),
    "turned_away_share": ("", "customers turned away as a share of those who came"),
    **{f"cars_{name}": ("cars", f"see analysis.record.META, cars_{name}") for name in CARS},
    "cars_conserved": ("0/1", "1 if initial + arrived = parked + left + in transit, and the garage's own audit agrees"),
    "parks_done": ("cars", "cars parked"),
    "retrievals_done": ("cars", "cars given back"),
    "cars_in_per_hour": ("cars/h", "cars parked per simulated hour"),
    "cars_out_per_hour": ("cars/h", "cars given back per simulated hour"),
    **{
        f"{wait}_{statistic}_s": ("s", f"{meaning}; {words}")
        for wait, meaning in _WAITS.items()
        for statistic, words in _STATISTICS.items()
    },
    **{
        f"retrieval_within_{level}_s_share": (
            "",
            f"share of retrievals with a wait of at most {level} s, of those delivered or already waiting longer and of"
            " the customers turned away, who count as missed",
        )
        for level in SERVICE_LEVELS_S
    },
    "car_on_agv_max_s": ("s", "longest time that a car sat on an AGV, from lifting to lowering"),
    "queue_mean": ("cars", "cars that wait to reach a bay, mean over time"),
    "queue_p95": ("cars", "the same, 95 % quantile over time"),
    "queue_max": ("cars", "the same, most"),
    "spill_back_s": ("s", "time with cars waiting on the public street"),
    "spill_back_max": ("cars", "most cars waiting on the public street"),
    "parked_max": ("cars", "most cars in slots"),
    **{f"agv_{name}_share": ("", f"share of all AGVs' time spent {name}") for name in ACTIVITIES},
    "agv_busy_share": ("", "share of all AGVs' time neither idle nor charging"),
    "empty_travel_share": ("", "driving without a car as a share of all driving time"),
    "agv_time_error_s": ("s", "largest difference between an AGV's times added up and the simulated time; about 0"),
    "distance_m": ("m", "distance driven by all AGVs"),
    "energy_wh": ("Wh", "energy drawn by all AGVs"),
    "charges": ("", "charges begun"),
    "charger_wait_s": (
        "s",
        "time from when an AGV had to charge and none was free to its charge, all AGVs together",
    ),
    "charger_wait_max_s": ("s", "the same, longest"),
    "charger_busy_share": ("", "share of the chargers' time in which an AGV charged"),
    "batteries_flat": ("", "times that an AGV stood with an empty battery"),
    "deadlocks_found": ("", "deadlocks detected"),
    "deadlocks_stuck": ("", "of these, those found as no ring or chain: an AGV came no nearer to its goal for long"),
    "deadlocks_resolved": ("", "deadlocks resolved"),
    "deadlocks_unresolved": ("", "deadlocks found but not resolved"),
    "deadlock_p50_s": ("s", "time from the beginning of the wait to the resolution, median"),
    "deadlock_p95_s": ("s", "the same, 95 % quantile"),
    "deadlock_max_s": ("s", "the same, longest"),
    "sumo_collisions": ("", "collisions SUMO reported"),
    "footprint_overlaps": ("", "overlaps the independent footprint check saw"),
    "turns_under_cars": ("", "turns of an empty AGV under a parked car, in slots too short to drive straight out of"),
    "least_clearance_m": ("m", "least distance between two bodies"),
    **{
        f"{name}_witnessed_share": ("", f"share of the facts about {what} that SUMO's outputs confirm")
        for name, what in (
            ("customers", "customers' stays at bays"),
            ("agvs", "the lifting and lowering of cars"),
            ("distance", "the distances of AGVs"),
            ("battery", "the batteries of AGVs"),
            ("street", "the queue in the street"),
            ("totals", "collisions, teleports and time"),
        )
    },
    "steps": ("steps", "planning steps simulated"),
    "throughput": ("tasks/step", "tasks done per planning step (thesis)"),
    "movement_cost": ("edges", "edges driven, cells on a grid (thesis)"),
    "nodes_expanded": ("", "search states expanded (thesis)"),
    "heap_moves": ("", "pushes, pops and swaps inside heaps (thesis)"),
    "nodes_generated": ("", "search states put on an open list (thesis)"),
    "valid_expansions": ("", "expanded states that were not stale (thesis)"),
    "valid_ratio": ("", "valid expansions / generated states (thesis)"),
    "slot_choice_expanded": ("", "states expanded while choosing slots, not in nodes_expanded"),
    "window_mean_cells": ("moves", "planning window, mean over planning calls"),
    "wait_edges": ("", "wait-for edges, summed over planning calls: met in planning (pipeline) or of AGVs that wait"),
    "wait_rings": ("", "strongly connected components of two or more of these, summed over planning calls"),
    "planning_calls": ("", "planning calls"),
    "planning_unsolved_share": ("", "share of planning calls that were not solved completely"),
    "wall_planning_call_p50_ms": ("ms", "wall-clock time of a planning call, median"),
    "wall_planning_call_p99_ms": ("ms", "the same, 99 % quantile"),
    "wall_planning_call_max_ms": ("ms", "the same, longest"),
    "wall_planning_step_p50_ms": ("ms", "wall-clock planning time of a step, steps without planning count 0; median"),
    "wall_planning_step_p99_ms": ("ms", "the same, 99 % quantile"),
    "wall_total_s": ("s", "wall-clock time of the run"),
    "wall_speed": ("", "simulated seconds per wall-clock second"),
}


def run_metrics(run: Run) -> Metrics:
    """All metrics of one run.

    Args:
        run: a record, see ``analysis.tables``.

    Returns:
        A number for each key of ``METRICS``, in that order.
    """
    values = {
        **_requests(run),
        **_cars(run),
        **_waits(run),
        **_queue(run),
        **_fleet(run),
        **_charging(run),
        **_deadlocks(run),
        **_safety(run),
        **_thesis(run),
        **_planning_time(run),
    }
    return {key: values[key] for key in METRICS}


def waits(tasks: pd.DataFrame, end_s: float) -> dict[str, NDArray[np.float64]]:
    """The waits that customers had.

    Args:
        tasks: table ``tasks``.
        end_s: end of the run, simulated seconds; a wait that has not ended by then counts with its length so far.

    Returns:
        Seconds by name as in ``METRICS`` (``retrieval_wait``, ``retrieval_total``, ``park_queue``, ``park_wait``,
        ``park_total``), in the order of requests, of those that began.
    """
    let_in = tasks[tasks["state"].isin(["served", "waiting"])]
    park, retrieve = (let_in[let_in["kind"] == kind] for kind in ("park", "retrieve"))
    differences = {
        "retrieval_wait": retrieve["delivered_s"].fillna(end_s) - retrieve["requested_s"],
        "retrieval_total": retrieve["done_s"].fillna(end_s) - retrieve["requested_s"],
        "park_queue": park["at_bay_s"].fillna(end_s) - park["requested_s"],
        "park_wait": park["lifted_s"].fillna(end_s) - park["at_bay_s"],
        "park_total": park["delivered_s"].fillna(end_s) - park["requested_s"],
    }
    return {name: column.dropna().to_numpy(dtype=np.float64) for name, column in differences.items()}


def share_within(tasks: pd.DataFrame, limit_s: float, end_s: float) -> float:
    """Share of customers whose retrieval had a wait of at most ``limit_s``.

    Retrievals that still wait at the end but not yet longer than the limit, and void ones, don't count. Those that wait
    longer count as missed, and so do customers who were turned away: a garage that locks up, or that turns customers
    away, does not look good.

    Args:
        tasks: table ``tasks``.
        limit_s: seconds.
        end_s: end of the run, simulated seconds.

    Returns:
        The share, NaN if nothing counts.
    """
    asked = tasks[(tasks["kind"] == "retrieve") & (tasks["state"] != "void")]
    delivered = asked["delivered_s"].notna()
    wait = asked["delivered_s"].fillna(end_s) - asked["requested_s"]
    counted = delivered | (wait > limit_s)
    return _ratio(int((wait[counted] <= limit_s).sum()), int(counted.sum()) + turned_away(tasks).number)


def _number(run: Run, key: str) -> float | int:
    """A number of ``run.json``, NaN if it is missing or null."""
    value = run.meta.get(key)
    return value if isinstance(value, int | float) else NAN


def _quantile(values: NDArray[np.float64], q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else NAN


def _ratio(a: float, b: float) -> float:
    return float(a / b) if b else NAN


def _requests(run: Run) -> Metrics:
    tasks, hours = run.tasks, _number(run, "simulated_s") / 3600.0
    state = tasks["state"]
    served = tasks[state == "served"]
    away = turned_away(tasks)
    parks, retrievals = (int((served["kind"] == kind).sum()) for kind in ("park", "retrieve"))
    return {
        "simulated_s": _number(run, "simulated_s"),
        "tasks_wanted": _number(run, "tasks_wanted"),
        "tasks_done": len(served),
        "requests": len(tasks),
        "requests_waiting": int((state == "waiting").sum()),
        "requests_void": int((state == "void").sum()),
        "requests_conserved": int(_conserved(run)),
        "customers_came": away.came,
        "customers_turned_away": away.number,
        "turned_away_share": away.share,
        "parks_done": parks,
        "retrievals_done": retrievals,
        "cars_in_per_hour": _ratio(parks, hours),
        "cars_out_per_hour": _ratio(retrievals, hours),
    }


def _conserved(run: Run) -> bool:
    """Each request made has exactly one row, with one of the four states."""
    tasks = run.tasks
    made = int((run.events["kind"] == "request_made").sum())
    known = tasks["state"].isin(["served", "waiting", "turned_away", "void"]).all()
    return bool(known and tasks["request"].is_unique and len(tasks) == made)


def _cars(run: Run) -> Metrics:
    cars = {name: _number(run, f"cars_{name}") for name in CARS}
    balance = cars["initial"] + cars["arrived"] - cars["parked"] - cars["left"] - cars["in_transit"]
    return {
        **{f"cars_{name}": value for name, value in cars.items()},
        "cars_conserved": NAN if np.isnan(balance) else int(balance == 0 and not run.meta.get("audit")),
    }


def _waits(run: Run) -> Metrics:
    metrics: Metrics = {}
    for name, values in waits(run.tasks, _number(run, "simulated_s")).items():
        for key in _STATISTICS:
            metrics[f"{name}_{key}_s"] = statistic(key, sorted(values))
    lifted = run.tasks[run.tasks["lifted_s"].notna()]
    on_agv_s = lifted["delivered_s"].fillna(_number(run, "simulated_s")) - lifted["lifted_s"]
    metrics["car_on_agv_max_s"] = float(on_agv_s.max()) if len(on_agv_s) else NAN
    for level in SERVICE_LEVELS_S:
        metrics[f"retrieval_within_{level}_s_share"] = share_within(run.tasks, level, _number(run, "simulated_s"))
    return metrics


def _queue(run: Run) -> Metrics:
    line = run.timeline
    end = _number(run, "simulated_s")
    times = line["time_s"].to_numpy(dtype=np.float64)
    held = np.diff(np.append(times, max(end, times[-1]) if len(times) else []))
    queue = line["queue"].to_numpy(dtype=np.float64)
    total = float(held.sum())
    return {
        "queue_mean": _ratio(float(queue @ held), total),
        "queue_p95": _time_quantile(queue, held, 0.95),
        "queue_max": int(queue.max()) if len(queue) else NAN,
        "spill_back_s": float(held[line["spilled"].to_numpy() > 0].sum()) if len(queue) else NAN,
        "spill_back_max": int(line["spilled"].max()) if len(queue) else NAN,
        "parked_max": int(line["parked"].max()) if len(queue) else NAN,
    }


def _time_quantile(values: NDArray[np.float64], held_s: NDArray[np.float64], q: float) -> float:
    """Least value that held, or a lesser one did, for at least a share ``q`` of the time."""
    if held_s.sum() <= 0.0:
        return NAN
    order = np.argsort(values, kind="stable")
    share = np.cumsum(held_s[order]) / held_s.sum()
    return float(values[order][np.searchsorted(share, q - 1e-12)])


def _fleet(run: Run) -> Metrics:
    agvs = run.agvs
    seconds = {name: float(agvs[f"{name}_s"].sum()) for name in ACTIVITIES}
    total = sum(seconds.values())
    errors = agvs[[f"{name}_s" for name in ACTIVITIES]].sum(axis=1) - _number(run, "simulated_s")
    return {
        **{f"agv_{name}_share": _ratio(value, total) for name, value in seconds.items()},
        "agv_busy_share": _ratio(total - seconds["idle"] - seconds["charging"], total),
        "empty_travel_share": _ratio(seconds["empty"], seconds["empty"] + seconds["loaded"]),
        "agv_time_error_s": float(errors.abs().max()) if len(agvs) else NAN,
        "distance_m": float(agvs["distance_m"].sum()),
        "energy_wh": float(agvs["energy_wh"].sum()),
    }


def _charging(run: Run) -> Metrics:
    events, end_s = run.events, _number(run, "simulated_s")
    since: dict[int, float] = {}
    waited: list[float] = []
    for agv, kind, time_s in events[["agv", "kind", "time_s"]].itertuples(index=False):
        if kind == "charge_wait":
            since.setdefault(agv, time_s)
        elif kind == "charge_start" and agv in since:
            waited.append(time_s - since.pop(agv))
    waited += [end_s - time_s for time_s in since.values()]
    chargers = int(run.vertices["roles"].str.split(",").map(lambda roles: "charger" in roles).sum())
    begun = run.details("fault_start")
    return {
        "charges": int((events["kind"] == "charge_start").sum()),
        "charger_wait_s": float(sum(waited)),
        "charger_wait_max_s": max(waited, default=0.0),
        "charger_busy_share": _ratio(float(run.agvs["charging_s"].sum()), chargers * end_s),
        "batteries_flat": int((begun["cause"] == "battery").sum()) if len(begun) else 0,
    }


def _deadlocks(run: Run) -> Metrics:
    causes = run.details("deadlock_found")
    found = len(causes)
    resolved = run.details("deadlock_resolved")
    cost = resolved["cost_s"].to_numpy(dtype=np.float64) if len(resolved) else np.empty(0)
    return {
        "deadlocks_found": found,
        "deadlocks_stuck": int((causes["cause"] == "stuck").sum()) if "cause" in causes else 0,
        "deadlocks_resolved": len(resolved),
        "deadlocks_unresolved": found - len(resolved),
        "deadlock_p50_s": _quantile(cost, 0.5),
        "deadlock_p95_s": _quantile(cost, 0.95),
        "deadlock_max_s": _quantile(cost, 1.0),
    }


def _safety(run: Run) -> Metrics:
    keys = ("sumo_collisions", "footprint_overlaps", "turns_under_cars", "least_clearance_m")
    witnesses = run.meta.get("witnesses") or {}
    return {
        **{key: _number(run, key) for key in keys},
        **{f"{name}_witnessed_share": _confirmed(witnesses.get(name)) for name in WITNESSES},
    }


def _confirmed(testimony: Mapping[str, Any] | None) -> float:
    """Share of a witness's facts that it confirms; NaN if it saw none."""
    return _ratio(testimony["facts"] - testimony["wrong"], testimony["facts"]) if testimony else NAN


def _thesis(run: Run) -> Metrics:
    planning, done = run.planning, int((run.tasks["state"] == "served").sum())
    steps = _steps(run)
    totals = {
        name: int(planning[name].sum()) for name in ("expanded", "heap_moves", "generated", "valid", "slot_choice")
    }
    return {
        "steps": steps,
        "throughput": _ratio(done, steps),
        "movement_cost": int(run.agvs["moves"].sum()),
        "nodes_expanded": totals["expanded"],
        "heap_moves": totals["heap_moves"],
        "nodes_generated": totals["generated"],
        "valid_expansions": totals["valid"],
        "valid_ratio": _ratio(totals["valid"], totals["generated"]),
        "slot_choice_expanded": totals["slot_choice"],
        "window_mean_cells": float(planning["window_cells"].mean()) if planning["window_cells"].any() else NAN,
        "wait_edges": int(planning["wait_edges"].sum()),
        "wait_rings": int(planning["rings"].sum()),
        "planning_calls": len(planning),
        "planning_unsolved_share": float((planning["status"] != "solved").mean()) if len(planning) else NAN,
    }


def _steps(run: Run) -> float | int:
    steps = _ratio(_number(run, "simulated_s"), _number(run, "step_s"))
    return NAN if np.isnan(steps) else round(steps)


def _planning_time(run: Run) -> Metrics:
    planning = run.planning
    calls = planning["wall_ms"].to_numpy(dtype=np.float64)
    by_step = planning.groupby("time_s")["wall_ms"].sum().to_numpy(dtype=np.float64)
    steps = _steps(run)
    quiet = 0 if np.isnan(steps) else max(0, int(steps) - len(by_step))
    by_step = np.concatenate([by_step, np.zeros(quiet)])
    wall = run.meta.get("wall_s") or {}
    total = float(wall.get("total", NAN))
    return {
        "wall_planning_call_p50_ms": _quantile(calls, 0.5),
        "wall_planning_call_p99_ms": _quantile(calls, 0.99),
        "wall_planning_call_max_ms": _quantile(calls, 1.0),
        "wall_planning_step_p50_ms": _quantile(by_step, 0.5),
        "wall_planning_step_p99_ms": _quantile(by_step, 0.99),
        "wall_total_s": total,
        "wall_speed": _ratio(_number(run, "simulated_s"), total),
    }
