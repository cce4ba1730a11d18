"""Functions that numba compiles, kept on disk from one process to the next."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba

_HERE = Path(__file__).parent
_CONFIG: Any = numba.config


def _folder() -> str:
    """Where compiled code is kept, told apart by the sources of all that is compiled.

    Numba looks only at the file of the function itself: with one folder for all sources, a change
    in a function that another file calls would go on running as it was.
    """
    digest = hashlib.sha256()
    for file in sorted(_HERE.parent.rglob("*.py")):
        source = file.read_bytes()
        if b"@compiled" in source:
            digest.update(source)
    name = f"angler-{digest.hexdigest()[:16]}"
    given = _CONFIG.CACHE_DIR
    if given:
        return os.path.join(given, name)
    beside = _HERE / "__pycache__"
    if os.access(beside if beside.exists() else _HERE, os.W_OK):
        return str(beside / name)
    return str(Path.home() / ".cache" / "angler-mjx" / name)


_FOLDER = _folder()


def compiled[F: Callable[..., Any]](function: F) -> F:
    """The function compiled at its first call: no interpreter lock, arithmetic as NumPy's."""
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = _FOLDER
    try:
        return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    finally:
        _CONFIG.CACHE_DIR = before
