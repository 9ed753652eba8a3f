"""Batches of departures planned at once: what the planners of papers 003 and 004 make of them beside WHCA*.

    python benchmarks/remake.py departures

Loaded AGVs stand in random slots of a shipped garage and all want to the bays, or the places beside them, within one
window. The figures are means over the batches: agents that hold their place, delay of the others in moves (of a cell)
against driving alone, and CPU milliseconds a batch.
"""

from __future__ import annotations

from time import process_time

import numpy as np

from controller.conflicts import validate
from controller.planners.table import load_planner
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import AgvNumber, Motion, PlanAgent, PlanningProblem, PlanResult
from parking_sim.plants.sumo_agv import AgvType, sumo_motion
from sumo_nets.graph import Graph
from sumo_nets.numbering import NO_EDGE, Vertex
from sumo_nets.read import read_net

BATCHES, WINDOW_CELLS = 10, 40


def batch(graph: Graph, motion: Motion, agvs: int, seed: int) -> PlanningProblem:
    """So many loaded AGVs in random slots, on their way to places near the bays."""
    rng = np.random.default_rng(seed)
    starts = rng.choice(list(graph.slots), agvs, replace=False)
    gates = [graph.successors[bay][0] for bay in graph.bays]
    goals = [*graph.bays, *gates, *graph.homes][:agvs]
    agents = [
        PlanAgent(AgvNumber(i), Vertex(int(v)), NO_EDGE, 0, goal, True, priority=agvs - i)
        for i, (v, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    blocked = np.zeros(len(graph.names), dtype=np.uint8)
    window = WINDOW_CELLS * int(np.median(motion.edge_steps[1]))
    return PlanningProblem(graph, motion, tuple(agents), (), blocked, blocked.copy(), window, seed)


def delay(problem: PlanningProblem, result: PlanResult, distances: Distances) -> float:
    """Mean over the agents that have a path: moves later at the goal than if each were alone."""
    late = []
    for a in problem.agents:
        if a.agv in result.paths:
            path = result.paths[a.agv]
            edge = problem.graph.edge_index[path.vertices[-2], path.vertices[-1]] if len(path.vertices) > 1 else NO_EDGE
            rest = distances.distance(path.vertices[-1], edge, a.goal, a.loaded)
            end = path.arrive[-1] if rest == 0 else max(path.arrive[-1], problem.window_steps)
            late.append(end + rest - distances.distance(a.vertex, NO_EDGE, a.goal, a.loaded))
    return float(np.mean(late)) / float(np.median(problem.motion.edge_steps[1]))


def measure(name: str, agvs: int, planner_name: str) -> dict[str, float]:
    """Agents that hold their place, delay of the others in moves, and CPU milliseconds: means over the batches."""
    graph = read_net(name).graph
    motion = sumo_motion(graph, AgvType(), 0.5)
    problems = [batch(graph, motion, agvs, seed) for seed in range(BATCHES)]
    distances = Distances(Space(graph, motion))
    planner = load_planner(planner_name, graph, motion, {})
    planner(problems[0])  # compiled before anything is timed
    began = process_time()
    results = [planner(problem) for problem in problems]
    spent_ms = 1000 * (process_time() - began) / BATCHES
    if any(validate(problem, result) for problem, result in zip(problems, results, strict=True)):
        raise RuntimeError(f"{planner_name}: a plan that can't be driven")
    return {
        "held": float(np.mean([len(result.failed) for result in results])),
        "delay": float(np.mean([delay(p, r, distances) for p, r in zip(problems, results, strict=True)])),
        "cpu_ms": spent_ms,
    }
