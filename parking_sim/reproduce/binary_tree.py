"""Paper 003, table 2: binary-tree routing against exact shortest routes, on its floor and on others.

The paper prints its floor's size and numbers of nodes; the lanes are reconstructed (``sumo_nets.floors.ForkFloor``).
Its ten queries are given by node numbers and can't be repeated: ten of ours stand beside them. Shortest routes follow
the same rules, no reversal and no fold on the way, so that only the search is judged. Milliseconds are CPU time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

from analysis.measures import interval
from controller.routing.binary_tree import BinaryTree, Route, compile_tree, find_route, find_routes
from controller.routing.kinematics import ForkAgv, check_turns
from controller.routing.shortest import shortest_route
from parking_sim.reproduce.findings import Finding, findings_table, make_folder, settled, write_findings
from parking_sim.reproduce.published import published
from parking_sim.reproduce.statistics import wilson
from sumo_nets.floors import ForkFloor, one_way_lattice
from sumo_nets.graph import Graph
from sumo_nets.numbering import Vertex
from sumo_nets.read import read_net
from sumo_nets.whole_file import whole_file

FULL_QUERIES, QUICK_QUERIES, TEN = 1000, 150, 10
FORK, LATTICE = "fork floor", "lattice 18 x 12"
#: Clear width for which turns are checked, in metres.
AISLE_M = 3.0


def reproduce(folder: Path, full: bool) -> None:
    """Run the experiment, print the table and write it with the queries and the figure.

    Args:
        folder: where ``binary-tree.csv``, ``.md``, ``-queries.csv`` and ``.svg`` go.
        full: 1,000 queries a floor; else 150.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    graphs = floors()
    queries = pd.concat(
        [run_queries(name, graph, FULL_QUERIES if full else QUICK_QUERIES) for name, graph in graphs.items()]
    )
    findings = [*compare(queries, graphs)]
    queries.to_csv(folder / "binary-tree-queries.csv", index=False, float_format="%.6g")
    write_findings(findings, folder, "binary-tree", full)
    draw(queries, graphs[FORK], folder / "binary-tree.svg")
    print(findings_table(findings, full), end="")
    print(f"table and figure: {folder}")


def floors() -> dict[str, Graph]:
    """The floors by name: the paper's, reconstructed, the shipped garages, and the one-way lattice."""
    shipped = {name: read_net(name).graph for name in ("map1", "map2", "map3")}
    return {FORK: ForkFloor().graph(), **shipped, LATTICE: one_way_lattice()}


def run_queries(name: str, graph: Graph, count: int, seed: int = 1) -> pd.DataFrame:
    """Random queries between different vertices that have a route.

    Args:
        name: of the floor, for the table.
        graph: the floor.
        count: queries.
        seed: of the vertices drawn.

    Returns:
        A row a query: floor, start, goal, nodes of the left-first and of the right-first route, metres of the shorter
        and of the exact shortest one, and milliseconds of CPU time for both searches.
    """
    tree, rng = compile_tree(graph), np.random.default_rng(seed)
    find_route(tree, graph.vertices[0], graph.vertices[1])  # compiled before anything is timed
    rows: list[tuple[str, str, str, int, int, float, float, float]] = []
    while len(rows) < count:
        start, goal = (Vertex(int(v)) for v in rng.choice(len(graph.names), 2, replace=False))
        best = shortest_route(graph, start, goal)
        began = process_time()
        found = find_route(tree, start, goal)
        ms = 1000 * (process_time() - began)
        left, right = find_routes(tree, start, goal)
        if best and found and left and right:
            nodes = len(left.vertices), len(right.vertices)
            rows.append((name, graph.names[start], graph.names[goal], *nodes, found.length_m, best.length_m, ms))
    columns = ["floor", "start", "goal", "left_nodes", "right_nodes", "route_m", "shortest_m", "ms"]
    return pd.DataFrame(rows, columns=columns)


def compare(queries: pd.DataFrame, graphs: Mapping[str, Graph]) -> Iterator[Finding]:
    """The paper's figures beside ours.

    Args:
        queries: the rows of ``run_queries`` for all floors.
        graphs: the floors.
    """
    paper, fork = published("binary_tree"), graphs[FORK]
    two_way = sum(bool((fork.reverse[fork.tail == v] >= 0).all()) for v in range(len(fork.names)))
    yield Finding("two-way nodes", str(paper["two_way_nodes"]), str(two_way))
    yield Finding("one-way nodes", str(paper["one_way_nodes"]), str(len(fork.names) - two_way))
    yield from _ten(queries[queries["floor"] == FORK].head(TEN), paper)
    for name in graphs:
        yield from _floor(name, queries[queries["floor"] == name])
    for name in ("map1", "map2", "map3"):
        turns = list(check_turns(graphs[name], ForkAgv(), AISLE_M))
        share = 100 * sum(turn.drivable for turn in turns) / len(turns)
        yield Finding(f"{name}: turns a fork AGV drives in {AISLE_M:.0f} m aisles, %", "", f"{share:.1f}")


def _ten(ten: pd.DataFrame, paper: Mapping[str, list[list[int]]]) -> Iterator[Finding]:
    nodes = np.sort(ten[["left_nodes", "right_nodes"]].to_numpy(), axis=1)
    printed = np.array(paper["queries"])[:, 2:]
    for k, what in enumerate(("shorter", "longer")):
        mean = interval(nodes[:, k].tolist())
        yield Finding(
            f"ten queries: nodes of the {what} route, mean",
            f"{printed[:, k].mean():.1f}",
            f"{mean.mean:.1f}",
            f"{mean.low:.1f} to {mean.high:.1f}",
        )
    differ = [sorted(set((rows[:, 1] - rows[:, 0]).tolist())) for rows in (printed, nodes)]
    yield Finding("ten queries: nodes between the two", _list(differ[0]), _list(differ[1]))
    best = int((_detours(ten) < 1 + 1e-9).sum())
    yield Finding("ten queries: shorter route is optimal", "10 of 10", f"{best} of {TEN}", "", settled(best == TEN))
    slowest = float(ten["ms"].max())
    yield Finding("ten queries: slowest, ms", "below 1", f"{slowest:.2f}", "", settled(slowest < 1))


def _list(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


def _floor(name: str, rows: pd.DataFrame) -> Iterator[Finding]:
    detours = _detours(rows)
    optimal = int((detours < 1 + 1e-9).sum())
    low, high = wilson(optimal, len(rows))
    share, words = 100 * optimal / len(rows), f"{100 * low:.1f} to {100 * high:.1f}"
    yield Finding(
        f"{name}: optimal, % of {len(rows)}", "100 (of 10)", f"{share:.1f}", words, settled(optimal == len(rows))
    )
    mean = interval(detours.tolist())
    yield Finding(
        f"{name}: route / shortest, mean", "1 (of 10)", f"{mean.mean:.2f}", f"{mean.low:.2f} to {mean.high:.2f}"
    )
    yield Finding(f"{name}: route / shortest, worst", "1 (of 10)", f"{detours.max():.2f}")
    median = float(rows["ms"].median())
    yield Finding(f"{name}: median, ms", "below 1", f"{median:.3f}", "", settled(median < 1))


def _detours(rows: pd.DataFrame) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(rows["route_m"] / rows["shortest_m"], dtype=np.float64)


def draw(queries: pd.DataFrame, fork: Graph, path: Path) -> None:
    """Draw the two routes of a query on the fork floor, as the paper's figure 8, and the detours on all floors."""
    from matplotlib.figure import Figure

    from analysis.figures import BLUE, GREEN, GREY, ORANGE, PINK, RED, WIDTH_IN, style

    with style():
        figure = Figure(figsize=(WIDTH_IN, 6.4))
        plan, spread = figure.subplots(2, 1, height_ratios=(3, 2))
        for u, v in zip(fork.tail, fork.head, strict=True):
            plan.plot(*fork.xy[[u, v]].T, color=GREY, linewidth=0.7)
        for route, colour, words, width in zip(
            _example(compile_tree(fork)),
            (ORANGE, BLUE),
            ("left child first", "right child first"),
            (4, 1.6),
            strict=True,
        ):
            label = f"{words}: {len(route.vertices)} nodes"
            plan.plot(*fork.xy[list(route.vertices)].T, color=colour, linewidth=width, label=label)
        plan.set(aspect="equal", title="fork floor, reconstructed: 70 x 36 m, 69 one-way and 147 two-way nodes")
        plan.grid(visible=False)
        plan.legend(loc="center", bbox_to_anchor=(0.5, 0.68))
        for (name, rows), colour in zip(
            queries.groupby("floor", sort=False), (GREEN, BLUE, ORANGE, RED, PINK), strict=True
        ):
            detours = np.sort(_detours(rows))
            spread.step(detours, np.arange(1, len(rows) + 1) / len(rows), where="post", color=colour, label=str(name))
        spread.set(xscale="log", xlabel="route / shortest route", ylabel="share of queries", ylim=(0, 1.02))
        spread.legend()
        with whole_file(path) as part:
            figure.savefig(part, metadata={"Date": None})


def _example(tree: BinaryTree) -> tuple[Route, Route]:
    """Both routes of a query whose routes differ: from a storage lane in the south to a storage lane in the west."""
    index = tree.graph.index
    left, right = find_routes(tree, index["8,0+3"], index["0,3+3"])
    if left is None or right is None or math.isclose(left.length_m, right.length_m):
        raise RuntimeError("the example's routes should differ")
    return left, right
