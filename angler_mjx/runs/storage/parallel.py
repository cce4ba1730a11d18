"""Work on files by threads or processes: results in order, few of them in memory.

Threads share Python's lock: they speed up calls that leave it for long, as hashing does. Arrays of
a world are decoded by many short calls, between which threads wait for each other: they are read in
processes.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, forkserver, process

from numcodecs import blosc

from angler_mjx.errors import RunError

MAX_PENDING = 256
"""Maximum number of items that are submitted, or whose results are not taken yet."""


def cpu_count() -> int:
    """Return the number of processors that this process may use: XLA's threads are as many."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def open_processes(count: int, module: str) -> Iterator[Executor | None]:
    """Open a pool of processes, which end with this one; None for a count below 2.

    They are forks of one process that imports the module meanwhile.

    Args:
        count: number of processes.
        module: module of the functions that they run, by its full name.
    """
    if count < 2:
        yield None
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module])
    forkserver.ensure_running()
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin_process)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _begin_process() -> None:
    """Leave interruptions to the parent process, end when it ends, and decode in one thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    blosc.set_nthreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = process.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def map_in_order[T, R](
    function: Callable[[T], R], items: Iterable[T], pool: Executor | None
) -> Iterator[R]:
    """Yield the results of a function in the order of its arguments.

    An interruption waits for the items in work alone.

    Args:
        function: called by the pool; what it raises is raised in place of its result.
        items: arguments; at most `MAX_PENDING` are taken ahead of the results.
        pool: threads or processes; None calls the function here.

    Raises:
        RunError: a process of the pool was killed.
    """
    if pool is None:
        yield from map(function, items)
        return
    pending: deque[Future[R]] = deque()
    try:
        for item in items:
            if len(pending) == MAX_PENDING:
                yield pending.popleft().result()
            pending.append(pool.submit(function, item))
        while pending:
            yield pending.popleft().result()
    except BrokenProcessPool as error:
        raise RunError(
            "a process of the pool was killed, perhaps for lack of memory; free some of it, or use "
            "fewer processes"
        ) from error
    finally:
        for future in pending:
            future.cancel()
