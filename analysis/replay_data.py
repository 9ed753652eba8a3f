"""How the replay's page carries numbers, which ``replay_data.js`` reads.

Columns of whole numbers (milliseconds, centimetres, tenths of degrees), delta-coded to bytes of variable length and
deflated together.
"""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

#: A time that never came.
NEVER: Final = 2**30

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
#: x and y (cm), angle (0.1 degrees).
Pose = tuple[int, int, int]


@dataclass(frozen=True)
class Window:
    """The part of a run that is shown.

    Attributes:
        start_s, end_s: simulated seconds.
    """

    start_s: float
    end_s: float


def pack(head: Mapping[str, Any], columns: Mapping[str, Ints]) -> str:
    """Put a description and columns of whole numbers into one text.

    Args:
        head: anything JSON can say; the columns' names and lengths are added as ``columns``.
        columns: numbers below 2^30 in size, also their differences.

    Returns:
        Base64 of a zlib stream: length of the JSON (4 bytes, little-endian), the JSON, then each column's
        differences in zigzag coding, seven bits a byte, the lowest first.
    """
    names = [[name, len(values)] for name, values in columns.items()]
    text = json.dumps({**head, "columns": names}, separators=(",", ":"), allow_nan=False).encode()
    body = b"".join(_varints(np.diff(values, prepend=0)) for values in columns.values())
    return base64.b64encode(zlib.compress(struct.pack("<I", len(text)) + text + body, 9)).decode()


def _varints(values: Ints) -> bytes:
    coded = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    size = np.ones(len(coded), dtype=np.int64)
    for bits in (7, 14, 21, 28):
        size += coded >= 1 << bits
    end = np.cumsum(size)
    out = np.zeros(int(end[-1]) if len(end) else 0, dtype=np.uint8)
    for k in range(5):
        has = size > k
        more = (size[has] > k + 1).astype(np.uint64) << np.uint64(7)
        out[(end - size)[has] + k] = (coded[has] >> np.uint64(7 * k)) & np.uint64(127) | more
    return out.tobytes()


def ms(seconds: Any) -> Ints:
    """Seconds as whole milliseconds; what never came lies far ahead."""
    values = np.asarray(seconds, dtype=np.float64)
    return np.rint(np.where(np.isfinite(values), values * 1000.0, NEVER)).astype(np.int64)


def cm(metres: Any) -> Ints:
    """Metres as whole centimetres."""
    return np.rint(np.asarray(metres, dtype=np.float64) * 100.0).astype(np.int64)


def tenths(direction: Floats) -> int:
    """The angle of a direction (x, y), counterclockwise from east, in whole tenths of degrees."""
    return round(math.degrees(math.atan2(direction[1], direction[0])) * 10)
