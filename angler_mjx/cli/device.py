"""Choosing the device and the compile cache, before JAX touches either."""

import os
from pathlib import Path
from typing import Literal

from angler_mjx.errors import ConfigError

type Device = Literal["cpu", "gpu"]


def choose(device: Device | None) -> None:
    """Make JAX compute on ``device``, or on its own choice if None, with a compile cache.

    Compiled programs are kept in ``JAX_COMPILATION_CACHE_DIR``, or else in the user's cache folder.

    Raises:
        ConfigError: there is no such device.
    """
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(base / "angler-mjx" / "xla"))
    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    if device == "gpu":
        try:
            jax.devices("gpu")
        except RuntimeError as error:
            raise ConfigError(
                "--device gpu: JAX finds no such device here; use --device cpu, or install the "
                "gpu extra on a machine with an NVIDIA driver"
            ) from error
