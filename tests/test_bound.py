"""The bound on the work of tasks that were done, against all orders of doing them."""

from dataclasses import replace
from itertools import pairwise, permutations

from brute_force import bodies, garages
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from analysis.bound import least_work, work_alone
from controller.search.distances import Distances
from controller.search.space import Space
from controller.types import FOREVER
from parking_sim.rulesets import RULE_SETS


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_order_of_the_tasks_takes_less_than_the_bound_and_one_task_takes_just_that(data):
    graph = data.draw(garages(10))
    motion, rules = bodies(graph), replace(RULE_SETS["fair"], lift=2, lower=3).rules()
    vertex = st.integers(0, len(graph.names) - 1)
    home = data.draw(vertex)
    tasks = data.draw(st.lists(st.tuples(vertex, vertex).filter(lambda t: t[0] != t[1]), min_size=1, max_size=4))
    distances = Distances(Space(graph, motion))

    def steps(order):
        places = [home, *(v for task in order for v in task)]
        return sum(distances.distance(u, -1, v, i % 2 == 1) for i, (u, v) in enumerate(pairwise(places)))

    slots = set(graph.slots)
    lifts = sum((rules.lift_slot if a in slots else rules.lift_bay) for a, _ in tasks)
    lowers = sum((rules.lower_slot if b in slots else rules.lower_bay) for _, b in tasks)
    best = min(steps(order) for order in permutations(tasks))
    assume(best < FOREVER)
    bound = least_work(graph, motion, rules, [home], tasks)
    assert bound <= best + lifts + lowers
    if steps(tasks) < FOREVER:
        assert work_alone(graph, motion, rules, home, tasks) == steps(tasks) + lifts + lowers
    if len(tasks) == 1 and steps([tasks[0]]) <= distances.distance(tasks[0][1], -1, tasks[0][0], False):
        assert bound == best + lifts + lowers
