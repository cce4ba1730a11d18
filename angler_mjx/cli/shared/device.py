"""Choice of the device and the compile cache, before JAX initialises either."""

import os
from typing import TYPE_CHECKING, Literal

from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.runs.processes import Processes

type Device = Literal["cpu", "gpu"]
type Kernels = Literal["xla", "cuda", "triton"]
"""Values of ``--kernels``."""


def choose_device(device: Device | None, *, distributed: bool = False) -> None:
    """Make JAX compute on ``device``, or on its own choice if None, with a compile cache.

    Compiled programs are kept: see `angler_mjx.runs.simulator.compile_cache` and
    `angler_mjx.runs.simulator.stored_programs`.

    Args:
        device: device to compute on.
        distributed: whether `join_processes` follows: processes that share a run must connect
            before any of them accesses its devices.

    Raises:
        ConfigError: there is no such device.
    """
    import jax

    from angler_mjx.runs.simulator import compile_cache, stored_programs

    compile_cache.enable_cache()
    stored_programs.enable_stored_programs()
    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    if device == "gpu" and not distributed:
        _require_gpu()


def keep_all_programs() -> None:
    """Make the compile cache keep fast compilations too; for interactive commands.

    JAX leaves out programs that compile in less than 1 s: of a scene on real autopilots all but two
    of 24 programs, 1 to 2 s of every start. ``JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS`` takes
    precedence.
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
    """Return the processes that share a run: this one alone, or all that were started with it.

    Args:
        device: as in `choose_device`.
        distributed: whether there are others.
        coordinator: host and port of process 0; detected under Slurm and Open MPI, as are the next
            two.
        processes: number of processes.
        process: index of this process.

    Raises:
        ConfigError: flags of a shared run without ``--distributed``, or missing flags.
        RunError: the other processes did not connect.
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
