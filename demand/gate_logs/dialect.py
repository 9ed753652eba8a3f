"""From a gate log's text to movements: encoding, separator, header, words for in and out.

Logs come from many makers. What can be told from the file itself is recognised; what can't is asked for in one line.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from demand.gate_logs.stamps import is_stamp, read_stamps
from sumo_nets.errors import InputError
from sumo_nets.input_file import MEGABYTE, read_bytes
from sumo_nets.wording import shown

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar"}
#: A header stands within the first lines; titles may come before it.
_HEADER_LINES = 20
#: Bytes and columns of a log.
_MOST_BYTES, _MOST_COLUMNS = 200 * MEGABYTE, 1000


def _words(text: str) -> frozenset[str]:
    return frozenset(unicodedata.normalize("NFKD", text).split())


#: Role of a column -> names it is known by, without capitals, accents and punctuation.
_COLUMNS: Mapping[str, frozenset[str]] = {
    "date": _words("date datum tag day jour fecha dia data giorno dato 날짜 일자"),
    "time": _words(
        "time timestamp datetime dateandtime eventtime transactiontime timeofday moment zeit zeitpunkt"
        " zeitstempel uhrzeit datumzeit datumuhrzeit heure horodatage dateheure dateetheure hora fechahora"
        " fechayhora momento ora dataora orario datahora tijd tijdstip datumtijd tidpunkt tid czas 일시 시간 시각"
    ),
    "event": _words(
        "event eventtype direction dir type movement inout entryexit action kind ereignis richtung fahrtrichtung"
        " bewegung vorgang einaus sens evenement mouvement entreesortie evento direccion sentido movimiento direzione"
        " movimento direcao richting gebeurtenis beweging riktning kierunek 구분 입출차 입출차구분"
    ),
    "car": _words(
        "car plate licenceplate licenseplate numberplate platenumber plateno registration vrm vehicle vehicleid ticket"
        " ticketid ticketnumber ticketno card cardid kennzeichen nummernschild kfz fahrzeug ticketnummer karte plaque"
        " immatriculation vehicule matricula placa vehiculo targa veicolo veiculo kenteken voertuig 차량번호 차번호"
    ),
}
#: Words of one meaning only.
_IN = _words(
    "in i + +1 entry enter entered entrance arrival arrive arrived checkin ein einfahrt eingefahren einfahren zufahrt"
    " ankunft entree entrer arrivee entrada ingreso entrata ingresso entra inrit inrijden binnen infart wjazd 입차"
)
_OUT = _words(
    "out o - -1 exit exited leave left departure depart departed checkout aus ausfahrt ausgefahren ausfahren abfahrt"
    " sortie sortir salida egreso uscita esce saida uit uitrit uitrijden buiten utfart wyjazd 출차"
)
_EVENTS: Mapping[str, int] = {**dict.fromkeys(_IN, 1), **dict.fromkeys(_OUT, -1)}
#: What is written where a plate was not read.
_NO_PLATE = _words("UNKNOWN UNBEKANNT INCONNU NA NAN NONE NULL NOPLATE NOREAD UNREAD KEINE KEINS")


@dataclass(frozen=True)
class Dialect:
    """What a log's file doesn't say about itself.

    Attributes:
        columns: role (date, time, event, car) -> the column's name in the header; the others are recognised.
        events: word -> +1 for in, -1 for out; if given, rows with any other word are left out.
        dates: "dmy" or "mdy" for dates such as 04/05/2024, "" if they tell by themselves.
        zone: time zone whose clock counts, such as "Europe/Berlin", for stamps that carry an offset or count seconds.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    dates: str = ""
    zone: str = ""


@dataclass(frozen=True)
class Movements:
    """What the file says, row by row.

    Attributes:
        table: one row per movement in the file's order: ``time`` (the clock on the wall), ``step`` (+1 in, -1 out),
            ``car`` (as written; "" if not read).
        notes: what was recognised and what was left out, in words.
    """

    table: pd.DataFrame
    notes: tuple[str, ...]


def parse_dialect(columns: str = "", events: str = "", dates: str = "", zone: str = "") -> Dialect:
    """The dialect that a user gives in words.

    Args:
        columns: such as ``time=Zeitpunkt,event=Richtung``.
        events: such as ``in=1,out=0``; a key may come several times.
        dates: see :class:`Dialect`.
        zone: see :class:`Dialect`.

    Returns:
        The dialect.

    Raises:
        InputError: an unknown role, event or order of dates.
    """
    roles = _pairs(columns, "--columns", tuple(_COLUMNS))
    words = _pairs(events, "--events", ("in", "out"))
    if len(dict(roles)) < len(roles):
        raise InputError(f"--columns: {shown(columns)}: give each of {', '.join(_COLUMNS)} at most once")
    if dates not in ("", "dmy", "mdy"):
        raise InputError(f"--dates: {shown(dates)}: give dmy (day first) or mdy (month first)")
    if words and {side for side, _ in words} != {"in", "out"}:
        raise InputError(f"--events: {shown(events)}: give a word for in and one for out, such as in=1,out=0")
    return Dialect(dict(roles), {word: 1 if side == "in" else -1 for side, word in words}, dates, zone)


def read_movements(path: Path, dialect: Dialect) -> Movements:
    """Read a log's rows.

    Args:
        path: the file.
        dialect: what it doesn't say about itself.

    Returns:
        Its movements.

    Raises:
        InputError: the file can't be read, or something in it can't be understood; the message says what to give.
    """
    text, encoding = _decode(path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    number, separator, header = _find_header(lines, dialect, path)
    roles = _roles(header, dialect.columns, path, number)
    rows = _read_rows(lines[number:], separator, len(header), path)
    rows.index += number + 1
    rows = rows[(rows != "").any(axis=1)]
    times = rows[roles.get("time", roles.get("date", 0))]
    if {"date", "time"} <= set(roles) and not times.map(is_stamp).any():
        times = rows[roles["date"]] + " " + times
    steps = _steps(rows[roles["event"]], dialect, path)
    kept = steps != 0
    if not kept.any():
        raise InputError(f"{path}: has no movements")
    time, form = read_stamps(times[kept], path, dialect.dates, dialect.zone)
    cars = rows[roles["car"]].map(_plate)[kept] if "car" in roles else ""
    named = ", ".join(f"{header[place]} ({role})" for role, place in roles.items())
    notes = [f"read: {kept.sum()} movements, {encoding}, {_SEPARATORS[separator]}, {form}; columns: {named}"]
    return Movements(
        pd.DataFrame({"time": time, "step": steps[kept], "car": cars}),
        (*notes, *_left_out(rows[roles["event"]][~kept])),
    )


def _pairs(text: str, option: str, keys: tuple[str, ...]) -> list[tuple[str, str]]:
    found = []
    for item in re.split(rf",(?=(?:{'|'.join(keys)})=)", text) if text else ():
        key, equals, value = (part.strip() for part in item.partition("="))
        if key not in keys or not equals:
            raise InputError(f"{option}: {shown(item)}: give such as {keys[0]}=NAME; the keys are {', '.join(keys)}")
        found.append((key, value))
    return found


def _decode(path: Path) -> tuple[str, str]:
    """Text and encoding of a file: by its mark, by UTF-16's zeros, UTF-8 if it can be, or Korean if it is."""
    try:
        data = read_bytes(path, _MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: can't be read as a CSV file: {error.strerror}") from None
    sample = data[:4096]
    zeros = sample.count(0) > len(sample) / 4
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    elif zeros:
        encodings = ["utf-16-be" if sample[0] == 0 else "utf-16-le"]
    else:
        encodings = ["utf-8-sig", "cp949" if _is_korean(data) else "cp1252"]
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text, encoding.removesuffix("-sig")
    raise InputError(f"{path}: can't be read as a CSV file: is neither UTF-8, UTF-16, Korean nor Windows-1252 text")


def _is_korean(data: bytes) -> bool:
    """Whether bytes are text of a Korean Windows: beyond ASCII there are Hangul syllables alone, also some in a row.

    Nearly any bytes can be read as Windows-1252. Its accented letters stand alone or in pairs, which make no syllable,
    or a single one.
    """
    try:
        text = data.decode("cp949")
    except UnicodeDecodeError:
        return False
    return re.search("[가-힣]{2}", text) is not None and all("가" <= x <= "힣" for x in text if not x.isascii())


def _find_header(lines: list[str], dialect: Dialect, path: Path) -> tuple[int, str, list[str]]:
    """Number of the header's row (the first is 1), the separator, and the columns' names."""
    first = next((number for number, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise InputError(f"{path}: has no movements")
    for number, line in enumerate(lines[:_HEADER_LINES]):
        splits = {separator: _split(line, separator) for separator in _SEPARATORS}
        fitting = [s for s, cells in splits.items() if not _missing(_candidates(cells, dialect.columns))]
        if fitting:
            separator = max(fitting, key=lambda s: len(splits[s]))
            return number + 1, separator, splits[separator]
    cells = max((_split(lines[first], separator) for separator in _SEPARATORS), key=len)
    missing = _missing(_candidates(cells, dialect.columns))
    given = [f"{role}={name}" for role, name in dialect.columns.items() if _bare(name) not in map(_bare, cells)]
    wrong = (
        f"--columns {','.join(given)}: no such column" if given else f"no column for the {' and the '.join(missing)}"
    )
    header = shown(",".join(cells))
    raise InputError(
        f"{path}: row {first + 1}: {header}: {wrong}; give such as --columns time=NAME,event=NAME,car=NAME"
    )


def _split(line: str, separator: str) -> list[str]:
    try:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:  # a cell longer than any header's
        return []
    return cells if len(cells) <= _MOST_COLUMNS else []


def _candidates(header: list[str], given: Mapping[str, str]) -> dict[str, list[int]]:
    """Role -> places of the columns that may have it."""
    taken = {_bare(name) for name in given.values()}
    found: dict[str, list[int]] = {}
    for role, names in _COLUMNS.items():
        wanted = {_bare(given[role])} if role in given else names - taken
        found[role] = [place for place, cell in enumerate(header) if _bare(cell) in wanted]
    return found


def _missing(candidates: Mapping[str, list[int]]) -> list[str]:
    """Roles that a header must have, and lacks."""
    absent = [] if candidates["time"] or candidates["date"] else ["time"]
    return absent if candidates["event"] else [*absent, "event (in or out)"]


def _roles(header: list[str], given: Mapping[str, str], path: Path, number: int) -> dict[str, int]:
    """Role -> place of its column."""
    candidates = _candidates(header, given)
    for role, places in candidates.items():
        if role in given and not places:
            raise InputError(f"--columns: {role}={given[role]}: {path}: the header has {', '.join(header)}")
        if len(places) > 1:
            names = " and ".join(shown(header[place]) for place in places)
            raise InputError(f"{path}: row {number}: {names} may be the {role}; give --columns {role}=NAME")
    return {role: places[0] for role, places in candidates.items() if places}


def _read_rows(lines: list[str], separator: str, width: int, path: Path) -> pd.DataFrame:
    """Cells as text; short rows are filled up with empty cells."""
    rows = [line.rstrip(separator + " \t") if separator != "\t" else line.rstrip() for line in lines]
    if not any(rows):
        raise InputError(f"{path}: has no movements")
    try:
        table = pd.read_csv(
            io.StringIO("\n".join(rows)),
            sep=separator,
            header=None,
            names=range(width),
            index_col=False,
            dtype=str,
            keep_default_na=False,
            skip_blank_lines=False,
            skipinitialspace=True,
        )
    except (pd.errors.ParserError, csv.Error) as error:
        raise InputError(f"{path}: can't be read as a CSV file: {' '.join(str(error).split())}") from None
    filled: pd.DataFrame = table.fillna("").apply(lambda column: column.str.strip())
    return filled


def _steps(words: pd.Series[str], dialect: Dialect, path: Path) -> pd.Series[int]:
    """+1, -1, or 0 for a row to leave out."""
    known = {_bare(word): step for word, step in dialect.events.items()} or _EVENTS
    meaning = {word: known.get(_bare(word), 0) for word in words.unique()}
    strange = [word for word, step in meaning.items() if word and not step]
    sides = set(meaning.values()) - {0}
    if dialect.events and len(sides) < 2:
        side = "out" if 1 in sides else "in"
        raise InputError(f"--events: {path}: finds no movement {side}; the log has {_some(words)}")
    if strange and not dialect.events:
        row = words.index[words == strange[0]][0]
        raise InputError(
            f"{path}: row {row}: event: {shown(strange[0])}: give in or out, or say which words mean so, such as"
            f" --events in=1,out=0 (the log has {_some(words)})"
        )
    if "" in meaning and not dialect.events and len(sides) == 1:
        only, other = ("in", "out") if 1 in sides else ("out", "in")
        word = next(word for word in meaning if word)
        raise InputError(
            f"{path}: event: all rows say {only} or are blank; give --events {only}={word},{other}= if blank means"
            f" {other}"
        )
    return words.map(meaning)


def _some(words: pd.Series[str]) -> str:
    return ", ".join(shown(word) for word in words.unique()[:6])


def _left_out(words: pd.Series[str]) -> list[str]:
    counts = words.value_counts(sort=False)
    return [
        f"left out: {count} rows {f'with event {shown(word)}' if word else 'without an event'}"
        for word, count in counts.items()
    ]


def _plate(text: str) -> str:
    bare = re.sub(r"[\W_]+", "", text).upper()
    return "" if not bare or bare in _NO_PLATE or set(bare) <= {"0"} else " ".join(text.split())


def _bare(text: str) -> str:
    """A word without capitals, accents, blanks and punctuation; +1 and -1 keep their signs."""
    if re.fullmatch(r"\s*[+-]1?\s*", text):
        return text.strip()
    flat = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return re.sub(r"[\W_]+", "", flat).casefold()
