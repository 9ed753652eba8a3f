"""The default planner on the thesis's grids in ticks: how long the work takes, and how much is searched.

    python benchmarks/grids.py [--planner token]

One tick a move and a turn, ten a lift, no charging; every car is parked, then every car is fetched in the same order.
The first row of a grid ends with parking.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from parking_sim.config import DEFAULT_PLANNER, load_scenario
from parking_sim.rulesets import RULE_SETS
from parking_sim.simulation import simulate

GRIDS = (("map1_thesis", 4), ("map2_thesis", 4), ("map3_thesis", 8))


def main() -> None:
    """Print ticks, nodes expanded (those to choose slots apart), cells driven and deadlocks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    given = parser.parse_args()
    RULE_SETS["fair"] = replace(RULE_SETS["fair"], charge_after_cells=10**9)
    print("grid | AGVs | tasks | ticks | expanded | expanded to choose slots | cells | deadlocks found")
    for garage, agvs in GRIDS:
        for park_only in (True, False):
            workload = {"kind": "park_exit", "order": "parked", "park_only": park_only}
            keys = {"agvs": agvs, "plant": "discrete", "planner": given.planner, "workload": workload}
            m = simulate(load_scenario(garage, keys), None).metrics
            row = [garage, agvs, m["tasks_done"], m["steps"], m["nodes_expanded"], m["slot_choice_expanded"]]
            print(" | ".join(map(str, [*row, m["movement_cost"], m["deadlocks_found"]])), flush=True)


if __name__ == "__main__":
    main()
