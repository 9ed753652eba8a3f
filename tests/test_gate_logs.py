"""Gate logs: dialects, missed reads, hours covered, the fit, and the replay.

Logs are made by hand or by a Poisson process with known rates; what comes out is compared with what went in.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import date, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.types import RequestKind
from demand.csv_file import Csv
from demand.gate_logs.coverage import outages
from demand.gate_logs.dialect import Dialect, parse_dialect
from demand.gate_logs.fit import basis, fit_profile
from demand.gate_logs.log import GateLog, cut, read_gate_log, window
from demand.gate_logs.mending import mend
from demand.gate_logs.requests import requests_of
from demand.profile_traffic import ProfileTraffic
from demand.profiles import PROFILES
from demand.types import Demand
from demand.workloads import make_demand
from parking_sim.cli import main
from sumo_nets.errors import InputError

#: A row of a log: when, +1 in or -1 out, plate.
Row = tuple[datetime, int, str]
MONDAY = datetime(2024, 5, 6)
SLOTS = 300


def log_of(tmp_path: Path, text: str, dialect: Dialect | None = None, encoding: str = "utf-8") -> GateLog:
    (tmp_path / "log.csv").write_bytes(text.encode(encoding))
    return read_gate_log(tmp_path / "log.csv", dialect)


# --- dialects ---------------------------------------------------------------------------------------------------------

ROWS: list[Row] = [
    (datetime(2024, 5, 13, 8, 5), 1, "HH-AB 12"),
    (datetime(2024, 5, 13, 9, 40), 1, "MÜ-C 3"),
    (datetime(2024, 5, 13, 12, 0), -1, "HH-AB 12"),
    (datetime(2024, 5, 13, 13, 30), 1, "B-X 7"),
    (datetime(2024, 5, 14, 0, 10), -1, "MÜ-C 3"),
    (datetime(2024, 5, 14, 0, 55), -1, "B-X 7"),
]


def written(header: str, stamp: str | Callable[[datetime], str], words: tuple[str, str], sep: str = ",") -> str:
    """The log above in another dialect; ``words`` are those for out and in."""
    form = stamp if callable(stamp) else lambda time: time.strftime(stamp)
    rows = [sep.join((form(time), words[step > 0], car)) for time, step, car in ROWS]
    return "\n".join([header.replace(",", sep), *rows]) + "\n"


PLAIN = "time,event,car"
DIALECTS: dict[str, tuple[str, str, dict[str, str]]] = {
    "iso": (written(PLAIN, "%Y-%m-%d %H:%M:%S", ("out", "in")), "utf-8", {}),
    "iso T, no seconds": (written(PLAIN, "%Y-%m-%dT%H:%M", ("OUT", "IN")), "utf-8-sig", {}),
    "offset": (written(PLAIN, "%Y-%m-%dT%H:%M:%S+02:00", ("Exit", "Entry")), "utf-8", {}),
    "German": (
        written("Zeitpunkt,Richtung,Kennzeichen", "%d.%m.%Y %H:%M", ("Ausfahrt", "Einfahrt"), ";"),
        "cp1252",
        {},
    ),
    "German, two columns": (
        written("Datum;Uhrzeit,Ereignis,Kfz", "%d.%m.%Y;%H:%M:%S", ("AUS", "EIN"), ";"),
        "utf-16",
        {},
    ),
    "French": (written("Horodatage,Sens,Immatriculation", "%d/%m/%Y %Hh%M", ("sortie", "entrée"), ";"), "utf-8", {}),
    "American": (written("Date/Time,Direction,Plate", "%m/%d/%Y %I:%M:%S %p", ("Out", "In")), "utf-8", {}),
    "American, in many words": (
        written("Transaction Time,Direction,License Plate", "%m/%d/%Y %I:%M:%S %p", ("Exit", "Entry")),
        "utf-8",
        {},
    ),
    "French, in many words": (
        written("Date et heure,Sens,Immatriculation", "%d/%m/%Y %Hh%M", ("Sortie", "Entrée"), ";"),
        "cp1252",
        {},
    ),
    "Korean": (
        written(
            "일시,구분,차량번호",
            lambda t: f"{t:%Y-%m-%d} {'오전' if t.hour < 12 else '오후'} {t:%I:%M:%S}",
            ("출차", "입차"),
        ),
        "utf-8-sig",
        {},
    ),
    "day first by its dates": (
        written("Fecha,Sentido,Matrícula", "%d/%m/%y %H:%M", ("salida", "entrada"), "\t"),
        "cp1252",
        {},
    ),
    "Oracle": (written(PLAIN, "%d-%b-%Y %H:%M:%S", ("out", "in"), "|"), "utf-16-le", {}),
    "month in words": (written(PLAIN, '"%B %d, %Y %I:%M %p"', ("out", "in")), "utf-8", {}),
    "digits": (written(PLAIN, "%Y%m%d%H%M%S", ("out", "in")), "utf-8", {}),
    "Excel, decimal comma": (
        written(
            PLAIN,
            lambda t: f"{(t - datetime(1899, 12, 30)) / timedelta(days=1):.6f}".replace(".", ","),
            ("-1", "+1"),
            ";",
        ),
        "utf-8",
        {},
    ),
    "epoch": (
        written(PLAIN, lambda t: f"{(t - datetime(1970, 1, 1) - timedelta(hours=2)).total_seconds():.0f}", ("o", "i")),
        "utf-8",
        {"zone": "Europe/Berlin"},
    ),
    "milliseconds": (
        written(PLAIN, lambda t: f"{(t - datetime(1970, 1, 1)).total_seconds() * 1000:.0f}", ("out", "in")),
        "utf-8",
        {},
    ),
    "own names, 0 and 1": (
        "Export of gate 2\n\n" + written("wann,was,wer", "%d.%m.%Y %H:%M:%S,250", ("0", "1"), ";"),
        "utf-8",
        {"columns": "time=wann,event=was,car=wer", "events": "in=1,out=0"},
    ),
    "newest first, quoted, more columns": (
        "\r\n".join(
            [
                '"gate","time","event","car"',
                *(f'"1, north","{t}","{("out", "in")[s > 0]}","{c}"' for t, s, c in ROWS[::-1]),
            ]
        ),
        "utf-8",
        {},
    ),
}


@pytest.mark.parametrize("name", DIALECTS)
def test_the_same_log_in_any_dialect_is_the_same_log(tmp_path: Path, name: str) -> None:
    text, encoding, given = DIALECTS[name]
    log = log_of(tmp_path, text, parse_dialect(**given), encoding)
    plain = log_of(tmp_path, DIALECTS["iso"][0])
    assert log.first_day == date(2024, 5, 13)
    assert log.hours == pytest.approx(plain.hours, abs=0.001)
    assert log.steps.tolist() == [1, 1, -1, 1, -1, -1]
    assert log.cars == tuple(car for _, _, car in ROWS)
    assert fit_profile(log, 9, "x").arrivals == pytest.approx(fit_profile(plain, 9, "x").arrivals, abs=0.001)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("when,event\n", "row 1: 'when,event': no column for the time"),
        ("when;who\n", "no column for the time and the event"),
        ("time,event\n", "no movements"),
        ("\n\n", "no movements"),
        ("time,event\nnoon,in\n", "row 2: time: 'noon': give such as 2024-05-04 13:07:30"),
        ("time,event\n2024-05-04,in\n", "row 2: time: '2024-05-04': give such as"),
        ("time,event\n2024-02-30 10:00,in\n", "row 2: time: .*no such day or time"),
        ("time,event\n2024-05-04 10:61,in\n", "row 2: time: .*no such day or time"),
        ("time,event\n2024-05-04 13:00 PM,in\n", "row 2: time: .*no such day or time"),
        ("time,event\n2024-05-04 10:30,on\n", "row 2: event: 'on': give in or out, .*--events"),
        (
            "time,event\n2024-05-04 10:30,1\n2024-05-04 10:40,0\n",
            "event: '1'.*--events in=1,out=0 .the log has '1', '0'",
        ),
        ("time,event\n04/05/2024 10:30,in\n", "row 2: .*day or month first.*--dates dmy or --dates mdy"),
        ("time,event\n14/05/2024 10:30,in\n04/15/2024 10:30,in\n", "row 3: .*other rows have the day first"),
        ("time,event\n2024-05-04 10:30Z,in\n2024-05-04 10:40,in\n", "row 3: .*no offset from UTC"),
        ("time,event\n2024-05-04T10:30+01:00,in\n2024-05-04T10:40+02:00,in\n", "--zone with the garage's"),
        ("time,event\n17.5,in\n", "row 2: .*counts from no known day"),
        ("time,zeit,event\n2024-05-04 10:30,x,in\n", "'time' and 'zeit' may be the time; give --columns time=NAME"),
        ("time,event\n2024-05-04 10:30,in\n2024-05-04 11:30,\n", "all rows say in or are blank"),
        ('time,event\n2024-05-04 10:30,"in\n', "can't be read as a CSV file"),
    ],
)
def test_what_a_log_leaves_open_is_asked_for_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        log_of(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"columns": "tme=x"}, "--columns: 'tme=x'"),
        ({"columns": "time=a,time=b"}, "at most once"),
        ({"columns": "time=wann"}, "--columns time=wann: no such column"),
        ({"columns": "car=wer"}, "--columns: car=wer: .*the header has time, event, car"),
        ({"events": "in=1"}, "a word for in and one for out"),
        ({"events": "in=1,out=0"}, "finds no movement in"),
        ({"dates": "ymd"}, "--dates: 'ymd'"),
        ({"zone": "Berlin"}, "--zone"),
    ],
)
def test_mistakes_in_the_dialect(tmp_path: Path, given: dict[str, str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        log_of(tmp_path, DIALECTS["iso"][0], parse_dialect(**given))


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    for data in (b"\xff\xfe\x00", b"\x00\x00\x00\x00", b"\x81\x8d" * 40, b""):
        (tmp_path / "log.csv").write_bytes(data)
        with pytest.raises(InputError):
            read_gate_log(tmp_path / "log.csv")


def test_both_orders_of_a_doubtful_date_can_be_given(tmp_path: Path) -> None:
    text = "time,event\n04/05/2024 10:30,in\n"
    assert log_of(tmp_path, text, Dialect(dates="dmy")).first_day == date(2024, 5, 4)
    assert log_of(tmp_path, text, Dialect(dates="mdy")).first_day == date(2024, 4, 5)


def test_offsets_of_summer_and_winter_count_by_one_clock(tmp_path: Path) -> None:
    text = "time,event\n2024-03-30T10:30+01:00,in\n2024-04-01T10:30+02:00,out\n"
    log = log_of(tmp_path, text, Dialect(zone="Europe/Berlin"))
    assert log.hours.tolist() == [10.5, 58.5]


def test_movements_of_one_moment_stand_for_their_day(tmp_path: Path) -> None:
    log = log_of(tmp_path, "time,event\n" + "2024-05-04 10:30,in\n" * 3)
    assert log.covered == ((0.0, 24.0),)
    assert fit_profile(log, 3, "x").arrivals_between(10, 11) == pytest.approx(1)


def test_rows_left_out_are_counted(tmp_path: Path) -> None:
    text = "time,event\n2024-05-04 10:30,in\n,\n2024-05-04 10:40,\n2024-05-04 10:50,out\n2024-05-04 10:55,paid\n"
    log = log_of(tmp_path, text, parse_dialect(events="in=in,out=out"))
    assert len(log.steps) == 2
    assert log.notes[1:3] == ("left out: 1 rows without an event", "left out: 1 rows with event 'paid'")


# --- missed reads -----------------------------------------------------------------------------------------------------

#: Stays of an hour, all day long, so that typical and longest stay are known.
OTHERS = {f"other{hour}": [(float(hour), 1), (hour + 1.0, -1)] for hour in range(23)}


@pytest.mark.parametrize(
    ("moves", "mended", "words"),
    [
        ([(8.0, 1), (9.0, -1)], [(8.0, 1), (9.0, -1)], ""),
        ([(8.0, 1), (8.01, 1), (9.0, -1)], [(8.0, 1), (9.0, -1)], "1 movements read twice"),
        ([(8.0, 1)], [(8.0, 1), (9.0, -1)], "1 entries without an exit"),
        ([(8.0, -1)], [(7.0, 1), (8.0, -1)], "1 exits without an entry"),
        ([(8.0, 1), (12.0, 1), (12.5, -1)], [(8.0, 1), (9.0, -1), (12.0, 1), (12.5, -1)], "1 entries without an exit"),
        ([(8.0, 1), (8.5, 1), (9.5, -1)], [(8.0, 1), (8.25, -1), (8.5, 1), (9.5, -1)], "1 entries without an exit"),
        ([(8.0, 1), (8.5, -1), (12.0, -1)], [(8.0, 1), (8.5, -1), (11.0, 1), (12.0, -1)], "1 exits without an entry"),
        ([(8.0, -1), (8.3, 1)], [(8.0, 1), (8.3, -1)], "1 pairs the wrong way round"),
        ([(8.0, 1), (9.0, -1), (9.0, 1), (9.6, -1)], [(8.0, 1), (9.0, -1), (9.0, 1), (9.6, -1)], ""),
        ([(0.5, -1), (8.0, 1), (9.0, -1)], [(0.5, -1), (8.0, 1), (9.0, -1)], ""),  # was there before
        ([(8.0, 1), (9.0, -1), (23.5, 1)], [(8.0, 1), (9.0, -1), (23.5, 1)], ""),  # stays beyond
    ],
)
def test_missed_reads_are_mended(moves: list[tuple[float, int]], mended: list[tuple[float, int]], words: str) -> None:
    found = mend({**OTHERS, "car": moves}, [], 0.0, 24.0)
    assert np.array(found.moves["car"]) == pytest.approx(np.array(mended))
    assert words in " ".join(found.notes)
    assert len(found.notes) == bool(words)
    assert all(found.moves[car] == others for car, others in OTHERS.items())


def test_a_movement_without_a_plate_is_the_one_that_a_car_lacks() -> None:
    found = mend({**OTHERS, "car": [(8.0, 1)]}, [(3.0, -1), (8.8, -1)], 0.0, 24.0)
    assert found.moves["car"] == [(8.0, 1), (8.8, -1)]
    assert found.moves["no plate 1"] == [(2.0, 1), (3.0, -1)]
    pair = mend(OTHERS, [(3.0, 1), (3.4, -1)], 0.0, 24.0)
    assert pair.moves["no plate 1"] == [(3.0, 1), (3.4, -1)]
    assert not pair.notes
    assert mend({}, [(3.0, 1), (3.4, -1)], 0.0, 24.0).unread == [(3.0, 1), (3.4, -1)]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.dictionaries(
        st.sampled_from("abc"),
        st.lists(st.tuples(st.integers(0, 50).map(float), st.sampled_from([-1, 1])), min_size=1, max_size=12),
    )
)
def test_whatever_was_read_movements_alternate_afterwards(cars: dict[str, list[tuple[float, int]]]) -> None:
    for moves in mend(cars, [], 0.0, 50.0).moves.values():
        assert all(a[1] != b[1] and a[0] <= b[0] for a, b in pairwise(moves))


# --- fit --------------------------------------------------------------------------------------------------------------

RATES = np.where(np.arange(24) < 6, 0.5, np.where(np.arange(24) < 20, 30.0, 8.0))
LEAVING = 1.0


def poisson_log(rng: np.random.Generator, days: int) -> list[Row]:
    """Cars that come with ``RATES`` an hour from a Monday on, and stay an exponential time of mean ``1 / LEAVING``."""
    came = np.concatenate([d * 24 + h + rng.random(rng.poisson(RATES[h])) for d in range(days) for h in range(24)])
    left = came + rng.exponential(1 / LEAVING, len(came))
    rows = [(MONDAY + timedelta(hours=hour), 1, f"c{k}") for k, hour in enumerate(came.tolist())]
    return rows + [(MONDAY + timedelta(hours=hour), -1, f"c{k}") for k, hour in enumerate(left.tolist())]


@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    begin=st.floats(0, 30),
    length=st.floats(60, 110),
    plates=st.booleans(),
    form=st.sampled_from([("%Y-%m-%d %H:%M:%S", "time,event,car", ","), ("%d.%m.%Y %H:%M", "Zeit,Richtung,Kfz", ";")]),
)
def test_a_log_cut_anywhere_gives_its_rates_back(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    begin: float,
    length: float,
    plates: bool,
    form: tuple[str, ...],
) -> None:
    rng = np.random.default_rng(seed)
    first, last = MONDAY + timedelta(hours=begin), MONDAY + timedelta(hours=begin + length)
    rows = [row for row in poisson_log(rng, 6) if first <= row[0] < last]
    rng.shuffle(rows)
    stamp, header, sep = form
    lines = [sep.join((t.strftime(stamp), ("OUT", "IN")[s > 0], car if plates else "")) for t, s, car in rows]
    log = log_of(tmp_path_factory.mktemp("log"), "\n".join([header.replace(",", sep), *lines]))
    fitted = fit_profile(log, 100, "x")
    hours = (
        np.array([min(b, begin + length) - max(a, begin) for a in range(144) if (b := a + 1)])
        .clip(0)
        .reshape(6, 24)
        .sum(axis=0)
    )
    for part in (slice(0, 6), slice(6, 20), slice(20, 24)):
        expected = (RATES * hours)[part].sum()
        found = 100 * (np.array(fitted.arrivals) * log.covered_hours().sum(axis=0))[part].sum()
        assert abs(found - expected) < 5 * np.sqrt(expected) + 2
        assert found / log.covered_hours().sum(axis=0)[part].sum() == pytest.approx(
            RATES[part].mean(), rel=5 / np.sqrt(expected), abs=0.5
        )
    # about 2,000 departures, of which those of cars inside at the start are unknown without plates
    leaving = np.array(fitted.leaving)[6:20].mean()
    assert leaving == pytest.approx(LEAVING, rel=0.15)
    assert "outage" not in " ".join(log.notes)


@pytest.mark.parametrize("share", [0.0, 0.03])
def test_missed_reads_do_not_move_the_fit(tmp_path: Path, share: float) -> None:
    rng = np.random.default_rng(1)
    rows = poisson_log(rng, 5)
    lines = [
        f"{t},{('out', 'in')[s > 0]},{car if rng.random() >= share else ''}"
        for t, s, car in rows
        if rng.random() >= share
    ]
    fitted = fit_profile(log_of(tmp_path, "\n".join(["time,event,car", *lines])), 100, "x")
    assert 100 * fitted.arrivals_between(0, 24) == pytest.approx(RATES.sum(), rel=0.05)
    assert np.array(fitted.leaving)[6:20].mean() == pytest.approx(LEAVING, rel=0.1)
    assert np.mean([fitted.observed[hour + 0.5] for hour in range(8, 20)]) == pytest.approx(0.3, rel=0.1)


def test_an_outage_is_no_lack_of_demand(tmp_path: Path) -> None:
    rows = poisson_log(np.random.default_rng(3), 5)
    begin, end = MONDAY + timedelta(hours=56), MONDAY + timedelta(hours=64)
    lines = [f"{t},{('out', 'in')[s > 0]},{car}" for t, s, car in rows if not begin <= t < end]
    log = log_of(tmp_path, "\n".join(["time,event,car", *lines]))
    (note,) = (note for note in log.notes if note.startswith("outage: "))
    assert "2024-05-08 0" in note or "2024-05-08 08:0" in note
    hole = (log.covered[0][1], log.covered[1][0])
    assert hole == pytest.approx((56.0, 64.0), abs=0.3)
    assert 100 * fit_profile(log, 100, "x").arrivals_between(0, 24) == pytest.approx(RATES.sum(), rel=0.05)
    kept = read_gate_log(tmp_path / "log.csv", keep_gaps=True)
    assert 100 * fit_profile(kept, 100, "x").arrivals_between(8, 16) == pytest.approx(RATES[8:16].sum() * 0.8, rel=0.05)


def test_a_day_of_the_week_that_is_always_quiet_is_no_outage() -> None:
    hours = np.concatenate([24 * d + 8 + np.arange(120) / 10 for d in range(28) if d % 7 != 6])
    assert outages(hours, MONDAY.date(), (0.0, 28 * 24.0)) == []
    holiday = hours[hours // 24 != 9]
    assert [(a // 24, b // 24) for a, b in outages(holiday, MONDAY.date(), (0.0, 28 * 24.0))] == [(8, 10)]


def write_log(path: Path, name: str, days: int) -> None:
    """A log of Mondays and Tuesdays ... of a profile; cars that stay overnight are let out at 23:59."""
    rows = ["time, event, car"]
    for number in range(days):
        profile = PROFILES[name]
        demand = make_demand(ProfileTraffic(name=name), SLOTS, number, Path())
        came, left = (_times(demand, kind, profile.hours[0]) for kind in (RequestKind.PARK, RequestKind.RETRIEVE))
        moves = [(hour, "in") for hour in [*[profile.hours[0]] * len(demand.initial_cars), *came]]
        moves += [(hour, "out") for hour in [*left, *[23.99] * (len(moves) - len(left))]]
        rows += [f"{MONDAY + timedelta(days=number, seconds=int(h * 3600))}, {e}," for h, e in moves]
    path.write_text("\n".join(rows[:1] + rows[:0:-1]) + "\n", encoding="utf-8")


def _times(demand: Demand, kind: RequestKind, first: float) -> list[float]:
    return [first + request.time_s / 3600 for request in demand.phases[0] if request.kind is kind]


def test_a_profile_fitted_to_a_log_gives_its_rates_back(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", "mall-weekday", 15)
    fitted = fit_profile(read_gate_log(tmp_path / "log.csv"), SLOTS, "a log made by a profile", "all")
    true = PROFILES["mall-weekday"]
    for hour in range(9, 19):
        assert fitted.arrivals_between(hour, hour + 1) == pytest.approx(true.arrivals_between(hour, hour + 1), rel=0.1)
        assert fitted.leaving[hour] == pytest.approx(true.leaving[hour - 8], rel=0.1)
        # the cars that are there at 8 h come through the gate at once, and are not quite forgotten at 10 h
        assert hour < 11 or fitted.occupancy_at(hour) == pytest.approx(true.occupancy_at(hour), rel=0.1)
    assert fitted.occupancy == 0


def test_days_of_the_week_are_picked(tmp_path: Path) -> None:
    log = log_of(tmp_path, "time,event\n2024-05-04 10:30,in\n2024-05-04 11:30,out\n2024-05-06T09:00,in\n")
    saturday = fit_profile(log, 10, "x", "sat")
    assert saturday.arrivals_between(10, 11) == pytest.approx(0.1)
    assert saturday.arrivals_between(9, 10) == 0
    assert fit_profile(log, 10, "x", "weekdays").arrivals_between(9, 10) == pytest.approx(0.1)
    with pytest.raises(InputError, match="has no such day"):
        fit_profile(log, 10, "x", "tue")


def test_a_fit_says_how_many_days_it_rests_on(tmp_path: Path) -> None:
    two = "time,event\n2024-05-04 00:00,in\n2024-05-04 23:30,out\n2024-05-11 00:10,in\n2024-05-11 23:59,out\n"
    log = log_of(tmp_path, two)
    assert basis(log, "weekdays") == ["days covered: 5.0 Mondays to Fridays"]
    lines = basis(log, "sat")
    assert lines[0] == "days covered: 2.0 Saturdays"
    assert lines[1].startswith("warning: the log has fewer than 4 Saturdays")
    assert "no log of the hours 0, 1, 2" in basis(cut(log, datetime(2024, 5, 11, 3), None), "sat")[2]


def test_a_log_that_does_not_fit_its_garage(tmp_path: Path) -> None:
    log = log_of(tmp_path, "time,event\n2024-05-04 10:30,out\n2024-05-04 11:30,in\n2024-05-04 12:30,in\n")
    with pytest.raises(InputError, match="--slots: 1: up to 2 cars"):
        fit_profile(log, 1, "x")
    with pytest.raises(InputError, match="--initial: 0: at least 1 cars"):
        fit_profile(log, 5, "x", initial=0)


# --- replay -----------------------------------------------------------------------------------------------------------


def test_a_logged_day_is_replayed_car_by_car(tmp_path: Path) -> None:
    log = cut(log_of(tmp_path, DIALECTS["iso"][0]), *window("2024-05-13", "09:00", None))
    assert requests_of(log) == [
        ("0", "inside", "HH-AB 12"),
        ("2400", "park", "MÜ-C 3"),
        ("10800", "retrieve", "HH-AB 12"),
        ("16200", "park", "B-X 7"),
    ]
    later = cut(log_of(tmp_path, DIALECTS["iso"][0]), *window("2024-05-14", None, None))
    assert requests_of(later)[:2] == [("0", "inside", "MÜ-C 3"), ("0", "inside", "B-X 7")]
    assert later.notes[-1] == "note: by its movements the log covers 2024-05-13 06:30 to 2024-05-14 01:40 only"


def test_cars_without_plates_leave_in_the_order_in_which_they_came(tmp_path: Path) -> None:
    text = "time,event\n2024-05-04 10:00,out\n2024-05-04 10:30,in\n2024-05-04 11:00,in\n2024-05-04 12:00,out\n"
    log = log_of(tmp_path, text)
    rows = requests_of(log, 3)
    inside = [car for _, kind, car in rows if kind == "inside"]
    assert len(inside) == 3
    assert [car for _, kind, car in rows if kind == "retrieve"] == inside[:2]
    with pytest.raises(InputError, match="--initial: 0: at least 1 cars"):
        requests_of(log, 0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("2026-13-07", None, None), "--date: '2026-13-07'"),
        (("2026-03-07", "8 h", None), "--from: '8 h': give such as 08:00"),
        ((None, "08:00", None), "--from: '08:00': give such as '2026-03-07 08:00'"),
        (("2026-03-07", "12:00", "11:00"), "--to: '11:00': give a moment after"),
    ],
)
def test_mistakes_in_the_window(given: tuple[str | None, str | None, str | None], words: str) -> None:
    with pytest.raises(InputError, match=words):
        window(*given)


def test_a_day_outside_the_log(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no movement in this time; the log covers 2024-05-13"):
        cut(log_of(tmp_path, DIALECTS["iso"][0]), *window("2024-05-20", None, None))


def test_a_replayed_log_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = sorted(poisson_log(np.random.default_rng(2), 1))
    lines = [f"{t:%d.%m.%Y %H:%M:%S};{('Ausfahrt', 'Einfahrt')[s > 0]};{car} ü,{car}" for t, s, car in rows[::3]]
    (tmp_path / "log.csv").write_text("\n".join(["Zeit;Richtung;Kennzeichen", *lines]), encoding="cp1252")
    given = ["--date", "2024-05-06", "--from", "08:00", "--to", "09:00", "--out", str(tmp_path / "day.csv")]
    with pytest.raises(SystemExit, match="0"):
        main(["requests", str(tmp_path / "log.csv"), *given])
    said = capsys.readouterr().out
    assert "day.csv: 2024-05-06 08:00 to 09:00: " in said
    (tmp_path / "day.yaml").write_text(
        "garage: map1_thesis\nagvs: 4\nplant: discrete\nworkload: {kind: csv, path: day.csv}\n", encoding="utf-8"
    )
    with pytest.raises(SystemExit, match="0"):
        main(["run", str(tmp_path / "day.yaml"), "--out", str(tmp_path / "run"), "--no-report", "-q"])
    demand = Csv(path="day.csv").demand(61, 0, tmp_path)
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert f"{len(demand.initial_cars)} cars inside at the start" in said
    assert demand.total > 15
    assert metrics["tasks_done"] == demand.total


def test_the_commands_print_what_they_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [f"{t},{s},{car}" for t, s, car in poisson_log(np.random.default_rng(2), 2)]
    (tmp_path / "log.csv").write_text("\n".join(["when,way,car", *lines]))
    told = ["--columns", "time=when,event=way", "--events", "in=1,out=-1"]
    with pytest.raises(SystemExit, match="0"):
        main(["fit-profile", str(tmp_path / "log.csv"), "--slots", "90", "--out", str(tmp_path / "p.yaml"), *told])
    said = capsys.readouterr().out
    assert "read: " in said
    assert "warning: the log has fewer than 4 Mondays to Fridays" in said
    assert "fitted to 48 h on 3 days" in said
    with pytest.raises(SystemExit, match="2"):
        main(["fit-profile", str(tmp_path / "log.csv"), "--slots", "90", "--out", str(tmp_path / "q.yaml")])
    assert "no column for the time" in capsys.readouterr().err
    assert not (tmp_path / "q.yaml").exists()


def test_a_log_of_a_korean_windows(tmp_path: Path) -> None:
    rows = ["일시,구분,차량번호", "2026-03-02 08:00:00,입차,12가3456", "2026-03-02 09:00:00,출차,12가3456"]
    (tmp_path / "log.csv").write_text("\n".join(rows), encoding="cp949")
    assert set(read_gate_log(tmp_path / "log.csv").cars) == {"12가3456"}


@pytest.mark.parametrize("word", ["ÄNDERUNG", "ÄÖÜ", "GROSSMÄRKTE", "ZÜRICH", "CITROËN", "ÉCOLE", "AÇÃO", "SEÑAL", "Ö"])
def test_western_letters_are_not_taken_for_korean(tmp_path: Path, word: str) -> None:
    (tmp_path / "log.csv").write_text(f"time,event,car\n2026-03-02 08:00,in,{word}\n", encoding="cp1252")
    assert read_gate_log(tmp_path / "log.csv").cars == (word,)
