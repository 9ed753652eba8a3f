"""AGVs in real SUMO, one at a time or made to meet on purpose."""

import math
import pickle
from itertools import pairwise
from pathlib import Path

import networkx as nx
import pytest

from controller.types import Act, Action, Advance
from parking_sim.footprint import FootprintCheck
from parking_sim.plants.sumo import PlantError, SumoPlant
from parking_sim.plants.sumo_agv import AgvType
from sumo_nets.read import GarageNet, read_net


@pytest.fixture(scope="module")
def map1() -> GarageNet:
    return read_net("map1")


@pytest.fixture
def started(request):
    """Starts plants and closes them: one simulation in a process at a time."""
    plants = []

    def start(garage, starts, **options) -> SumoPlant:
        plants.append(SumoPlant(garage, starts, options.pop("agv_type", AgvType()), 1, **options))
        return plants[-1]

    yield start
    for plant in plants:
        plant.close()


class Driver:
    """Sends one AGV along shortest paths and checks what the plant says on the way."""

    def __init__(self, plant: SumoPlant, start: int) -> None:
        self.plant, self.graph = plant, plant.graph
        self.edge, self.at, self.loaded = -1, start, False
        self.model = plant.graph.to_networkx()
        self.planned = self.taken = 0

    def wait(self, limit: int = 3000) -> int:
        plant, old = self.plant, self.plant.states()[0]
        for steps in range(limit):
            if plant.states()[0].standing:
                return steps
            plant.step()
            new = plant.states()[0]
            assert old.reached <= new.reached <= old.reached + 1
            assert old.left <= new.left
            assert new.left - 1 <= new.reached
            old = new
        raise AssertionError("the AGV never came to a stand")

    def act(self, action: Action, steps: int) -> None:
        self.plant.execute(Act(0, action, steps))
        assert self.wait() == steps
        if action in (Action.LIFT, Action.LOWER):
            self.loaded = action is Action.LIFT

    def go(self, goal: int) -> None:
        path = nx.shortest_path(self.model, self.at, goal, weight="length_m")
        edges = [self.graph.edge_index[u, v] for u, v in pairwise(path)]
        while edges:
            turn = self.plant.motion.turn(self.graph, self.edge, edges[0], self.loaded)
            if turn and self.edge >= 0:
                column = self.plant.motion.transition(self.graph, self.edge, edges[0])
                rotation = int(self.plant.motion.rotation_steps[int(self.loaded), column])
                self.act(Action.TURN, rotation)
                self.taken += rotation
            run = [edges.pop(0)]
            while edges and not self.plant.motion.turn(self.graph, run[-1], edges[0], self.loaded):
                run.append(edges.pop(0))
            self.edge, self.at = run[-1], int(self.graph.head[run[-1]])
            self.plant.execute(Advance(0, tuple(int(self.graph.head[e]) for e in run)))
            assert not self.plant.states()[0].standing
            self.planned += turn + sum(int(self.plant.motion.edge_steps[int(self.loaded), e]) for e in run)
            self.taken += self.wait()
            state = self.plant.states()[0]
            assert state.reached == state.left


def test_park_and_back(map1, started):
    graph = map1.graph
    plant = started(map1, graph.homes[:1])
    assert plant.time_s <= 3.0
    assert [(s.reached, s.left, s.standing) for s in plant.states()] == [(0, 0, True)]
    driver = Driver(plant, graph.homes[0])
    driver.go(graph.bays[0])
    driver.act(Action.LIFT, 40)
    assert plant._api.vehicle.getTypeID("agv0") == "agv_loaded"
    for slot in (graph.slots[0], graph.slots[20], graph.slots[-1]):
        driver.go(slot)
    driver.act(Action.LOWER, 30)
    assert plant._api.vehicle.getTypeID("agv0") == "agv_empty"
    driver.go(graph.homes[0])
    assert plant.collisions == 0
    assert math.dist(_front(plant), graph.xy[graph.homes[0]]) < 0.5


def test_executed_times_agree_with_planned_ones(started):
    for name in ("map1", "map1_thesis"):
        garage = read_net(name)
        plant = started(garage, garage.graph.homes[:1])
        driver = Driver(plant, garage.graph.homes[0])
        driver.go(garage.graph.slots[5])
        driver.act(Action.LIFT, 1)
        driver.go(garage.graph.bays[0])
        driver.act(Action.LOWER, 1)
        driver.go(garage.graph.slots[-1])
        plant.close()
        assert driver.taken <= driver.planned <= 1.08 * driver.taken


def test_front_and_rear_are_where_sumo_says(map1, started):
    graph = map1.graph
    plant = started(map1, graph.homes[:1])
    path = nx.shortest_path(graph.to_networkx(), graph.homes[0], graph.slots[0], weight="length_m")[:2]
    granted = [graph.homes[0]]
    plant.execute(Advance(0, tuple(path[1:])))
    granted += path[1:]
    vehicle = plant._api.vehicle
    while not plant.states()[0].standing:
        plant.step()
        state, road = plant.states()[0], vehicle.getRoadID("agv0")
        if not road.startswith(":"):
            e = graph.edge_names.index(road)
            assert state.reached >= granted.index(graph.tail[e])
            x, y = plant._place[0, 0], plant._place[1, 0]
            assert (x, y) == pytest.approx(vehicle.getPosition("agv0"))
            rear_past_tail = vehicle.getLanePosition("agv0") - plant.agv_type.length_m + plant._lanes.before_m[e]
            assert (state.left > granted.index(graph.tail[e])) == (rear_past_tail >= plant._lanes.clear_m[e] - 1e-5)


@pytest.mark.parametrize("delay", [1, 4, 6, 7, 8, 9, 10, 11, 12, 13])
def test_extended_while_driving_it_never_stops_before_the_end(map1, started, delay):
    """Whenever the next grant comes, even on a junction or while it brakes, it is carried out."""
    graph = map1.graph
    plant = started(map1, graph.homes[:1])
    driver = Driver(plant, graph.homes[0])
    path = nx.shortest_path(driver.model, graph.homes[0], graph.slots[-1], weight="length_m")
    straight = _straight(graph, path)
    driver.go(straight[1])
    for vertex in straight[2:5]:
        plant.execute(Advance(0, (vertex,)))
        for _ in range(delay):
            plant.step()
    driver.wait()
    state = plant.states()[0]
    assert state.reached == state.left
    assert math.dist(_front(plant), graph.xy[straight[4]]) < 0.5


def _front(plant):
    """The middle of the first AGV's front side; samples tell the middle of its body."""
    sample, angle, half = plant.samples()[0], math.radians(plant.samples()[0].angle_deg), plant.agv_type.length_m / 2
    return sample.x_m + half * math.cos(angle), sample.y_m + half * math.sin(angle)


def _straight(graph, path):
    """The longest straight part of a path, with the vertex before it."""
    runs, run = [], path[:2]
    for u, v, w in zip(path, path[1:], path[2:], strict=False):
        straight = graph.turn_deg(graph.edge_index[u, v], graph.edge_index[v, w]) < 1.0
        run = [*run, w] if straight else [v, w]
        runs.append(run)
    longest = max(runs, key=len)
    assert len(longest) >= 5
    return longest


def test_head_on_is_seen_by_sumo_and_by_the_footprint_check(map1, started):
    """Two AGVs sent towards each other on one lane: what a broken executor would do."""
    graph = map1.graph
    lane = _two_way_run(graph)
    plant = started(map1, (lane[0], lane[-1]))
    check = FootprintCheck()
    plant.execute(Advance(0, tuple(lane[1:])))
    plant.execute(Advance(1, tuple(lane[-2::-1])))
    for _ in range(100):
        plant.step()
        check.step(plant.time_s, plant.bodies())
    assert plant.collisions > 0
    assert check.result().overlaps > 0
    assert check.result().least_m == 0.0


def _two_way_run(graph):
    """Five or more vertices in a row along lanes for both directions."""
    model = graph.to_networkx()
    model.remove_edges_from([(u, v) for u, v in model.edges if not model.has_edge(v, u)])
    ways = [path for a in model for path in nx.single_source_shortest_path(model, a, cutoff=4).values()]
    for path in ways:
        edges = [graph.edge_index[e] for e in pairwise(path)]
        if len(path) == 5 and all(graph.turn_deg(e, f) < 1.0 for e, f in pairwise(edges)):
            return path
    raise AssertionError("no such run")


def test_crossing_at_a_node_is_seen_by_the_footprint_check_alone(started):
    """SUMO does not detect it, so the check must."""
    garage = read_net("map1_thesis")
    graph = garage.graph
    plant_starts, ways = _crossing(graph)
    plant = started(garage, plant_starts)
    check = FootprintCheck()
    for agv, way in enumerate(ways):
        plant.execute(Advance(agv, way))
    for _ in range(60):
        plant.step()
        check.step(plant.time_s, plant.bodies())
    assert check.result().overlaps > 0
    assert check.events[0].agv == 0
    assert check.events[0].other == 1


def _crossing(graph):
    """Two AGVs a cell before a common vertex, at right angles, both going straight over it."""
    into, out = {}, {}
    for e, (u, v) in enumerate(zip(graph.tail.tolist(), graph.head.tolist(), strict=True)):
        into.setdefault(v, []).append(e)
        out.setdefault(u, []).append(e)
    for v in sorted(into):
        straight = [
            (e, f)
            for e in into[v]
            for f in out[v]
            if graph.reverse[e] != f and graph.turn_deg(e, f) < 1.0 and len(into[int(graph.tail[e])]) > 0
        ]
        for e, f in straight:
            for g, h in straight:
                if graph.turn_deg(e, g) > 80.0:
                    starts = (int(graph.tail[e]), int(graph.tail[g]))
                    return starts, tuple((v, int(graph.head[x])) for x in (f, h))
    raise AssertionError("no crossing")


def test_battery_drains_and_charges(map1, started):
    graph = map1.graph
    plant = started(map1, graph.homes[:1], agv_type=AgvType(battery_wh=60.0))
    driver = Driver(plant, graph.homes[0])
    driver.go(graph.slots[-1])
    driver.go(graph.chargers[0])
    low = plant.states()[0].soc
    assert 0.0 < low < 0.95
    driver.act(Action.CHARGE, 60)
    assert plant.states()[0].soc > low + 0.1


def test_default_battery_lasts_and_charges_in_an_hour(map1, started):
    """About 8 hours of driving, half of it loaded; 30 % to 90 % within an hour."""
    graph, kind = map1.graph, AgvType()
    plant = started(map1, graph.homes[:1])
    driver = Driver(plant, graph.homes[0])
    drop = []
    for loaded, slot in ((True, graph.slots[0]), (False, graph.slots[-1])):
        driver.act(Action.LIFT if loaded else Action.LOWER, 1)
        soc, start_s = plant.states()[0].soc, plant.time_s
        driver.go(slot)
        driver.go(graph.homes[0])
        drop.append((soc - plant.states()[0].soc) / (plant.time_s - start_s))
    hours = 1.0 / (sum(drop) / 2) / 3600.0
    assert 7.0 < hours < 10.0
    assert 0.6 * kind.battery_wh / (0.95 * kind.charge_w) <= 1.0


def test_what_cannot_be_done_is_one_clear_error(map1, started):
    graph = map1.graph
    plant = started(map1, graph.homes[:2])
    with pytest.raises(PlantError, match="another SUMO simulation is open"):
        SumoPlant(map1, graph.homes[:1], AgvType(), 1)
    with pytest.raises(PlantError, match="no edge from"):
        plant.execute(Advance(0, (graph.bays[0],)))
    first = graph.successors[graph.homes[0]][0]
    plant.execute(Advance(0, (first,)))
    with pytest.raises(PlantError, match="not standing"):
        plant.execute(Act(0, Action.LIFT, 40))
    with pytest.raises(PlantError, match="reverse"):
        plant.execute(Advance(0, (graph.homes[0],)))
    assert pickle.loads(pickle.dumps(PlantError("x"))).args == ("x",)
    plant.close()
    plant.close()
    with pytest.raises(PlantError, match="too short"):
        SumoPlant(map1, graph.homes[:1], AgvType(length_m=7.0), 1)
    started(map1, graph.homes[:1]).step()


def test_the_run_folder_opens_in_sumo_and_repeats_byte_for_byte(map1, started, tmp_path):
    contents = []
    for name in ("a", "b"):
        folder = tmp_path / name
        plant = started(map1, map1.graph.homes[:4], outputs=folder, fcd=True)
        for request in range(3):
            plant.arrive(request)
        Driver(plant, map1.graph.homes[0]).go(map1.graph.slots[3])
        plant.close()
        found = {p.name for p in folder.iterdir()}
        assert found == {
            "run.sumocfg", "agvs.rou.xml", "tripinfo.xml", "stops.xml", "statistics.xml", "fcd.xml.gz",
        }  # fmt: skip
        contents.append(_fcd(folder / "fcd.xml.gz"))
    assert contents[0] == contents[1]
    import libsumo

    libsumo.start(["sumo", "-c", str(tmp_path / "a" / "run.sumocfg")])
    libsumo.simulationStep()
    assert libsumo.vehicle.getIDCount() == 4
    libsumo.close()


def _fcd(path: Path) -> str:
    import gzip

    return gzip.decompress(path.read_bytes()).decode().split("-->", 1)[-1]


def test_the_same_over_traci(map1, started, monkeypatch):
    """What --gui runs, with SUMO's own program in place of sumo-gui."""
    import parking_sim.plants.sumo_api as module

    find = module._find_binary
    results = []
    for gui in (False, True):
        monkeypatch.setattr(module, "_find_binary", lambda name: find("sumo"))
        plant = started(map1, map1.graph.homes[:1], gui=gui)
        driver = Driver(plant, map1.graph.homes[0])
        driver.go(map1.graph.slots[0])
        results.append((plant.time_s, plant.samples(), plant.states()))
        plant.close()
    assert results[0] == results[1]
