"""Reading of files that may be damaged: any exception becomes one message.

Zarr, its codecs, Arrow, JSON and NumPy raise dozens of kinds of errors on files that were cut,
overwritten or edited, and the kinds change with their versions.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from angler_mjx.errors import AnglerError, ConfigError

DEFAULT_ADVICE = "copy it again, or make it anew"
_MAX_MESSAGE = 200
"""Characters of another library's message that are shown."""


@contextmanager
def wrap_read_errors(path: Path, advice: str = DEFAULT_ADVICE) -> Iterator[None]:
    """Read stored data inside; what goes wrong there is the file's fault.

    Args:
        path: what is read, for the message.
        advice: what a person can do about it.

    Raises:
        ConfigError: anything but our own errors was raised inside.
    """
    try:
        yield
    except AnglerError:
        raise
    except Exception as error:  # there is no common base: see above
        message = " ".join(str(error).split()) or "no reason given"
        message = "".join(c if c.isprintable() else "?" for c in message)
        message = message if len(message) <= _MAX_MESSAGE else message[:_MAX_MESSAGE] + "..."
        raise ConfigError(
            f"{path}: cannot be read, it is damaged or no such file "
            f"({type(error).__name__}: {message}); {advice}"
        ) from error


def read_table(path: Path, advice: str = DEFAULT_ADVICE) -> dict[str, Any]:
    """Read a JSON file that holds one object.

    Raises:
        ConfigError: it holds something else, or cannot be read.
    """
    with wrap_read_errors(path, advice):
        table = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(table, dict):
            raise TypeError(f"holds a {type(table).__name__} and no object")
    return table
