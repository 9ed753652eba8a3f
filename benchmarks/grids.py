"""The default planner on the thesis's grids in ticks: how long the work takes, and how much is searched.

    python benchmarks/remake.py grids

One tick a move and a turn, ten a lift, no charging; every car is parked, then every car is fetched in the same order.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from parking_sim.config import load_scenario
from parking_sim.rulesets import RULE_SETS
from parking_sim.simulation import simulate


def measure(garage: str, agvs: int, park_only: bool) -> dict[str, Any]:
    """Ticks, nodes expanded (those to choose slots apart), cells driven and deadlocks.

    Args:
        garage: a grid.
        agvs: size of the fleet.
        park_only: end when all cars are parked.
    """
    RULE_SETS["fair"] = replace(RULE_SETS["fair"], charge_after_cells=10**9)
    workload = {"kind": "park_exit", "order": "parked", "park_only": park_only}
    metrics = simulate(load_scenario(garage, {"agvs": agvs, "plant": "discrete", "workload": workload}), None).metrics
    kept = ("tasks_done", "steps", "nodes_expanded", "slot_choice_expanded", "movement_cost", "deadlocks_found")
    return {key: metrics[key] for key in kept}
