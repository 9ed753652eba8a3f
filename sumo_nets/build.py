"""Build SUMO nets from layouts with netconvert.

A net is two files, ``NAME.net.xml.gz`` and ``NAME.add.xml``. What SUMO has no notion of is kept in generic
parameters, which netconvert and netedit leave alone:

=====================================  ==================================================================
``garage.slot``, ``garage.bay``,       on a junction: its role; the value is its place in the role's order
``garage.home``, ``garage.charger``,
``garage.refuge``
``garage.street``                      on a street edge: ``entry``, ``queue``, ``front`` or ``exit``
``garage.bay``, ``garage.use``         on a parkingArea: the bay's junction, and ``in`` or ``out``
=====================================  ==================================================================

AGV lanes allow ``tram`` only, street lanes ``passenger`` only.
"""

from __future__ import annotations

import gzip
import importlib
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import quoteattr

from sumo_nets.errors import InputError
from sumo_nets.graph import ROLES
from sumo_nets.layout import Layout
from sumo_nets.plan import NODE_SIZE_M, GaragePlan, Point, plan_garage

#: Speed limits of AGV lanes (far above any AGV's own), of the public street and of the street inside the garage.
AGV_LANE_MPS = 5.0
STREET_MPS = 8.33
FRONT_MPS = 5.56
CHARGER_W = 10_000
LANE_WIDTH_M = 2.4
_STREET_PARTS = ("entry", "queue", "front", "exit")

#: netconvert must guess nothing: every connection is given, every vertex keeps its shape, and turns aren't slowed
#: down (the plant times them).
NETCONVERT_OPTIONS = (
    "--no-turnarounds", "true",
    "--junctions.limit-turn-speed", "-1",
    "--junctions.internal-link-detail", "2",
    "--geometry.min-radius", "0",
    "--geometry.min-radius.fix.railways", "false",
    "--offset.disable-normalization", "true",
)  # fmt: skip


class NetconvertError(InputError):
    """netconvert isn't installed or refused a net; one line."""


def build_net(layout: Layout, folder: str | Path, source: str = "") -> tuple[Path, Path]:
    """Build one net; files of the same name are replaced, both or none.

    The same layout gives the same bytes.

    Args:
        layout: what to build.
        folder: where the two files go; made if absent.
        source: what to call the layout in an error; its name by default.

    Returns:
        Paths of the net and of the additional file.

    Raises:
        LayoutError: the layout's parts don't fit together.
        NetconvertError: netconvert isn't installed, or it complained.
        OSError: the folder can't be written.
    """
    plan = plan_garage(layout, source)
    net = compile_net(plan)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    files = {
        target / f"{plan.name}.net.xml.gz": gzip.compress(net, compresslevel=9, mtime=0),
        target / f"{plan.name}.add.xml": "".join(_additional(plan)).encode(),
    }
    _replace_all(files)
    net_file, additional_file = files
    return net_file, additional_file


def compile_net(plan: GaragePlan) -> bytes:
    """Run netconvert on a plan.

    Args:
        plan: the garage in metres.

    Returns:
        The net's XML without the header that names dates and paths.

    Raises:
        NetconvertError: netconvert isn't installed, or it warned or failed.
    """
    program = find_netconvert()
    with tempfile.TemporaryDirectory() as scratch:
        inputs = {"--node-files": _nodes, "--edge-files": _edges, "--connection-files": _connections}
        command = [program, *NETCONVERT_OPTIONS]
        for option, lines in inputs.items():
            path = Path(scratch) / f"{option.strip('-')}.xml"
            path.write_text("".join(lines(plan)), encoding="utf-8")
            command += [option, str(path)]
        output = Path(scratch) / "net.xml"
        done = subprocess.run([*command, "--output-file", str(output)], capture_output=True, text=True, check=False)
        complaints = [line for line in done.stderr.splitlines() if line.startswith(("Warning", "Error"))]
        if done.returncode or complaints:
            raise NetconvertError(f"netconvert on {plan.name}: {complaints[0] if complaints else 'failed'}")
        return re.sub(rb"<!--.*?-->\s*", b"", output.read_bytes(), flags=re.DOTALL)


def find_netconvert() -> str:
    """Path of netconvert: that of the eclipse-sumo package, else the one on PATH.

    Raises:
        NetconvertError: there is none.
    """
    name = "netconvert.exe" if os.name == "nt" else "netconvert"
    try:
        package = importlib.import_module("sumo")
    except ImportError:
        package = None
    candidates = [Path(package.SUMO_HOME) / "bin" / name] if package else []
    for candidate in candidates:
        if candidate.is_file():
            return str(candidate)
    found = shutil.which(name)
    if found is None:
        raise NetconvertError('netconvert is not installed: pip install "parking-sim[nets]"')
    return found


def _nodes(plan: GaragePlan) -> Iterator[str]:
    orders = {role: {name: i for i, name in enumerate(plan.roles[role])} for role in ROLES}
    half = NODE_SIZE_M / 2
    corners = ((-half, -half), (-half, half), (half, half), (half, -half))
    yield "<nodes>\n"
    for name, (x, y) in plan.vertices.items():
        shape = _shape((x + dx, y + dy) for dx, dy in corners)
        # unregulated: AGVs don't yield to each other at nodes, the controller keeps them apart
        yield f'<node id="{name}" x="{x:.2f}" y="{y:.2f}" type="unregulated" shape="{shape}">'
        for role in ROLES:
            if name in orders[role]:
                yield _param(f"garage.{role}", str(orders[role][name]))
        yield "</node>\n"
    for i, (x, y) in enumerate(plan.street):
        yield f'<node id="street{i}" x="{x:.2f}" y="{y:.2f}" type="unregulated"/>\n'
    yield "</nodes>\n"


def _edges(plan: GaragePlan) -> Iterator[str]:
    yield "<edges>\n"
    for lane in plan.lanes.values():
        # exactly reversed shapes and centred lanes make netconvert pair the two directions as one track
        shape = f' shape="{_shape(lane.shape)}"' if len(lane.shape) > 2 else ""
        yield (
            f'<edge id="{lane.name}" from="{lane.tail}" to="{lane.head}" numLanes="1" speed="{AGV_LANE_MPS}"'
            f' allow="tram" spreadType="center" width="{LANE_WIDTH_M}"{shape}/>\n'
        )
    if plan.street:
        for i, part in enumerate(_STREET_PARTS):
            speed = STREET_MPS if part in ("entry", "exit") else FRONT_MPS
            yield (
                f'<edge id="street_{part}" from="street{i}" to="street{i + 1}" numLanes="1" speed="{speed}"'
                f' allow="passenger" spreadType="center">{_param("garage.street", part)}</edge>\n'
            )
    yield "</edges>\n"


def _connections(plan: GaragePlan) -> Iterator[str]:
    leaving: dict[str, list[str]] = {}
    for lane in plan.lanes.values():
        leaving.setdefault(lane.tail, []).append(lane.name)
    yield "<connections>\n"
    for lane in plan.lanes.values():
        # the lane back is one of them: that is how an AGV reverses in place
        for onward in leaving.get(lane.head, ()):
            yield f'<connection from="{lane.name}" to="{onward}" fromLane="0" toLane="0"/>\n'
    if plan.street:
        for part, onward in pairwise(_STREET_PARTS):
            yield f'<connection from="street_{part}" to="street_{onward}" fromLane="0" toLane="0"/>\n'
    yield "</connections>\n"


def _additional(plan: GaragePlan) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8"?>\n<additional>\n'
    for places in plan.places:
        for use, (start, end) in (("in", places.arrive), ("out", places.leave)):
            yield (
                f'    <parkingArea id="{places.bay}_{use}" lane="street_front_0" startPos="{start:.2f}"'
                f' endPos="{end:.2f}" roadsideCapacity="1">\n'
                f"        {_param('garage.bay', places.bay)}\n        {_param('garage.use', use)}\n    </parkingArea>\n"
            )
    chargers = set(plan.roles["charger"])
    for lane in plan.lanes.values():
        if lane.head in chargers:
            # one for each lane into the charger: an AGV stands on the lane it came by
            yield (
                f'    <chargingStation id="charge_{lane.name}" lane="{lane.name}_0"'
                f' power="{CHARGER_W}" efficiency="0.95"/>\n'
            )
    yield "</additional>\n"


def _param(key: str, value: str) -> str:
    return f"<param key={quoteattr(key)} value={quoteattr(value)}/>"


def _shape(points: Iterable[Point]) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in points)


def _replace_all(files: dict[Path, bytes]) -> None:
    """Write every file beside its target first, so that a failure leaves the old ones as they were."""
    ready: list[tuple[Path, Path]] = []
    try:
        for path, content in files.items():
            beside = path.with_name(f".{path.name}.new")
            ready.append((beside, path))
            beside.write_bytes(content)
        for beside, path in ready:
            beside.replace(path)
    finally:
        for beside, _ in ready:
            beside.unlink(missing_ok=True)
