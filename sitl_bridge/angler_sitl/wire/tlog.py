"""A telemetry log as ground stations write it: MAVProxy and Mission Planner replay it.

Each packet stands behind its time: microseconds since 1970, 8 bytes, big-endian. Here the clock is
that of the scene, begun when the log was: it plays at the pace of the scene, however fast it ran.
"""

import struct
import time
from pathlib import Path

from angler_mjx.errors import RunError

FILE_NAME = "mavlink.tlog"


class TelemetryLog:
    """A log in the making; its `tap` is given to a link."""

    def __init__(self, path: Path) -> None:
        """Begin a new file.

        Raises:
            RunError: it cannot be written.
        """
        self._path, self._began_us = path, time.time_ns() // 1000
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error

    def log_packet(self, packet: bytes, time_s: float) -> None:
        """Write a packet that passed at a time of the scene."""
        self._file.write(struct.pack(">Q", self._began_us + round(time_s * 1e6)) + packet)

    def close(self) -> None:
        """Write what is left; twice does no harm."""
        self._file.close()
