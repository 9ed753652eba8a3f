"""Free-space planners: no path touches an obstacle by a geometry library's word, and the paper's order of lengths."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from shapely import LineString, Polygon, box, unary_union
from shapely.geometry.base import BaseGeometry

from parking_sim import cli
from parking_sim.reproduce.findings import Verdict
from parking_sim.reproduce.rrt_grid import PAPER, compare, run_experiment
from sumo_nets.freespace import rrt_grid as grid
from sumo_nets.freespace.floor import Floor, path_length, rectangle, room_around, winding
from sumo_nets.freespace.rrt import FreePath, Tuning, rrt, rrt_connect, rrt_smart, rrt_star
from sumo_nets.freespace.scenes import GOAL, START, Scene, scenes
from sumo_nets.freespace.visibility import VisibilityGraph
from sumo_nets.graph import FloatArray

Planner = Callable[..., FreePath]
PLANNERS: dict[str, Planner] = {
    "rrt": rrt,
    "rrt_connect": rrt_connect,
    "rrt_star": rrt_star,
    "rrt_smart": rrt_smart,
    "rrt_grid": grid.rrt_grid,
}
SCENES = {f"C{scene.category}.{scene.number}": scene for scene in scenes()}


def solid(floor: Floor) -> BaseGeometry:
    return unary_union([Polygon(corners) for corners in floor.obstacles])


def plan(name: str, scene: Scene, seed: int = 3, **options: object) -> FreePath:
    return PLANNERS[name](scene.floor, START, GOAL, np.random.default_rng(seed), **options)


# --- geometry --------------------------------------------------------------------------------------------------------


def random_floor(rng: np.random.Generator, clearance: float) -> Floor:
    solids = []
    for _ in range(8):
        angles = np.sort(rng.uniform(0, 2 * np.pi, 5))
        if np.diff(angles).min() > 0.2:
            corners = rng.uniform(15, 85, 2) + rng.uniform(3, 12) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            solids.append(corners[:: rng.choice([-1, 1])])
    return Floor(100.0, 100.0, tuple(solids), clearance)


@pytest.mark.parametrize("clearance", [0.0, 2.5])
def test_floor_agrees_with_shapely(clearance: float) -> None:
    rng = np.random.default_rng(1)
    outcomes = set()
    for _ in range(60):
        floor = random_floor(rng, clearance)
        obstacles = solid(floor)
        for a, b in rng.uniform(0, 100, (20, 2, 2)):
            holds = floor.holds(tuple(a))
            assert holds == (LineString([a, a]).distance(obstacles) > clearance)
            if holds and floor.holds(tuple(b)):
                sees = floor.sees(tuple(a), tuple(b))
                assert sees == (LineString([a, b]).distance(obstacles) > clearance)
                outcomes.add(sees)
    assert outcomes == {True, False}


def test_winding_counts_polygons_that_overlap() -> None:
    floor = Floor(10.0, 10.0, (rectangle(1, 1, 6, 6), rectangle(4, 4, 9, 9)[::-1]))
    assert [winding(floor.edges, *spot) for spot in ((5, 5), (2, 2), (8, 8), (2, 8))] == [2, 1, 1, 0]


def test_an_outline_keeps_paths_inside() -> None:
    corner = np.array([(0, 0), (60, 0), (60, 30), (30, 30), (30, 60), (0, 60)], dtype=np.float64)
    floor = Floor(60.0, 60.0, clearance=1.0, outline=corner)
    assert floor.holds((10, 10))
    assert not floor.holds((45, 45))
    assert not floor.holds((0.5, 10))
    path = VisibilityGraph(floor).shortest((55, 25), (25, 55))
    assert LineString(path.points).within(Polygon(corner))
    straight = np.hypot(25 + 2, 5 - 1) * 2
    assert straight - 4 < path.length < straight + 4


def test_room_around_bodies_agrees_with_shapely() -> None:
    rng = np.random.default_rng(2)
    floor = random_floor(rng, 0.0)
    rims = unary_union([Polygon(corners).exterior for corners in floor.obstacles])
    angles = rng.uniform(0, 2 * np.pi, 300)
    bodies = np.stack([*rng.uniform(0, 100, (2, 300)), np.cos(angles), np.sin(angles)], axis=1)
    room = room_around(bodies, 4.7, 2.0, floor.edges, 3.0)
    for (x, y, hx, hy), gap in zip(bodies.tolist(), room.tolist(), strict=True):
        along, aside = np.array([hx, hy]) * 2.35, np.array([-hy, hx])
        body = Polygon(np.array([x, y]) + np.array([along + aside, along - aside, -along - aside, -along + aside]))
        assert gap == pytest.approx(min(3.0, body.distance(rims)), abs=1e-9)


# --- planners --------------------------------------------------------------------------------------------------------


def test_there_are_thirty_layouts_of_the_papers_size() -> None:
    assert [(s.category, s.number) for s in scenes()] == list(itertools.product(range(1, 6), range(1, 7)))
    for scene in scenes():
        assert (scene.floor.width, scene.floor.height) == (960, 640)
        assert box(0, 0, 960, 640).contains(solid(scene.floor)) or not scene.floor.obstacles
        assert scene.floor.holds(START)
        assert scene.floor.holds(GOAL)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_every_path_is_free_and_no_shorter_than_the_shortest(scene: Scene) -> None:
    obstacles = solid(scene.floor)
    shortest = VisibilityGraph(scene.floor).shortest(START, GOAL)
    assert not LineString(shortest.points).intersects(obstacles)
    for name in PLANNERS:
        path = plan(name, scene)
        assert path.found, name
        assert tuple(path.points[0]) == START, name
        assert tuple(path.points[-1]) == GOAL, name
        assert not LineString(path.points).intersects(obstacles), name
        assert path.length == pytest.approx(LineString(path.points).length), name
        assert path.length >= shortest.length - 1e-4, name


@pytest.mark.parametrize("name", PLANNERS)
def test_same_seed_same_path(name: str) -> None:
    scene = SCENES["C4.3"]
    one, again, other = plan(name, scene, 5), plan(name, scene, 5), plan(name, scene, 6)
    assert np.array_equal(one.points, again.points)
    assert one.samples == again.samples
    assert not np.array_equal(one.points, other.points)


@pytest.mark.parametrize("name", ["rrt", "rrt_connect"])
def test_trees_grow_by_the_step(name: str) -> None:
    path = plan(name, SCENES["C3.4"], tuning=Tuning(step=12.0))
    assert np.hypot(*np.diff(path.points, axis=0).T).max() <= 12.0 + 1e-9


@pytest.mark.parametrize("name", PLANNERS)
def test_an_enclosed_goal_is_not_reached(name: str) -> None:
    walls = (rectangle(40, 40, 80, 42), rectangle(40, 78, 80, 80), rectangle(40, 40, 42, 80), rectangle(78, 40, 80, 80))
    floor = Floor(100.0, 100.0, walls)
    path = PLANNERS[name](floor, (10, 10), (60, 60), np.random.default_rng(0), Tuning(step=5, iterations=400))
    assert not path.found
    assert path.length == np.inf
    assert not VisibilityGraph(floor).shortest((10, 10), (60, 60)).found


def test_more_samples_make_rrt_star_no_longer() -> None:
    scene = SCENES["C4.2"]
    first = plan("rrt_star", scene)
    best = plan("rrt_star", scene, tuning=Tuning(iterations=6000), use_all=True)
    shortest = VisibilityGraph(scene.floor).shortest(START, GOAL).length
    assert shortest < best.length < first.length
    assert best.length < 1.05 * shortest


def test_visibility_graph_goes_round_a_block_by_its_corner() -> None:
    floor = Floor(100.0, 100.0, (rectangle(40, 20, 60, 90),))
    path = VisibilityGraph(floor).shortest((10, 50), (90, 50))
    assert path.length == pytest.approx(2 * np.hypot(30, 30) + 20, abs=1e-4)
    wide = VisibilityGraph(Floor(100.0, 100.0, floor.obstacles, 5.0)).shortest((10, 50), (90, 50))
    assert LineString(wide.points).distance(solid(floor)) >= 5.0
    # straight lines onto a quarter circle of 5 round each corner
    reach = np.sqrt(30**2 + 30**2 - 5**2)
    bend = np.pi / 4 + np.arcsin(5 / np.hypot(30, 30))
    assert wide.length == pytest.approx(2 * (reach + 5 * bend) + 20, rel=0.002)


# --- RRT-GRID --------------------------------------------------------------------------------------------------------


def way_points(*obstacles: FloatArray) -> list[tuple[float, float]]:
    floor = Floor(100.0, 100.0, obstacles)
    points, _ = grid.reachable_way_points(floor, (10, 90), (90, 10), np.random.default_rng(0), Tuning(step=5))
    return [(round((x - 10) / 80, 2), round((90 - y) / 80, 2)) for x, y in points]


def around(share_x: float, share_y: float) -> FloatArray:
    x, y = 10 + 80 * share_x, 90 - 80 * share_y
    return rectangle(x - 2, y - 2, x + 2, y + 2)


def test_way_points_of_phase_one_are_enough_if_two_are_left() -> None:
    assert way_points() == [(0.5, 0.5), (0.25, 0.75), (0.75, 0.25)]
    assert way_points(around(0.5, 0.5)) == [(0.25, 0.75), (0.75, 0.25)]


def test_phase_two_adds_four_and_five_are_kept_at_most() -> None:
    blocked = [around(0.5, 0.5), around(0.25, 0.75)]
    assert way_points(*blocked) == [(0.75, 0.25), (0.25, 0.25), (0.75, 0.75), (0.5, 0.25), (0.5, 0.75)]
    every = [around(*spot) for spot in grid.PHASE_1]
    assert len(way_points(*every)) == 4


def test_without_way_points_start_and_goal_are_joined_directly() -> None:
    obstacles = tuple(around(*spot) for spot in (*grid.PHASE_1, *grid.PHASE_2))
    floor = Floor(100.0, 100.0, obstacles)
    path = grid.rrt_grid(floor, (10, 90), (90, 10), np.random.default_rng(0), Tuning().scaled(0.1))
    assert path.found
    assert not LineString(path.points).intersects(solid(floor))


def test_the_path_leads_over_a_way_point() -> None:
    path = plan("rrt_grid", SCENES["C2.3"])
    points, _ = grid.reachable_way_points(SCENES["C2.3"].floor, START, GOAL, np.random.default_rng(3))
    assert {tuple(point) for point in path.points.tolist()} & set(points)


# --- the paper's table -----------------------------------------------------------------------------------------------


def test_the_papers_claims_follow_from_its_table() -> None:
    """-8.61 % and -31 % are the means over the categories of table 2."""
    runs = [
        (category, number, run, name, length + run, seconds, 1)
        for name, cells in PAPER.items()
        for category, (length, seconds) in enumerate(cells, start=1)
        for number, run in itertools.product((1, 2), (0, 1))
    ]
    runs += [(category, 1, 0, "visibility graph", 1000.0, 1.0, 0) for category in range(1, 6)]
    columns = ["category", "number", "run", "planner", "length_px", "cpu_s", "samples"]
    findings = {finding.what: finding for finding in compare(pd.DataFrame(runs, columns=columns))}
    assert findings["length in %, RRT-GRID to RRT, mean"].paper == "-8.6"
    assert findings["time ratio, RRT-GRID to RRT, mean"].ours == "0.69"
    assert findings["length in %, RRT-GRID to RRT, mean"].holds is Verdict.YES


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the quick form wrote."""
    folder = tmp_path_factory.mktemp("rrt-grid")
    with pytest.raises(SystemExit) as ended:
        cli.main(["reproduce", "rrt-grid", "--out", str(folder)])
    assert ended.value.code == 0
    return folder


def test_quick_reproduction_rrt_grid_is_shorter_in_every_category(quick: Path) -> None:
    table = pd.read_csv(quick / "rrt-grid.csv", dtype=str).set_index("figure")
    for category in range(1, 6):
        assert table.loc[f"length in %, RRT-GRID to RRT, C{category}", "claim holds"] == "yes"
    for name in PAPER:
        assert table.loc[f"runs of {name} that found a path, %", "ours"] == "100.0"
    assert table.loc["time ratio, RRT-GRID to RRT, mean", "paper"] == "0.69"
    assert len((quick / "rrt-grid.md").read_text(encoding="utf-8").splitlines()) == len(table) + 2
    assert (quick / "rrt-grid.svg").stat().st_size > 0
    assert (quick / "rrt-grid-paths.svg").stat().st_size > 0


def test_runs_repeat_but_for_their_times(quick: Path) -> None:
    written = pd.read_csv(quick / "rrt-grid-runs.csv")
    assert len(written) == 30 * (3 * 8 + 1)
    first = written[written["run"] == 0].drop(columns="cpu_s").reset_index(drop=True)
    pd.testing.assert_frame_equal(run_experiment(1)[0].drop(columns="cpu_s"), first, rtol=1e-5)


def test_an_output_folder_that_cannot_be_made_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit) as ended:
        cli.main(["reproduce", "rrt-grid", "--out", str(tmp_path / "file")])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("error: --out:")


def test_path_length_takes_points_or_arrays() -> None:
    assert path_length([(0, 0), (3, 4), (3, 5)]) == path_length(np.array([(0, 0), (3, 4), (3, 5)])) == 6.0


def test_four_of_the_layouts_have_fewer_than_two_way_points_and_two_of_them_none() -> None:
    rng = np.random.default_rng(1)
    kept = {name: len(grid.reachable_way_points(s.floor, START, GOAL, rng)[0]) for name, s in SCENES.items()}
    assert {name: n for name, n in kept.items() if n < 2} == {"C1.5": 1, "C1.6": 0, "C5.1": 1, "C5.3": 0}
