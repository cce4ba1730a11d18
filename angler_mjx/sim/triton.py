"""Pallas kernels lowered by Triton: no other module knows which compiler stands behind them."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as plt

from angler_mjx.errors import RunError


def call(
    kernel: Callable[..., None],
    grid: tuple[int, int],
    constant: Sequence[jax.Array],
    changed: Sequence[jax.Array],
    *,
    warps: int,
    interpret: bool = False,
) -> Sequence[jax.Array]:
    """Run a kernel that changes some arrays in place.

    Args:
        kernel: of references to the constant arrays and, twice, to the changed ones: they are read
            and written under the second.
        grid: programs along the lanes of a row, and rows.
        constant: arrays that are read.
        changed: arrays that are read and written.
        warps: in one program.
        interpret: run the kernel as ordinary JAX, on any device.

    Returns:
        The changed arrays.

    Raises:
        RunError: an array is too long for the numbers that count its places.
    """
    largest = max(x.size for x in (*constant, *changed))
    if largest >= 2**31:
        raise RunError(
            f"the Triton kernels count places in 31 bits, and an array of this tile has {largest}: "
            f"use a tile {-(-largest // 2**31)} times smaller, or more, or fewer samples a segment"
        )
    first = len(constant)
    after: Sequence[jax.Array] = pl.pallas_call(
        kernel,
        out_shape=[jax.ShapeDtypeStruct(x.shape, x.dtype) for x in changed],
        grid=grid,
        input_output_aliases={first + k: k for k in range(len(changed))},
        compiler_params=plt.CompilerParams(num_warps=warps, num_stages=1),
        interpret=interpret,
    )(*constant, *changed)
    return after


def place(lanes: int) -> tuple[jax.Array, jax.Array]:
    """Lanes [lanes] of this program within its row, and the row."""
    return pl.program_id(0) * lanes + jnp.arange(lanes), pl.program_id(1)


def loader(ref: Any) -> Callable[[Any], Any]:
    """What reads a reference at places."""
    return lambda at: ref[at]


def storer(ref: Any, like: jax.Array) -> Callable[[Any, Any], None]:
    """What writes lanes, or one number for all of them, to a reference at places."""

    def put(at: Any, value: Any) -> None:
        ref[at] = jnp.broadcast_to(jnp.asarray(value, ref.dtype), like.shape)

    return put


def when(condition: jax.Array, do: Callable[[], None]) -> None:
    """Do something in a kernel if a condition [] holds."""
    pl.when(condition)(do)


def with_gradient_of(reference: Callable[..., Any], fast: Callable[..., Any]) -> Callable[..., Any]:
    """``fast``, with the derivatives of ``reference``, a function of the same arrays."""

    @jax.custom_vjp
    def run(*args: Any) -> Any:
        return fast(*args)

    def forward(*args: Any) -> tuple[Any, Any]:
        return fast(*args), args

    def backward(args: Any, cotangent: Any) -> Any:
        return jax.vjp(reference, *args)[1](cotangent)

    run.defvjp(forward, backward)
    return run
