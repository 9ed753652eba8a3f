"""A small garage to spoil: its two files as text, with strings replaced as by hand."""

from __future__ import annotations

import gzip
import tempfile
from functools import lru_cache
from pathlib import Path

from sumo_nets.build import build_net
from sumo_nets.layout import parse_layout

LAYOUT = """
name: small
pitch_m: 7.0
handover: bay
aisles:
  - {from: [2, 6], to: [2, 0], way: one}
  - {from: [2, 0], to: [9, 0], way: two}
  - {from: [9, 0], to: [9, 6], way: one}
  - {from: [9, 6], to: [2, 6], way: one}
slots:
  - {from: [4, 0], to: [7, 0], side: [north, south], per_cell: 2}
bays:
  - {at: [2, 3], side: west}
homes:
  - {at: [9, 2], side: east, per_cell: 2}
chargers:
  - {at: [9, 5], side: east}
refuges:
  - {at: [8, 0], side: north}
street: {from: [0, 6], to: [0, 0]}
"""

#: Which file, what is in it, and what shall be there instead.
Change = tuple[str, str, str]


@lru_cache(maxsize=4)
def texts(layout: str = LAYOUT) -> dict[str, str]:
    """The text of the ``net`` and of the ``add`` file of a layout."""
    with tempfile.TemporaryDirectory() as folder:
        net, add = build_net(parse_layout(layout), folder)
        return {"net": gzip.decompress(net.read_bytes()).decode(), "add": add.read_text()}


def write_net(folder: Path, *changes: Change, layout: str = LAYOUT) -> Path:
    """Write both files with each change made once, and return the path of the net."""
    changed = dict(texts(layout))
    for which, old, new in changes:
        assert old in changed[which], old
        changed[which] = changed[which].replace(old, new, 1)
    path = folder / "spoilt.net.xml"
    path.write_text(changed["net"])
    path.with_name("spoilt.add.xml").write_text(changed["add"])
    return path
