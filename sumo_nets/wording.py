"""Words of complaints: what would have been valid."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Lists of names up to this length are given whole.
_WHOLE = 60
#: Of longer ones so many are given.
_EXAMPLES = 5


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
    like = difflib.get_close_matches(str(given), names, n=_EXAMPLES) or names[:_EXAMPLES]
    return f"give one of {len(names)} names such as {', '.join(like)}"
