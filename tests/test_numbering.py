"""mypy refuses a number of one numbering in the place of another, and nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent

#: mypy has to find an error in each line that ends with ``# refused``, and in no other one.
PLANTED = """
from controller.garage import Garage
from controller.types import AgvNumber, AgvState, CallForward, Path, RequestNumber
from sumo_nets.graph import Graph
from sumo_nets.numbering import EdgeIndex, Numbered, Vertex, numbered
from sumo_nets.read import GarageNet

vertex, agv, request, edge = Vertex(7), AgvNumber(1), RequestNumber(3), EdgeIndex(12)


def bay_sites(net: GarageNet) -> None:
    net.bay_sites[vertex]
    net.bay_sites[agv]  # refused
    net.bay_sites[edge]  # refused
    for bay in net.graph.bays:
        net.bay_sites[bay]
    for place, bay in enumerate(net.graph.bays):
        net.bay_sites[place]  # refused
    net.graph.bays[vertex]  # refused
    net.graph.slots[0]  # refused


def graph(graph: Graph) -> None:
    graph.names[vertex]
    graph.names[agv]  # refused
    graph.names[edge]  # refused
    graph.edge_names[edge]
    graph.edge_names[vertex]  # refused
    graph.edge_index[vertex, vertex]
    graph.edge_index[vertex, agv]  # refused
    graph.successors[graph.ends[edge][1]]
    graph.successors[edge]  # refused


def books(garage: Garage) -> None:
    garage.bays[vertex]
    garage.bays[agv]  # refused
    garage.tasks[request]
    garage.tasks[agv]  # refused
    garage.car_left(request, vertex, 0.0)
    garage.car_left(vertex, request, 0.0)  # refused


def fleet(states: Numbered[AgvNumber, AgvState], homes: Numbered[AgvNumber, Vertex], graph: Graph) -> None:
    states[agv]
    states[vertex]  # refused
    graph.names[homes[agv]]
    for n, home in numbered(homes):
        Path(n, (home,), (0,), ())
        Path(home, (n,), (0,), ())  # refused
    CallForward(request, vertex)
    CallForward(request, agv)  # refused
    CallForward(agv, vertex)  # refused
"""


def test_mypy_refuses_numbers_of_other_numberings(tmp_path: Path) -> None:
    planted = tmp_path / "planted.py"
    planted.write_text(PLANTED, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "--no-error-summary", str(planted)]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert said.returncode == 1, said.stdout + said.stderr
    found = {int(line) for line in re.findall(r"planted\.py:(\d+): error:", said.stdout)}
    refused = {n for n, line in enumerate(PLANTED.split("\n"), start=1) if line.endswith("# refused")}
    assert found == refused, said.stdout
