"""A paper's figure beside ours: the rows that every reproduction prints and writes.

A claim is judged only by a sample that could speak for it as well as against it (``statistics.py`` has the tests); any
other sample is too small to tell.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from sumo_nets.errors import InputError
from sumo_nets.whole_file import whole_file, write_whole

_HEADINGS = ("figure", "paper", "ours", "95 % interval", "claim holds")


class Verdict(StrEnum):
    """What a sample says about a claim."""

    NO_CLAIM = ""
    YES = "yes"
    NO = "no"
    TOO_FEW = "too few to tell"


def verdict(shown: bool, refuted: bool) -> Verdict:
    """YES or NO where a sample shows a claim or its contrary; TOO_FEW where it shows neither."""
    return Verdict.YES if shown else Verdict.NO if refuted else Verdict.TOO_FEW


def contrary(of: Verdict) -> Verdict:
    """The verdict on the contrary claim."""
    return {Verdict.YES: Verdict.NO, Verdict.NO: Verdict.YES}.get(of, of)


def settled(holds: bool) -> Verdict:
    """The verdict on a claim about these very figures. Chance has no part in them."""
    return verdict(holds, not holds)


@dataclass(frozen=True, slots=True)
class Finding:
    """One figure.

    Attributes:
        what: the figure, with its unit.
        paper: the paper's value; empty where it gives none.
        ours: our value.
        interval: our 95 % interval; empty for what is counted or exact.
        holds: whether the claim holds here.
    """

    what: str
    paper: str
    ours: str
    interval: str = ""
    holds: Verdict = Verdict.NO_CLAIM

    def cells(self, full: bool) -> tuple[str, ...]:
        """The row as text, in the order of the headings; the quick form names the full one where it can't tell."""
        said = f"{self.holds}: run --full" if self.holds is Verdict.TOO_FEW and not full else str(self.holds)
        return self.what, self.paper, self.ours, self.interval, said


def findings_table(findings: Sequence[Finding], full: bool) -> str:
    """The rows of the full or the quick form as a Markdown table."""
    return aligned([_HEADINGS, *(finding.cells(full) for finding in findings)])


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns line up in plain text; the first row has the headings."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in rows]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(lines) + "\n"


def write_findings(findings: Sequence[Finding], folder: Path, name: str, full: bool) -> None:
    """Write ``NAME.csv`` and ``NAME.md`` into an existing folder.

    Args:
        findings: the rows.
        folder: where they go.
        name: name of the files.
        full: they are of the full form.
    """
    with whole_file(folder / f"{name}.csv") as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_HEADINGS)
        writer.writerows(finding.cells(full) for finding in findings)
    write_whole(folder / f"{name}.md", findings_table(findings, full))


def make_folder(folder: Path) -> None:
    """Make the folder for a reproduction before anything is computed.

    Raises:
        InputError: it can't be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: {folder}: can't be written: {error.strerror}") from None
