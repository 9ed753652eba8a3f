"""Two hours of Poisson traffic with retrievals by name on every garage: is every car and every request accounted for.

    python benchmarks/poisson.py [--planner token] [--garages map1,...] [--seed 3]

Each run goes on after the two hours until everybody has been served. A run that loses a request or a car, leaves a
deadlock, or lets bodies touch is marked, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import sys

from parking_sim.config import DEFAULT_AGVS, DEFAULT_PLANNER, load_scenario
from parking_sim.demo import complaints_of
from parking_sim.simulation import simulate

TRAFFIC = {
    "kind": "poisson",
    "arrivals_share_per_h": 0.1,
    "dwell_median_min": 40,
    "initial_occupancy": 0.5,
    "duration_min": 120,
}


def main() -> int:
    """Print a row for each garage; 1 if something was amiss."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    parser.add_argument("--garages", default=",".join(DEFAULT_AGVS))
    parser.add_argument("--seed", type=int, default=3)
    given = parser.parse_args()
    print("garage | AGVs | requests | served | cars arrived | cars left | deadlocks found | resolved | simulated s")
    amiss = False
    for garage in given.garages.split(","):
        keys = {"agvs": DEFAULT_AGVS[garage], "planner": given.planner, "workload": TRAFFIC, "seed": given.seed}
        summary = simulate(load_scenario(garage, keys), None)
        m = summary.metrics
        row = [garage, DEFAULT_AGVS[garage], m["requests"], m["tasks_done"], m["cars_arrived"], m["cars_left"]]
        row += [m["deadlocks_found"], m["deadlocks_resolved"], f"{m['simulated_s']:.0f}"]
        complaints = complaints_of(summary)
        amiss |= bool(complaints)
        print(" | ".join(map(str, row)), *complaints, sep="  <-- ", flush=True)
    return int(amiss)


if __name__ == "__main__":
    sys.exit(main())
