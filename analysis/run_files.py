"""The files that tell a run's folder: that of a run that has ended, or of a run that was killed."""

from __future__ import annotations

from pathlib import Path

from sumo_nets.errors import InputError

#: A folder that holds this file holds a run. It is the last file of a run to be written.
RUN_FILE = "run.json"
METRICS_FILE = "metrics.json"
#: The scenario as it was run, every key written out.
SCENARIO_FILE = "scenario.yaml"
#: A folder that holds this one holds a run that has not ended, see ``analysis.journal``.
JOURNAL = "journal.jsonl"
#: Folder within a run's, or a sweep's, for copies of the user's own files that it reads.
INPUTS = "inputs"


def did_not_end(folder: Path) -> bool:
    """Whether a folder holds a run that was killed."""
    return (folder / JOURNAL).is_file() and not (folder / RUN_FILE).is_file()


def go_on(folder: Path) -> str:
    """What to tell about a run that was killed."""
    return f"{folder}: holds a run that did not end; go on with it: parking-sim resume {folder}"


def check_ended(folder: Path) -> None:
    """Make sure that a folder does not hold a run that was killed.

    Raises:
        InputError: it does.
    """
    if did_not_end(folder):
        raise InputError(go_on(folder))
