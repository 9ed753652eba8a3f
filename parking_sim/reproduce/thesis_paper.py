"""What the thesis prints, where that contradicts itself, and what its authors' program does when it is run again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

#: Tasks of each row: MAP1 parks 61 cars and fetches them, MAP2 and MAP3 park 390 and 900.
_TASKS = {"map1": 122, "map2": 390, "map3": 900}
#: Names of ``rerun`` in the file for metrics of ours.
_RERUN = {"steps": "steps", "movement_cost": "moves"}


@cache
def published() -> Any:
    """The thesis's printed figures and those of its program run again, see ``thesis.yaml``."""
    return yaml.safe_load(files("parking_sim.reproduce").joinpath("thesis.yaml").read_text(encoding="utf-8"))


def printed(metric: str, planner: str, garage: str, agvs: int) -> float | None:
    """The figure of a cell as it is printed; None where the thesis has none."""
    return _cell(published()["printed"].get(planner, {}).get(metric), garage, agvs)


def rerun(metric: str, planner: str, garage: str, agvs: int) -> float | None:
    """The figure of the authors' program run again; None where there is none."""
    return _cell(published()["rerun"].get(planner, {}).get(_RERUN.get(metric)), garage, agvs)


def program(metric: str, planner: str, garage: str, agvs: int) -> float | None:
    """Steps or moves of the authors' program: run again, or else as they follow from the print."""
    again = rerun(metric, planner, garage, agvs)
    if again is not None or metric != "steps":
        return again or printed(metric, planner, garage, agvs)
    throughput = printed("throughput", planner, garage, agvs)
    return None if throughput is None else round(_TASKS[garage] / throughput)


def cause(planner: str, garage: str, agvs: int) -> str:
    """Why a row's steps or moves are far from the program's; empty where nothing has been shown."""
    return str(published()["causes"].get(planner, {}).get(f"{garage} x {agvs}", ""))


def _cell(values: list[float | None] | None, garage: str, agvs: int) -> float | None:
    row = [garage, agvs]
    rows = published()["rows"]
    value = values[rows.index(row)] if values and row in rows else None
    return None if value is None else float(value)


@dataclass(frozen=True, slots=True)
class Slip:
    """A printed figure that looks like a slip.

    Attributes:
        planner, metric, garage, agvs: the cell.
        printed, likely: the figure, and what was likely meant.
        evidence: what the thesis's ratio of valid to generated nodes, or the program run again, says.
    """

    planner: str
    metric: str
    garage: str
    agvs: int
    printed: int
    likely: int
    evidence: str


def slips() -> Iterator[Slip]:
    """The printed figures that look like slips, with what speaks for that or against it."""
    paper = published()
    for planner, metric, place, likely in paper["slips"]:
        garage, agvs = paper["rows"][place]
        figure = paper["printed"][planner][metric][place]
        yield Slip(planner, metric, garage, agvs, figure, likely, _evidence(planner, metric, place, likely))


def _evidence(planner: str, metric: str, place: int, likely: int) -> str:
    paper = published()
    table = paper["printed"][planner]
    if metric == "nodes_generated":
        valid, ratio = table["valid_expansions"][place], table["valid_ratio"][place]
        as_printed, as_likely = (fits(valid, n, ratio) for n in (table[metric][place], likely))
        if as_printed:
            return f"none: the printed ratio {ratio:.4f} fits {'both' if as_likely else 'the printed figure'}"
        said = f"the printed ratio {ratio:.4f} contradicts the printed figure ({valid / table[metric][place]:.4f})"
        return f"{said} and fits the likely one" if as_likely else said
    again = _RERUN.get(metric)
    if again and paper["rerun"][planner][again][place] == likely:
        return "the program run again does the likely one"
    return "none in the tables"


def fits(valid: int, generated: int, ratio: float) -> bool:
    """Whether a ratio printed with four digits is that of valid expansions to generated nodes."""
    return abs(valid / generated - ratio) <= 0.5e-4


def contradictions() -> set[tuple[str, str, int]]:
    """Planner, garage and AGVs of the cells where generated and valid nodes contradict the printed ratio."""
    paper = published()
    return {
        (planner, garage, agvs)
        for planner, table in paper["printed"].items()
        for place, (garage, agvs) in enumerate(paper["rows"])
        if not fits(
            table["valid_expansions"][place], table["nodes_generated"][place], table["valid_ratio"][place]
        )
    }  # fmt: skip
