"""A planner of one's own: one AGV after the other, each round the paths of those before it."""

from controller.search.distances import Distances
from controller.search.reservations import ReservationTable
from controller.search.sipp import PathSearch
from controller.search.space import Space
from controller.types import AgvNumber, Path, PlanningProblem, PlanResult, Status


def plan(problem: PlanningProblem) -> PlanResult:
    """Prioritised planning: an AGV that finds no path keeps its place, and the others plan again round it."""
    search = PathSearch(Distances(Space(problem.graph, problem.motion)))
    stays: dict[AgvNumber, AgvNumber] = {}
    search.begin(problem)
    while True:
        table, paths = ReservationTable(len(problem.graph.names), problem.motion.following), dict[AgvNumber, Path]()
        for fixed in problem.fixed:
            table.add(fixed)
        for agent in (a for a in problem.agents if a.agv in stays):
            table.hold(agent.vertex, 0, problem.window_steps, agent.agv)
        for agent in sorted((a for a in problem.agents if a.agv not in stays), key=lambda a: -a.priority):
            path = search.find_path(problem, agent, table)
            if path is None:
                stays[agent.agv] = search.blocker
                break
            table.add(path)
            paths[agent.agv] = path
        else:
            return PlanResult(Status.PARTIAL if stays else Status.SOLVED, paths, stays)
