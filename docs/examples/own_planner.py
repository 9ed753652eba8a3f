"""A planner of one's own: one AGV after the other, each round the paths of those before it."""

from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import PlanResult, Status


def plan(problem):
    """Prioritised planning; whoever finds no path keeps its place, and the others plan again round it."""
    search, stays = PathSearch(Distances(Space(problem.graph, problem.motion))), {}
    search.begin(problem)
    while True:
        table, paths = ReservationTable(len(problem.graph.names), problem.motion.following), {}
        for path in problem.fixed:
            table.add(path)
        for agent in problem.agents:
            if agent.agv in stays:
                table.hold(agent.vertex, 0, problem.window_steps, agent.agv)
        for agent in sorted(problem.agents, key=lambda a: -a.priority):
            if agent.agv not in stays:
                paths[agent.agv] = search.find_path(problem, agent, table)
                if paths[agent.agv] is None:
                    stays[agent.agv] = search.blocker
                    break
                table.add(paths[agent.agv])
        else:
            return PlanResult(Status.PARTIAL if stays else Status.SOLVED, paths, stays)
