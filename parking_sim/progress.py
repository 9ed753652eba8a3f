"""Progress of runs as bars on the terminal, of a sweep also as lines in a log."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import perf_counter
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich import progress as rich_progress
from rich.console import Console

if TYPE_CHECKING:
    from parking_sim.many_runs import SweepProgress
    from parking_sim.simulation import RunProgress

#: Seconds between two lines when there is no terminal for a bar.
_LINE_S = 30.0


class RunBars:
    """One bar a run: tasks done, simulated time, simulated seconds a second."""

    def __init__(self, names: Sequence[str]) -> None:
        """Prepare a bar for each run; they appear on entering the context.

        Args:
            names: names of the runs.
        """
        self._bars = rich_progress.Progress(
            "{task.description}",
            rich_progress.BarColumn(),
            "{task.fields[tasks]}",
            "{task.fields[clock]}",
            "{task.fields[speed]}",
            console=Console(stderr=True),
            transient=True,
        )
        self._ids = {
            name: self._bars.add_task(name, total=None, tasks="starting", clock="", speed="") for name in names
        }

    def update(self, name: str, progress: RunProgress) -> None:
        """Show how far a run is."""
        hours, minutes = divmod(int(progress.time_s) // 60, 60)
        self._bars.update(
            self._ids[name],
            completed=progress.done,
            total=progress.total,
            tasks=f"{progress.done}/{progress.total} tasks",
            clock=f"{hours}:{minutes:02} h simulated",
            speed=f"{progress.time_s / progress.wall_s:.0f}x" if progress.wall_s > 0 else "",
        )

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()


class SweepBar:
    """How far a sweep is: a bar on the terminal, or a line now and then where there is none."""

    def __init__(self, quiet: bool = False) -> None:
        """Prepare; the bar appears on entering the context.

        Args:
            quiet: show nothing.
        """
        self._quiet = quiet
        self._said_s = perf_counter()
        self._bar = rich_progress.Progress(
            rich_progress.BarColumn(),
            "{task.fields[words]}",
            rich_progress.TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=quiet or not sys.stderr.isatty(),
        )
        self._id = self._bar.add_task("", total=None, words="starting")

    def update(self, progress: SweepProgress) -> None:
        """Show how far the sweep is."""
        words = progress_words(progress)
        ended = progress.done + progress.failed
        self._bar.update(self._id, completed=ended, total=progress.total, words=words)
        if self._bar.disable and not self._quiet and perf_counter() - self._said_s > _LINE_S:
            self._said_s = perf_counter()
            print(words, file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


def progress_words(progress: SweepProgress) -> str:
    """A sweep's progress in words: ``37 of 200 runs, 1 failed, about 4 min left``."""
    failed = f", {progress.failed} failed" if progress.failed else ""
    left = ""
    if progress.left_s is not None and progress.done + progress.failed < progress.total:
        minutes = round(progress.left_s / 60)
        left = f", about {minutes // 60} h {minutes % 60:02} min left" if minutes >= 60 else (
            f", about {minutes} min left" if minutes else ", less than a minute left"
        )  # fmt: skip
    return f"{progress.done} of {progress.total} runs{failed}{left}"
