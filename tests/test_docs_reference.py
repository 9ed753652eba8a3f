"""The generated pages of the docs site name every key, column, command and public name."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import typer

import parking_sim
from parking_sim.cli import app
from parking_sim.columns import run_columns
from parking_sim.config import Scenario
from sumo_nets.layout import Layout


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    spec = importlib.util.spec_from_file_location("reference", Path(__file__).parent.parent / "docs" / "reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: dict[str, str] = module.pages()
    return found


def test_every_key_of_a_scenario_and_of_a_layout(pages: dict[str, str]) -> None:
    keys = [column for column in run_columns() if column.split(".")[0] in Scenario.model_fields]
    assert len(keys) > 100
    for key in keys:
        assert f"| `{key.split('.')[-1]}` |" in pages["scenario"], key
    for name, field in Layout.model_fields.items():
        assert f"| `{field.alias or name}` |" in pages["layout"]


def test_every_column_command_and_public_name(pages: dict[str, str]) -> None:
    assert all(f"| `{column}` |" in pages["columns"] for column in run_columns())
    assert all(f"## parking-sim {command}\n" in pages["commands"] for command in typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    assert "## parking-sim reproduce thesis\n" in pages["commands"]
    assert pages["library"].count(":::") == len(parking_sim.__all__) - 1  # the version has no page


@pytest.mark.parametrize("page", ["scenario", "layout", "floorplan", "sweep"])
def test_every_key_has_a_meaning(pages: dict[str, str], page: str) -> None:
    rows = [line for line in pages[page].splitlines() if line.startswith("| `")]
    assert len(rows) >= 4
    assert [line for line in rows if line.endswith("|  |")] == []
