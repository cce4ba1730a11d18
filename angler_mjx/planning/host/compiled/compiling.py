"""Functions that numba compiles, kept on disk from one process to the next."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba

_SOURCE_FOLDER = Path(__file__).parent
_CONFIG: Any = numba.config


def _cache_folder() -> str:
    """Return the folder of compiled code, named by the sources of all that is compiled.

    Numba looks only at the file of the function itself: with one folder for all sources, a change
    in a function that another file calls would go on running as it was.
    """
    digest = hashlib.sha256()
    for file in sorted(_SOURCE_FOLDER.parent.rglob("*.py")):
        source = file.read_bytes()
        if b"@compiled" in source:
            digest.update(source)
    name = f"angler-{digest.hexdigest()[:16]}"
    configured = _CONFIG.CACHE_DIR
    if configured:
        return os.path.join(configured, name)
    cache = _SOURCE_FOLDER / "__pycache__"
    if os.access(cache if cache.exists() else _SOURCE_FOLDER, os.W_OK):
        return str(cache / name)
    return str(Path.home() / ".cache" / "angler-mjx" / name)


_CACHE_FOLDER = _cache_folder()


def compile_function[F: Callable[..., object]](function: F) -> F:
    """Compile a function at its first call: no interpreter lock, arithmetic as NumPy's."""
    previous = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = _CACHE_FOLDER
    try:
        return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    finally:
        _CONFIG.CACHE_DIR = previous
