"""Figures of a run, one style for all: Okabe and Ito's colours, which colour-blind readers can tell apart.

Each ``draw_*`` function takes a run and returns a matplotlib figure, or None when the run has nothing to show; call it
within ``style()``.
``figures`` gives them all as SVG to be put inline: text stays text, the background is clear and black becomes
``currentColor``, so that a page may be light or dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.clock import Clock
from analysis.deadlocks import deadlocks
from analysis.metrics import SERVICE_LEVELS_S, waits
from analysis.record import ACTIVITIES
from analysis.tables import Run
from analysis.words import words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, SKY, PINK, YELLOW = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#F0E442",
)  # fmt: skip
GREY, INK = "#8a8f98", "#010203"  # INK is an unused near-black that becomes currentColor
ACTIVITY_COLORS = dict(zip(ACTIVITIES, (SKY, BLUE, PINK, GREEN, YELLOW, RED, ORANGE, "#c4c8ce"), strict=True))
WIDTH_IN = 7.4
_MAX_POINTS = 400
#: Vertices up to which two floor plans side by side can be read.
_MAX_SIDE_BY_SIDE = 300
_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "svg.fonttype": "none",
    "text.parse_math": False,
    "svg.hashsalt": "parking-sim",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "grid.color": GREY,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}


@dataclass(frozen=True)
class Drawing:
    """A figure ready for a page.

    Attributes:
        key: short name.
        title: what it shows.
        caption: how to read it.
        svg: the ``<svg>`` element.
    """

    key: str
    title: str
    caption: str
    svg: str


def style() -> AbstractContextManager[None]:
    """Matplotlib's settings for these figures, as a context; afterwards they are as before."""
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def draw_waits(run: Run) -> Figure | None:
    """Distribution functions of the customers' waits, with the service levels marked."""
    shown = [
        ("retrieval_wait", "retrieval: request to car at the bay", BLUE, "-"),
        ("park_queue", "parking: arrival to bay", ORANGE, "--"),
        ("park_wait", "parking: bay to car on the AGV", GREEN, "-."),
    ]
    values = waits(run.tasks, float(run.meta.get("simulated_s") or 0.0))
    if not any(len(values[name]) for name, *_ in shown):
        return None
    figure, (axes,) = new_figure(2.9)
    for name, label, color, dash in shown:
        x = np.sort(values[name]) / 60.0
        if len(x):
            y = np.arange(1, len(x) + 1) / len(x)
            keep = np.unique(np.linspace(0, len(x) - 1, _MAX_POINTS).astype(int))
            axes.step(np.append(0.0, x[keep]), np.append(0.0, y[keep]), dash, where="post", color=color, label=label)
    for level in SERVICE_LEVELS_S:
        axes.axvline(level / 60.0, color=INK, linewidth=0.8, linestyle=":")
        if axes.get_xlim()[1] < 15.0:
            at = (level / 60.0, 0.0)
            axes.annotate(f"{level} s", at, (3, 3), textcoords="offset points", fontsize=8, color=INK)
    axes.set(xlabel="minutes", ylabel="share of customers", ylim=(0, 1.02))
    axes.set_xlim(left=0)
    axes.yaxis.set_major_formatter("{x:.0%}")
    figure.legend(loc="outside upper center", ncols=len(shown), columnspacing=1.5)
    return figure


def draw_waits_over_time(run: Run) -> Figure | None:
    """Each retrieval's wait over the time of its request."""
    tasks = run.tasks
    asked = tasks[(tasks["kind"] == "retrieve") & (tasks["state"] != "void")]
    delivered = asked[asked["delivered_s"].notna()]
    waiting = asked[asked["delivered_s"].isna()]
    if asked.empty:
        return None
    figure, (axes,) = new_figure(2.5)
    big = len(asked) > 3000
    end = float(run.meta.get("simulated_s") or asked["requested_s"].max())
    axes.plot(
        delivered["requested_s"],
        (delivered["delivered_s"] - delivered["requested_s"]) / 60.0,
        "o", color=BLUE, markersize=3, alpha=0.85, markeredgewidth=0, rasterized=big, label="delivered",
    )  # fmt: skip
    if len(waiting):
        axes.plot(
            waiting["requested_s"], (end - waiting["requested_s"]) / 60.0, "x", color=RED, markersize=4,
            rasterized=big, label="still waiting at the end",
        )  # fmt: skip
        axes.legend(loc="upper right")
    for level in SERVICE_LEVELS_S:
        axes.axhline(level / 60.0, color=INK, linewidth=0.8, linestyle=":")
    axes.set(xlabel="time of the request (h:mm)", ylabel="wait (minutes)", xlim=(0.0, max(end, 1.0)))
    axes.set_ylim(bottom=0)
    _show_clock(axes, Clock.of(run.meta))
    return figure


def draw_queue(run: Run) -> Figure | None:
    """Cars and requests that wait, and cars in slots, over time."""
    line = run.timeline
    if line.empty:
        return None
    from matplotlib.ticker import MaxNLocator

    figure, (top, bottom) = new_figure(3.8, rows=2)
    binned = _binned(line, ["queue", "spilled", "waiting_requests", "parked"])
    for name, label, color, dash in (
        ("queue", "cars waiting for a bay", BLUE, "-"),
        ("waiting_requests", "requests without an AGV", ORANGE, "--"),
    ):
        top.plot(binned["time_s"], binned[name], dash, color=color, label=label)
    top.fill_between(
        binned["time_s"], binned["spilled"], color=RED, alpha=0.45, linewidth=0, label="of them on the street"
    )
    top.set_ylabel("waiting")
    top.yaxis.set_major_locator(MaxNLocator(integer=True))
    top.legend(loc="upper right", ncols=3)
    top.set_ylim(0, max(1.0, top.get_ylim()[1] * 1.15))
    bottom.plot(binned["time_s"], binned["parked"], color=GREEN)
    bottom.set(ylabel="cars in slots", xlabel=f"{Clock.of(run.meta).name} (h:mm)")
    bottom.set_ylim(bottom=0)
    _show_clock(bottom, Clock.of(run.meta))
    return figure


def draw_utilisation(run: Run) -> Figure | None:
    """What each AGV did with its time, and all of them together."""
    agvs = run.agvs
    seconds = agvs[[f"{name}_s" for name in ACTIVITIES]].to_numpy(dtype=np.float64)
    if not seconds.sum() > 0.0:
        return None
    if len(agvs) > 40:
        seconds, labels = seconds.sum(axis=0, keepdims=True), [f"all {len(agvs)}"]
    else:
        seconds = np.vstack([seconds, seconds.sum(axis=0)])
        labels = [f"AGV {agv}" for agv in agvs["agv"]] + ["all"]
    shares = seconds / np.maximum(seconds.sum(axis=1, keepdims=True), 1e-9)
    figure, (axes,) = new_figure(0.9 + 0.22 * len(labels))
    left = np.zeros(len(labels))
    for k, name in enumerate(ACTIVITIES):
        axes.barh(labels, shares[:, k], left=left, color=ACTIVITY_COLORS[name], label=name, height=0.8)
        left += shares[:, k]
    axes.margins(y=0.01)
    axes.invert_yaxis()
    axes.set(xlim=(0, 1), xlabel="share of time")
    axes.xaxis.set_major_formatter("{x:.0%}")
    axes.grid(axis="y", visible=False)
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=len(ACTIVITIES), columnspacing=1.0, handlelength=1.0)
    return figure


def draw_deadlocks(run: Run) -> Figure | None:
    """Each deadlock: when it was found and how long it lasted, coloured by what resolved it."""
    found = deadlocks(run)
    if not found:
        return None
    figure, (axes,) = new_figure(2.3)
    colors = (BLUE, ORANGE, GREEN, PINK, SKY, YELLOW)
    for k, stage in enumerate(sorted({d.stage for d in found} - {""})):
        color = colors[k % len(colors)]
        starts, costs = zip(*((d.began_s, d.cost_s) for d in found if d.stage == stage), strict=True)
        axes.vlines(starts, 0.0, costs, color=color, linewidth=1.2)
        axes.plot(starts, costs, "o", color=color, markersize=4.5, label=words(stage))
    lost = [d.began_s for d in found if not d.stage]
    if lost:
        top = axes.get_ylim()[1]
        axes.plot(lost, [top] * len(lost), "x", color=RED, markersize=6, label="not resolved", clip_on=False)
    axes.set(xlabel=f"beginning of the wait, {Clock.of(run.meta).name} (h:mm)", ylabel="seconds to resolve")
    axes.set_xlim(0, float(run.meta.get("simulated_s") or max(d.found_s for d in found)))
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6)
    _show_clock(axes, Clock.of(run.meta))
    return figure


def draw_planning(run: Run) -> Figure | None:
    """Histogram of the wall-clock time of planning calls."""
    wall = run.planning["wall_ms"].to_numpy(dtype=np.float64)
    wall = np.maximum(wall[np.isfinite(wall)], 1e-3)
    if not len(wall):
        return None
    from matplotlib.ticker import LogLocator

    figure, (axes,) = new_figure(2.2)
    edges = np.geomspace(wall.min() * 0.95, wall.max() * 1.05, 41)
    axes.hist(wall, bins=edges.tolist(), color=BLUE, histtype="stepfilled")
    for q in (0.5, 0.99):
        value = float(np.quantile(wall, q))
        axes.axvline(value, color=INK, linewidth=0.8, linestyle=":")
        axes.annotate(
            f"p{q * 100:.0f} {value:.3g} ms", (value, 1.0), (3, -9), xycoords=("data", "axes fraction"),
            textcoords="offset points", fontsize=8, color=INK,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="wall-clock time of a call (ms)", ylabel="calls")
    return figure


def draw_window(run: Run) -> Figure | None:
    """Course of the planning window and of the score that it goes by, if planning calls have windows."""
    calls = run.planning
    if not calls["window_cells"].any():
        return None
    figure, (axes,) = new_figure(2.2)
    times = calls["time_s"]
    axes.step(times, calls["window_cells"], where="post", color=BLUE, label="window (moves)")
    axes.plot(times, calls["wait_edges"], color=ORANGE, linewidth=0.8, label="wait-for edges")
    axes.set(xlabel=f"{Clock.of(run.meta).name} (h:mm)", ylabel="moves, edges")
    if calls["score"].any():
        axes.plot(times, calls["score"], color=INK, linewidth=0.8, linestyle=":", label="congestion score")
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    _show_clock(axes, Clock.of(run.meta))
    return figure


def draw_floor(run: Run) -> Figure | None:
    """Floor plan with how often AGVs passed each place and how long they stood there with something to do."""
    vertices, trajectory = run.vertices, run.trajectory
    if vertices.empty or trajectory.empty:
        return None
    xy = vertices[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    passed, stood = _per_vertex(xy, trajectory)
    lanes = run.edges[["tail", "head"]].to_numpy()
    size = _cell_sizes(xy)
    spread = np.ptp(xy, axis=0) + 5.0
    wide = spread[0] > 1.4 * spread[1] or len(xy) > _MAX_SIDE_BY_SIDE
    panel = min(5.5, (WIDTH_IN - 0.9) * spread[1] / spread[0] if wide else 0.45 * WIDTH_IN * spread[1] / spread[0])
    figure, panels = new_figure((panel + 0.3) * (2 if wide else 1), rows=2 if wide else 1, columns=1 if wide else 2)
    titles = "driving: AGV-minutes", "standing with a task: AGV-minutes"
    for axes, values, title in zip(panels, (passed / 60.0, stood / 60.0), titles, strict=True):
        axes.plot(*_lines(xy, lanes), color=GREY, linewidth=0.5, alpha=0.6)
        heat = _squares(xy, size, values)
        axes.add_collection(heat)
        _marks(axes, vertices)
        figure.colorbar(heat, ax=axes, shrink=0.8, aspect=15, pad=0.01)
        axes.set_title(title)
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.axis("off")
    return figure


FIGURES: Mapping[str, tuple[str, str, Callable[[Run], Any]]] = {
    "waits": (
        "How long customers waited",
        "Share of customers who waited at most so long. A wait that had not ended counts with its length so far;"
        " customers turned away are not among them. Dotted: the service levels of 180 and 300 s.",
        draw_waits,
    ),
    "waits_over_time": (
        "Retrieval waits over time",
        "One point for each retrieval, at the time of its request. Dotted: 180 and 300 s.",
        draw_waits_over_time,
    ),
    "queue": (
        "Queue and occupancy",
        "Top: cars that wait for a bay, those of them on the public street, and requests that no AGV has taken yet. "
        "Bottom: cars in slots. Each the most at a time.",
        draw_queue,
    ),
    "utilisation": (
        "What the AGVs did",
        "Share of each AGV's time. Waiting is standing with a task: for other AGVs or for a customer.",
        draw_utilisation,
    ),
    "floor": (
        "Where it is busy",
        "Time that AGVs drove and stood at each place, from the sampled trajectory. B: bays; C: chargers; dots: homes.",
        draw_floor,
    ),
    "deadlocks": (
        "Deadlocks over time",
        "One stem for each deadlock: when the wait began, how long until it was resolved, and by what.",
        draw_deadlocks,
    ),
    "window": (
        "Planning window",
        "Course of the window of planners that plan in windows, and the wait-for edges of each call.",
        draw_window,
    ),
    "planning": (
        "Planning time",
        "Wall-clock time of the planning calls on the machine of this run.",
        draw_planning,
    ),
}


def figures(run: Run) -> list[Drawing]:
    """All figures that a run has something for, in the order of ``FIGURES``.

    Args:
        run: a record.

    Returns:
        The drawings; the same record gives the same text.
    """
    drawings = []
    with style():
        for key, (title, caption, draw) in FIGURES.items():
            figure = draw(run)
            if figure is not None:
                drawings.append(Drawing(key, title, caption, svg(figure, key, title)))
    return drawings


def svg(figure: Figure, key: str, title: str) -> str:
    """A figure as an inline ``<svg>`` element.

    Args:
        figure: what to draw.
        key: makes ids unique on a page with several figures.
        title: read out instead of the picture.

    Returns:
        The element, without fixed size and without ids that nothing refers to. Black is ``currentColor``; a page may
        set ``--blue`` to suit its background.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", dpi=160, transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    used = set(re.findall(r"#([\w.-]+)", text)) - {INK[1:]}
    text = re.sub(r'\bid="([^"]+)"', lambda m: f'id="{key}-{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="|url\()#', rf"\1#{key}-", text)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif", text)
    head, body = text.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    body = body.replace(INK, "currentColor").replace(BLUE.lower(), f"var(--blue, {BLUE})")
    names = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    opening = f'<svg {box[0] if box else ""} role="img" aria-label="{title}" {names}>'
    return opening + re.sub(r"\n\s*", "\n", body)


def new_figure(height_in: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure without pyplot: nothing global, nothing to close."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=rows > 1, squeeze=False)
    return figure, list(axes.ravel())


def _show_clock(axes: Axes, clock: Clock) -> None:
    """Seconds on the x axis as h:mm of a clock, at its round times."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    low, high = axes.get_xlim()
    low = max(0.0, low)
    axes.set_xlim(low, high)
    steps = (60, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400)
    step = next((s for s in steps if (high - low) / s <= 12), 86400)
    first = -(-(low + clock.offset_s) // step) * step - clock.offset_s
    axes.xaxis.set_major_locator(FixedLocator(np.arange(first, high + 1e-6, step).tolist()))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda s, _: clock.at(s).rpartition(":")[0]))


def _binned(line: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """The maximum of each column in each of ``_MAX_POINTS`` equal stretches of time."""
    width = max(1e-9, float(line["time_s"].iloc[-1] - line["time_s"].iloc[0]) / _MAX_POINTS)
    stretch = ((line["time_s"] - line["time_s"].iloc[0]) // width).astype(int)
    binned = line.groupby(stretch)[names].max()
    binned["time_s"] = line.groupby(stretch)["time_s"].min()
    return binned


def _per_vertex(xy: NDArray[np.float64], trajectory: pd.DataFrame) -> tuple[NDArray[Any], NDArray[Any]]:
    """Seconds driven and seconds stood with a task at the vertex nearest to each sample."""
    times = np.unique(trajectory["time_s"].to_numpy())
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    driving = trajectory["speed_mps"].to_numpy() > 0.05
    busy = ~trajectory["mode"].isin(["idle", "charging"]).to_numpy()
    places = np.round(trajectory[["x_m", "y_m"]].to_numpy(dtype=np.float64) * 2.0) / 2.0
    distinct, which = np.unique(places, axis=0, return_inverse=True)
    nearest = np.concatenate(
        [
            np.argmin(((part[:, None, :] - xy[None, :, :]) ** 2).sum(axis=2), axis=1)
            for part in np.array_split(distinct, max(1, len(distinct) // 500))
        ]
    )[which.ravel()]
    passed, stood = (np.bincount(nearest[rows], minlength=len(xy)) * period for rows in (driving, ~driving & busy))
    return passed, stood


def _cell_sizes(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Side of the square drawn for each vertex: nine tenths of the way to its neighbour, 2 to 4.5 m."""
    if len(xy) < 2:
        return np.full(len(xy), 4.5)
    apart = [float(np.partition(np.abs(xy - place).max(axis=1), 1)[1]) for place in xy]
    return np.array([0.9 * min(max(side, 2.2), 5.0) for side in apart])


def _lines(xy: NDArray[np.float64], lanes: NDArray[np.int32]) -> NDArray[np.float64]:
    """All lanes as one line with gaps, rows x and y; a two-way lane once."""
    pairs = np.unique(np.sort(lanes, axis=1), axis=0)
    gap = np.full((len(pairs), 1, 2), np.nan)
    return np.concatenate([xy[pairs], gap], axis=1).reshape(-1, 2).T


def _squares(xy: NDArray[np.float64], size: NDArray[np.float64], values: NDArray[np.float64]) -> Any:
    """Coloured squares at the vertices with something to show; the scale ends at the 99 % quantile."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba

    # from hardly there to solid, so that the busiest places stand out on a light and on a dark page
    colors = LinearSegmentedColormap.from_list("heat", [to_rgba(ORANGE, 0.2), to_rgba(RED, 1.0)])
    shown = values > 0.0
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    squares = xy[shown, None, :] + corners[None, :, :] * size[shown, None, None]
    top = float(np.quantile(values[shown], 0.99)) if shown.any() else 1.0
    heat = PolyCollection(list(squares), array=values[shown], cmap=colors, norm=Normalize(0.0, max(top, 1e-9)))
    heat.set_linewidth(0.0)
    heat.set_rasterized(True)
    return heat


def _marks(axes: Axes, vertices: pd.DataFrame) -> None:
    """Letters at bays and chargers, dots at homes."""
    paper = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    text: dict[str, Any] = {
        "ha": "center",
        "va": "center",
        "fontsize": 6,
        "fontweight": "bold",
        "clip_on": True,
        "bbox": paper,
    }

    def having(role: str) -> pd.DataFrame:
        return vertices[[role in roles.split(",") for roles in vertices["roles"]]]

    homes = having("home")
    axes.plot(homes["x_m"], homes["y_m"], "o", color=GREY, markersize=1.6)
    for letter, role, color in (("C", "charger", RED), ("B", "bay", BLUE)):
        chosen = having(role)
        for x, y in zip(chosen["x_m"], chosen["y_m"], strict=True):
            axes.text(x, y, letter, color=color, **text)
