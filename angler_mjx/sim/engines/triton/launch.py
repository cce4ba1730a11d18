"""Launches of kernels: no other module knows which compiler stands behind them.

Triton compiles them by Pallas; `angler_kernels.cuda` emits them as CUDA C for NVRTC.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as plt
from jax.typing import ArrayLike

from angler_kernels import lanes
from angler_kernels.cuda import kernel_call
from angler_kernels.lanes.planes import StoreFunction
from angler_kernels.programs import Compiler
from angler_mjx.errors import RunError


@dataclass(frozen=True, kw_only=True)
class LaunchedProgram:
    """Shape of the programs of a kernel."""

    lanes: int
    """Lanes of one, a power of two."""
    warps: int
    """Warps of one."""
    compiler: Compiler = "triton"
    """Compiler of the kernels; with cuda, a lane is a thread and a program a block."""
    interpret: bool = False
    """Run the kernels as ordinary JAX, on any device."""


def call_kernel(
    kernel: Callable[..., None],
    program: LaunchedProgram,
    width: int,
    rows: int,
    constant: Sequence[jax.Array],
    changed: Sequence[jax.Array],
) -> Sequence[jax.Array]:
    """Run a kernel that changes some arrays in place.

    Args:
        kernel: of lanes int32 [n], the row int32 [], and references to the constant arrays and to
            the changed ones.
        program: shape of its programs.
        width: lanes of a row, a multiple of a program's.
        rows: number of rows.
        constant: arrays that are read.
        changed: arrays that are read and written.

    Returns:
        The changed arrays.

    Raises:
        RunError: an array is too long for the numbers that count its places.
    """
    largest = max(x.size for x in (*constant, *changed))
    if largest >= 2**31:
        raise RunError(
            f"kernels count places in 31 bits, and an array of this tile has {largest}: "
            f"use a tile {-(-largest // 2**31)} times smaller, or more, or fewer samples a segment"
        )
    if program.compiler == "cuda":
        return kernel_call.call_lanes(
            kernel,
            constant,
            changed,
            width=width,
            rows=rows,
            block=program.lanes,
            interpret=program.interpret,
        )
    first = len(constant)

    def traced(*refs: jax.Ref) -> None:
        at, row = _locate_lanes(program.lanes)
        with lanes.use_instructions(kernel_call.ORDINARY if program.interpret else _INSTRUCTIONS):
            # Changed arrays are there twice: they are read and written under the second.
            kernel(at, row, *refs[:first], *refs[-len(changed) :])

    after: Sequence[jax.Array] = pl.pallas_call(
        traced,
        out_shape=[jax.ShapeDtypeStruct(x.shape, x.dtype) for x in changed],
        grid=(width // program.lanes, rows),
        input_output_aliases={first + k: k for k in range(len(changed))},
        compiler_params=plt.CompilerParams(num_warps=program.warps, num_stages=1),
        interpret=program.interpret,
    )(*constant, *changed)
    return after


def _inline_instruction(text: str, *args: jax.Array) -> jax.Array:
    """One instruction of PTX on float32 lanes."""
    (output,) = plt.elementwise_inline_asm(
        text,
        args=list(args),
        constraints=",".join(["=f"] + ["f"] * len(args)),
        pack=1,
        result_shape_dtypes=[jax.ShapeDtypeStruct(args[0].shape, args[0].dtype)],
    )
    return output


def multiply_add(a: jax.Array, b: jax.Array, c: jax.Array) -> jax.Array:
    """``a b + c``, rounded once: this compiler keeps multiplication and addition apart."""
    return _inline_instruction("fma.rn.f32 $0, $1, $2, $3;", a, b, c)


def _approximate_reciprocal(x: jax.Array) -> jax.Array:
    """One instruction, within an ulp; division would be seven more, for the sake of denormals."""
    return _inline_instruction("rcp.approx.ftz.f32 $0, $1;", x)


_INSTRUCTIONS = lanes.Instructions(reciprocal=_approximate_reciprocal, multiply_add=multiply_add)


def _locate_lanes(width: int) -> tuple[jax.Array, jax.Array]:
    """Lanes [width] of this program within its row, and the row."""
    return pl.program_id(0) * width + jnp.arange(width), pl.program_id(1)


def make_loader(ref: jax.Ref) -> lanes.LoadFunction:
    """What reads a reference at places."""
    return lambda at: ref[at]


def make_storer(ref: jax.Ref, like: jax.Array) -> StoreFunction:
    """What writes lanes, or one number for all of them, to a reference at places."""

    def store(at: jax.Array, value: ArrayLike) -> None:
        ref[at] = jnp.broadcast_to(jnp.asarray(value, ref.dtype), like.shape)

    return store


def run_when(condition: jax.Array, do: Callable[[], None]) -> None:
    """Do something in a kernel if a condition [] holds."""
    jax.lax.cond(condition, do, lambda: None)


def with_gradient_of[*Arrays, Result](
    reference: Callable[[*Arrays], Result], fast: Callable[[*Arrays], Result]
) -> Callable[[*Arrays], Result]:
    """``fast``, with the derivatives of ``reference``, a function of the same arrays."""

    @jax.custom_vjp
    def run(*args: *Arrays) -> Result:
        return fast(*args)

    def forward(*args: *Arrays) -> tuple[Result, tuple[*Arrays]]:
        return fast(*args), args

    def backward(args: tuple[*Arrays], cotangent: Result) -> tuple[*Arrays]:
        gradient: tuple[*Arrays] = jax.vjp(reference, *args)[1](cotangent)
        return gradient

    run.defvjp(forward, backward)
    return lambda *args: run(*args)
