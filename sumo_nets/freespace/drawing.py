"""What tracing found: in words, as the layout's file, and as a picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sumo_nets.freespace.floor import Floor, Point, rectangle
from sumo_nets.freespace.floorplan import FloorPlan, boxes_of
from sumo_nets.freespace.trace import Tracing
from sumo_nets.generate import layout_yaml
from sumo_nets.graph import FloatArray, Role
from sumo_nets.plan import GaragePlan, plan_garage
from sumo_nets.whole_file import whole_file

_WALL, _BOX, _LANE, _PATH = "#3b4252", "#e8ebf1", "#2f4b7c", "#d1495b"
_COLOURS: dict[Role, str] = {"slot": "#c9d3e3", "bay": "#f2a541", "home": "#66a182", "charger": "#f7e05e"}


def describe(tracing: Tracing) -> str:
    """The guide paths as a table, and what the layout holds."""
    rows = [("guide path", "traced m", "shortest m", "along lanes m")]
    rows += [
        (f"{path.start} to {path.to}", f"{path.length_m:.1f}", f"{path.shortest_m:.1f}", f"{path.lanes_m:.1f}")
        for path in tracing.guide_paths
    ]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]
    lines += [f"given up: {number} places of {label}, too near to walls" for label, number in tracing.dropped.items()]
    places = ", ".join(f"{number} {role}s" for role, number in tracing.places.items())
    room = f"least room to walls and pillars {tracing.least_room_m:.2f} m"
    return "\n".join([*lines, f"{tracing.layout.name}: {places}; {room}"])


def tracing_yaml(tracing: Tracing, source: str) -> str:
    """The layout as YAML, with where its cells lie in the plan.

    Args:
        tracing: what was traced.
        source: the plan's file name.
    """
    x, y = tracing.origin
    return (
        f"# Traced from {source}: the middle of cell [0, 0] is at {x:.2f}, {y:.2f} m of the plan.\n"
        f"{layout_yaml(tracing.layout)}"
    )


def draw_tracing(tracing: Tracing, plan: FloorPlan, walls: Floor, path: Path) -> None:
    """Draw the plan, the traced paths, and the lanes.

    Args:
        tracing: what was traced.
        plan, walls: the plan as read.
        path: the picture, .svg or .png.

    Raises:
        OSError: it can't be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure

    garage = plan_garage(tracing.layout)
    figure = Figure(figsize=(9.0, max(3.0, 9.0 * walls.height / walls.width)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal")
    axes.set(xlim=(-12, walls.width + 3), ylim=(walls.height + 3, -3), xlabel="m", title=tracing.layout.name)
    axes.add_collection(PolyCollection([rectangle(*box.box) for _, _, box in boxes_of(plan)], facecolors=_BOX))
    axes.add_collection(PolyCollection(list(walls.obstacles), facecolors=_WALL))
    if walls.outline is not None:
        axes.add_collection(PolyCollection([walls.outline], facecolors="none", edgecolors=_WALL, linewidths=2))
    axes.add_collection(LineCollection(list(_lanes(garage, tracing.origin)), colors=_LANE, linewidths=1.2))
    for role, colour in _COLOURS.items():
        spots = np.array([_in_plan(garage.vertices[name], tracing.origin) for name in garage.roles[role]])
        if len(spots):
            axes.plot(*spots.T, "s", color=colour, markeredgecolor="#555b66", markersize=6, zorder=3, label=role)
    for k, guide in enumerate(tracing.guide_paths):
        axes.plot(*guide.points.T, color=_PATH, linewidth=2, zorder=2.5, label=None if k else "guide path")
    axes.legend(ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.06), frameon=False)
    with whole_file(path) as part:
        figure.savefig(part, metadata={"Date": None} if path.suffix == ".svg" else None)


def _lanes(garage: GaragePlan, origin: Point) -> Iterator[FloatArray]:
    for lane in garage.lanes.values():
        yield np.array([_in_plan(point, origin) for point in lane.shape])


def _in_plan(point: Point, origin: Point) -> Point:
    """A point of the net, whose y points up, in the plan's metres."""
    return origin[0] + point[0], origin[1] - point[1]
