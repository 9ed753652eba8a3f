"""A paper's figure beside ours: the rows that every reproduction prints and writes."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from parking_sim.errors import InputError

_HEADINGS = ("figure", "paper", "ours", "95 % interval", "claim holds")


@dataclass(frozen=True, slots=True)
class Finding:
    """One figure.

    Attributes:
        what: the figure, with its unit.
        paper: the paper's value; empty where it gives none.
        ours: our value.
        interval: our 95 % interval; empty for what is counted or exact.
        holds: whether the paper's claim holds here; None where it claims nothing.
    """

    what: str
    paper: str
    ours: str
    interval: str = ""
    holds: bool | None = None

    def cells(self) -> tuple[str, ...]:
        """The row as text, in the order of the headings."""
        said = {True: "yes", False: "no", None: ""}[self.holds]
        return self.what, self.paper, self.ours, self.interval, said


def findings_table(findings: Sequence[Finding]) -> str:
    """The rows as a Markdown table whose columns line up in plain text."""
    rows = [_HEADINGS, *(finding.cells() for finding in findings)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEADINGS))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in rows]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(lines) + "\n"


def write_findings(findings: Sequence[Finding], folder: Path, name: str) -> None:
    """Write ``NAME.csv`` and ``NAME.md`` into an existing folder.

    Args:
        findings: the rows.
        folder: where they go.
        name: name of the files.
    """
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_HEADINGS)
        writer.writerows(finding.cells() for finding in findings)
    (folder / f"{name}.md").write_text(findings_table(findings), encoding="utf-8")


def make_folder(folder: Path) -> None:
    """Make the folder for a reproduction before anything is computed.

    Raises:
        InputError: it can't be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None
