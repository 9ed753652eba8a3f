"""The papers' tables beside ours: one command and one module a paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from parking_sim.command_groups import Papers

app = typer.Typer(
    help="Print a paper's figures beside ours, and whether its claims hold.", rich_markup_mode=None, cls=Papers
)

Full = Annotated[bool, typer.Option("--full", help="As many runs as the paper; else a quick form.")]
Out = Annotated[Path | None, typer.Option(help="Folder for tables and figures; default: one in runs/reproduce.")]


@app.callback()
def _reproduce() -> None:
    """Print a paper's figures beside ours, and whether its claims hold."""


@app.command("thesis")
def _thesis(full: Full = False, out: Out = None) -> None:
    """A*, D* Lite, the pipeline and our planners on three maps, under three sets of rules (paper 002)."""
    from parking_sim.reproduce.thesis import reproduce

    reproduce(out or Path("runs/reproduce/thesis"), full)


@app.command("rrt-grid")
def _rrt_grid(full: Full = False, out: Out = None) -> None:
    """RRT-GRID against RRT and RRT* on thirty layouts in five categories (paper 001)."""
    from parking_sim.reproduce.rrt_grid import reproduce

    reproduce(out or Path("runs/reproduce/rrt-grid"), full)


@app.command("binary-tree")
def _binary_tree(full: Full = False, out: Out = None) -> None:
    """Binary-tree routing against exact shortest routes on five floors (paper 003)."""
    from parking_sim.reproduce.binary_tree import reproduce

    reproduce(out or Path("runs/reproduce/binary-tree"), full)


@app.command("two-stage-ga")
def _two_stage_ga(
    full: Full = False,
    instances: Annotated[int | None, typer.Option(help="Only the first so many instances of each kind.", min=2)] = None,
    out: Out = None,
) -> None:
    """One-stage and two-stage genetic algorithms and CBS on a lattice of 5 x 8 intersections (paper 004)."""
    from parking_sim.reproduce.two_stage_ga import reproduce

    reproduce(out or Path("runs/reproduce/two-stage-ga"), full, instances)


@app.command("lg")
def _lg(full: Full = False, out: Out = None) -> None:
    """Online MAPF with and without replanning: ten robots on a one-line grid (paper 000)."""
    from parking_sim.reproduce.lg import reproduce

    reproduce(out or Path("runs/reproduce/lg"), full)
