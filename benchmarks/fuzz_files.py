"""Changes of files for :mod:`fuzz`: of bytes, of lines, of words and numbers, and of the parts of a document."""

from __future__ import annotations

import gzip
import random
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import yaml

#: Words in place of a number or word.
WORDS = (
    "-1", "0", "-0", "0.5", "1e300", "1e-300", "1e18", "1e400", ".nan", ".inf", "-.inf", "nan", "inf", "", "null", "~",
    "true", "[]", "{}", "[[]]", "2024-13-45", "2024-02-29", "0x" + "f" * 400, "9" * 25, "9" * 5000, "!!int abc",
    "!!binary x", "!!set {a}", "*a", "&a [*a]", "x" * 5000, "\u2603", "a\x00b", "\x1b[31m", "../../etc/passwd",
    "/dev/zero", "/dev/stdin", ".", "..", "/", "a/" * 3000, "1:1:1", "1_000", "+1", "0o17", "1e", "=", "<<", "'", '"',
    "\ud7ff", "\ufeff", "\u202e", "%s", "{0}", "${HOME}", "&#0;", "&lt;", "<a>", "1,2", "1 2", "-1e18", "2147483648",
    "9223372036854775808", "\u0661", "\U0001d7d8", "1..10", "1..2000000000", "file.py:run",
)  # fmt: skip
#: Values in place of a part of a document.
VALUES: tuple[Any, ...] = (
    -1, 0, 0.5, 1e300, 1e-300, 5e-324, 1e18, float("nan"), float("inf"), "", "x", None, [], {}, True, 10**30, 10**300,
    [[]], {"": 1}, {1: 2}, {None: 1}, {(1, 2): 3}, "\u2603", "x" * 5000, list(range(2000)), 2**31, 2**63, "1..5",
    "/dev/zero", "a\nb", [None], {"a": {"a": {"a": {}}}}, b"x",
)  # fmt: skip
_BYTES = (b"\x00", b"\xff", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\x85")
_TOKEN = re.compile(r"[\w.+-]+")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def mutated(name: str, content: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """A file with one to four changes.

    Args:
        name: its name, whose ending says what it is.
        content: what it holds.
        others: contents of files to splice it with.
        rng: what draws the changes.
    """
    if name.endswith(".gz"):
        plain = mutated(name.removesuffix(".gz"), gzip.decompress(content), (), rng) if _is_gzip(content) else content
        packed = gzip.compress(plain, 1)
        return _bytes(packed, (), rng) if rng.random() < 0.2 else packed
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(_changes(name))(content, others, rng)
    return content


def _is_gzip(content: bytes) -> bool:
    try:
        return len(gzip.decompress(content)) < 50_000_000
    except (OSError, EOFError, zlib.error):
        return False


_Change = Callable[[bytes, Sequence[bytes], random.Random], bytes]


def _changes(name: str) -> list[_Change]:
    text: list[_Change] = [_bytes, _lines, _words, _words, _numbers]
    if name.endswith((".yaml", ".yml")):
        return [*text, _parts, _parts, _parts, _aliases]
    if name.endswith(".xml"):
        return [*text, _tags, _tags, _encoding]
    if name.endswith(".png"):
        return [_bytes, _chunk, _chunk]
    if name.endswith(".csv"):
        return [*text, _cells, _cells, _as_other_text]
    return text


def _bytes(content: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    data = bytearray(content or b"x")
    k, n = rng.randrange(len(data)), rng.choice((1, 4, 100, 5000))
    what = rng.randrange(6)
    if what == 0:
        data[k] ^= 1 << rng.randrange(8)
    elif what == 1:
        del data[k : k + n]
    elif what == 2:
        del data[k:]
    elif what == 3:
        data[k:k] = data[k : k + n] * rng.choice((1, 2, 50))
    elif what == 4:
        data[k : k + rng.choice((0, 1, 4))] = rng.choice(
            (b"\x00", b"\xff", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\x85")
        )
    elif others:
        other = rng.choice(others)
        data[k:] = other[rng.randrange(len(other) + 1) :]
    return bytes(data)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def _bytes_of(text: str) -> bytes:
    return text.encode("utf-8", "replace")


def _lines(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    lines = _text(content).splitlines(keepends=True) or [""]
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        lines[k:k] = [lines[k]] * rng.choice((1, 1, 300))
    elif what == 1:
        del lines[k]
    elif what == 2:
        lines[k], lines[m] = lines[m], lines[k]
    elif what == 3:
        lines[k] = "  " + lines[k]
    else:
        lines[k] = lines[k].rstrip("\n") + lines[m]
    return _bytes_of("".join(lines))


def _swap(content: bytes, pattern: re.Pattern[str], new: Callable[[str], str], rng: random.Random) -> bytes:
    text = _text(content)
    found = list(pattern.finditer(text))
    if not found:
        return content
    place = rng.choice(found)
    return _bytes_of(text[: place.start()] + new(place[0]) + text[place.end() :])


def _words(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    tokens = _TOKEN.findall(_text(content)) or ["x"]
    return _swap(content, _TOKEN, lambda _: rng.choice(WORDS) if rng.random() < 0.7 else rng.choice(tokens), rng)


def _numbers(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    changes = (
        lambda s: f"-{s}",
        lambda s: s + "0" * rng.choice((1, 3, 9, 300)),
        lambda s: "0",
        lambda s: f"{s}.5",
        lambda s: s + rng.choice(("e9", "e-9")),
        lambda s: str(float(s) + 1),
        lambda s: rng.choice(WORDS),
    )
    return _swap(content, _NUMBER, lambda s: rng.choice(changes)(s[:300]), rng)


def _parts(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    try:
        data = yaml.load(_text(content), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return yaml.safe_dump(_part(data, data, rng), sort_keys=False, allow_unicode=True).encode("utf-8", "replace")
    except Exception:  # it is no YAML any more
        return content


def _part(value: Any, whole: Any, rng: random.Random) -> Any:
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(list(value))
        what = rng.random()
        if what < 0.08:
            return {k: v for k, v in value.items() if k != key}
        if what < 0.16:
            return {**value, rng.choice((f"{key}_", 1, None, "", "x" * 3000, True)): value[key]}
        return {**value, key: _part(value[key], whole, rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        k = rng.randrange(len(value))
        what = rng.random()
        if what < 0.08:
            return value[:k] + value[k + 1 :]
        if what < 0.16:
            return value + [value[k]] * rng.choice((1, 500))
        return [*value[:k], _part(value[k], whole, rng), *value[k + 1 :]]
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        changes = (lambda: -value, lambda: value * 1000, lambda: value + 1, lambda: value / 3, lambda: value * 1e18)
        return rng.choice(changes)()
    what = rng.random()
    return [value] * 3 if what < 0.1 else {"kind": value} if what < 0.2 else whole if what < 0.3 else rng.choice(VALUES)


def _aliases(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    """A value that stands for 10^9, in place of one."""
    levels = rng.choice((2, 5, 9, 30))
    laughs = "&z0 [x, 1]"
    for k in range(levels):
        laughs = f"&z{k + 1} [{laughs}{f', *z{k}' * 9}]"
    if rng.random() < 0.3:
        laughs = "{<<: [" + ", ".join(["&m {a: 1}", *["*m"] * 50]) + "]}"
    return _swap(content, re.compile(r"(?<=: )[^\n]+"), lambda _: laughs, rng)


def _tags(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    what = rng.randrange(4)
    if what == 0:
        return _swap(content, re.compile(r'"[^"]*"'), lambda _: f'"{rng.choice(WORDS)}"', rng)
    if what == 1:
        return _swap(content, re.compile(r' \w+="[^"]*"'), lambda _: "", rng)
    if what == 2:
        return _swap(content, re.compile(r"<[^>]*>"), lambda tag: tag * rng.choice((0, 2, 300)), rng)
    values = re.findall(r'"[^"]*"', _text(content)) or ['""']
    return _swap(content, re.compile(r'"[^"]*"'), lambda _: rng.choice(values), rng)


def _encoding(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    text = re.sub(r"^<\?xml[^>]*>\s*", "", _text(content))
    name = rng.choice(
        ("utf-8", "utf-16", "utf-32", "utf-7", "latin-1", "cp037", "shift_jis", "idna", "rot13", "no-such")
    )
    entities = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(12))
    head = rng.choice(
        (
            "",
            f'<!DOCTYPE net [<!ENTITY e0 "ha">{entities}]>',
            '<!DOCTYPE net SYSTEM "file:///etc/passwd">',
            '<!DOCTYPE net [<!ENTITY % p SYSTEM "file:///dev/zero"> %p;]>',
        )
    )
    whole = f'<?xml version="1.0" encoding="{name}"?>\n{head}{text}'
    try:
        return whole.encode(name if rng.random() < 0.5 else "utf-8", "replace")
    except (LookupError, UnicodeError):
        return _bytes_of(whole)


def _chunk(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    """A part of a PNG with other values and a right check sum."""
    data, at, chunks = content[8:], 0, []
    while at + 12 <= len(data):
        (size,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += size + 12
    if not chunks:
        return content
    k = rng.randrange(len(chunks))
    kind, body = chunks[k]
    if kind == b"IHDR" and len(body) == 13:
        width, height, depth, colour = struct.unpack(">IIBB", body[:10])
        width, height = rng.choice((width, 0, 1, 10**9, 7999)), rng.choice((height, 0, 2**31 - 1, 8000))
        body = struct.pack(">IIBB", width, height, rng.choice((depth, 1, 2, 16)), rng.choice((colour, 0, 2, 3, 4, 6)))
        body += chunks[k][1][10:]
    elif kind == b"IDAT" and rng.random() < 0.5:
        body = zlib.compress(bytes(rng.choice((0, 10, 10**7))))
    else:
        body = _bytes(body, (), rng)
    chunks[k] = (rng.choice((kind, kind, b"tEXt", b"zTXt", b"tRNS", b"PLTE", b"acTL")), body)
    packed = (struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in chunks)
    return content[:8] + b"".join(packed)


def _cells(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    word = rng.choice((*WORDS, '"' + "x" * 200_000, '"a\nb"', "\x00", ",,,", ";", "31/12/1969", "25:61", "0000-00-00"))
    return _swap(content, re.compile(r"[^,;\n]+"), lambda _: word, rng)


def _as_other_text(content: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    return _text(content).encode(
        rng.choice(("utf-16", "utf-16-be", "cp1252", "cp949", "utf-8-sig", "utf-32")), "replace"
    )
