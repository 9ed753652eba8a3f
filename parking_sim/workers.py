"""Where the runs of a sweep are done: processes on this machine, or the workers of a dask cluster.

Both are a ``concurrent.futures.Executor``, and get the same task function. A process does one simulation at a time.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from sumo_nets.errors import InputError

_CONNECT_S = 20


@contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """The executor for a sweep, closed at the end; what was not begun by then is cancelled.

    Args:
        workers: processes on this machine; default: one for each core that may be used.
        scheduler: address of a dask scheduler instead, such as ``tcp://host:8786``. Its workers need this package, one
            thread each, and the sweep's folder under the same path.

    Yields:
        The executor.

    Raises:
        InputError: fewer than one worker, dask is not installed, or no scheduler with such workers answers.
    """
    if scheduler is not None:
        with _dask_executor(scheduler) as executor:
            yield executor
        return
    if workers is not None and workers < 1:
        raise InputError(f"--workers: {workers}: give 1 or more")
    spawned = SpawnedWorkers(workers or len(os.sched_getaffinity(0)))
    try:
        yield spawned
    finally:
        spawned.shutdown(cancel_futures=True)


class SpawnedWorkers(ThreadPoolExecutor):
    """Spawned processes, each a ``ProcessPoolExecutor`` of its own that a thread waits for.

    A process that dies takes only its own task along, where a common pool would lose those of all. After a task that
    failed the next one gets a fresh process. Processes end with this one, even when it is killed.
    """

    def __init__(self, workers: int) -> None:
        """Prepare; processes start with the first tasks.

        Args:
            workers: number of processes.
        """
        super().__init__(workers, thread_name_prefix="sweep")
        self._context = multiprocessing.get_context("spawn")
        self._of_thread = threading.local()
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a process call a function, see ``concurrent.futures.Executor.submit``."""
        return super().submit(self._in_process, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, see ``concurrent.futures.Executor.shutdown``."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)

    def _in_process(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        pool = getattr(self._of_thread, "pool", None)
        if pool is None:
            pool = self._of_thread.pool = ProcessPoolExecutor(1, self._context, _start_process)
            self._pools.append(pool)
        try:
            return pool.submit(_interruptible, fn, *args, **kwargs).result()
        except InputError:
            raise  # the process is as good as before
        except BaseException:
            self._of_thread.pool = None
            pool.shutdown(wait=False)
            raise


def _start_process() -> None:
    """An idle process leaves Ctrl-C to its parent, and no process outlives its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _interruptible(fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Call a function that Ctrl-C reaches."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return fn(*args, **kwargs)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _dask_executor(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler: dask is not installed: pip install 'parking-sim[cluster]'") from None
    try:
        client = Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler: {address}: no dask scheduler answers: {error}") from None
    with client:
        crowded = [worker for worker, threads in client.nthreads().items() if threads > 1]
        if crowded:
            raise InputError(f"--scheduler: {crowded[0]} has several threads: start workers with --nthreads 1")
        with client.get_executor(pure=False) as executor:
            yield executor
