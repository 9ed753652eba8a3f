"""Rules by which SUMO reads the attributes of its own files: who may use a lane, where a stopping place lies."""

from __future__ import annotations

from functools import lru_cache

#: SUMO wants a stopping place to be at least this long, and takes what stands this close to its ends for inside.
POSITION_EPS_M = 0.1
#: A class's name in old nets.
_OLD_NAMES = {"lightrail": "tram"}
_TRUE = ("1", "yes", "true", "on", "x", "t")


@lru_cache(maxsize=256)
def permits(vehicle_class: str, allow: str, disallow: str) -> bool:
    """Whether a lane may be used: by every class, if neither attribute says anything; ``allow`` goes first.

    Args:
        vehicle_class: SUMO's name of it, such as ``tram``.
        allow, disallow: the lane's attributes: class names between blanks, or ``all``.
    """
    listed = allow or disallow
    named = listed == "all" or vehicle_class in {_OLD_NAMES.get(name, name) for name in listed.split()}
    return named if allow else not named


def stopping_place(start: str, end: str, friendly: str, lane_m: float) -> tuple[float, float]:
    """Where a parkingArea or chargingStation lies.

    Args:
        start, end: its ``startPos`` and ``endPos``: metres from the lane's begin, or negative ones from its end; an
            empty text stands for the lane's begin and end.
        friendly: its ``friendlyPos``: whether a place beyond the lane's ends is moved onto the lane.
        lane_m: length of its lane.

    Returns:
        Its begin and end, metres from the lane's begin.

    Raises:
        ValueError: it is no number, or not on the lane, or shorter than ``POSITION_EPS_M``.
    """
    begin_m, end_m = (float(start) if start else 0.0), (float(end) if end else lane_m)
    begin_m, end_m = (at + lane_m if at < 0 else at for at in (begin_m, end_m))
    if friendly.lower() in _TRUE:
        end_m = min(max(end_m, POSITION_EPS_M), lane_m)
        begin_m = min(max(begin_m, 0.0), end_m - POSITION_EPS_M)
    # so that what is no number fails as well
    if not (0.0 <= begin_m <= end_m - POSITION_EPS_M and end_m <= lane_m):
        raise ValueError(f"{begin_m:.2f} to {end_m:.2f} m is not valid: its lane has 0 to {lane_m:.2f} m")
    return begin_m, end_m
