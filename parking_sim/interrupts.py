"""A process that is told to end, or whose terminal is closed, ends its work as by Ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

#: Signals that end a process politely, besides that of Ctrl-C.
_ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def ended_like_by_ctrl_c() -> Iterator[list[int]]:
    """Within, SIGTERM and SIGHUP raise what Ctrl-C raises, so that a run is ended with its record so far.

    A second one ends the writing of the record, too: the run's journal is left, and the run can be resumed. A signal
    that the process was started to ignore stays ignored, so that a run under ``nohup`` outlives its terminal.

    Yields:
        The numbers of the signals that have come.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return

    def stop(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        for process in multiprocessing.active_children():  # Ctrl-C reaches them by itself, these signals don't
            if process.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGINT)
        raise KeyboardInterrupt

    ignored = [number for number in _ENDING if signal.getsignal(number) in (signal.SIG_IGN, None)]  # as nohup has it
    before = {number: signal.signal(number, stop) for number in _ENDING if number not in ignored}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
