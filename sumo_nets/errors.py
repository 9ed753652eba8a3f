"""What a user can put right is an ``InputError``, whatever part of the program finds it."""

from __future__ import annotations

from collections.abc import Sequence

from sumo_nets.wording import cut

#: Characters of a line of a complaint, and complaints that are told of one file.
_MOST_CHARACTERS, MOST_LINES = 4000, 20


class InputError(ValueError):
    """Input that can't be used. The message is a line for each thing: file, field, value, what would be valid.

    Whatever the input holds, a line has no control characters and is cut where it is long.

    Example:
        >>> import parking_sim as ps
        >>> try:
        ...     ps.load_scenario("map1", {"agvs": "four"})
        ... except ps.InputError as error:
        ...     print(error)
        command line: agvs: 'four': must be a valid integer
    """

    def __init__(self, message: str) -> None:
        super().__init__("\n".join(cut(line, _MOST_CHARACTERS) for line in message.split("\n")))


class NetError(InputError):
    """A net that can't be read or lacks what a garage needs."""


def in_lines(wrong: Sequence[str], total: int = 0) -> str:
    """One message of all that is wrong with a file.

    Args:
        wrong: a line for each thing.
        total: how many there are, if not all are given.

    Returns:
        The lines; of many the first, and how many more there are.

    Example:
        >>> print(in_lines([f"row {row}" for row in range(30)]).splitlines()[-1])
        and 10 more
    """
    total = max(total, len(wrong))
    more = [f"and {total - MOST_LINES} more"] if total > MOST_LINES else []
    return "\n".join([*wrong[:MOST_LINES], *more])
