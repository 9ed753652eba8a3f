"""An independent look at all bodies as rectangles: who overlaps, and how close they come.

SUMO does not see AGVs that cross at a small node, and the controller is what is to be checked, so this knows neither:
it is given rectangles, step by step.
"""

from __future__ import annotations

from dataclasses import dataclass

from sumo_nets.graph import FloatArray


@dataclass(frozen=True, eq=False)
class Bodies:
    """Rectangles, each given by the middle of its front side; arrays of one length.

    Attributes:
        x, y: middle of the front side in metres.
        angle: direction of driving in radians, counter-clockwise from east.
        length, width: in metres.
    """

    x: FloatArray
    y: FloatArray
    angle: FloatArray
    length: FloatArray
    width: FloatArray
