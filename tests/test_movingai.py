"""Maps and scenarios of MovingAI: read, refused in a line, and solved."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from sumo_nets.movingai import MovingAiError, read_map, read_scenario


def test_a_map_of_movingai_is_read_and_anything_else_refused_in_a_line(tmp_path):
    path = tmp_path / "little.map"
    path.write_text("type octile\nheight 2\nwidth 3\nmap\ne.@\n@.r\n", encoding="utf-8")
    graph = read_map(path)
    assert set(graph.names) == {"0,0", "1,0", "1,1", "2,1"}
    assert len(graph.head) == 6
    assert [graph.names[v] for v in (*graph.slots, *graph.homes)] == ["0,0", "2,1"]
    path.write_text("type octile\nheight 3\nwidth 3\nmap\ne.@\n", encoding="utf-8")
    with pytest.raises(MovingAiError, match="not 3 rows of 3 cells"):
        read_map(path)


SCENARIO = "version 1\n0\tlittle.map\t4\t3\t0\t0\t3\t0\t3\n0\tlittle.map\t4\t3\t3\t0\t0\t0\t3\n"
MAP = "type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n"


@pytest.fixture
def little(tmp_path):
    (tmp_path / "little.map").write_text(MAP, encoding="utf-8")
    (tmp_path / "little.scen").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


def test_a_scenario_of_movingai_is_read_and_anything_else_refused_in_a_line(little):
    graph, path = read_map(little / "little.map"), little / "little.scen"
    names = [(graph.names[start], graph.names[goal]) for start, goal in read_scenario(path, graph)]
    assert names == [("0,0", "3,0"), ("3,0", "0,0")]
    for wrong, words in (
        (MAP, "does not give a version"),
        ("version 1\n0 little.map 4 3 0 x 3 0 3\n", "line 2: not bucket"),
        ("version 1\n0 little.map 4 3 0 0 1 1 3\n", "line 2: 1,1 is no free cell of little"),
    ):
        path.write_text(wrong, encoding="utf-8")
        with pytest.raises(MovingAiError, match=words):
            read_scenario(path, graph)


def test_a_scenario_of_movingai_is_solved_by_the_benchmark(little):
    program = Path(__file__).parents[1] / "benchmarks" / "movingai.py"
    given = [str(little / "little.map"), str(little / "little.scen"), "--agents", "2", "--planner", "lacam,cbs"]
    table = little / "table.csv"
    subprocess.run([sys.executable, str(program), *given, "--csv", str(table)], check=True)
    rows = pd.read_csv(table)
    # two that swap ends of a ring of ten cells: one of them takes the long way, 7 instead of 3
    assert rows["solved"].all()
    assert rows["conflicts"].tolist() == [0, 0]
    assert rows["sum_of_costs"].min() == 10
    assert rows.set_index("planner")["sum_of_costs"]["cbs"] == 10
