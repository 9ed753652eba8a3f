"""The exception for nets that can't be used."""

from __future__ import annotations


class NetError(ValueError):
    """A net that can't be read or lacks what a garage needs; the message is one line."""
