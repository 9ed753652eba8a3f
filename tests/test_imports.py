"""Everything flows down: which package imports which, and no module that imports itself by a detour."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import networkx as nx
import pytest

ROOT = Path(__file__).parent.parent

#: Package -> the packages from which it may import.
BELOW = {
    "sumo_nets": set(),
    "controller": {"sumo_nets"},
    "demand": {"controller", "sumo_nets"},
    "analysis": {"demand", "controller", "sumo_nets"},
    "parking_sim": {"analysis", "demand", "controller", "sumo_nets"},
}
#: All that ``demand`` takes from ``controller``: the words of both.
WORDS = {"controller.types"}
#: Modules of the controller that read files (machine code of kernels, planners of users), or that stop after some
#: seconds, as the paper's conflict-based search and planners of users do.
EXEMPT = {
    "controller.kernel",
    "controller.planners.table",
    "controller.planners.guest",
    "controller.genetic.lattice_cbs",
}


def imports() -> Iterator[tuple[str, str]]:
    """Each module with each name that it imports, in functions and for types as well."""
    for package in BELOW:
        for file in sorted((ROOT / package).rglob("*.py")):
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    inner = {f"{node.module}.{alias.name}" for alias in node.names}
                    files = {name for name in inner if (ROOT / name.replace(".", "/")).with_suffix(".py").is_file()}
                    yield from ((module, name) for name in sorted(files) or [node.module])
                elif isinstance(node, ast.Import):
                    yield from ((module, alias.name) for alias in node.names)


def package_of(module: str) -> str:
    return module.split(".")[0]


@pytest.mark.parametrize("package", BELOW)
def test_no_arrow_leads_up(package: str) -> None:
    wanted = {b for a, b in imports() if package_of(a) == package and package_of(b) in BELOW}
    assert {package_of(b) for b in wanted} - {package} <= BELOW[package]
    if package == "demand":
        assert {b for b in wanted if package_of(b) == "controller"} <= WORDS


def test_no_module_imports_itself_by_a_detour() -> None:
    graph = nx.DiGraph((a, b) for a, b in imports() if a != b and package_of(b) in BELOW)
    assert len(graph) > 150
    assert [ring for ring in nx.strongly_connected_components(graph) if len(ring) > 1] == []


def test_the_controller_knows_neither_sumo_nor_files_nor_the_clock() -> None:
    outer = {"libsumo", "traci", "sumolib", "time", "datetime", "os", "pathlib"}
    found = {a for a, b in imports() if package_of(a) == "controller" and package_of(b) in outer}
    assert found == EXEMPT
