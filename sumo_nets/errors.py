"""What a user can put right is an ``InputError``, whatever part of the program finds it."""

from __future__ import annotations


class InputError(ValueError):
    """Input that can't be used. The message is one line: file, field, value, what would be valid.

    Example:
        >>> import parking_sim as ps
        >>> try:
        ...     ps.load_scenario("map1", {"agvs": "four"})
        ... except ps.InputError as error:
        ...     print(error)
        command line: agvs: 'four': must be a valid integer
    """


class NetError(InputError):
    """A net that can't be read or lacks what a garage needs."""
