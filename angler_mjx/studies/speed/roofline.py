"""What the device itself can do, measured, and how far from it a rate is.

Memory: a large array is read and written once, element by element. Arithmetic: chains of fused
multiply-adds of float32 in registers, eight of them side by side so that none waits for itself; on
a GPU in a kernel that names the instruction, because XLA keeps multiplication and addition apart
there. A rate cannot be above either of ``copy / bytes`` and ``fma / flops``, with the bytes
and operations that one step needs: the lower of the two is its roofline (Williams, Waterman and
Patterson, 2009).
"""

import shlex
import subprocess
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.cuda.kernel_call import INSTRUCTIONS
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.studies.speed.rows import SpeedRow, iterate_turns, seconds_of

CHAINS = 8
"""Side by side in each element."""
_SHAPE = launch.LaunchShape(block=256)
_IN_A_TURN = 16
"""Links of each chain in a turn of the kernel's loop: its own instructions are few beside them."""


@dataclass(frozen=True, kw_only=True)
class _DeviceLoad:
    """What is timed."""

    copied: int
    """Elements."""
    chained: int
    """Elements with chains."""
    links: int
    """Multiply-adds of a chain."""


_LOADS = {"cpu": _DeviceLoad(copied=2**26, chained=2**20, links=64)}
"""About 20 ms each on two cores."""
_LOAD_ELSEWHERE = _DeviceLoad(copied=2**30, chained=2**25, links=1024)
"""Some ms each on a device of some TB/s and some 10 TFLOP/s: a launch, and reading what the chains
begin with, are little beside it."""


@dataclass(frozen=True, kw_only=True)
class DeviceSpeed:
    """Measured limits of one device."""

    copy_bytes_per_s: float
    """Bytes read plus bytes written."""
    fma_flops_per_s: float
    """A multiply-add counts two."""
    driver: str | None
    """Of an NVIDIA device, as ``nvidia-smi`` says."""


def measure(repeats: int = 10) -> DeviceSpeed:
    """Measure the default device; medians of the repeats."""
    backend = jax.default_backend()
    load = _LOADS.get(backend, _LOAD_ELSEWHERE)
    copy = _median_s(load.copied, jax.jit(lambda x, a, b: x + b), repeats)
    chains = partial(_run_chains_in_kernel if backend == "gpu" else _run_chains, load.links)
    chain = _median_s(load.chained, jax.jit(chains), repeats)
    return DeviceSpeed(
        copy_bytes_per_s=2 * 4 * load.copied / copy,
        fma_flops_per_s=2 * CHAINS * load.links * load.chained / chain,
        driver=None if backend == "cpu" else read_driver_version(),
    )


def compute_bound(row: SpeedRow, device: DeviceSpeed) -> float | None:
    """Highest rate that the row's devices allow; None if neither of its needs is known."""
    limits = []
    if row.flops:
        limits.append(device.fma_flops_per_s / row.flops)
    if row.least_bytes:
        limits.append(device.copy_bytes_per_s / row.least_bytes)
    return row.devices * min(limits) if limits else None


def read_driver_version() -> str | None:
    """Version of the NVIDIA driver; None where there is none."""
    try:
        output = subprocess.run(
            ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"],
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        ).stdout.split()
    except (OSError, subprocess.SubprocessError):
        return None
    return output[0] if output else None


def _run_chains(n_link: int, x: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """The sum of ``CHAINS`` chains; nothing in them is known before the call."""
    links = [x + k for k in range(CHAINS)]
    for _ in range(n_link):
        links = [link * a + b for link in links]
    total = links[0]
    for link in links[1:]:
        total = total + link
    return total


def _run_chains_in_kernel(n_link: int, x: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """The same in one kernel; in a loop, for straight code would wait for its instructions."""
    multiply_add = INSTRUCTIONS.multiply_add

    def kernel(
        at: jax.Array, _: jax.Array, a: jax.Ref, b: jax.Ref, turns: jax.Ref, out: jax.Ref
    ) -> None:
        x = launch.make_loader(out)(at)
        factor, term = (jnp.broadcast_to(number[0], x.shape) for number in (a, b))

        def turn(_: jax.Array, links: list[jax.Array]) -> list[jax.Array]:
            for _link in range(_IN_A_TURN):
                links = [multiply_add(link, factor, term) for link in links]
            return links

        links = [x + k for k in range(CHAINS)]
        links = jax.lax.fori_loop(0, turns[0], turn, links)
        launch.make_storer(out, at)(at, sum(links))

    # Read, not known: else the compiler writes the loop out.
    inputs = [a.reshape(1), b.reshape(1), jnp.array([n_link // _IN_A_TURN], jnp.int32)]
    (after,) = launch.call_kernel(kernel, _SHAPE, x.size, 1, inputs, [x])
    return after


def _median_s(elements: int, function: jax.stages.Wrapped, repeats: int) -> float:
    x = jnp.ones(elements, jnp.float32)
    a, b = jnp.float32(0.999), jnp.float32(0.001)
    program = function.lower(x, a, b).compile()
    taken = [(seconds_of(program, x, a, b)[0], counts) for counts in iterate_turns(repeats)]
    return float(np.median([seconds for seconds, counts in taken if counts]))


def describe_conditions(device: DeviceSpeed) -> dict[str, object]:
    """Return the device with its measured limits and driver, versions, machine, commit and command.

    Rows are for others to read: of absolute paths in the command the last name is kept.
    """
    conditions = {**describe_environment(), **asdict(device)}
    arguments = shlex.split(conditions["command"])
    names = [Path(word).name if Path(word).is_absolute() else word for word in arguments]
    return {**conditions, "command": shlex.join(names)}


def compare_with_bound(row: SpeedRow, device: DeviceSpeed) -> dict[str, float | None]:
    """Return the roofline of a row in its own unit, and the fraction of it that was reached."""
    highest = compute_bound(row, device)
    reached = None if highest is None or row.median is None else row.median / highest
    return {"bound": highest, "share_of_bound": reached}
