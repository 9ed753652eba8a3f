"""Empty AGVs under parked cars in real SUMO: straight in and out, at any step and speed."""

import re
from pathlib import Path

import pytest
from small_net import write_net

from parking_sim.config import check_scenario
from parking_sim.simulation import simulate
from sumo_nets.bodies import AGV_LENGTH_M
from sumo_nets.check import check_net
from sumo_nets.read import read_net


def counted(**keys):
    """Collisions, overlaps and turns under cars of a run that ends well."""
    summary = simulate(check_scenario(keys, "test", Path()), None)
    assert summary.status == "finished"
    return tuple(summary.metrics[key] for key in ("sumo_collisions", "footprint_overlaps", "turns_under_cars"))


@pytest.mark.parametrize(("step_s", "speed_mps"), [(0.1, 3.0), (0.5, 1.0), (0.5, 3.0), (1.0, 1.0), (1.0, 3.0)])
def test_nothing_overlaps_whatever_the_step_and_the_speed(step_s, speed_mps):
    agv = {"empty_mps": speed_mps, "loaded_mps": speed_mps, "lift_s": 2.0, "lower_s": 2.0}
    assert counted(garage="map1", agvs=2, step_s=step_s, agv=agv, workload={"kind": "park_exit", "cars": 3}) == (
        0,
        0,
        0,
    )


def test_from_a_straight_spur_an_agv_turns_only_clear_of_the_car(tmp_path):
    """The only slot of map1 whose spur is straight."""
    rows = ["time_s,kind,car,zone", "0,park,blue,slot10_2n", "300,retrieve,blue,"]
    (tmp_path / "requests.csv").write_text("\n".join(rows))
    workload = {"kind": "csv", "path": str(tmp_path / "requests.csv")}
    assert counted(garage="map1", agvs=1, workload=workload) == (0, 0, 0)


def test_on_a_grid_of_small_cells_turns_under_cars_are_counted_apart():
    """Cells of 6.5 m leave no room to drive straight out: the AGV turns under the first car on its way out and in.

    It stays under the second car, and brings it back first.
    """
    workload = {"kind": "park_exit", "cars": 2}
    collisions, overlaps, turns = counted(garage="map1_thesis", agvs=1, workload=workload)
    assert (collisions, overlaps, turns) == (0, 0, 2)


@pytest.mark.parametrize("name", ["map1", "map2", "map3"])
def test_spurs_of_slots_have_room_for_two_bodies(name):
    graph = read_net(name).graph
    into = [length for v, length in zip(graph.head, graph.length_m, strict=True) if int(v) in set(graph.slots)]
    assert min(into) >= 2 * AGV_LENGTH_M


@pytest.mark.parametrize("garage", ["map1", "small"])
@pytest.mark.parametrize(("length_m", "fits"), [(4.5, True), (4.8, True), (4.9, False), (5.0, False)])
def test_an_agv_is_refused_if_its_rear_swings_back_into_its_own_car(garage, length_m, fits, tmp_path, monkeypatch):
    """What the check of nets expects is what the run's own check, which measures SUMO's bodies, then counts."""
    source = str(write_net(tmp_path)) if garage == "small" else garage
    complaints = check_net(read_net(source), (length_m, 2.0), loads=False)
    assert (complaints == ()) == fits
    if not fits:
        monkeypatch.setattr("parking_sim.assembly.require_fit", lambda net, size_m: None)
    keys = {"garage": source, "agv": {"length_m": length_m, "lift_s": 2.0, "lower_s": 2.0}}
    collisions, overlaps, turns = counted(agvs=1, workload={"kind": "park_exit", "cars": 3}, **keys)
    assert (collisions, turns) == (0, 0)
    assert (overlaps == 0) == fits


@pytest.mark.parametrize("length_m", [4.85, 4.9, 5.0])
def test_the_complaint_names_slot_body_and_what_fits(length_m):
    net = read_net("map1")
    said = check_net(net, (length_m, 2.0), loads=False)[0]
    match = re.fullmatch(
        rf"(slot\w+): an empty AGV of {length_m:g} x 2 m that turns between the slot and (\S+) has -?\d\.\d\d m to the"
        r" car parked there; 0.05 m is needed, which AGVs of up to (\S+) m have",
        said,
    )
    assert match is not None, said
    assert net.graph.index[match[1]] in net.graph.slots
    assert match[2] in net.graph.edge_names
    longest_m = float(match[3])
    assert check_net(net, (longest_m, 2.0), loads=False) == ()
    assert check_net(net, (longest_m + 0.1, 2.0), loads=False) != ()
