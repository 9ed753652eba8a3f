"""One-shot problems of MovingAI's benchmark, as public solvers are measured: everybody from start to goal, once.

    python benchmarks/movingai.py MAP.map SCENARIO.scen [--agents 10,20,50] [--planner token,pbs,lacam,cbs] [--csv FILE]

The first trips of the scenario are one problem: one move a tick, no turning cost, agents rest at their goals. Printed
for each planner: whether it solves the problem, makespan, sum of costs (ticks until everybody is at its goal), that sum
over the one without any conflict, search states expanded and CPU seconds. Plans are checked for conflicts.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

import numpy as np
from rows import give_out

from controller.conflicts import validate
from controller.flags import flags_of
from controller.planners.contract import all_standing
from controller.planners.table import load_planner
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import FOREVER, AgvNumber, PlanAgent, PlanningProblem, Status, make_motion
from sumo_nets.graph import Graph
from sumo_nets.movingai import read_map, read_scenario
from sumo_nets.numbering import NO_EDGE, Vertex

#: Options of the planners: slots are no dead ends here, and there is time to improve.
OPTIONS: dict[str, dict[str, object]] = {"token": {"through_slots_agvs": 10**6, "improvements": 100, "passes": 10}}


def problem_of(graph: Graph, trips: Sequence[tuple[Vertex, Vertex]]) -> PlanningProblem:
    """Everybody stands at its start."""
    motion = make_motion(graph, 1.0, lambda _metres, _loaded: 1, lambda _degrees, _loaded: 0, following=True)
    free = np.zeros(len(graph.names), dtype=np.uint8)
    agents = tuple(PlanAgent(AgvNumber(n), start, NO_EDGE, 0, goal, False) for n, (start, goal) in enumerate(trips))
    return PlanningProblem(graph, motion, agents, (), free, free, FOREVER)


def solve(name: str, problem: PlanningProblem) -> dict[str, object]:
    """One row."""
    planner = load_planner(name, problem.graph, problem.motion, OPTIONS.get(name, {}))
    if flags_of(planner).complete:
        problem = all_standing(problem)
    begin = process_time()
    result = planner(problem)
    spent_s = process_time() - begin
    solved = result.status is Status.SOLVED
    arrivals = [path.arrive[-1] for path in result.paths.values()]
    distances = Distances(Space(problem.graph, problem.motion))
    alone = sum(distances.distance(a.vertex, NO_EDGE, a.goal, False) for a in problem.agents)
    return {
        "map": problem.graph.name, "agents": len(problem.agents), "planner": name, "solved": solved,
        "conflicts": len(validate(problem, result)), "makespan": max(arrivals) if solved else None,
        "sum_of_costs": sum(arrivals) if solved else None,
        "over_ideal": round(sum(arrivals) / alone, 4) if solved and alone else None,
        "expanded": result.counters.expanded, "cpu_s": round(spent_s, 3),
    }  # fmt: skip


def rows(given: argparse.Namespace) -> Iterator[dict[str, object]]:
    """All rows asked for; compiles first."""
    graph = read_map(given.map)
    trips = read_scenario(given.scenario, graph)
    for name in given.planner.split(","):
        solve(name, problem_of(graph, trips[:2]))
        for agents in given.agents:
            yield solve(name, problem_of(graph, trips[:agents]))


def main() -> None:
    """Print a row each, and write them if asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("map", type=Path)
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--agents", type=lambda text: [int(n) for n in text.split(",")], default=[10, 20, 50])
    parser.add_argument("--planner", default="token,pbs,lacam")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    give_out(rows(given), given.csv)


if __name__ == "__main__":
    main()
