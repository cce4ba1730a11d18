"""Compiled programs kept on disk, for Python as for the command.

A `Simulator` switches this on. It is left alone where ``JAX_COMPILATION_CACHE_DIR`` or JAX's own
setting names a folder, and where ``ANGLER_COMPILE_CACHE=0`` says not to keep any.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

OPT_OUT = "ANGLER_COMPILE_CACHE"
"""Environment variable; "0" keeps nothing."""


def cache_folder() -> Path:
    """Where programs are kept: ``angler-mjx/xla`` in the user's cache folder."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "angler-mjx" / "xla"


def enable_cache() -> None:
    """Have JAX keep what it compiles, unless the user said where or not to."""
    if os.environ.get(OPT_OUT) == "0" or jax.config.jax_compilation_cache_dir is not None:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
    # JAX looks at the setting once, when it first compiles: that may have been before.
    compilation_cache.reset_cache()


@contextmanager
def use_cache_folder(folder: Path) -> Iterator[None]:
    """Keep every program in a folder, however fast it compiles, until the context ends.

    Args:
        folder: of the programs, which are read from it as well; the user's cache is left alone.
    """
    settings = {
        "jax_enable_compilation_cache": True,
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        _apply_settings(settings)
        yield
    finally:
        _apply_settings(before)


def _apply_settings(settings: dict[str, Any]) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
