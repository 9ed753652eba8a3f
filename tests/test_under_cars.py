"""Empty AGVs under parked cars in real SUMO: straight in and out, at any step and speed."""

from pathlib import Path

import pytest

from parking_sim.config import check_scenario
from parking_sim.simulation import simulate
from sumo_nets.bodies import AGV_LENGTH_M
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
