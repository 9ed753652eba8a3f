"""Floor plans become layouts that build and run; every body keeps clear of the walls by a geometry library's word."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as numpy_strategies
from matplotlib.image import imsave
from numpy.typing import NDArray
from shapely import LineString, Polygon, unary_union
from shapely.prepared import prep

import sumo_nets
from parking_sim import cli
from sumo_nets.bodies import AGV_LENGTH_M, AGV_WIDTH_M, MIN_GAP_M, driving_bodies, standing_bodies
from sumo_nets.freespace.drawing import tracing_yaml
from sumo_nets.freespace.floor import Floor
from sumo_nets.freespace.floorplan import FloorPlan, cover, load_plan
from sumo_nets.freespace.trace import LANE_CLEARANCE_M, Tracing, trace_lanes
from sumo_nets.layout import LayoutError, parse_layout
from sumo_nets.plan import plan_garage
from sumo_nets.yaml_file import read_mapping

CORNER = Path(sumo_nets.__file__).parent / "plans" / "corner_garage.yaml"
PAGE = Path(__file__).parent.parent / "docs" / "trace-lanes.md"

#: A room of 6 x 5 cells with an island; slots north and south, bays and a home to the west.
ROOM = """
name: room
pitch_m: 7.0
{shell}
slots:
  - {{box: [14, 0, 42, 7], opens: south}}
  - {{box: [14, 28, 42, 35], opens: north}}
bays:
  - {{box: [0, 14, 7, 21], opens: east, per_cell: 1}}
homes:
  - {{box: [0, 7, 7, 14], opens: east}}
street: {{from: [-4, 38], to: [-4, -10]}}
"""
POLYGONS = "outline: [[0, 0], [42, 0], [42, 35], [0, 35]]\nwalls:\n  - [[20, 15], [30, 15], [30, 20], [20, 20]]"


def write(folder: Path, shell: str = POLYGONS, **changes: str) -> Path:
    text = ROOM.format(shell=shell)
    for old, new in changes.items():
        text = re.sub(rf"(?m)^{old}:.*(\n  .*)*", new, text)
    path = folder / "room.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def call(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as caught:
        cli.main(words)
    return caught.value.code


@pytest.fixture(scope="module")
def corner() -> tuple[FloorPlan, Floor, Tracing]:
    plan, walls = load_plan(CORNER)
    return plan, walls, trace_lanes(plan, walls)


# --- an existing kind of garage --------------------------------------------------------------------------------------


def test_the_page_leads_from_a_floor_plan_to_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command of docs/trace-lanes.md, in order: plan, layout, net, check, picture, run, report."""
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    for name, text in re.findall(r"```yaml\n# (\S+\.yaml)\n(.*?)```", page, re.DOTALL):
        Path(name).write_text(text, encoding="utf-8")
    assert FloorPlan.model_validate(read_mapping(Path("corner_garage.yaml"), "name: x")) == load_plan(CORNER)[0]
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    commands = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    assert {words[1] for words in commands} == {"trace-lanes", "build-net", "check-net", "run"}
    for words in commands:
        assert words[0] == "parking-sim"
        assert call(*words[1:]) == 0, words
    assert Path("runs/corner/report.html").stat().st_size > 0


def test_the_corner_garage_keeps_its_boxes(corner: tuple[FloorPlan, Floor, Tracing]) -> None:
    _, _, tracing = corner
    assert tracing.places == {"slot": 56, "bay": 2, "home": 4, "charger": 2}
    assert tracing.dropped == {}
    assert parse_layout(tracing_yaml(tracing, "x")) == tracing.layout


def test_every_body_keeps_clear_of_walls_and_pillars(corner: tuple[FloorPlan, Floor, Tracing]) -> None:
    _, walls, tracing = corner
    garage = plan_garage(tracing.layout)
    tail, head, shapes = garage.lane_arrays()
    bodies = np.concatenate([standing_bodies(shapes), *(b for b, _, _ in driving_bodies(tail, head, shapes))])
    assert walls.outline is not None
    free = prep(Polygon(walls.outline).difference(unary_union([Polygon(p) for p in walls.obstacles])))
    half = AGV_WIDTH_M / 2
    for x, y, hx, hy in bodies.tolist():
        middle = np.array([tracing.origin[0] + x, tracing.origin[1] - y])
        along = np.array([hx, -hy]) * AGV_LENGTH_M / 2
        assert free.contains(LineString([middle - along, middle + along]).buffer(half + MIN_GAP_M, cap_style="flat"))


def test_guide_paths_keep_the_lanes_clearance(corner: tuple[FloorPlan, Floor, Tracing]) -> None:
    plan, walls, tracing = corner
    boxes = [Polygon.from_bounds(*box.box) for box in (*plan.slots, *plan.bays, *plan.homes, *plan.chargers)]
    solid = unary_union([*(Polygon(p) for p in walls.obstacles), *boxes])
    for path in tracing.guide_paths:
        assert LineString(path.points).distance(solid) >= LANE_CLEARANCE_M
        assert path.shortest_m <= path.length_m + 1e-6
        assert path.shortest_m <= path.lanes_m + 1e-6
    lift = next(path for path in tracing.guide_paths if (path.start, path.to) == ("slots[0]", "slots[3]"))
    assert lift.lanes_m > 16.2 + 1e-6, "the lift stands in the straight way"


def test_the_same_seed_traces_the_same(corner: tuple[FloorPlan, Floor, Tracing]) -> None:
    plan, walls, tracing = corner
    again = trace_lanes(plan, walls)
    assert tracing_yaml(again, "x") == tracing_yaml(tracing, "x")
    assert [p.length_m for p in again.guide_paths] == [p.length_m for p in tracing.guide_paths]


def test_rrt_grid_and_the_visibility_graph_lead_to_the_same_lanes(corner: tuple[FloorPlan, Floor, Tracing]) -> None:
    plan, walls, tracing = corner
    exact = trace_lanes(plan, walls, "visibility")
    assert exact.layout == tracing.layout
    assert all(path.length_m == path.shortest_m for path in exact.guide_paths)


# --- other plans -----------------------------------------------------------------------------------------------------


def test_pictures_give_the_layout_of_the_polygons(tmp_path: Path) -> None:
    drawn = trace_lanes(*load_plan(write(tmp_path)), method="visibility").layout
    pixels = np.ones((350, 420))
    pixels[150:200, 200:300] = 0
    imsave(tmp_path / "plan.png", pixels, cmap="gray", vmin=0, vmax=1)
    (tmp_path / "plan.pgm").write_bytes(b"P5 420 350 255\n" + (255 * pixels).astype(np.uint8).tobytes())
    for file in ("plan.png", "plan.pgm"):
        plan, walls = load_plan(write(tmp_path, f"picture: {{file: {file}, metres_per_pixel: 0.1}}"))
        assert trace_lanes(plan, walls, "visibility").layout == drawn


def test_a_plan_and_its_mirror_image_hold_the_same(tmp_path: Path) -> None:
    plain = trace_lanes(*load_plan(write(tmp_path)), method="visibility")
    path = write(
        tmp_path,
        "outline: [[0, 0], [35, 0], [35, 42], [0, 42]]\nwalls:\n  - [[15, 20], [20, 20], [20, 30], [15, 30]]",
        slots="slots:\n  - {box: [0, 14, 7, 42], opens: east}\n  - {box: [28, 14, 35, 42], opens: west}",
        bays="bays:\n  - {box: [14, 0, 21, 7], opens: south, per_cell: 1}",
        homes="homes:\n  - {box: [7, 0, 14, 7], opens: south}",
        street="street: {from: [-10, -4], to: [38, -4]}",
    )
    mirrored = trace_lanes(*load_plan(path), method="visibility")
    assert mirrored.places == plain.places == {"slot": 16, "bay": 1, "home": 2}
    assert mirrored.least_room_m == pytest.approx(plain.least_room_m)


def test_slots_too_near_to_a_pillar_are_left_out(tmp_path: Path) -> None:
    pillar = POLYGONS + "\n  - [[23.8, 3], [24.2, 3], [24.2, 3.4], [23.8, 3.4]]"
    fewer = trace_lanes(*load_plan(write(tmp_path, pillar)), method="visibility")
    plain = trace_lanes(*load_plan(write(tmp_path)), method="visibility")
    assert fewer.places["slot"] < plain.places["slot"]
    assert fewer.least_room_m >= MIN_GAP_M


@settings(max_examples=60, deadline=None)
@given(numpy_strategies.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_rectangles_cover_a_picture_exactly(dark: NDArray[np.bool_]) -> None:
    painted = np.zeros(dark.shape, dtype=int)
    for (x0, y0), _, (x1, y1), _ in cover(dark):
        painted[int(y0) : int(y1), int(x0) : int(x1)] += 1
    assert np.array_equal(painted, dark.astype(int))


# --- mistakes --------------------------------------------------------------------------------------------------------

MISTAKES: list[tuple[dict[str, str], str]] = [
    ({"name": "nam: room"}, "room.yaml: nam: unknown key; did you mean name?"),
    ({"slots": ""}, "slots: missing"),
    ({"bays": "bays: []"}, "bays"),
    ({"pitch_m": "pitch_m: 3"}, "pitch_m: 3: must be greater than"),
    ({"outline": ""}, "give outline: [[x, y], ...], or picture: {file, metres_per_pixel}"),
    ({"outline": "outline: [[0, 0], [42, 0]]"}, "outline"),
    ({"outline": "outline: [[-5, 0], [42, 0], [42, 35]]"}, "outline: corners between 0 and 2000 m are valid"),
    ({"outline": "picture: {file: none.png, metres_per_pixel: 0.1}"}, "picture.file: none.png: can't be read: No such"),
    ({"outline": "picture: {file: room.yaml, metres_per_pixel: 0.1}"}, "room.yaml: can't be read: not a picture"),
    ({"homes": "homes:\n  - {box: [7, 14, 0, 21], opens: east}"}, "homes[0]: box [7.0, 14.0, 0.0, 21.0] is empty"),
    ({"homes": "homes:\n  - {box: [0, 7, 3, 9], opens: east}"}, "homes[0]: no place fits between walls and pillars"),
    ({"homes": "homes:\n  - {box: [0, 7, 7, 14], opens: up}"}, "homes[0].opens: 'up': give 'north'"),
    ({"street": "street: {from: [-4, 38], to: [-40, -10]}"}, "street: from [-4.0, 38.0] to [-40.0, -10.0] is slanted"),
    ({"street": "street: {from: [-4, 38], to: [-4, 30]}"}, "street: from [-4.0, 38.0] to [-4.0, 30.0] is short"),
    ({"street": "street: {from: [-60, 38], to: [-60, -10]}"}, "to the right of the street; 5.5 to 30 m is valid"),
    ({"walls": "walls:\n  - [[12.5, 6], [14, 6], [14, 29], [12.5, 29]]"}, "no way from"),
]


@pytest.mark.parametrize(("changes", "said"), MISTAKES, ids=[said[:40] for _, said in MISTAKES])
def test_a_mistake_is_one_line_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, str], said: str
) -> None:
    path = write(tmp_path, **changes)
    assert call("trace-lanes", str(path), "--method", "visibility") == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["room.yaml"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("nowhere.yaml", "nowhere.yaml: can't be read: No such file"),
        ("plan.png", "a picture shows no bays and slots: write a .yaml"),
        ("room.yaml --draw a.doc", "--draw: a.doc: give a file name that ends with .svg or .png"),
        ("room.yaml --out none/x.yaml --method visibility", "none/x.yaml: can't be written"),
        ("room.yaml --method best", "--method"),
    ],
)
def test_a_wrong_call_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str, said: str
) -> None:
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert call("trace-lanes", *words.split()) == 2
    assert said in capsys.readouterr().err


def test_a_floor_without_room_to_turn_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, POLYGONS + "\n  - [[9, 6], [15, 6], [15, 29], [9, 29]]")
    with pytest.raises(LayoutError, match="no place fits"):
        trace_lanes(*load_plan(path), method="visibility")
