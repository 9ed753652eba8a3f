"""The shipped nets are the garages they claim to be, and nets and layouts that aren't are refused in one line."""

from __future__ import annotations

import gzip
import itertools
import subprocess
import sys
from collections import deque
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from small_net import LAYOUT as GOOD

import sumo_nets
from sumo_nets.bodies import closest_moving, closest_standing
from sumo_nets.build import NetconvertError, build_net, find_netconvert
from sumo_nets.check import check_net, describe_net
from sumo_nets.draw import draw_net
from sumo_nets.errors import NetError
from sumo_nets.generate import generate_layout, layout_yaml
from sumo_nets.graph import ROLES, Graph
from sumo_nets.layout import LayoutError, load_layout, parse_layout
from sumo_nets.plan import plan_garage
from sumo_nets.read import GarageNet, read_net, shipped_nets

PACKAGE = Path(sumo_nets.__file__).parent
OURS = ("map1", "map2", "map3")
THESIS = ("map1_thesis", "map2_thesis", "map3_thesis")


@pytest.fixture(scope="module")
def nets() -> dict[str, GarageNet]:
    return {name: read_net(name) for name in shipped_nets()}


def neighbours(graph: Graph, v: int) -> set[int]:
    return {*graph.successors[v], *np.asarray(graph.tail)[graph.head == v].tolist()}


# --- what the maps are -----------------------------------------------------------------------------------------------


def test_six_nets_are_shipped() -> None:
    assert shipped_nets() == tuple(sorted(OURS + THESIS))


@pytest.mark.parametrize(
    ("name", "slots", "bays", "homes", "chargers", "handover"),
    [
        ("map1", 61, 2, 8, 3, "bay"),
        ("map2", 390, 4, 32, 4, "bay"),
        ("map3", 900, 8, 64, 8, "bay"),
        ("map1_thesis", 61, 4, 4, 3, "home"),
        ("map2_thesis", 390, 16, 16, 4, "home"),
        ("map3_thesis", 900, 48, 48, 4, "home"),
    ],
)
def test_counts(
    nets: dict[str, GarageNet], name: str, slots: int, bays: int, homes: int, chargers: int, handover: str
) -> None:
    net = nets[name]
    graph = net.graph
    assert (len(graph.slots), len(graph.bays), len(graph.homes), len(graph.chargers)) == (slots, bays, homes, chargers)
    assert net.handover == handover
    assert all(len(set(graph.roles[role])) == len(graph.roles[role]) for role in ROLES)


@pytest.mark.parametrize(("name", "cells", "home_a", "distances"), [
    ("map1_thesis", 215, "c0_2", 1324),
    ("map2_thesis", 991, "c2_2", 25091),
    ("map3_thesis", 2106, "c2_2", 55470),
])  # fmt: skip
def test_thesis_maps_have_the_papers_check_sums(
    nets: dict[str, GarageNet], name: str, cells: int, home_a: str, distances: int
) -> None:
    graph = nets[name].graph
    # by the cells' coordinates alone, not by the edges that were built
    at = {tuple(int(part) for part in vertex[1:].split("_")): v for v, vertex in enumerate(graph.names)}
    start = next(cell for cell, v in at.items() if graph.names[v] == home_a)
    steps = {start: 0}
    queue = deque([start])
    while queue:
        x, y = queue.popleft()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if cell in at and cell not in steps:
                steps[cell] = steps[x, y] + 1
                queue.append(cell)
    slots = set(graph.slots)
    assert graph.names[graph.homes[0]] == home_a
    assert len(steps) == cells == len(graph.names)
    assert sum(step for cell, step in steps.items() if at[cell] in slots) == distances
    # and the edges are exactly the sides of adjacent cells, both ways
    sides = {(at[x, y], at[c]) for x, y in at for c in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)) if c in at}
    assert set(graph.edge_index) == sides
    for (x, y), v in at.items():
        assert graph.xy[v] == pytest.approx((6.5 * x, -6.5 * y))


def test_thesis_homes_are_bays_in_the_papers_order(nets: dict[str, GarageNet]) -> None:
    for name in THESIS:
        assert nets[name].graph.bays == nets[name].graph.homes
        assert nets[name].street is None
        assert nets[name].bay_sites == {}
    graph = nets["map1_thesis"].graph
    assert [graph.names[v] for v in graph.homes] == ["c0_2", "c0_3", "c0_4", "c0_1"]


@pytest.mark.parametrize("name", OURS)
def test_our_maps_have_both_kinds_of_lanes_and_spurs_that_block_nobody(nets: dict[str, GarageNet], name: str) -> None:
    graph = nets[name].graph
    assert (graph.reverse < 0).any()
    aisle = set(range(len(graph.names)))
    for role in ROLES:
        for v in graph.roles[role]:
            assert len(neighbours(graph, v)) == 1
            aisle.discard(v)
    two_way_aisles = [e for e in range(len(graph.tail)) if {int(graph.tail[e]), int(graph.head[e])} <= aisle]
    assert (graph.reverse[two_way_aisles] >= 0).any()
    assert nx.is_strongly_connected(graph.to_networkx().subgraph(aisle))


@pytest.mark.parametrize("name", OURS + THESIS)
def test_every_two_way_lane_is_one_track(nets: dict[str, GarageNet], name: str) -> None:
    net = nets[name]
    pairs = net.graph.reverse >= 0
    assert (net.bidi == pairs).all()
    assert (net.graph.length_m[pairs] == net.graph.length_m[net.graph.reverse[pairs]]).all()
    for e in np.flatnonzero(pairs):
        assert (net.shapes[e] == net.shapes[net.graph.reverse[e]][::-1]).all()


@pytest.mark.parametrize("name", OURS + THESIS)
def test_every_place_is_reached_and_left(nets: dict[str, GarageNet], name: str) -> None:
    assert nx.is_strongly_connected(nets[name].graph.to_networkx())


@pytest.mark.parametrize(("name", "standing_m", "moving_m"), [("map1", 0.6, 0.45), ("map1_thesis", 0.55, 0.25)])
def test_bodies_have_room(nets: dict[str, GarageNet], name: str, standing_m: float, moving_m: float) -> None:
    graph, shapes = nets[name].graph, nets[name].shapes
    standing = closest_standing(graph.tail, graph.head, shapes)
    moving = closest_moving(graph.tail, graph.head, shapes)
    assert standing is not None
    assert standing.gap_m > standing_m
    assert moving is not None
    assert moving.gap_m > moving_m


@pytest.mark.parametrize("name", OURS)
def test_bays_have_their_places_on_the_street(nets: dict[str, GarageNet], name: str) -> None:
    net = nets[name]
    assert net.street is not None
    assert list(net.bay_sites) == list(net.graph.bays)
    areas = [area for site in net.bay_sites.values() for area in (site.in_area, site.out_area)]
    assert len(set(areas)) == 2 * len(net.bay_sites)
    for site in net.bay_sites.values():
        assert (site.in_route[0], site.in_route[-1]) == (net.street.queue_edge, net.street.exit_edge)
        assert site.out_route[-1] == net.street.exit_edge
    assert net.street.queue_m >= 6 * 7.5
    assert 0 < net.street.hold_pos_m < net.street.queue_m


@pytest.mark.parametrize("name", OURS + THESIS)
def test_an_agv_charges_whatever_way_it_came(nets: dict[str, GarageNet], name: str) -> None:
    net = nets[name]
    into = [e for e, v in enumerate(net.graph.head.tolist()) if v in net.graph.chargers]
    assert sorted(net.charging_station_of_edge) == into


@pytest.mark.parametrize("name", ["map1", "map1_thesis"])
def test_check_finds_nothing(nets: dict[str, GarageNet], name: str) -> None:
    assert check_net(nets[name]) == ()


# --- building --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OURS + THESIS)
def test_committed_nets_are_what_their_layouts_build(name: str, tmp_path: Path) -> None:
    net_file, additional_file = build_net(load_layout(PACKAGE / "layouts" / f"{name}.yaml"), tmp_path)
    committed = PACKAGE / "nets" / net_file.name
    # the XML, not the packed bytes: those depend on the zlib at hand
    assert gzip.decompress(net_file.read_bytes()) == gzip.decompress(committed.read_bytes())
    assert additional_file.read_bytes() == (PACKAGE / "nets" / additional_file.name).read_bytes()
    rebuilt, shipped = read_net(net_file), read_net(name)
    assert rebuilt.graph.names == shipped.graph.names
    assert rebuilt.graph.edge_names == shipped.graph.edge_names
    assert rebuilt.graph.roles == shipped.graph.roles
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([net_file.name, additional_file.name])


def test_building_leaves_no_trace_of_when_or_where(tmp_path: Path) -> None:
    layout = load_layout(PACKAGE / "layouts" / "map1.yaml")
    first, second = (build_net(layout, tmp_path / folder)[0].read_bytes() for folder in ("a", "b"))
    assert first == second
    assert b"<!--" not in gzip.decompress(first)


def test_what_we_add_survives_netedit(tmp_path: Path) -> None:
    # netedit loads and saves nets with netconvert's own reader and writer
    path = edited(tmp_path, "map1")
    subprocess.run([find_netconvert(), "-s", path, "-o", path], check=True, capture_output=True)
    again, shipped = read_net(path), read_net("map1")
    assert again.graph.roles == shipped.graph.roles
    assert again.graph.edge_names == shipped.graph.edge_names
    assert (again.bidi == shipped.bidi).all()
    assert again.bay_sites == shipped.bay_sites
    assert again.street == shipped.street


def test_without_netconvert_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sumo", None)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NetconvertError, match=r"parking-sim\[nets\]"):
        find_netconvert()


@pytest.mark.parametrize(("slots", "bays", "homes", "chargers"), [(1, 1, 1, 0), (47, 2, 3, 1), (500, 5, 20, 9)])
def test_generated_garages_have_what_was_asked_for(slots: int, bays: int, homes: int, chargers: int) -> None:
    layout = generate_layout("any", slots, bays, homes, chargers)
    roles = plan_garage(layout).roles
    assert [len(roles[role]) for role in ("slot", "bay", "home", "charger")] == [slots, bays, homes, chargers]
    assert parse_layout(layout_yaml(layout)) == layout


@pytest.mark.parametrize("name", OURS + THESIS)
def test_layouts_survive_being_written(name: str) -> None:
    layout = load_layout(PACKAGE / "layouts" / f"{name}.yaml")
    assert parse_layout(layout_yaml(layout)) == layout


@pytest.mark.parametrize("wish", [{"slots": 0}, {"bays": 99}, {"homes": 10_000}, {"chargers": -1}, {"aisles": 2}])
def test_generator_refuses_what_does_not_fit(wish: dict[str, int]) -> None:
    with pytest.raises(LayoutError, match="is not valid: ") as caught:
        generate_layout("any", **{"slots": 61, "bays": 2, "homes": 8, "chargers": 3, **wish})
    assert "\n" not in str(caught.value)


# --- layouts that can't be built -------------------------------------------------------------------------------------


def test_the_small_layout_is_good() -> None:
    roles = plan_garage(parse_layout(GOOD)).roles
    assert [len(roles[role]) for role in ROLES] == [16, 1, 2, 1, 1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("name: small", "name: 7 up", "name"),
        ("name: small", "", "name: missing"),
        ("pitch_m: 7.0", "pitch_m: -7.0", "pitch_m"),
        ("pitch_m: 7.0", "pitch_m: .nan", "pitch_m"),
        ("pitch_m: 7.0", "pitch_m: wide", "pitch_m"),
        ("pitch_m: 7.0", "pitch_m: 7.0\npitch_m: 8.0", "'pitch_m' is given twice"),
        ("pitch_m: 7.0", "colour: red", "colour: unknown key"),
        ("handover: bay", "handover: street", "handover"),
        ("handover: bay", "handover: home", "handover"),
        ("way: two", "way: three", "aisles[1].way"),
        ("to: [9, 0], way", "to: [9, 1], way", "slanted"),
        ("{from: [9, 6], to: [2, 6], way: one}", "{from: [9, 6], to: [9, 6], way: one}", "two cells"),
        ("to: [9, 0]", "to: [9.5, 0]", "aisles[1].to[0]: 9.5"),
        ("to: [9, 0]", "to: [-9, 0]", "aisles[1].to[0]: -9"),
        ("to: [9, 0]", "to: [true, 0]", "aisles[1].to[0]"),
        ("to: [9, 0]", "to: [9]", "aisles[1].to"),
        ("to: [9, 0], way: two}", "to: [9, 0], way: two, speed: 3}", "aisles[1].speed: unknown key"),
        ("from: [9, 6], to: [2, 6]", "from: [9, 0], to: [2, 0]", "has a lane already"),
        ("from: [4, 0], to: [7, 0]", "from: [4, 1], to: [7, 1]", "slots[0]: [4, 1] is no aisle cell"),
        ("side: [north, south]", "side: [east, south]", "the east side of [4, 0] is taken"),
        ("side: [north, south]", "side: [north, north]", "once"),
        ("side: [north, south]", "side: up", "slots[0].side"),
        ("side: [north, south]", "side: []", "slots[0]"),
        ("per_cell: 2}\nbays", "per_cell: 3}\nbays", "slots[0].per_cell: 3"),
        ("{at: [2, 3], side: west}", "{side: west}", "bays[0]: give either at"),
        ("{at: [2, 3], side: west}", "{at: [2, 3], from: [2, 3], to: [2, 3], side: west}", "bays[0]: give either at"),
        ("{at: [9, 5], side: east}", "{at: [9, 2], side: east}", "the east side of [9, 2] is taken"),
        ("{at: [8, 0], side: north}", "{at: [7, 0], side: north}", "the north side of [7, 0] is taken"),
        ("pitch_m: 7.0", "pitch_m: 6.0", "would have"),
        ("{at: [8, 0], side: north}", "{at: [8, 0], side: here}\n  - {at: [8, 0], side: here}", "refuge already"),
        ("bays:\n  - {at: [2, 3], side: west}\n", "", "needs bays"),
        ("street: {from: [0, 6], to: [0, 0]}", "", "needs bays and a street"),
        ("street: {from: [0, 6], to: [0, 0]}", "street: {from: [0, 0], to: [0, 6]}", "right of the street"),
        ("street: {from: [0, 6], to: [0, 0]}", "street: {from: [0, 3], to: [0, 0]}", "street: bay2_3w"),
        ("street: {from: [0, 6], to: [0, 0]}", "street: {from: [0, 6], to: [0, 0], queue_m: 0}", "street.queue_m"),
        ("{at: [2, 3], side: west}", "{from: [2, 3], to: [2, 2], side: west}", "street places overlap"),
        ("homes:\n  - {at: [9, 2], side: east, per_cell: 2}\n", "homes: []\n", "homes"),
        ("aisles:", "picture: |\n  .?\naisles:", "picture"),
        (GOOD, "[1, 2]", "give a mapping of keys to values, such as name"),
        (GOOD, "name: [", "line"),
        (GOOD, "? [a, b]\n: 1", "small.yaml"),
        (GOOD, "", "give a mapping of keys to values, such as name"),
    ],
)
def test_a_bad_layout_is_one_line(old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(LayoutError) as caught:
        plan_garage(parse_layout(GOOD.replace(old, new), "small.yaml"), "small.yaml")
    message = str(caught.value)
    assert said in message
    assert all(line.startswith("small.yaml: ") for line in message.split("\n"))


def test_a_missing_layout_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"can't be read: No such file"):
        load_layout(tmp_path / "none.yaml")


def test_nothing_is_written_of_a_bad_layout(tmp_path: Path) -> None:
    layout = parse_layout(GOOD.replace("pitch_m: 7.0", "pitch_m: 6.0"))
    with pytest.raises(LayoutError):
        build_net(layout, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- nets from elsewhere ---------------------------------------------------------------------------------------------


def edited(tmp_path: Path, name: str, **changes: tuple[str, str]) -> Path:
    """A shipped net with strings replaced in its ``net`` or ``add`` file, as by hand."""
    net = gzip.decompress((PACKAGE / "nets" / f"{name}.net.xml.gz").read_bytes()).decode()
    add = (PACKAGE / "nets" / f"{name}.add.xml").read_text()
    texts = {"net": net, "add": add}
    for which, (old, new) in changes.items():
        assert old in texts[which]
        texts[which] = texts[which].replace(old, new)
    path = tmp_path / "edited.net.xml"
    path.write_text(texts["net"])
    path.with_name("edited.add.xml").write_text(texts["add"])
    return path


def test_a_net_edited_by_hand_is_read_as_edited(tmp_path: Path) -> None:
    before = read_net("map1").graph
    net = gzip.decompress((PACKAGE / "nets" / "map1.net.xml.gz").read_bytes()).decode()
    start = net.index('<edge id="c5_5-c6_5"')
    edge = net[start : net.index("</edge>", start) + len("</edge>")]
    after = read_net(edited(tmp_path, "map1", net=(edge, ""))).graph
    assert set(before.edge_names) - set(after.edge_names) == {"c5_5-c6_5"}
    assert after.slots == before.slots


def test_roles_follow_the_parameters(tmp_path: Path) -> None:
    path = edited(
        tmp_path, "map1", net=('<param key="garage.home" value="0"/>', '<param key="garage.refuge" value="0"/>')
    )
    after, before = read_net(path).graph, read_net("map1").graph
    assert after.homes == before.homes[1:]
    assert after.roles["refuge"] == before.homes[:1]


def test_a_net_is_read_once_and_again_when_either_file_changes(tmp_path: Path) -> None:
    path = edited(tmp_path, "map1")
    first = read_net(path)
    assert read_net(path) is first
    edited(tmp_path, "map1", net=('<param key="garage.home" value="0"/>', '<param key="garage.refuge" value="0"/>'))
    assert read_net(path).graph.homes == first.graph.homes[1:]
    add = path.with_name("edited.add.xml")
    add.write_text(add.read_text() + " ")
    assert read_net(path) is not first
    add.unlink()
    with pytest.raises(NetError, match=r"edited\.add\.xml: can't read"):
        read_net(path)


def test_check_sees_a_lane_that_lost_its_mark(tmp_path: Path) -> None:
    garage = read_net(edited(tmp_path, "map1", net=(' bidi="c6_2-c5_2"', "")))
    assert any("c5_2-c6_2: not marked bidi" in line for line in check_net(garage))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"net": ("garage.bay", "garage.was_bay")}, "no bays"),
        ({"net": ('"garage.slot" value="5"', '"garage.slot" value="five"')}, "garage.slot is 'five'"),
        ({"net": ('"garage.street" value="queue"', '"garage.street" value="row"')}, "garage.street=queue"),
        ({"net": ("</net>", "<net")}, "not XML"),
        ({"add": ('"garage.use" value="in"', '"garage.use" value="inn"')}, "no parkingArea with garage.use 'in'"),
        ({"add": ("garage.bay", "garage.b")}, "has no parkingArea"),
        ({"add": ("street_front_0", "street_back_0")}, "street_back_0"),
        ({"add": ("</additional>", "")}, "not XML"),
    ],
)
def test_a_bad_net_is_one_line(tmp_path: Path, changes: dict[str, tuple[str, str]], said: str) -> None:
    path = edited(tmp_path, "map1", **changes)
    with pytest.raises(NetError) as caught:
        read_net(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_no_unknown_map() -> None:
    with pytest.raises(NetError, match=r"^nowhere/x\.net\.xml: no such file$"):
        read_net("nowhere/x.net.xml")


@pytest.mark.parametrize("given", ["map9", "", "tests"])
def test_an_unknown_map_lists_the_known_ones(given: str) -> None:
    with pytest.raises(NetError) as caught:
        read_net(given)
    assert all(name in str(caught.value) for name in shipped_nets())
    assert "\n" not in str(caught.value)


def test_a_net_without_its_additional_file_is_one_line(tmp_path: Path) -> None:
    path = edited(tmp_path, "map1")
    path.with_name("edited.add.xml").unlink()
    with pytest.raises(NetError, match=r"edited\.add\.xml: can't read"):
        read_net(path)


# --- words and pictures ----------------------------------------------------------------------------------------------


def test_a_net_is_described_in_a_line(nets: dict[str, GarageNet]) -> None:
    assert describe_net(nets["map1"]) == (
        "map1: 61 slots, 2 bays, 8 homes, 3 chargers; 123 vertices, 94 two-way and 34 one-way lanes;"
        " hand-over at the bay; well-formed: end points block nobody"
    )


def test_pictures(nets: dict[str, GarageNet], tmp_path: Path) -> None:
    pictures = [tmp_path / "a.svg", tmp_path / "b.svg", tmp_path / "c.png"]
    for path in pictures:
        draw_net(nets["map1"], path)
    assert all(path.stat().st_size > 10_000 for path in pictures)
    assert all(a.read_bytes() == b.read_bytes() for a, b in itertools.pairwise(pictures[:2]))
    with pytest.raises(ValueError, match=r"\.svg or \.png"):
        draw_net(nets["map1"], tmp_path / "d.jpeg")
