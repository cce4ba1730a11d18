"""Terminal for single-key input and for a screen that is repainted in place.

Keys come as they are pressed, without echo. Signals keep their meaning, but the keys that suspend,
dump core or stop the output (Ctrl-Z, Ctrl-backslash, Ctrl-S) become ordinary ones: a stopped
program drives no robot, and would leave the terminal as it is. However the program's block ends, by
an exception or a signal, the terminal is restored. The screen is the terminal's alternate one, so
its earlier content comes back as well.
"""

import codecs
import contextlib
import os
import re
import select
import shutil
import sys
import termios
import tty
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from angler_mjx.errors import ConfigError

_ENTER = "\x1b[?1049h\x1b[?25l\x1b[2J"
_LEAVE = "\x1b[?25h\x1b[?1049l"

_SEQUENCE = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|O.|[^\x1b])?|.", re.DOTALL)
"""One key: a character, or the sequence of an arrow key, a function key or Alt."""

_IFLAG, _CC = 0, 6
"""Indices in the result of `termios.tcgetattr`."""

_HANGUP = "\x03"
"""A closed terminal is read as Ctrl-C."""


def parse_keys(text: str) -> list[str]:
    """Parse terminal input into keys; those of several characters come as Escape."""
    return [part[0] for part in _SEQUENCE.findall(text)]


class Keyboard:
    """Keyboard of the terminal on standard input."""

    def __init__(self) -> None:
        """Find the terminal; nothing is changed yet.

        Raises:
            ConfigError: standard input is no terminal.
        """
        if not sys.stdin.isatty():
            raise ConfigError(
                "standard input is not a terminal, and keys come from one; "
                "run this in a terminal, or give --script FILE"
            )
        self._file = sys.stdin.fileno()
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self.finished = False

    def __enter__(self) -> Self:
        """Switch to single-key input; earlier input is dropped."""
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file, termios.TCSAFLUSH)
        attributes = termios.tcgetattr(self._file)
        attributes[_IFLAG] &= ~termios.IXON
        disabled = os.fpathconf(self._file, "PC_VDISABLE").to_bytes(1, "little")
        for slot in (termios.VSUSP, termios.VQUIT):
            attributes[_CC][slot] = disabled
        termios.tcsetattr(self._file, termios.TCSADRAIN, attributes)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Restore the terminal; unread keys are dropped."""
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    def read(self, time_s: float) -> list[str]:
        """Return the keys pressed since the last call; does not wait.

        Args:
            time_s: of the scene; not used by a keyboard.
        """
        del time_s
        sent = b""
        try:
            while select.select([self._file], [], [], 0.0)[0]:
                more = os.read(self._file, 1024)
                if not more:
                    return [_HANGUP]
                sent += more
        except OSError:
            return [_HANGUP]
        return parse_keys(self._decoder.decode(sent))


class Screen:
    """Screen of the terminal on standard output, repainted in place."""

    def __enter__(self) -> Self:
        """Switch to the terminal's alternate screen."""
        self._write(_ENTER)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Switch back to the main screen."""
        self._write(_LEAVE)

    def paint(self, lines: Sequence[str]) -> None:
        """Show lines from the top; those that do not fit are cut.

        All lines go out in one piece, and each is overwritten before its rest is cleared, to
        prevent flicker.
        """
        columns, rows = shutil.get_terminal_size()
        # Clearing behind a line that fills its row would remove the last character.
        shown = [line[: columns - 1] for line in lines[:rows]]
        self._write("\x1b[H" + "\r\n".join(f"{line}\x1b[K" for line in shown) + "\x1b[J")

    @staticmethod
    def _write(text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal is gone; the keyboard reports it
            sys.stdout.write(text)
            sys.stdout.flush()


def has_screen() -> bool:
    """Return whether standard output is a terminal that can be repainted."""
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
