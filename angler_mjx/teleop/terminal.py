"""A terminal for a while: single keys in, a screen that is painted over in place out.

Keys come as they are pressed, without echo. Signals keep their meaning, but the keys that suspend,
dump core or stop the output (Ctrl-Z, Ctrl-backslash, Ctrl-S) become ordinary ones: a program that
stands still drives nobody, and would leave the terminal as it is. Whatever ends the program's
block, an exception or a signal, the terminal is given back as it was. The screen is the terminal's
second one, so what stood there comes back as well.
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
"""One key: a character, or what arrow keys, function keys and Alt send."""

_IFLAG, _CC = 0, 6
"""Places in what `termios.tcgetattr` gives."""

_HANGUP = "\x03"
"""A terminal that is gone is read as Ctrl-C."""


def parse_keys(text: str) -> list[str]:
    """Keys in what a terminal sent; those of several characters come as Escape."""
    return [part[0] for part in _SEQUENCE.findall(text)]


class Keyboard:
    """Keys of the terminal on standard input."""

    def __init__(self) -> None:
        """Look for the terminal; nothing is changed yet.

        Raises:
            ConfigError: standard input is none.
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
        """Take keys as they are pressed; what was typed before is dropped."""
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
        """Give the terminal back as it was; keys that nobody read are dropped."""
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    def read(self, time_s: float) -> list[str]:
        """Keys that were pressed since the last call; does not wait.

        Args:
            time_s: of the scene; a keyboard has no use for it.
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
    """The terminal on standard output, painted over in place."""

    def __enter__(self) -> Self:
        """Go to the terminal's second screen."""
        self._write(_ENTER)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Come back to the first."""
        self._write(_LEAVE)

    def paint(self, lines: Sequence[str]) -> None:
        """Show lines from the top; those that do not fit are cut.

        All goes out in one piece, and each line is overwritten before its rest is cleared: nothing
        is blank for a moment.
        """
        columns, rows = shutil.get_terminal_size()
        # Clearing behind a line that fills its row would take the last character away.
        shown = [line[: columns - 1] for line in lines[:rows]]
        self._write("\x1b[H" + "\r\n".join(f"{line}\x1b[K" for line in shown) + "\x1b[J")

    @staticmethod
    def _write(text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal is gone; the keyboard tells
            sys.stdout.write(text)
            sys.stdout.flush()


def has_screen() -> bool:
    """Whether standard output is a terminal that can be painted over."""
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
