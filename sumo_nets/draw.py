"""Draw a net as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sumo_nets.bodies import AGV_LENGTH_M, AGV_WIDTH_M, standing_bodies
from sumo_nets.graph import FloatArray, Role
from sumo_nets.numbering import Vertex, numbered
from sumo_nets.read import GarageNet
from sumo_nets.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FLOOR, _TWO_WAY, _ONE_WAY, _SPUR, _STREET = "#f4f1ea", "#2f4b7c", "#d1495b", "#b8bcc4", "#6c6f75"
_COLOURS: dict[Role, str] = {
    "slot": "#c9d3e3",
    "bay": "#f2a541",
    "home": "#66a182",
    "charger": "#f7e05e",
    "refuge": "#b48ead",
}
#: Roles are drawn in this order, so that a charger or home shows on top of a slot, and a home on top of its bay.
_DRAWN: tuple[Role, ...] = ("slot", "refuge", "charger", "bay", "home")
_LANE_M = 1.0
_METRES_PER_INCH = 14.0
_WIDEST_DOTS = 2400.0


def draw_net(garage: GarageNet, path: str | Path) -> None:
    """Draw aisles, slots, bays, homes, chargers, refuges and the street to scale.

    Two-way lanes are broad and blue, one-way lanes are thin and red with arrows.

    Args:
        garage: the net as read.
        path: the picture; its suffix chooses the format, ``.svg`` or ``.png``.

    Raises:
        ValueError: another suffix.
        OSError: the picture can't be written.
    """
    target = Path(path)
    if target.suffix not in (".svg", ".png"):
        raise ValueError(f"{target}: the suffix {target.suffix!r} is not valid: .svg or .png")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    streets = list(garage.street_shapes.values())
    low, high = _bounds(garage, streets)
    size = (high - low) / _METRES_PER_INCH
    figure = Figure(
        figsize=(float(max(size[0], 6.0)), float(size[1]) + 0.9 * max(1.0, float(size[0]) / 14.0)), layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", facecolor=_FLOOR)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
    text = 10.0 * max(1.0, figure.get_figwidth() / 14.0)
    axes.set_title(_title(garage), fontsize=text, loc="left")
    for spine in axes.spines.values():
        spine.set_visible(False)
    _draw_street(axes, streets)
    _draw_lanes(axes, garage)
    _draw_places(axes, garage)
    axes.legend(
        handles=_legend(garage), loc="upper left", bbox_to_anchor=(0, 0), ncols=9, fontsize=0.8 * text, frameon=False
    )
    dots = min(110.0, _WIDEST_DOTS / figure.get_figwidth())
    # a fixed salt and no date: the same net gives the same bytes
    with rc_context({"svg.hashsalt": garage.name, "svg.fonttype": "none"}):
        metadata = {"Date": None} if target.suffix == ".svg" else {"Software": None}
        with whole_file(target) as part:
            figure.savefig(part, dpi=dots, metadata=metadata)


def _bounds(garage: GarageNet, streets: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners of what is shown: the garage, and the street only as far as it runs alongside."""
    points = garage.graph.xy
    low, high = points.min(axis=0) - 6.0, points.max(axis=0) + 6.0
    beside = [p for shape in streets for p in shape if ((p > low - 40.0) & (p < high + 40.0)).all()]
    if beside:
        low, high = np.minimum(low, np.min(beside, axis=0) - 4.0), np.maximum(high, np.max(beside, axis=0) + 4.0)
    return low, high


def _title(garage: GarageNet) -> str:
    roles = garage.graph.roles
    counts = ", ".join(f"{len(roles[role])} {role}s" for role in _COLOURS if roles[role])
    return f"{garage.name}: {counts}"


def _draw_street(axes: Axes, streets: list[FloatArray]) -> None:
    for shape in streets:
        axes.plot(*shape.T, color=_STREET, linewidth=_points(3.2), solid_capstyle="butt", zorder=1)
        axes.plot(*shape.T, color="white", linewidth=1.0, linestyle=(0, (6, 6)), zorder=1.1)
        if np.hypot(*(shape[-1] - shape[0])) > 20.0:
            _arrow(axes, shape, 0.5, "white", 1.2)


def _draw_lanes(axes: Axes, garage: GarageNet) -> None:
    from matplotlib.collections import LineCollection

    graph = garage.graph
    ends = [graph.xy[[u, v]] for u, v in zip(graph.tail, graph.head, strict=True)]
    spurs = np.array(sorted(_spur_ends(garage)), dtype=np.int32)
    spur = np.isin(graph.tail, spurs) | np.isin(graph.head, spurs)
    two_way = graph.reverse >= 0
    lines: tuple[tuple[Any, str, float, float], ...] = (
        (spur & two_way, _SPUR, 0.25, 2.0),
        (~spur & two_way, _TWO_WAY, _LANE_M, 3.0),
        (~two_way, _ONE_WAY, 0.45, 3.1),
    )
    for chosen, colour, width, order in lines:
        paths = [garage.shapes[e] if spur[e] else ends[e] for e in graph.edges if chosen[e]]
        axes.add_collection(
            LineCollection(paths, colors=colour, linewidths=_points(width), capstyle="round", zorder=order)
        )
    for e in np.flatnonzero(~two_way).tolist():
        _arrow(axes, ends[e], 0.62, _ONE_WAY, 0.9)


def _spur_ends(garage: GarageNet) -> set[Vertex]:
    """Ends of spurs: one lane in, one out, the same neighbour. An open floor, where slots are aisle too, has none."""
    graph = garage.graph
    entries = np.bincount(graph.head, minlength=len(graph.names))
    ends = {
        v
        for v, out in numbered(graph.successors)
        if len(out) == 1 and entries[v] == 1 and v in graph.successors[out[0]]
    }
    return ends if ends.issuperset(graph.slots) else set()


def _draw_places(axes: Axes, garage: GarageNet) -> None:
    from matplotlib.collections import PolyCollection

    graph = garage.graph
    spurs = _spur_ends(garage)
    for k, role in enumerate(_DRAWN):
        boxes = []
        for v in graph.roles[role]:
            if v in spurs:
                boxes.append(_box(standing_bodies([garage.shapes[graph.in_edges(v)[0]]])[0]))
            else:
                # where any aisle may lead through, the place is the cell; smaller for a role drawn on top
                boxes.append(_square(graph.xy[v], 2.5 - 0.6 * (role == "home")))
        axes.add_collection(
            PolyCollection(boxes, facecolors=_COLOURS[role], edgecolors="#555b66", linewidths=0.4, zorder=4 + 0.1 * k)
        )


def _box(body: FloatArray) -> FloatArray:
    along, across = body[2:] * AGV_LENGTH_M / 2, np.array([-body[3], body[2]]) * AGV_WIDTH_M / 2
    corners: FloatArray = body[:2] + np.array([along + across, along - across, -along - across, -along + across])
    return corners


def _square(centre: FloatArray, half: float) -> FloatArray:
    return centre + half * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


def _arrow(axes: Axes, line: FloatArray, at: float, colour: str, size_m: float) -> None:
    step = line[-1] - line[0]
    unit = step / np.hypot(*step)
    tip = line[0] + step * at + unit * size_m
    across = np.array([-unit[1], unit[0]]) * size_m * 0.8
    corners = np.array([tip, tip - unit * 2 * size_m + across, tip - unit * 2 * size_m - across])
    axes.fill(*corners.T, color=colour, zorder=3.5, linewidth=0)


def _points(metres: float) -> float:
    """Line width, in points, of a line that is ``metres`` wide at the picture's scale."""
    return metres / _METRES_PER_INCH * 72.0


def _legend(garage: GarageNet) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    graph = garage.graph
    handles: list[Any] = [Line2D([], [], color=_TWO_WAY, linewidth=5, label="two-way")]
    if (graph.reverse < 0).any():
        handles.append(Line2D([], [], color=_ONE_WAY, linewidth=2, marker=">", markersize=6, label="one-way"))
    for role, colour in _COLOURS.items():
        if graph.roles[role]:
            handles.append(Patch(facecolor=colour, edgecolor="#555b66", linewidth=0.4, label=role))
    if garage.street:
        handles.append(Line2D([], [], color=_STREET, linewidth=5, label="street"))
    return handles
