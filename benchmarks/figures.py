"""The runs behind the docs' tables, and how each table shows them; ``remake.py`` makes both.

A set is a list of cases, a function from a case to its figures, and words. A table is a set and a function from its
rows to lines of Markdown. Each group of tables has a module of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import clearances
import deadlock_tables
import fault_tables
import garage_tables
import garages
import planner_tables
import thesis_tables
import window_tables
from docs_tables import Row, RunSet, Table

__all__ = ["SETS", "TABLES", "Row", "RunSet", "Table"]

_GROUPS = (
    garage_tables, fault_tables, planner_tables, thesis_tables, deadlock_tables, window_tables, garages, clearances,
)  # fmt: skip

#: In the order in which they are made.
SETS: Mapping[str, RunSet] = {name: runs for group in _GROUPS for name, runs in group.SETS.items()}
TABLES: Mapping[str, Table] = {name: table for group in _GROUPS for name, table in group.TABLES.items()}
