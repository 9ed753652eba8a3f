"""Customers turned away: one definition for metrics, reports, comparisons and sizing.

A customer comes with a car that is to be parked. The garage turns the customer away when every slot is taken or
promised, or the customer turns away because the queue is too long; the record's ``state`` is then ``turned_away``.
Requests that mean nothing (``void``) are no customers: neither those who came nor those turned away. A request to fetch
a car that was turned away is void, so that no customer counts twice.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

#: Conditions in SQL on the table ``tasks``: customers who came, and those of them who were turned away.
SQL_CAME = "(WHERE kind = 'park' AND state <> 'void')"
SQL_TURNED_AWAY = "(WHERE kind = 'park' AND state = 'turned_away')"


@dataclass(frozen=True)
class TurnedAway:
    """How many customers were turned away.

    Attributes:
        number: customers turned away.
        came: customers who came, with those turned away.
        reasons: why -> how many of them, most first.
    """

    number: int
    came: int
    reasons: Mapping[str, int] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """Share of all customers that came, 0 to 1; NaN if none came."""
        return self.number / self.came if self.came else math.nan


def turned_away(tasks: pd.DataFrame) -> TurnedAway:
    """Count the customers turned away.

    Args:
        tasks: table ``tasks``, or some rows of it.

    Returns:
        The counts. Reasons are the words before the colon, without the figures of each case.
    """
    came = tasks[(tasks["kind"] == "park") & (tasks["state"] != "void")]
    away = came[came["state"] == "turned_away"]
    reasons = Counter(reason.partition(":")[0] for reason in sorted(away["reason"]))
    return TurnedAway(len(away), len(came), dict(reasons.most_common()))


def percent(share: float) -> str:
    """A share in percent, with two figures however small it is."""
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def turned_away_words(away: TurnedAway) -> str:
    """The counts in words, such as ``42 of 48 customers were turned away (88 %): queue too long 42``."""
    if not away.came:
        return "no customer came with a car"
    if not away.number:
        return f"none of {away.came:,} customers was turned away"
    reasons = ", ".join(f"{reason} {count:,}" for reason, count in away.reasons.items())
    were = "was" if away.number == 1 else "were"
    told = f"{away.number:,} of {away.came:,} customers {were} turned away ({percent(away.share)})"
    return f"{told}: {reasons}" if reasons else told
