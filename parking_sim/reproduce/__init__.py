"""The papers' tables beside ours: one command and one module a paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="Print a paper's figures beside ours, and whether its claims hold.", rich_markup_mode=None)

Full = Annotated[bool, typer.Option("--full", help="As many runs as the paper; else a quick form.")]
Out = Annotated[Path | None, typer.Option(help="Folder for tables and figures; default: one in runs/reproduce.")]


@app.callback()
def _reproduce() -> None:
    """Print a paper's figures beside ours, and whether its claims hold."""


@app.command("rrt-grid")
def rrt_grid(full: Full = False, out: Out = None) -> None:
    """RRT-GRID against RRT and RRT* on thirty layouts in five categories (paper 001)."""
    from parking_sim.reproduce.rrt_grid import reproduce

    reproduce(out or Path("runs/reproduce/rrt-grid"), full)
