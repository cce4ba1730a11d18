"""Disk cache of compiled programs, for Python and the command line.

A `Simulator` enables it. It does nothing where ``JAX_COMPILATION_CACHE_DIR`` or JAX's own setting
names a folder, or where ``ANGLER_COMPILE_CACHE=0`` disables it.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

OPT_OUT = "ANGLER_COMPILE_CACHE"
"""Environment variable; "0" disables the cache."""


def cache_folder() -> Path:
    """Return the folder of programs: ``angler-mjx/xla`` in the user's cache folder."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "angler-mjx" / "xla"


def enable_cache() -> None:
    """Enable JAX's cache, unless the user has set its folder or disabled it."""
    if os.environ.get(OPT_OUT) == "0" or jax.config.jax_compilation_cache_dir is not None:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
    # JAX reads the setting once, at its first compilation, which may have been earlier.
    compilation_cache.reset_cache()


@contextmanager
def use_cache_folder(folder: Path) -> Iterator[None]:
    """Keep every program in a folder, however fast it compiles, until the context ends.

    Args:
        folder: folder from which programs are read and to which they are written; the user's cache
            is not used.
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


def switch_cache(is_on: bool) -> None:
    """Turn JAX's cache on or off for what is compiled from now on, in all threads."""
    _apply_settings({"jax_enable_compilation_cache": is_on})


def _apply_settings(settings: Mapping[str, object]) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
