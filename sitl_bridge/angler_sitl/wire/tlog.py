"""Telemetry log in the format of ground stations: MAVProxy and Mission Planner replay it.

Each packet stands behind its time: microseconds since 1970, 8 bytes, big-endian. The clock is that
of the scene, started with the log: it plays at the pace of the scene, at any speed of the run.
"""

import struct
import time
from pathlib import Path

from angler_mjx.errors import RunError

FILE_NAME = "mavlink.tlog"


class TelemetryLog:
    """Open log; its `tap` is given to a link."""

    def __init__(self, path: Path) -> None:
        """Create a new file.

        Raises:
            RunError: it cannot be written.
        """
        self._path, self._began_us = path, time.time_ns() // 1000
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error

    def log_packet(self, packet: bytes, time_s: float) -> None:
        """Write a packet at its scene time."""
        self._file.write(struct.pack(">Q", self._began_us + round(time_s * 1e6)) + packet)

    def close(self) -> None:
        """Flush and close the log; a second call has no effect."""
        self._file.close()
