"""Process-wide settings that are off while any thread needs that."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class SharedPause:
    """Setting that is off from the first thread's entry to the last one's exit."""

    def __init__(self, read: Callable[[], bool], write: Callable[[bool], object]) -> None:
        """Take the functions that read and write the setting.

        Args:
            read: returns whether it is on.
            write: turns it on or off.
        """
        self._read, self._write = read, write
        self._lock, self._inside, self._was_on = threading.Lock(), 0, False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Turn the setting off until the last thread has left; restore the caller's then."""
        with self._lock:
            if self._inside == 0:
                self._was_on = self._read()
                self._write(False)
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0:
                    self._write(self._was_on)
