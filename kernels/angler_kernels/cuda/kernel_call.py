"""Kernels within JAX programs: traced, emitted as CUDA C, compiled side by side, and called.

A kernel is a Python function of references to flat arrays and, where its lanes are independent, of
the number of its lane and its row. Where it is traced into a program, its compilation begins in
another thread; the program waits for it only when it is lowered itself. XLA calls PTX without a
library of ours, so that a compiled program holds all it needs and can be kept in a cache.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive
from jax.interpreters import batching, mlir

from angler_kernels import lanes
from angler_kernels.cuda import nvrtc
from angler_kernels.cuda.emission import KernelArray, emit_block, emit_kernel
from angler_kernels.cuda.nvrtc import FAST_DIVISION, KernelSource

type Kernel = Callable[..., None]
"""Kernel of references to its arrays, in which it stores results; before these, where lanes are
independent, of lanes int32 [n] and the row int32 []."""

type Shaped = jax.Array | jax.ShapeDtypeStruct
"""Array, or its shape and type."""

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

_barrier: ContextVar[jax.Ref] = ContextVar("barrier")
"""Array that a kernel that is being traced writes to where its lanes wait for each other."""

_call_p, _call_block_p = Primitive("cuda_kernel"), Primitive("cuda_block")
_call_p.multiple_results = _call_block_p.multiple_results = True


@dataclass(frozen=True, kw_only=True)
class KernelLaunch:
    """Kernel of independent lanes, and the threads that run it."""

    source: KernelSource
    grid: tuple[int, int]
    """Blocks along x, and rows."""
    block: int
    """Threads of a block."""
    constants: int
    """Number of arrays that are only read; they come first."""


@dataclass(frozen=True, kw_only=True)
class BlockLaunch:
    """Kernel whose lanes work together, the blocks that run it, and the arrays that they fill."""

    body: str
    """Source, except which problem is whose."""
    threads: int
    """Threads of a block."""
    filled: tuple[jax.ShapeDtypeStruct, ...]
    """Arrays that a problem fills."""
    batch: tuple[int, ...] = ()
    """Numbers of problems along the axes of the batch; blocks are in the order of the last."""
    shared: tuple[frozenset[int], ...] = ()
    """For each array that is read, the axes of the batch, from the last, along which all problems
    share it."""

    @property
    def source(self) -> KernelSource:
        """Return the source, with the problem of each array for each block."""
        every = [*self.shared, *(frozenset[int]() for _ in self.filled)]
        lines = [
            f"#define PROBLEM_OF_{_array_name(k)} {_write_problem(self.batch, shared)}"
            for k, shared in enumerate(every)
        ]
        return KernelSource("\n".join([*lines, self.body]))


def _write_problem(batch: Sequence[int], shared: frozenset[int]) -> str:
    """Return the number of a block's problem among those with an array of their own, in C."""
    terms, stride, problems = ["0"], 1, 1
    for axis, count in enumerate(reversed(batch)):
        if axis not in shared:
            terms.append(f"block / {stride} % {count} * {problems}")
            problems *= count
        stride *= count
    return " + ".join(terms)


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
        kernel: of references to the constant arrays and the changed ones; divisions, square roots
            and sums of products are instructions of the device, see `INSTRUCTIONS` and
            `nvrtc.FAST_DIVISION`.
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
    code = emit_kernel("kernel", closed, described, lanes=TRACED_LANES, threads=block)
    return _bind(
        KernelLaunch(
            source=KernelSource(code.text, options=FAST_DIVISION),
            grid=(width // block, rows),
            block=block,
            constants=len(constant),
        ),
        [*constant, *changed],
    )


def call_block(
    kernel: Kernel,
    arrays: Sequence[jax.Array],
    filled: Sequence[jax.ShapeDtypeStruct],
    *,
    lanes: int,
    threads: int,
    interpret: bool = False,
) -> Sequence[jax.Array]:
    """Run a kernel whose lanes work together on one problem; under ``vmap``, a block for each.

    Lanes are numbered by `jax.numpy.arange`. Stores behind the end of an array are dropped. A
    barrier makes stores visible to other lanes; a load of one number is a barrier, too, where the
    array is filled.

    Args:
        kernel: of references to the arrays and to those that it fills.
        arrays: flat arrays that are read.
        filled: shapes of the flat arrays that are filled; they hold anything before.
        lanes: number of lanes, a multiple of ``threads``.
        threads: of a block, a multiple of 32, at most 1,024.
        interpret: run as ordinary JAX, on any device.

    Returns:
        The filled arrays.
    """
    if interpret:
        run = jax.custom_batching.sequential_vmap(partial(_interpret_block, kernel, filled))
        results: Sequence[jax.Array] = run(*arrays)
        return results
    every: list[Shaped] = [*arrays, *filled]
    code = emit_block(
        "kernel",
        _trace_block(kernel, every),
        _describe(every, len(arrays)),
        lanes=lanes,
        threads=threads,
    )
    launch = BlockLaunch(
        body=code.text,
        threads=threads,
        filled=tuple(filled),
        shared=(frozenset(),) * len(arrays),
    )
    results = _call_block_p.bind(*arrays, launch=launch)
    return results


def wait_for_lanes() -> None:
    """Make all earlier stores of any lane of a block visible to all of them, in a kernel."""
    _barrier.get()[0] = jnp.int32(0)


def _trace(kernel: Kernel, n_lanes: int, arrays: Sequence[Shaped]) -> ClosedJaxpr:
    """Trace a kernel of independent lanes; its references are those of ``arrays``."""

    def run(lane: jax.Array, row: jax.Array, *values: jax.Array) -> None:
        kernel(lane, row, *(jax.new_ref(value) for value in values))

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays]
    lane = jax.ShapeDtypeStruct((n_lanes,), jnp.int32)
    return jax.make_jaxpr(run)(lane, jax.ShapeDtypeStruct((), jnp.int32), *shapes)


def _trace_block(kernel: Kernel, arrays: Sequence[Shaped]) -> ClosedJaxpr:
    """Trace a kernel of a block; the last reference is the barrier."""

    def run(*values: jax.Array) -> None:
        *refs, barrier = (jax.new_ref(value) for value in values)
        with _use_barrier(barrier):
            kernel(*refs)

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays]
    return jax.make_jaxpr(run)(*shapes, jax.ShapeDtypeStruct((1,), jnp.int32))


@contextmanager
def _use_barrier(barrier: jax.Ref) -> Iterator[None]:
    token = _barrier.set(barrier)
    try:
        yield
    finally:
        _barrier.reset(token)


def _array_name(k: int) -> str:
    return f"array{k}"


def _describe(arrays: Sequence[Shaped], constants: int) -> list[KernelArray]:
    return [
        KernelArray(
            name=_array_name(k), dtype=np.dtype(x.dtype), size=x.size, is_written=k >= constants
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


def _interpret_block(
    kernel: Kernel, filled: Sequence[jax.ShapeDtypeStruct], *arrays: jax.Array
) -> list[jax.Array]:
    """Run a kernel of a block as ordinary JAX: all lanes at once."""
    empty = [jax.lax.empty(x.shape, x.dtype) for x in filled]
    refs = [jax.new_ref(x) for x in (*arrays, *empty)]
    with _use_barrier(jax.new_ref(jnp.zeros(1, jnp.int32))):
        kernel(*refs)
    return [jax.freeze(ref) for ref in refs[len(arrays) :]]


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
    changed, at = arrays[launch.constants :], launch.constants
    return _call_source(
        launch.source,
        arrays,
        [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in changed],
        grid=launch.grid,
        threads=launch.block,
        aliases={at + k: k for k in range(len(changed))},
    )


def _call_block(*arrays: jax.Array, launch: BlockLaunch) -> Sequence[jax.Array]:
    """Call a kernel with a block for each problem, once it is compiled."""
    return _call_source(
        launch.source,
        arrays,
        [jax.ShapeDtypeStruct((*launch.batch, *x.shape), x.dtype) for x in launch.filled],
        grid=(math.prod(launch.batch), 1),
        threads=launch.threads,
    )


def _call_source(
    source: KernelSource,
    arrays: Sequence[jax.Array],
    results: Sequence[jax.ShapeDtypeStruct],
    *,
    grid: tuple[int, int],
    threads: int,
    aliases: dict[int, int] | None = None,
) -> Sequence[jax.Array]:
    """Call a kernel whose pointers are those of the arrays, then those of the results."""
    code = nvrtc.begin_compilation(source, _architecture(), _cache_folder())
    call = jax.ffi.ffi_call(TARGET, results, input_output_aliases=aliases)
    sizes = {
        "grid_x": grid[0],
        "grid_y": grid[1],
        "grid_z": 1,
        "block_x": threads,
        "block_y": 1,
        "block_z": 1,
        "shared_mem_bytes": 0,
    }
    after: Sequence[jax.Array] = call(
        *arrays,
        name="kernel",
        kernel_type="ptx",
        kernel_data=code.result(),
        **{name: np.int32(size) for name, size in sizes.items()},
    )
    return after


def _batch_blocks(
    arrays: Sequence[jax.Array], axes: Sequence[int | None], *, launch: BlockLaunch
) -> tuple[Sequence[jax.Array], list[int]]:
    """Add an axis of problems before those of the batch; arrays without it are shared along it."""
    batched = [(x, axis) for x, axis in zip(arrays, axes, strict=True) if axis is not None]
    axis_number = len(launch.batch)
    many = replace(
        launch,
        batch=(batched[0][0].shape[batched[0][1]], *launch.batch),
        shared=tuple(
            shared | {axis_number} if axis is None else shared
            for shared, axis in zip(launch.shared, axes, strict=True)
        ),
    )
    rows = [
        x if axis is None else jnp.moveaxis(x, axis, 0)
        for x, axis in zip(arrays, axes, strict=True)
    ]
    results = _call_block_p.bind(*rows, launch=many)
    return results, [0] * len(results)


def _shapes(*arrays: jax.core.AbstractValue, launch: KernelLaunch) -> list[jax.core.AbstractValue]:
    return list(arrays[launch.constants :])


def _block_shapes(
    *arrays: jax.core.AbstractValue, launch: BlockLaunch
) -> list[jax.core.AbstractValue]:
    """Return the shapes of the filled arrays; compilation begins where the batch may be whole."""
    nvrtc.begin_compilation(launch.source, _architecture(), _cache_folder())
    return [jax.core.ShapedArray((*launch.batch, *x.shape), x.dtype) for x in launch.filled]


def _register(
    primitive: Primitive, shapes: Callable[..., object], call: Callable[..., object]
) -> None:
    """Give a primitive its rules."""
    primitive.def_abstract_eval(shapes)
    primitive.def_impl(
        lambda *arrays, launch: jax.jit(partial(primitive.bind, launch=launch))(*arrays)
    )
    mlir.register_lowering(primitive, mlir.lower_fun(call, multiple_results=True), platform="cuda")


_register(_call_p, _shapes, _call)
_register(_call_block_p, _block_shapes, _call_block)
batching.primitive_batchers[_call_block_p] = _batch_blocks
