"""MovingAI's grid maps and scenarios (Sturtevant 2012, https://movingai.com/benchmarks) as graphs and trips.

A ``.map`` has ``.``, ``G`` and ``S`` for cells that can be entered; ``@``, ``O``, ``T`` and ``W`` can't. Cells are
4-connected here, though the files say ``octile``, as is usual for multi-agent path finding. Warehouse maps of the
lifelong literature mark end points with letters: ``e`` becomes a slot, ``b`` a bay and ``r`` a home.

Cell (x, y) counts from the upper left corner, as in the files; the vertex is called ``x,y`` and drawn with y upwards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from sumo_nets.errors import InputError
from sumo_nets.graph import Graph, Role, make_graph
from sumo_nets.input_file import MEGABYTE, read_text
from sumo_nets.numbering import Vertex

_FREE = ".GSebr"
_BLOCKED = "@OTW"
_MOST_BYTES = 20 * MEGABYTE
_ROLES: dict[str, Role] = {"e": "slot", "b": "bay", "r": "home"}


class MovingAiError(InputError):
    """A file that is not a map or a scenario; the message is one line."""


def read_map(path: Path) -> Graph:
    """Read a ``.map`` file.

    Raises:
        MovingAiError: it can't be read or is not a map.
    """
    lines = _lines(path)
    try:
        at = lines.index("map")
        header = dict(line.split(maxsplit=1) for line in lines[:at])
        height, width = int(header["height"]), int(header["width"])
    except (ValueError, KeyError):
        raise MovingAiError(f"{path}: not a MovingAI map: no header of type, height, width, map") from None
    rows = lines[at + 1 : at + 1 + height]
    if len(rows) != height or any(len(row) != width for row in rows):
        raise MovingAiError(f"{path}: not {height} rows of {width} cells")
    return grid_graph(path.stem, rows)


def read_scenario(path: Path, graph: Graph) -> list[tuple[Vertex, Vertex]]:
    """Read the trips of a ``.scen`` file.

    Args:
        path: the file; its lines give bucket, map, width, height, x, y of start and goal, and a length.
        graph: the map the trips are on.

    Returns:
        Start and goal vertex of each trip.

    Raises:
        MovingAiError: it can't be read, is not a scenario, or does not fit the map.
    """
    lines = _lines(path)
    if not lines or not lines[0].startswith("version"):
        raise MovingAiError(f"{path}: not a MovingAI scenario: the first line does not give a version")
    return [_trip(path, number, line, graph) for number, line in enumerate(lines[1:], start=2) if line.strip()]


def _trip(path: Path, number: int, line: str, graph: Graph) -> tuple[Vertex, Vertex]:
    try:
        *_, x, y, goal_x, goal_y, _length = line.split()
        ends = [f"{int(x)},{int(y)}", f"{int(goal_x)},{int(goal_y)}"]
    except ValueError:
        raise MovingAiError(f"{path}: line {number}: not bucket, map, size, start, goal and length") from None
    for cell in ends:
        if cell not in graph.index:
            raise MovingAiError(f"{path}: line {number}: {cell} is no free cell of {graph.name}")
    return graph.index[ends[0]], graph.index[ends[1]]


def grid_graph(name: str, rows: Sequence[str], cell_m: float = 1.0) -> Graph:
    """The 4-connected graph of a map's rows.

    Raises:
        MovingAiError: an unknown letter.
    """
    cells = {(x, y): letter for y, row in enumerate(rows) for x, letter in enumerate(row) if letter not in _BLOCKED}
    for (x, y), letter in cells.items():
        if letter not in _FREE:
            raise MovingAiError(f"{name}: cell {x},{y}: unknown letter {letter!r}")
    vertices = [(f"{x},{y}", x * cell_m, -y * cell_m) for x, y in cells]
    roles = {role: [f"{x},{y}" for (x, y), c in cells.items() if c == letter] for letter, role in _ROLES.items()}
    return make_graph(name, vertices, list(_edges(cells, cell_m)), roles)


def _edges(cells: dict[tuple[int, int], str], cell_m: float) -> Iterator[tuple[str, str, str, float]]:
    for x, y in cells:
        for there in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if there in cells:
                u, v = f"{x},{y}", f"{there[0]},{there[1]}"
                yield f"{u}>{v}", u, v, cell_m


def _lines(path: Path) -> list[str]:
    try:
        return read_text(path, _MOST_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise MovingAiError(f"{path}: can't be read: {reason}") from None
