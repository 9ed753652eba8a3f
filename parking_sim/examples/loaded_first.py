"""A planner made from WHCA*: parking-sim run rush.yaml --planner loaded_first.py:plan."""

from dataclasses import replace
from functools import cache

from controller.planners.table import load_planner
from controller.types import Motion, Planner, PlanningProblem, PlanResult
from sumo_nets.graph import Graph


@cache
def whca(graph: Graph, motion: Motion) -> Planner:
    """WHCA* for a garage, made once."""
    return load_planner("whca", graph, motion, {})


def plan(problem: PlanningProblem) -> PlanResult:
    """WHCA*, but AGVs that carry a car go before all others."""
    agents = tuple(replace(agent, priority=agent.priority + 100_000 * agent.loaded) for agent in problem.agents)
    return whca(problem.graph, problem.motion)(replace(problem, agents=agents))
