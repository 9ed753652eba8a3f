"""The one exception for input a user can put right."""

from __future__ import annotations


class InputError(ValueError):
    """Input that can't be used. The message is one line: file, field, value, what would be valid."""
