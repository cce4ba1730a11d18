"""A thread that writes finished tiles while the device computes the next ones."""

import queue
import threading
import time
from collections.abc import Callable


class BackgroundWriter[Item]:
    """Writes items one after another, in the order they come, in a thread of its own.

    What waits is bounded: `put` blocks while there is no room. After a failed write nothing more is
    written, and the error is raised by the next `put` or by `close`.
    """

    def __init__(self, write: Callable[[Item], None], *, max_waiting: int) -> None:
        """Start the thread.

        Args:
            write: writes one item.
            max_waiting: items waiting or being written at most.
        """
        self._write = write
        self._slots = threading.BoundedSemaphore(max_waiting)
        self._waiting: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._write_items, name="angler-writer")
        self._thread.start()
        self.waited_s = 0.0
        """Seconds that `put` and `close` waited for the disk."""

    def put(self, item: Item) -> None:
        """Hand over an item.

        Raises:
            RunError: or whatever a write before raised.
        """
        started_s = time.perf_counter()
        self._slots.acquire()
        self.waited_s += time.perf_counter() - started_s
        if self._error is not None:
            self._slots.release()
            raise self._error
        self._waiting.put(item)

    def close(self) -> None:
        """Wait until everything is written; errors as in `put`."""
        started_s = time.perf_counter()
        self._waiting.put(None)
        self._thread.join()
        self.waited_s += time.perf_counter() - started_s
        if self._error is not None:
            raise self._error

    def _write_items(self) -> None:
        while (item := self._waiting.get()) is not None:
            try:
                if self._error is None:
                    self._write(item)
            except BaseException as error:
                self._error = error
            finally:
                self._slots.release()
