"""Files of timed keys: the keys of a drive with their times, in seconds of the scene.

One key a line: ``2.5 <tab>``. A held key has its start and end time: ``3-8 i``; it repeats as a
keyboard does. A ``#`` that begins a line or follows a space begins a comment.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path, read_text
from angler_mjx.teleop import keys

REPEAT_S = 0.1
"""Repeat period of a held key: not below a control period, not above the key timeout."""

MAX_TIME_S = 86_400.0
"""Max time of a key: the longest horizon of a scenario."""
MAX_KEYS = 1_000_000
"""Max keys of a file, with each repeat of a held key counted."""
_MAX_BYTES, _MAX_LINE_LENGTH = 1 << 24, 200
"""Max bytes of a file, and max characters of a line."""

MAX_FAULTS = 10
"""Max reported faults of a file; a file with more is no key file."""

_SLACK_S = 1e-6
"""Tolerance of scene times, which are sums of periods in floating point."""

_LINE = re.compile(r"(?P<begin>\S+?)(?:-(?P<end>[^\s-]\S*))?\s+(?P<key>\S+)")


@dataclass(frozen=True)
class TimedKey:
    """Key with its time."""

    time_s: float
    key: str


class KeyScript:
    """Source of keys at their times."""

    def __init__(self, timed: Sequence[TimedKey]) -> None:
        """Create the source with the keys in the order of time."""
        self._timed = list(timed)
        self._next = 0

    def read(self, time_s: float) -> list[str]:
        """Return the keys that became due since the last call."""
        first = self._next
        while self._next < len(self._timed) and self._timed[self._next].time_s <= time_s + _SLACK_S:
            self._next += 1
        return [timed.key for timed in self._timed[first : self._next]]

    @property
    def finished(self) -> bool:
        """Whether the last key has been read."""
        return self._next == len(self._timed)


def load_keys(path: Path) -> list[TimedKey]:
    """Read a file of keys.

    Raises:
        ConfigError: it cannot be read, holds no key, or has invalid lines (with
            their numbers).
    """
    try:
        text = read_text(path, _MAX_BYTES)
    except ConfigError as error:
        raise ConfigError(f"--script {error}") from error
    timed: list[TimedKey] = []
    faults: list[str] = []
    latest = 0.0
    for number, line in enumerate(text.splitlines(), start=1):
        if not (stripped := re.sub(r"(^|\s)#.*", "", line).strip()):
            continue
        try:
            begin, presses, pressed = _parse_line(stripped)
            if begin < latest:
                raise ValueError(f"comes before the line above it ({latest:g} s); sort the lines")
            if len(timed) + presses > MAX_KEYS:  # checked before the keys are created
                raise ValueError(
                    f"more than {MAX_KEYS:,} keys up to here; drive for a shorter time"
                )
        except ValueError as error:
            faults.append(f"  line {number}: {format_value(stripped)}: {error}")
            continue
        latest = begin
        timed += [TimedKey(begin + i * REPEAT_S, pressed) for i in range(presses)]
    if faults:
        count = f"{len(faults)} fault{'s' if len(faults) > 1 else ''}"
        more = [f"  and {len(faults) - MAX_FAULTS} more"] if len(faults) > MAX_FAULTS else []
        raise ConfigError(
            "\n".join([f"--script {format_path(path)}: {count}", *faults[:MAX_FAULTS], *more])
        )
    if not timed:
        raise ConfigError(f"--script {format_path(path)}: holds no key; give lines such as `2.0 i`")
    # A held key continues past the lines that follow it.
    return sorted(timed, key=lambda timed_key: timed_key.time_s)


def save_keys(path: Path, timed: Sequence[TimedKey]) -> None:
    """Write a file that `load_keys` reads: the same keys at the same times."""
    lines = [f"{timed_key.time_s!r} {keys.format_key(timed_key.key)}\n" for timed_key in timed]
    path.write_text("".join(["# seconds of the scene, key\n", *lines]), encoding="utf-8")


def _parse_line(line: str) -> tuple[float, int, str]:
    """Return the first time of a line, the number of presses, and the key.

    Raises:
        ValueError: naming the fault.
    """
    if len(line) > _MAX_LINE_LENGTH or (match := _LINE.fullmatch(line)) is None:
        raise ValueError("give a time in seconds and a key, as in `2.0 i`")
    begin = _parse_seconds(match["begin"])
    key = _parse_key(match["key"])
    if match["end"] is None:
        return begin, 1, key
    end = _parse_seconds(match["end"])
    if end <= begin:
        raise ValueError(f"is held until {end:g} s, which is not after {begin:g} s")
    return begin, int((end - begin) / REPEAT_S + _SLACK_S) + 1, key


def _parse_seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{format_value(text)} is not a time in seconds") from None
    if not 0.0 <= value <= MAX_TIME_S:
        raise ValueError(f"{text} is not a time from 0 s on, {MAX_TIME_S:g} s at most")
    return value


def _parse_key(text: str) -> str:
    """Return the key of its written form.

    Raises:
        ValueError: it is no key.
    """
    if len(text) == 1:
        return text
    key_name = text[1:-1].lower()
    if text.startswith("<") and text.endswith(">") and key_name in keys.NAMES:
        return keys.NAMES[key_name]
    available = ", ".join(f"<{name}>" for name in keys.NAMES)
    raise ValueError(f"{format_value(text)} is not a key; give one character, or {available}")
