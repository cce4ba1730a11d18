"""Compiled programs kept on disk, for Python as for the command.

A `Simulator` switches this on. It is left alone where ``JAX_COMPILATION_CACHE_DIR`` or JAX's own
setting names a folder, and where ``ANGLER_COMPILE_CACHE=0`` says not to keep any.
"""

import os
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

OPT_OUT = "ANGLER_COMPILE_CACHE"
"""Environment variable; "0" keeps nothing."""


def folder() -> Path:
    """Where programs are kept: ``angler-mjx/xla`` in the user's cache folder."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "angler-mjx" / "xla"


def switch_on() -> None:
    """Have JAX keep what it compiles, unless the user said where or not to."""
    if os.environ.get(OPT_OUT) == "0" or jax.config.jax_compilation_cache_dir is not None:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder()))
    # JAX looks at the setting once, when it first compiles: that may have been before.
    compilation_cache.reset_cache()
