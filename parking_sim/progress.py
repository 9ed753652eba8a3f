"""Progress of runs as bars on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich import progress as rich_progress
from rich.console import Console

if TYPE_CHECKING:
    from parking_sim.simulation import Progress


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

    def update(self, name: str, progress: Progress) -> None:
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
