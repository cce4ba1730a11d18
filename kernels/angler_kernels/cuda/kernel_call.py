"""Kernels within JAX programs: traced, emitted as CUDA C, compiled side by side, and called.

A kernel is a Python function of the number of its lane, its row, and references to flat arrays.
Where it is traced into a program, its compilation begins in another thread; the program waits for
it only when it is lowered itself. XLA calls PTX without a library of ours, so that a compiled
program holds all it needs and can be kept in a cache.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive
from jax.interpreters import mlir

from angler_kernels import lanes
from angler_kernels.cuda import nvrtc
from angler_kernels.cuda.emission import KernelArray, emit_kernel

type Kernel = Callable[..., None]
"""Kernel of lanes int32 [n], the row int32 [], and references to its arrays: it stores results."""

TARGET = "__gpu$xla.gpu.ptx"
"""XLA's name of a call of a kernel in PTX."""

TRACED_LANES = 32
"""Number of lanes that kernels of independent lanes are traced with; any would do."""

_multiply_add_p = Primitive("multiply_add")
_approximate_reciprocal_p = Primitive("approximate_reciprocal")
for _primitive in (_multiply_add_p, _approximate_reciprocal_p):
    _primitive.def_abstract_eval(lambda *operands: operands[0])

INSTRUCTIONS = lanes.Instructions(
    reciprocal=_approximate_reciprocal_p.bind, multiply_add=_multiply_add_p.bind
)
"""Instructions of the device: an approximate reciprocal, within an ulp, and a product and a sum
rounded once."""

ORDINARY = lanes.Instructions(reciprocal=lambda x: 1.0 / x, multiply_add=lambda a, b, c: a * b + c)
"""The same where kernels run as ordinary JAX."""

_call_p = Primitive("cuda_kernel")
_call_p.multiple_results = True


@dataclass(frozen=True, kw_only=True)
class KernelLaunch:
    """Kernel, and the threads that run it."""

    source: str
    grid: tuple[int, int]
    """Blocks along x, and rows."""
    block: int
    """Threads of a block."""
    constants: int
    """Number of arrays that are only read; they come first."""


def call_lanes(
    kernel: Kernel,
    constant: Sequence[jax.Array],
    changed: Sequence[jax.Array],
    *,
    width: int,
    rows: int,
    block: int,
    interpret: bool = False,
) -> Sequence[jax.Array]:
    """Run a kernel of independent lanes, ``width`` of them in each row.

    Args:
        kernel: of references to the constant arrays and the changed ones; divisions and sums of
            products are instructions of the device, see `INSTRUCTIONS`.
        constant: flat arrays that are read.
        changed: flat arrays that are read and written.
        width: lanes of a row, a multiple of ``block``.
        rows: number of rows.
        block: lanes of a block.
        interpret: run as ordinary JAX, on any device.

    Returns:
        The changed arrays.
    """
    if interpret:
        with lanes.use_instructions(ORDINARY):
            return _interpret(kernel, width, rows, constant, changed)
    with lanes.use_instructions(INSTRUCTIONS):
        closed = _trace(kernel, TRACED_LANES, [*constant, *changed])
    described = _describe([*constant, *changed], len(constant))
    code = emit_kernel("kernel", closed, described, lanes=TRACED_LANES)
    return _bind(
        KernelLaunch(
            source=code.text, grid=(width // block, rows), block=block, constants=len(constant)
        ),
        [*constant, *changed],
    )


def _trace(kernel: Kernel, n_lanes: int, arrays: Sequence[jax.Array]) -> ClosedJaxpr:
    """Trace a kernel; its references are those of ``arrays``."""

    def run(lane: jax.Array, row: jax.Array, *values: jax.Array) -> None:
        kernel(lane, row, *(jax.new_ref(value) for value in values))

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays]
    lane = jax.ShapeDtypeStruct((n_lanes,), jnp.int32)
    return jax.make_jaxpr(run)(lane, jax.ShapeDtypeStruct((), jnp.int32), *shapes)


def _describe(arrays: Sequence[jax.Array], constants: int) -> list[KernelArray]:
    return [
        KernelArray(
            name=f"array{k}", dtype=np.dtype(x.dtype), size=x.size, is_written=k >= constants
        )
        for k, x in enumerate(arrays)
    ]


def _interpret(
    kernel: Kernel,
    width: int,
    rows: int,
    constant: Sequence[jax.Array],
    changed: Sequence[jax.Array],
) -> list[jax.Array]:
    """Run a kernel as ordinary JAX: all lanes of a row at once, rows one after another."""
    refs = [jax.new_ref(x) for x in (*constant, *changed)]
    lane = jnp.arange(width, dtype=jnp.int32)
    jax.lax.fori_loop(0, rows, lambda row, _: kernel(lane, row, *refs), None)
    return [jax.freeze(ref) for ref in refs[len(constant) :]]


def _bind(launch: KernelLaunch, arrays: Sequence[jax.Array]) -> Sequence[jax.Array]:
    nvrtc.begin_compilation(launch.source, _architecture(), _cache_folder())
    results: Sequence[jax.Array] = _call_p.bind(*arrays, launch=launch)
    return results


def _architecture() -> str:
    """Return the virtual architecture of the first device, like ``compute_90``."""
    return "compute_" + str(jax.devices()[0].compute_capability).replace(".", "")


def _cache_folder() -> Path | None:
    """Return the folder of PTX: in that of JAX's compiled programs, where there is one."""
    folder = jax.config.jax_compilation_cache_dir
    return Path(folder) / "ptx" if folder else None


def _call(*arrays: jax.Array, launch: KernelLaunch) -> Sequence[jax.Array]:
    """Call a kernel as XLA does, once it is compiled."""
    code = nvrtc.begin_compilation(launch.source, _architecture(), _cache_folder())
    changed, at = arrays[launch.constants :], launch.constants
    call = jax.ffi.ffi_call(
        TARGET,
        [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in changed],
        input_output_aliases={at + k: k for k in range(len(changed))},
    )
    sizes = {
        "grid_x": launch.grid[0],
        "grid_y": launch.grid[1],
        "grid_z": 1,
        "block_x": launch.block,
        "block_y": 1,
        "block_z": 1,
        "shared_mem_bytes": 0,
    }
    results: Sequence[jax.Array] = call(
        *arrays,
        name="kernel",
        kernel_type="ptx",
        kernel_data=code.result(),
        **{name: np.int32(size) for name, size in sizes.items()},
    )
    return results


def _shapes(*arrays: jax.core.AbstractValue, launch: KernelLaunch) -> list[jax.core.AbstractValue]:
    return list(arrays[launch.constants :])


_call_p.def_abstract_eval(_shapes)
_call_p.def_impl(lambda *arrays, launch: jax.jit(partial(_call_p.bind, launch=launch))(*arrays))
mlir.register_lowering(_call_p, mlir.lower_fun(_call, multiple_results=True), platform="cuda")
