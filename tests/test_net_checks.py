"""A net is what its file says: each thing that would stop AGVs later is refused in one line, and the rest is driven."""

from __future__ import annotations

import math
import os
import random
import re
import subprocess
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import libsumo
import numpy as np
import pytest
from small_net import Change, texts, write_net

from controller.types import NEVER, Advance
from parking_sim.assembly import assemble
from parking_sim.cli import main
from parking_sim.config import check_scenario, load_scenario
from parking_sim.plants.sumo import SumoPlant
from parking_sim.plants.sumo_agv import AgvType, sumo_motion
from parking_sim.simulation import simulate
from sumo_nets.bodies import AGV_SIZE_M
from sumo_nets.build import NETCONVERT_OPTIONS, find_netconvert
from sumo_nets.check import check_net, describe_net
from sumo_nets.errors import NetError
from sumo_nets.net_files import read_net_file
from sumo_nets.read import read_net, shipped_nets
from sumo_nets.sumo_rules import permits

#: Mutants that are read and checked, and of those how many without complaints are run.
MUTANTS, RUNS = int(os.environ.get("FUZZ", "150")) // 2, max(2, int(os.environ.get("FUZZ", "150")) // 75)

STATION = '<chargingStation id="charge_c9_5-charger9_5e"'
CHARGED = "c9_5-charger9_5e_0"
#: A block of two rows of slots, of which an aisle passes one.
DENSE = """
name: dense
pitch_m: 7.0
handover: bay
picture: |
  ########
  ###SSSS#
  ###SSSS#
  ##......
homes:
  - {at: [7, 3], side: east}
bays:
  - {at: [2, 3], side: west}
street: {from: [0, 8], to: [0, 0]}
"""
#: The only aisle leads through a home.
THROUGH_HOME = """
name: mid
pitch_m: 7.0
handover: bay
aisles:
  - {from: [2, 2], to: [6, 2], way: two}
slots:
  - {from: [4, 2], to: [6, 2], side: [north, south]}
bays:
  - {at: [2, 2], side: west}
homes:
  - {at: [3, 2], side: here}
street: {from: [0, 6], to: [0, 0]}
"""


def lane(name: str, old: str, new: str) -> Change:
    """Change an attribute of an edge's lane."""
    row = re.search(rf'<lane id="{name}_0".*?/>', texts()["net"])
    assert row is not None
    return ("net", row[0], row[0].replace(old, new))


def turn_closed(inner: str) -> Change:
    """Close the lane inside a junction to AGVs."""
    return ("net", row := f'<lane id="{inner}" index="0" allow="tram"', row.replace("tram", "bus"))


def station(places: str) -> Change:
    """Give the chargingStation a place on its lane."""
    return ("add", STATION, f"{STATION} {places}")


def without_turn(came: str, onto: str) -> Change:
    """Take a connection away."""
    row = re.search(rf'<connection from="{came}" to="{onto}".*?/>', texts()["net"])
    assert row is not None
    return ("net", row[0], "")


# --- what check-net complains of, and a run refuses ------------------------------------------------------------------

COMPLAINTS: dict[str, tuple[list[Change], str]] = {
    "missing turn": ([without_turn("c2_1-c2_0", "c2_0-c3_0")], "can't turn from c2_1-c2_0 to c2_0-c3_0"),
    "missing reversal": (
        [without_turn("c4_0-slot4_0n1", "slot4_0n1-c4_0")],
        "can't turn from c4_0-slot4_0n1 to slot4_0n1-c4_0",
    ),
    "closed turn": ([turn_closed(":c2_0_1_0")], "can't turn from c2_1-c2_0 to c2_0-c3_0"),
    "no bidi": ([("net", ' bidi="slot4_0n1-c4_0"', "")], "c4_0-slot4_0n1: not marked bidi with slot4_0n1-c4_0"),
    "other bidi": ([("net", ' bidi="slot4_0n1-c4_0"', ' bidi="slot4_0n2-c4_0"')], "not marked bidi with slot4_0n1"),
    "slow": ([lane("c3_0-c4_0", 'speed="5.00"', 'speed="0.05"')], "c3_0-c4_0: 0.05 m/s; 0.1 m/s or more is valid"),
    "one longer than the other": ([lane("c3_0-c4_0", "6.60", "6.65")], "c3_0-c4_0: 6.65 m, but 6.60 m in the other"),
    "longer than drawn": ([lane("c2_1-c2_0", 'length="6.60"', 'length="9.60"')], "9.60 m long, but drawn with 6.60 m"),
    "junction elsewhere": ([("net", 'x="14.00" y="-7.00"', 'x="19.00" y="-7.00"')], "its lanes end 5.00 m beside it"),
    "station beside the stop": ([station('startPos="0" endPos="0.5"')], "no chargingStation covers"),
    "station on another lane": ([("add", CHARGED, "c2_1-c2_0_0")], "no chargingStation covers"),
    "no way out of a refuge": ([lane("refuge8_0n-c8_0", "tram", "bus")], "an AGV that drives there has no way back"),
    "no way to a home": ([lane("c9_2-home9_2e1", "tram", "bus")], "no way to home9_2e1"),
    "no way back from a home": ([lane("home9_2e1-c9_2", "tram", "bus")], "no way back from home9_2e1"),
    "one-way slot": ([lane("slot4_0n1-c4_0", "tram", "bus")], "slot4_0n1 has no two-way lane to an aisle"),
    "slots gone": ([("net", "garage.slot", "garage.spot")] * 16, "no slots"),
}  # fmt: skip


@pytest.mark.parametrize("kind", COMPLAINTS)
def test_each_fault_is_a_complaint_and_a_run_refuses_it(kind: str, tmp_path: Path) -> None:
    changes, said = COMPLAINTS[kind]
    path = write_net(tmp_path, *changes)
    complaints = check_net(read_net(path), loads=False)
    assert any(said in line for line in complaints), complaints
    with pytest.raises(NetError) as caught:
        assemble(check_scenario({"garage": str(path), "agvs": 1}, "test", Path()))
    assert str(caught.value).startswith(f"{path}: ")
    assert complaints[0] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_small_net_has_none(tmp_path: Path) -> None:
    assert check_net(read_net(write_net(tmp_path))) == ()


def test_what_only_sumo_knows_is_a_complaint_too(tmp_path: Path) -> None:
    path = write_net(tmp_path, ("net", 'to="c2_0-c3_0" fromLane="0"', 'to="nowhere" fromLane="0"'))
    assert any("SUMO: Error: Unknown to-edge 'nowhere'" in line for line in check_net(read_net(path)))


def test_slots_that_shut_others_in_are_named(tmp_path: Path) -> None:
    complaints = check_net(read_net(write_net(tmp_path, layout=DENSE)), loads=False)
    assert complaints == (
        "no way to c3_1, c4_1, c5_1 and 1 more but through slots:"
        " cars parked in c3_2, c4_2, c5_2 and 1 more would shut them in",
    )


def test_slots_in_the_way_of_nobody_are_no_complaint_but_said() -> None:
    thesis = read_net("map1_thesis")
    assert check_net(thesis, loads=False) == ()
    assert "slots are not driven through in SUMO, which leaves 94 lanes unused" in describe_net(thesis)


# --- room for the scenario's AGV -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size_m", "said"),
    [((5.2, 2.1), r"0\.\d\d m to one at the end of"), ((6.5, 2.4), "an AGV needs 7.75 m to stand on")],
)
def test_an_agv_that_does_not_fit_is_refused(size_m: tuple[float, float], said: str, tmp_path: Path) -> None:
    path = write_net(tmp_path)
    assert any(re.search(said, line) for line in check_net(read_net(path), size_m, loads=False))
    keys = {"garage": str(path), "agvs": 1, "agv": {"length_m": size_m[0], "width_m": size_m[1]}}
    with pytest.raises(NetError, match=said):
        assemble(check_scenario(keys, "test", Path()))


def test_the_command_knows_the_scenarios_agv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    net = write_net(tmp_path)
    scenario = tmp_path / "wide.yaml"
    scenario.write_text(f"garage: {net.name}\nagvs: 1\nagv: {{length_m: 5.2, width_m: 2.1}}\n")
    for words, code in (
        ([str(net)], 0),
        ([str(net), "--length", "5.2", "--width", "2.1"], 1),
        (["--scenario", str(scenario)], 1),
        ([str(net), "--length", "-1"], 2),
        ([str(net), "--width", "nan"], 2),
        ([], 2),
    ):
        with pytest.raises(SystemExit) as left:
            main(["check-net", *words])
        assert left.value.code == code, words
        assert "\n" not in capsys.readouterr().err.rstrip()


# --- what is refused where it is read --------------------------------------------------------------------------------

BAD: dict[str, tuple[list[Change], str]] = {
    "speed 0": ([lane("c3_0-c4_0", 'speed="5.00"', 'speed="0"')], "lane 'c3_0-c4_0_0': speed is '0'; a number above 0"),
    "speed nan": ([lane("c3_0-c4_0", 'speed="5.00"', 'speed="nan"')], "speed is 'nan'"),
    "turn's speed 0": ([("net", 'speed="5.00" length="0.28"', 'speed="0" length="0.28"')], "speed is '0'"),
    "length 0": ([lane("c3_0-c4_0", 'length="6.60"', 'length="0"')], "length is '0'"),
    "length inf": ([lane("c3_0-c4_0", 'length="6.60"', 'length="inf"')], "length is 'inf'"),
    "shape of one point": ([lane("c2_1-c2_0", "14.00,-6.80 14.00,-0.20", "14.00,-6.80")], "two points x,y or more"),
    "shape that stays": ([lane("c2_1-c2_0", "14.00,-0.20", "14.00,-6.80")], "two points x,y or more that differ"),
    "shape of no numbers": ([lane("c2_1-c2_0", "14.00,-0.20", "nan,-0.20")], "shape is '14.00,-6.80 nan,-0.20'"),
    "junction nowhere": ([("net", 'x="14.00" y="-7.00"', 'x="1e300" y="-7.00"')], "junction 'c2_1': x is '1e300'"),
    "edge twice": ([("net", '<edge id="c2_2-c2_1"', '<edge id="c2_1-c2_0"')], "edge 'c2_1-c2_0' is given twice"),
    "junction twice": ([("net", '<junction id="c2_2"', '<junction id="c2_1"')], "junction 'c2_1' is given twice"),
    "lane and lane": ([("net", 'from="c2_2" to="c2_1"', 'from="c2_1" to="c2_0"')], "both lead from 'c2_1' to 'c2_0'"),
    "lane to itself": ([("net", 'from="c2_2" to="c2_1"', 'from="c2_1" to="c2_1"')], "from junction 'c2_1' to itself"),
    "AGVs and cars": ([lane("c2_1-c2_0", 'allow="tram"', "")], "edge 'c2_1-c2_0' allows tram and passenger"),
    "two garages' streets": (
        [("net", '"garage.street" value="front"', '"garage.street" value="queue"')],
        "edges 'street_front' and 'street_queue' both have the parameter garage.street=queue: a net holds one garage",
    ),
    "two garages' homes": (
        [("net", '"garage.home" value="1"', '"garage.home" value="0"')],
        "junctions 'home9_2e1' and 'home9_2e2' are both home number 0: a net holds one garage",
    ),
    "area twice": ([("add", 'value="out"', 'value="in"')], "are both for bay 'bay2_3w', use 'in'"),
    "area for nobody": ([("add", 'roadsideCapacity="1"', 'roadsideCapacity="0"')], "holds no car"),
    "area's capacity": ([("add", 'roadsideCapacity="1"', 'roadsideCapacity="-1"')], "roadsideCapacity is '-1'"),
    "area in the queue": ([("add", "street_front_0", "street_queue_0")], "lies on edge 'street_queue', where cars"),
    "area off its lane": ([("add", 'endPos="20.50"', 'endPos="2050"')], "12.50 to 2050.00 m is not valid"),
    "area's end first": ([("add", 'endPos="20.50"', 'endPos="12.50"')], "12.50 to 12.50 m is not valid"),
    "station off its lane": ([station('endPos="70"')], "0.00 to 70.00 m is not valid"),
    "station of no use": ([("add", 'efficiency="0.95"', 'efficiency="0"')], "efficiency is '0'; a number above 0"),
    "station nowhere": ([("add", CHARGED, "nowhere_0")], "lane 'nowhere_0', which the net doesn't have"),
    "short queue": ([lane("street_queue", 'length="70.00"', 'length="5"')], "'street_queue' is 5.00 m long; 7.5 m or"),
    "entry without queue": ([without_turn("street_entry", "street_queue")], "no connection leads cars from"),
    "street without way": ([without_turn("street_front", "street_exit")], "the street leads nowhere"),
    "two tram lanes": (
        [("net", '<lane id="c2_1-c2_0_0"', '<lane id="c2_1-c2_0_9" index="0" allow="tram" speed="5" length="6.6"'
                                           ' shape="14,-6.8 14,-0.2"/><lane id="c2_1-c2_0_0"')],
        "edge 'c2_1-c2_0': lanes that allow tram: 0, 1; lane 0 alone is valid",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_what_can_not_be_read_is_one_line(kind: str, tmp_path: Path) -> None:
    changes, said = BAD[kind]
    with pytest.raises(NetError) as caught:
        read_net(write_net(tmp_path, *changes))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_space_of_its_own_holds_a_car(tmp_path: Path) -> None:
    space = '<space x="1" y="-20"/>\n'
    change = ("add", 'roadsideCapacity="1">\n', f'roadsideCapacity="0">\n{space}')
    assert read_net(write_net(tmp_path, change)).bay_sites


# --- SUMO's own rules, as SUMO itself says ---------------------------------------------------------------------------

FORMS = (
    "", 'allow="all"', 'allow="tram bus"', 'allow="all bus"', 'allow="lightrail"', 'allow="rail"', 'disallow="all"',
    'disallow="tram"', 'disallow="bus passenger"', 'disallow="rail"', 'allow="bus" disallow="bus"', 'allow="tram_x"',
)  # fmt: skip


def test_permissions_are_those_of_sumo(tmp_path: Path) -> None:
    names = re.findall(r'<lane id="([a-z]\S*)" index="0" allow="tram"', texts()["net"])[: len(FORMS)]
    rows = [f'<lane id="{name}" index="0" ' for name in names]
    changes = [("net", f'{row}allow="tram"', row + form) for row, form in zip(rows, FORMS, strict=True)]
    path = write_net(tmp_path, *changes)
    ours = {lane.name: lane for edge in read_net_file(path).edges.values() for lane in edge.lanes}
    libsumo.start(["sumo", "-n", str(path), "--no-step-log", "--no-warnings"])
    try:
        for name, form in zip(names, FORMS, strict=True):
            allowed, disallowed = libsumo.lane.getAllowed(name), libsumo.lane.getDisallowed(name)
            for kind in ("tram", "passenger", "bus"):
                said = kind in allowed if allowed else kind not in disallowed
                assert ours[name].permits(kind) == said, (form, kind)
    finally:
        libsumo.close()
    assert permits("tram", "", "")


PLACES = (
    "", 'startPos="-3"', 'endPos="-0.05"', 'endPos="-1"', 'startPos="9" friendlyPos="true"',
    'endPos="9" friendlyPos="1"', 'startPos="5" endPos="2" friendlyPos="yes"', 'startPos="-20" friendlyPos="t"',
    'startPos="2" endPos="6.5"', 'startPos="3" endPos="3.1"',
)  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_a_station_is_one_where_sumo_has_it_at_the_lanes_end(place: str, tmp_path: Path) -> None:
    net = read_net(path := write_net(tmp_path, station(place)))
    libsumo.start(["sumo", "-n", str(path), "-a", str(net.additional_file), "--no-step-log", "--no-warnings"])
    try:
        end_m = libsumo.chargingstation.getEndPos("charge_c9_5-charger9_5e")
    finally:
        libsumo.close()
    assert bool(net.charging_station_of_edge) == (end_m >= 6.6 - 0.1)


# --- what is driven as the file says ---------------------------------------------------------------------------------


def test_a_turn_that_the_net_lacks_is_never_planned(tmp_path: Path) -> None:
    """Out of the row, no AGV can turn right any more, nor reverse in the aisle; each car comes home all the same."""
    gone = [("slot4_0n1-c4_0", "c4_0-c3_0"), ("c4_0-c5_0", "c5_0-c4_0"), ("c5_0-c6_0", "c6_0-c5_0")]
    path, cut = write_net(tmp_path), tmp_path / "cut.con.xml"
    rows = "".join(f'<delete from="{came}" to="{onto}"/>' for came, onto in gone)
    cut.write_text(f"<connections>{rows}</connections>")
    subprocess.run([find_netconvert(), "-s", path, "-x", cut, *NETCONVERT_OPTIONS, "-o", path], check=True)
    net = read_net(path)
    assert check_net(net) == ()
    assert "AGVs don't turn from" in describe_net(net)
    graph, edge = net.graph, {name: e for e, name in enumerate(net.graph.edge_names)}
    motion = sumo_motion(graph, AgvType(), 0.5)
    for came, onto in gone:
        assert motion.turn(graph, edge[came], edge[onto], loaded=True) == NEVER
    workload = {"kind": "poisson", "arrivals_per_h": 60, "duration_min": 20, "dwell_median_min": 5}
    keys = {"garage": str(path), "agvs": 2, "workload": {**workload, "initial_occupancy": 0.9}, "duration_s": 1500}
    # SUMO has no route through a turn without a connection, and a run that asks for one fails
    metrics = simulate(check_scenario(keys, "test", Path()), None).metrics
    assert metrics["tasks_done"] >= 8
    assert metrics["footprint_overlaps"] == 0


def test_a_slow_lane_is_planned_as_slow_as_sumo_drives_it(tmp_path: Path) -> None:
    net = read_net(write_net(tmp_path, lane("c9_0-c9_1", 'speed="5.00"', 'speed="0.3"')))
    graph = net.graph
    motion = sumo_motion(graph, AgvType(), 0.5)
    way = [graph.index[name] for name in ("c8_0", "c9_0", "c9_1", "c9_2")]
    slow = graph.edge_index[way[1], way[2]]
    assert motion.edge_steps[:, slow].tolist() == [math.ceil(7.0 / 0.3 / 0.5)] * 2
    plant = SumoPlant(net, (way[0],), AgvType(), seed=1)
    try:
        plant.execute(Advance(0, tuple(way[1:])))
        passed = []
        while not plant.states()[0].standing:
            plant.step()
            passed += [plant.time_s] * (plant.states()[0].reached - len(passed))
    finally:
        plant.close()
    assert passed[1] - passed[0] == pytest.approx(7.0 / 0.3, abs=2.0)


@pytest.mark.parametrize("name", shipped_nets())
def test_shipped_nets_are_faster_than_any_agv(name: str) -> None:
    graph = read_net(name).graph
    free = replace(graph, limit_mps=np.full(len(graph.tail), np.inf))
    kept, limited = (sumo_motion(g, AgvType(), 0.5).edge_steps for g in (free, graph))
    assert (kept == limited).all()
    assert not graph.unconnected


def test_a_garage_that_is_not_well_formed_is_said_once_and_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_net(tmp_path, layout=THROUGH_HOME)
    assert check_net(read_net(path), loads=False) == ()
    scenario = tmp_path / "s.yaml"
    scenario.write_text(f"garage: {path.name}\nagvs: 1\nplant: discrete\nduration_s: 5\n")
    with pytest.raises(SystemExit) as left:
        main(["run", str(scenario), "--out", str(tmp_path / "run"), "--no-report", "--no-replay"])
    assert left.value.code == 0
    assert capsys.readouterr().err.startswith("warning: spoilt is not well-formed: every way from bay2_2w to slot4_2n")


def test_nothing_is_written_of_a_refused_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_net(tmp_path, *COMPLAINTS["no bidi"][0])
    with pytest.raises(SystemExit) as left:
        main(["run", str(path), "--agvs", "1", "--out", str(tmp_path / "run")])
    assert left.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "run").exists()


# --- mutants ---------------------------------------------------------------------------------------------------------

ODD = ("", "0", "-1", "nan", "inf", "1e300", "x", "0.3")


def mutant(rng: random.Random) -> Change:
    """A change of one attribute somewhere: gone, odd, or that of another element."""
    which = rng.choice(("net", "net", "add"))
    rows = [
        row for row in re.findall(r"<[a-zA-Z]+ [^>]*>", texts()[which]) if 'id=":' not in row and '"1.0"' not in row
    ]
    row = rng.choice(rows)
    name, value = rng.choice(re.findall(r'([\w.]+)="([^"]*)"', row))
    others = [other for r in rows for other in re.findall(rf'\b{name}="([^"]*)"', r)]
    spoilt = rng.choice(("", *(f'{name}="{odd}"' for odd in (*ODD, rng.choice(others)))))
    return (which, row, row.replace(f'{name}="{value}"', spoilt))


def test_a_mutant_is_refused_in_one_line_or_runs(tmp_path: Path) -> None:
    rng = random.Random(7)
    ran = 0
    for _ in range(MUTANTS):
        change = mutant(rng)
        path = write_net(tmp_path, change)
        try:
            complaints = check_net(read_net(path), AGV_SIZE_M, loads=False)
        except NetError as error:
            complaints = (str(error),)
        assert not any("\n" in line for line in complaints), change
        if complaints or ran >= RUNS or change[1] == change[2]:
            continue
        ran += 1
        workload = {"kind": "poisson", "arrivals_per_h": 60, "duration_min": 10, "initial_occupancy": 0.5}
        scenario = load_scenario(path, {"agvs": 2, "workload": workload, "duration_s": 900.0})
        with suppress(NetError):  # SUMO does not load it
            metrics = simulate(scenario, None).metrics
            assert metrics["tasks_done"] >= 3, change
            assert metrics["footprint_overlaps"] == 0, change
    assert ran == RUNS


WRITERS = (
    'edgeData id="d" file',
    "include href",
    'timedEvent type="SaveTLSStates" dest',
    'e1Detector id="e" lane="c2_0-c3_0_0" pos="1" file',
    'calibrator id="c" output',
)


@pytest.mark.parametrize("element", WRITERS)
@pytest.mark.parametrize(("which", "end"), [("net", "</net>"), ("add", "</additional>")])
def test_a_net_that_has_sumo_write_a_file_is_refused(tmp_path, which, end, element):
    """SUMO takes such elements from either file, and would write over whatever is named."""
    told = tmp_path / "told.xml"
    path = write_net(tmp_path, (which, end, f'<{element}="{told}"/>{end}'))
    with pytest.raises(NetError, match=r"names a file for SUMO to read or write"):
        check_net(read_net(path))
    assert not told.exists()
