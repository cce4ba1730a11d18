"""Programs on pseudo-terminals."""

import contextlib
import os
import pty
import subprocess
import sys
import termios
import time

IN_CONTROL = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
"""Makes a program's terminal the one whose Ctrl-C reaches it, as a shell does."""

TIMEOUT_S = 300
"""For a program that compiles a scene on a busy machine."""


class Terminal:
    """A program on a pseudo-terminal of 80 columns."""

    def __init__(self, program):
        self.master, self.slave = pty.openpty()
        termios.tcsetwinsize(self.slave, (24, 80))
        self.before = termios.tcgetattr(self.slave)
        self.process = subprocess.Popen(
            [sys.executable, "-c", IN_CONTROL + program],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            env={**os.environ, "TERM": "xterm-256color"},
            start_new_session=True,
        )
        self.shown = b""
        os.set_blocking(self.master, False)

    def wait_for(self, text):
        """Read until the program has shown a text since the last one that was waited for."""
        until = time.monotonic() + TIMEOUT_S
        while text.encode() not in self.shown:
            assert time.monotonic() < until, self.shown[-2000:]
            assert self.process.poll() is None or self._read(), self.shown[-2000:]
            self._read()
            time.sleep(0.01)
        self.shown = self.shown.split(text.encode(), 1)[1]

    def _read(self):
        with contextlib.suppress(BlockingIOError):
            more = os.read(self.master, 65536)
            self.shown += more
            return len(more)
        return 0

    def type(self, text):
        os.write(self.master, text.encode())

    def end(self):
        """Wait for the program; its exit code."""
        until = time.monotonic() + TIMEOUT_S
        while self.process.poll() is None:
            assert time.monotonic() < until
            self._read()
            time.sleep(0.01)
        self._read()
        return self.process.returncode

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)
        os.close(self.slave)


def assert_given_back(terminal):
    assert termios.tcgetattr(terminal.slave) == terminal.before
    # The cursor is shown and the first screen is back; nothing hides or leaves it after that.
    tail = terminal.shown.rsplit(b"\x1b[?1049l", 1)
    assert len(tail) == 2
    assert tail[0].endswith(b"\x1b[?25h")
    assert b"\x1b[?" not in tail[1]
