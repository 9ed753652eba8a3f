"""What the command line says in one line: input that a user can put right, and a run that came to no end."""

from __future__ import annotations


class InputError(ValueError):
    """Input that can't be used. The message is one line: file, field, value, what would be valid."""


class RunFailedError(RuntimeError):
    """A run that ended without a record, with the reason in one line."""
