"""The commands on gate logs: a profile fitted to one, and the requests that replay one."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from sumo_nets.errors import InputError
from sumo_nets.whole_file import whole_file

Log = Annotated[Path, typer.Argument(help="A gate log: a header, then a row a movement with time, in or out, plate.")]
Columns = Annotated[str, typer.Option(help="Names of columns, such as time=Zeitpunkt,event=Richtung,car=Kennzeichen.")]
Events = Annotated[str, typer.Option(help="Words for in and out, such as in=1,out=0; other rows are left out.")]
Dates = Annotated[str, typer.Option(help="Order in dates such as 04/05/2024: dmy or mdy.")]
Zone = Annotated[str, typer.Option(help="Time zone of the garage's clock, for times with an offset.")]
Begin = Annotated[str | None, typer.Option("--from", help="When the log begins to count, '2026-03-07 08:00'.")]
End = Annotated[str | None, typer.Option("--to", help="When it ends to count.")]
Initial = Annotated[int | None, typer.Option(help="Cars inside before that; default: as few as the log allows.", min=0)]


def fit_profile(
    log: Log,
    slots: Annotated[int, typer.Option(help="Slots of the garage that was logged.", min=1)],
    out: Annotated[Path, typer.Option(help="Profile to write (.yaml).")],
    days: Annotated[str, typer.Option(help="Days to use: all, weekdays, mon, tue, ...")] = "all",
    initial: Initial = None,
    source: Annotated[str | None, typer.Option(help="Where the log is from; default: its file name.")] = None,
    columns: Columns = "",
    events: Events = "",
    dates: Dates = "",
    zone: Zone = "",
    begin: Begin = None,
    end: End = None,
    keep_gaps: Annotated[bool, typer.Option("--keep-gaps", help="Count outages as no demand.")] = False,
) -> None:
    """Fit a demand profile to a gate log."""
    from demand.gate_logs.dialect import parse_dialect
    from demand.gate_logs.fit import basis
    from demand.gate_logs.fit import fit_profile as fit
    from demand.gate_logs.log import cut, read_gate_log, window
    from demand.profiles import write_profile

    if out.suffix not in (".yaml", ".yml"):
        raise InputError(f"--out: {out}: give a file name that ends with .yaml")
    stretch = window(None, begin, end)
    whole = read_gate_log(log, parse_dialect(columns, events, dates, zone), keep_gaps)
    part = cut(whole, *stretch)
    fitted = fit(part, slots, source or log.name, days, initial)
    try:
        write_profile(fitted, out)
    except OSError as error:
        raise InputError(f"--out: {out}: can't be written: {error.strerror}") from None
    _print_lines([*part.notes, *basis(part, days)])
    if len(part.covered) > 1:
        print("outages are left out; --keep-gaps counts them as no demand")
    print(f"{out}: {fitted.words}; {fitted.arrivals_between(0, 24):.2f} cars a day for each slot")


def requests(
    log: Log,
    out: Annotated[Path, typer.Option(help="Requests to write (.csv), for the workload csv.")],
    date: Annotated[str | None, typer.Option(help="Day to replay, such as 2026-03-07; default: the whole log.")] = None,
    begin: Annotated[str | None, typer.Option("--from", help="Begin: a moment; with --date a time, 08:00.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="End, likewise.")] = None,
    initial: Initial = None,
    columns: Columns = "",
    events: Events = "",
    dates: Dates = "",
    zone: Zone = "",
) -> None:
    """Turn a gate log into the requests that replay it, car by car."""
    from demand.gate_logs.coverage import in_words
    from demand.gate_logs.dialect import parse_dialect
    from demand.gate_logs.log import cut, read_gate_log, window
    from demand.gate_logs.requests import COLUMNS, requests_of

    if out.suffix != ".csv":
        raise InputError(f"--out: {out}: give a file name that ends with .csv")
    stretch = window(date, begin, end)
    part = cut(read_gate_log(log, parse_dialect(columns, events, dates, zone)), *stretch)
    rows = requests_of(part, initial)
    try:
        with whole_file(out) as beside, beside.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    except OSError as error:
        raise InputError(f"--out: {out}: can't be written: {error.strerror}") from None
    _print_lines(part.notes)
    kinds = Counter(kind for _, kind, _ in rows)
    words = f"{kinds['inside']} cars inside at the start, {kinds['park']} come, {kinds['retrieve']} leave"
    print(f"{out}: {in_words((part.covered[0][0], part.covered[-1][1]), part.first_day)}: {words}")
    print(f"in a scenario: workload: {{kind: csv, path: {out.name}}}")


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        print(line)
