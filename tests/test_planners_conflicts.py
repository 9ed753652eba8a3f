import pytest
from brute_force import bodies, classic, garages, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.conflicts import find_conflicts
from controller.types import FOREVER, Conflict, Path
from sumo_nets.graph import make_graph

LINE = make_graph(
    "line",
    [(str(x), 5.0 * x, 0.0) for x in range(4)],
    [(f"{a}>{b}", str(a), str(b), 5.0) for x in range(3) for a, b in ((x, x + 1), (x + 1, x))],
)
UNIT = classic(LINE)
BODY = bodies(LINE)


def path(agv, vertices, arrive, until=FOREVER, steps=1):
    return Path(agv, vertices, arrive, tuple(t - steps for t in arrive[1:]), until)


CASES = {
    "behind each other in step": (UNIT, [path(1, (0, 1), (0, 1)), path(2, (1, 2), (0, 1))], []),
    "the same as bodies": (
        BODY,
        [path(1, (0, 1), (0, 1)), path(2, (1, 2), (0, 1))],
        [Conflict("vertex", (1, 2), 1, 0)],
    ),
    "behind each other as bodies": (BODY, [path(1, (0, 1), (0, 2)), path(2, (1, 2), (0, 1))], []),
    "entered while the one ahead still leaves": (
        BODY,
        [path(1, (0, 1), (0, 4), steps=3), path(2, (1, 2), (0, 3), steps=3)],
        [Conflict("following", (2, 1), 1, 1)],
    ),
    "into one that stands": (
        UNIT,
        [path(1, (0, 1), (0, 3)), path(2, (1,), (0,))],
        [Conflict("vertex", (1, 2), 1, 3)],
    ),
    "swap": (UNIT, [path(1, (0, 1), (0, 2)), path(2, (1, 0), (0, 2))], [Conflict("swap", (1, 2), 1, 2)]),
    "swap as bodies": (
        BODY,
        [path(1, (0, 1), (0, 3), steps=3), path(2, (1, 0), (0, 4), steps=3)],
        [Conflict("swap", (1, 2), 1, 0), Conflict("swap", (2, 1), 0, 1)],
    ),
    "both into one": (
        UNIT,
        [path(1, (0, 1), (0, 2)), path(2, (2, 1), (0, 5))],
        [Conflict("vertex", (1, 2), 1, 5)],
    ),
    "gone in time": (UNIT, [path(1, (0,), (0,), 4), path(2, (1, 0), (0, 4))], []),
    "two that leave one place, and a third that comes from where they go": (
        UNIT,
        [path(0, (0, 1), (0, 1), until=1), path(1, (0, 1), (0, 1), until=1), path(2, (1, 0), (0, 1), until=1)],
        [Conflict("vertex", (0, 1), 0, 0), Conflict("swap", (0, 2), 1, 1), Conflict("swap", (1, 2), 1, 1)],
    ),
    "a ring of three": (
        UNIT,
        [path(3, (0, 1), (0, 2)), path(1, (1, 2), (0, 2)), path(2, (2, 0), (0, 2))],
        [],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_drawn_by_hand(name):
    motion, paths, expected = CASES[name]
    assert find_conflicts(paths, motion) == expected
    assert find_conflicts(paths[::-1], motion) == expected


def test_only_before_until():
    motion, paths, expected = CASES["both into one"]
    assert find_conflicts(paths, motion, until=6) == expected
    assert find_conflicts(paths, motion, until=5) == []


@st.composite
def walks(draw, graph, agv, unit):
    vertices, arrive, depart = [draw(st.integers(0, len(graph.names) - 1))], [0], []
    for _ in range(draw(st.integers(0, 5))):
        if not graph.successors[vertices[-1]]:
            break
        vertices.append(draw(st.sampled_from(graph.successors[vertices[-1]])))
        depart.append(arrive[-1] + draw(st.integers(0, 2)))
        arrive.append(depart[-1] + (1 if unit else draw(st.integers(1, 3))))
    return Path(agv, tuple(vertices), tuple(arrive), tuple(depart), arrive[-1] + draw(st.integers(0, 5)))


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_against_a_simulation_step_by_step(data):
    graph = data.draw(garages(5))
    motion = data.draw(st.sampled_from([classic(graph), bodies(graph), bodies(graph, following=True)]))
    paths = [data.draw(walks(graph, agv, motion is None)) for agv in range(data.draw(st.integers(1, 4)))]
    found = find_conflicts(paths, motion)
    expected = simulate(paths, motion, 40)
    assert {(c.step, frozenset(c.agents)) for c in found} == expected
