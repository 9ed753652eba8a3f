"""How far from the optimum: sum of costs of each planner over that of CBS, on random small garages.

    python benchmarks/optimality.py [--problems 1000] [--csv FILE] [--figure FILE]

Complete plans on the problems of ``controller.planners.contract``. CBS is optimal where it ends within its limit; the
rest, and what CBS finds to have no solution, is left out. PIBT has no complete plans: its moves are carried out one
after the other until everybody is at the goal, or for 60 moves.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from controller.flags import flags_of
from controller.planners.contract import all_standing, random_problem
from controller.planners.table import load_planner
from controller.types import FOREVER, PlanningProblem, Status

PLANNERS: dict[str, dict[str, object]] = {
    "whca": {}, "pbs": {}, "token": {}, "lacam": {"proposals": 2000, "improve": 3.0}, "pibt": {},
}  # fmt: skip


def cost(planner: str, options: dict[str, object], problem: PlanningProblem) -> int | None:
    """Sum of the steps of arrival; None if the planner does not solve the problem."""
    made = load_planner(planner, problem.graph, problem.motion, options)
    if planner == "pibt":
        return _moves_in_a_row(made, problem)
    if flags_of(made).complete:
        problem = all_standing(problem)
    result = made(problem)
    return sum(p.arrive[-1] for p in result.paths.values()) if result.status is Status.SOLVED else None


def _moves_in_a_row(planner, problem: PlanningProblem) -> int | None:  # type: ignore[no-untyped-def]
    """Plan, let every move end, and plan again; the steps at which each agent is at its goal for good."""
    clock, arrived = 0, {a.agv: 0 for a in problem.agents}
    agents = problem.agents
    for _ in range(60):
        result = planner(replace(problem, agents=agents, window_steps=1 << 12))
        end = max(path.arrive[-1] for path in result.paths.values())
        moved = []
        for a in agents:
            path = result.paths[a.agv]
            if len(path.vertices) > 1:
                edge = problem.graph.edge_index[path.vertices[0], path.vertices[1]]
                arrived[a.agv] = clock + path.arrive[-1]
                moved.append(replace(a, vertex=path.vertices[1], in_edge=edge, ready_step=0))
            else:
                moved.append(replace(a, ready_step=max(0, a.ready_step - max(end, 1))))
        agents, clock = tuple(moved), clock + max(end, 1)
        if all(a.vertex == a.goal for a in agents):
            return sum(arrived.values())
    return None


def rows(problems: Iterable[int]) -> Iterator[dict[str, object]]:
    """One row for each problem that CBS solves, with each planner's ratio (nan where it finds no plan)."""
    for number in problems:
        problem = random_problem(number, FOREVER)
        best = cost("cbs", {"expansions": 2000}, problem)
        if best:
            found = {name: cost(name, options, problem) for name, options in PLANNERS.items()}
            ratios = {name: float("nan") if c is None else c / best for name, c in found.items()}
            yield {"problem": number, "agents": len(problem.agents), "optimum": best, **ratios}


def draw(table: dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]], path: Path) -> None:
    """Distribution of the ratios: share of the solved problems up to each ratio."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4))
    for name, ratios in table.items():
        solved = np.sort(ratios[~np.isnan(ratios)])
        share = np.arange(1, len(solved) + 1) / len(ratios)
        axes.step(solved, share, where="post", label=f"{name} (solves {len(solved) / len(ratios):.0%})")
    axes.set_xlabel("sum of costs / optimum")
    axes.set_ylabel("share of problems")
    axes.set_xlim(0.99, 2.0)
    axes.legend()
    figure.savefig(path, bbox_inches="tight")


def main() -> None:
    """Print the quantiles of each planner, and write table and figure if asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    done = list(rows(range(given.problems)))
    print(f"{len(done)} of {given.problems} problems solved by CBS")
    table = {name: np.array([row[name] for row in done], dtype=float) for name in PLANNERS}
    for name, ratios in table.items():
        solved = ratios[~np.isnan(ratios)]
        p50, p90, p99 = np.quantile(solved, (0.5, 0.9, 0.99))
        print(
            f"{name}: solves {len(solved) / len(ratios):.3f}, optimal {(solved < 1 + 1e-9).mean():.3f}, mean"
            f" {solved.mean():.4f}, p50 {p50:.3f}, p90 {p90:.3f}, p99 {p99:.3f}, worst {solved.max():.2f}"
        )
    if given.csv:
        pd.DataFrame(done).to_csv(given.csv, index=False)
    if given.figure:
        draw(table, given.figure)


if __name__ == "__main__":
    main()
