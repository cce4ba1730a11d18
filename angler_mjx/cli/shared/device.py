"""Choosing the device and the compile cache, before JAX touches either."""

import os
from typing import TYPE_CHECKING, Literal

from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.runs.processes import Processes

type Device = Literal["cpu", "gpu"]


def choose_device(device: Device | None, *, distributed: bool = False) -> None:
    """Make JAX compute on ``device``, or on its own choice if None, with a compile cache.

    Compiled programs are kept: see `angler_mjx.runs.simulator.compile_cache`.

    Args:
        device: where to compute.
        distributed: whether `join_processes` follows: processes that share a run must find each
            other before one of them looks at its devices.

    Raises:
        ConfigError: there is no such device.
    """
    import jax

    from angler_mjx.runs.simulator import compile_cache

    compile_cache.enable_cache()
    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    if device == "gpu" and not distributed:
        _require_gpu()


def keep_all_programs() -> None:
    """Have the compile cache keep what compiles fast too; for commands that a person waits for.

    JAX leaves out what takes less than 1 s: of a scene on real autopilots all but two of 24
    programs, 1 to 2 s of every start. ``JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS`` is obeyed.
    """
    import jax

    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def join_processes(
    device: Device | None,
    *,
    distributed: bool,
    coordinator: str | None,
    processes: int | None,
    process: int | None,
) -> "Processes":
    """The processes that share a run: this one alone, or all that were started with it.

    Args:
        device: as given to `choose_device`.
        distributed: whether there are others.
        coordinator: host and port of process 0; as the next two, told by Slurm and Open MPI.
        processes: how many there are.
        process: index of this one.

    Raises:
        ConfigError: flags of a shared run without ``--distributed``, or not enough of them.
        RunError: the others did not come.
    """
    from angler_mjx.runs.processes import OneProcess
    from angler_mjx.runs.processes import join_processes as join_others

    if distributed:
        group = join_others(coordinator, processes, process)
        if device == "gpu":
            _require_gpu()
        return group
    flags = {"coordinator": coordinator, "processes": processes, "process": process}
    for name, value in flags.items():
        if value is not None:
            raise ConfigError(f"--{name} {value}: belongs to --distributed; give that as well")
    return OneProcess()


def _require_gpu() -> None:
    import jax

    try:
        jax.local_devices(backend="gpu")
    except RuntimeError as error:
        raise ConfigError(
            "--device gpu: JAX finds no such device here; use --device cpu, or install the "
            "gpu extra on a machine with an NVIDIA driver"
        ) from error
