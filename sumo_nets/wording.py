"""Words of complaints: what would have been valid."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Lists of names up to this length are given whole.
_WHOLE = 60
#: Of longer ones so many are given.
_EXAMPLES = 5
#: Names are compared by so many characters.
_LONGEST = 100


def one_of(valid: Iterable[str], given: object = "") -> str:
    """Which names are valid.

    Args:
        valid: the names.
        given: what was given instead. Of a long list the names most like it are told, or else the first ones.

    Returns:
        Words such as "give one of a, b, c" or "give one of 412 names such as s12, s13".
    """
    names = list(valid)
    if not names:
        return "there is none to give"
    if len(names) <= _WHOLE:
        return f"give one of {', '.join(names)}"
    like = difflib.get_close_matches(str(given)[:_LONGEST], names, n=_EXAMPLES) or names[:_EXAMPLES]
    return f"give one of {len(names)} names such as {', '.join(like)}"


def cut(text: str, most: int = 80) -> str:
    """A text on one line, cut where it is long.

    Args:
        text: any text.
        most: characters that are kept.

    Example:
        >>> cut("a" * 100, 10)
        'aaaaaaaaaa... (100 characters)'
    """
    if len(text) > most:
        return f"{cut(text[:most], most)}... ({len(text)} characters)"
    return " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in text).split())


def shown(value: object, most: int = 80) -> str:
    """A value as a complaint shows it: its ``repr``, on one line, cut where it is long.

    Args:
        value: any value, also one whose ``repr`` fails.
        most: characters that are kept.

    Example:
        >>> shown("four"), shown([1.5, None])
        ("'four'", '[1.5, None]')
        >>> shown(10**5000)
        'a whole number of more than 4000 digits'
    """
    if isinstance(value, int) and abs(value) >= 10**4000:
        return "a whole number of more than 4000 digits"
    if isinstance(value, str | bytes) and len(value) > most:
        return f"{cut(repr(value[:most]), 10 * most)}... ({len(value)} characters)"
    try:
        return cut(repr(value), most)
    except Exception:
        return f"a {type(value).__name__}"
