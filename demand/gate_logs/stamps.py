"""Moments as gate logs write them: ISO, 04.05.2024, 5/4/2024 1:07 PM, 04-May-2024, epochs, Excel's days."""

from __future__ import annotations

import re
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd

from sumo_nets.errors import MOST_LINES, InputError, in_lines
from sumo_nets.wording import shown

_STAMP = re.compile(
    r"^\s*(?:[^\W\d]{2,}\.?,?\s+)?(?P<a>\d{1,4})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{1,4})"
    r"(?:[T\s,]+(?P<hour>\d{1,2})[:.h](?P<minute>\d{2})(?:[:.](?P<second>\d{2})(?:[.,](?P<fraction>\d{1,9}))?)?"
    r"\s*(?:Uhr)?(?:(?P<half>[AaPp])\.?\s?[Mm]\.?)?\s*(?P<offset>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)?)\s*$"
)
_NUMBER = re.compile(r"^\d+(?:[.,]\d+)?$")
_DIGITS = re.compile(r"^((?:19|20)\d{2})(\d{2})(\d{2})[T ]?(\d{2})(\d{2})(\d{2})$")
#: Morning or afternoon before the time of day, as Korean writes it.
_HALF_FIRST = re.compile(r"(오전|오후)\s*(\d{1,2}:\d{2}(?::\d{2})?)")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH_NAME = rf"(?P<month>{'|'.join(_MONTHS)})[a-z]*"
_DAY_MONTH = re.compile(rf"\b(?P<day>\d{{1,2}})[-\s.]+{_MONTH_NAME}[-\s.,]+(?P<year>\d{{4}})", re.IGNORECASE)
_MONTH_DAY = re.compile(rf"\b{_MONTH_NAME}\.?\s+(?P<day>\d{{1,2}}),?\s+(?P<year>\d{{4}})", re.IGNORECASE)
#: Unit of a number -> the greatest number that is one: days since 1899-12-30 (Excel), then parts since 1970.
_UNITS = (("D", 1e5), ("s", 1e10), ("ms", 1e13), ("us", 1e16))
_LIKE = "give such as 2024-05-04 13:07:30"


def is_stamp(text: str) -> bool:
    """Whether a cell holds a date and a time of day by itself."""
    return bool(_STAMP.match(_spelt_out(text)) or _NUMBER.match(text.strip()))


def read_stamps(cells: pd.Series[str], path: Path, dates: str, zone: str) -> tuple[pd.Series[pd.Timestamp], str]:
    """Moments by the clock on the wall.

    Args:
        cells: the texts, indexed by row of the file.
        path: the file, for complaints.
        dates: "dmy", "mdy", or "" to tell from the dates.
        zone: zone whose clock counts, for stamps with an offset or numbers; "": the clock as written, numbers in UTC.

    Returns:
        The moments, and the form in words.

    Raises:
        InputError: a text is no moment, or may be read in two ways.
    """
    cells = cells.map(_spelt_out)
    numbers = cells.map(lambda text: bool(_NUMBER.match(text)))
    if numbers.all():
        return _from_numbers(cells, path, zone)
    parts = cells.str.extract(_STAMP)
    _refuse(cells, parts["a"].isna(), path, _LIKE)
    year_first = parts["a"].str.len() == 4
    order = dates or _order(cells, parts, ~year_first, path)
    number = parts[["a", "b", "c", "hour", "minute", "second"]].fillna("0").astype(int)
    day_first = ~year_first & ((order == "dmy") | ((parts["mark"] == ".") & (dates == "")))
    year = number["a"].where(year_first, number["c"])
    month = number["b"].where(year_first | day_first, number["a"])
    day = number["c"].where(year_first, number["a"].where(day_first, number["b"]))
    midnight = pd.to_datetime(
        pd.DataFrame({"year": year.where(year > 99, year + 2000), "month": month, "day": day}), errors="coerce"
    )
    half = parts["half"].str.lower()
    hour = number["hour"].where(half.isna(), number["hour"] % 12 + 12 * (half == "p"))
    clock = 3600 * hour + 60 * number["minute"] + number["second"]
    good = (number["hour"] <= np.where(half.isna(), 24, 12)) & (number["minute"] < 60) & (number["second"] <= 60)
    _refuse(cells, midnight.isna() | ~good | (clock > 86400), path, f"no such day or time; {_LIKE}")
    fraction = ("0." + parts["fraction"].fillna("0")).astype(float)
    time = midnight + pd.to_timedelta(clock + fraction, unit="s")
    form = "dates year first" if year_first.all() else "dates day first" if day_first.any() else "dates month first"
    return _on_the_wall(time, cells, parts["offset"], path, zone, form)


def _spelt_out(text: str) -> str:
    """Month names as numbers, 20240504130730 with marks, and morning or afternoon behind the time of day."""
    text = _HALF_FIRST.sub(lambda found: f"{found[2]} {'AM' if found[1] == '오전' else 'PM'}", text.strip())
    if found := _DAY_MONTH.search(text) or _MONTH_DAY.search(text):
        number = _MONTHS.index(found["month"].lower()) + 1
        text = f"{text[: found.start()]}{found['day']}.{number}.{found['year']}{text[found.end() :]}"
    return _DIGITS.sub(r"\1-\2-\3 \4:\5:\6", text)


def _from_numbers(cells: pd.Series[str], path: Path, zone: str) -> tuple[pd.Series[pd.Timestamp], str]:
    values = cells.str.replace(",", ".").astype(float)
    unit = next((unit for unit, most in _UNITS if values.max() < most), "")
    small = values < {"D": 2e4, "s": 1e8, "ms": 1e11, "us": 1e14}.get(unit, np.inf)
    _refuse(cells, small, path, f"counts from no known day; {_LIKE}")
    if unit == "D":
        days = pd.to_timedelta((values * 86400).round(3), unit="s")
        return pd.Timestamp("1899-12-30") + days, "Excel's days"
    seconds = values / {"s": 1, "ms": 1e3, "us": 1e6}[unit]
    time = pd.Timestamp("1970-01-01") + pd.to_timedelta(seconds, unit="s")
    return _on_the_wall(time, cells, pd.Series("Z", cells.index), path, zone, f"numbers ({unit} since 1970)")


def _order(cells: pd.Series[str], parts: pd.DataFrame, doubtful: pd.Series[bool], path: Path) -> str:
    """Whether the day or the month is first where dots don't tell."""
    first, second = (parts.loc[doubtful & (parts["mark"] != "."), name].astype(int) for name in ("a", "b"))
    if (first > 12).any() and (second > 12).any():
        _refuse(cells, (second > 12).reindex(cells.index, fill_value=False), path, "other rows have the day first")
    if (first > 12).any() or (first == second).all():
        return "dmy"
    if (second > 12).any():
        return "mdy"
    row = first.index[first != second][0]
    raise InputError(
        f"{path}: row {row}: time: {shown(cells[row])}: day or month first? Give --dates dmy or --dates mdy"
    )


def _on_the_wall(
    time: pd.Series[pd.Timestamp], cells: pd.Series[str], offsets: pd.Series[str], path: Path, zone: str, form: str
) -> tuple[pd.Series[pd.Timestamp], str]:
    """Moments by one clock, from stamps that may carry an offset from UTC."""
    if offsets.isna().all():
        if zone:
            raise InputError(f"--zone: {zone}: {path}: its times carry no offset, so they are by the clock on the wall")
        return time, form
    _refuse(cells, offsets.isna(), path, "has no offset from UTC, other rows have one")
    ahead = offsets.map(_minutes)
    if not zone:
        if ahead.nunique() > 1:
            names = " and ".join(sorted(offsets.unique())[:3])
            raise InputError(f"{path}: time: offsets {names}: give --zone with the garage's, such as Europe/Berlin")
        by = offsets.iloc[0] if ahead.iloc[0] else "UTC, for the garage's own clock give --zone such as Europe/Berlin"
        return time, f"{form}, by the clock of {by}"
    try:
        clock = ZoneInfo(zone)
    except (OSError, ValueError, KeyError):
        raise InputError(f"--zone: {shown(zone)}: give a name such as Europe/Berlin") from None
    universal = (time - pd.to_timedelta(ahead, unit="min")).dt.tz_localize("UTC")
    return universal.dt.tz_convert(clock).dt.tz_localize(None), f"{form}, by the clock of {zone}"


def _minutes(offset: str) -> int:
    if offset in ("Z", "UTC", "GMT"):
        return 0
    digits = offset[1:].replace(":", "").ljust(4, "0")
    return (-1 if offset[0] == "-" else 1) * (60 * int(digits[:2]) + int(digits[2:]))


def _refuse(cells: pd.Series[str], bad: pd.Series[bool], path: Path, why: str) -> None:
    if bad.any():
        rows = bad.index[bad.to_numpy()].tolist()
        told = [f"{path}: row {row}: time: {shown(cells[row])}: {why}" for row in rows[:MOST_LINES]]
        raise InputError(in_lines(told, len(rows)))
