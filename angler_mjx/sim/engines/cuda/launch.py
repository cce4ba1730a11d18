"""Launches of kernels of independent lanes, and references within them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from angler_kernels import lanes
from angler_kernels.cuda import kernel_call
from angler_kernels.lanes.planes import StoreFunction
from angler_mjx.errors import RunError


@dataclass(frozen=True, kw_only=True)
class LaunchShape:
    """Threads that run a kernel, a lane each."""

    block: int
    """Lanes of a block."""
    interpret: bool = False
    """Run the kernels as ordinary JAX, on any device."""


def call_kernel(
    kernel: Callable[..., None],
    shape: LaunchShape,
    width: int,
    rows: int,
    constant: Sequence[jax.Array],
    changed: Sequence[jax.Array],
) -> Sequence[jax.Array]:
    """Run a kernel that changes some arrays in place.

    Args:
        kernel: of lanes int32 [n], the row int32 [], and references to the constant arrays and to
            the changed ones.
        shape: threads that run it.
        width: lanes of a row, a multiple of a block's.
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
    return kernel_call.call_lanes(
        kernel,
        constant,
        changed,
        width=width,
        rows=rows,
        block=shape.block,
        interpret=shape.interpret,
    )


def make_loader(ref: jax.Ref) -> lanes.LoadFunction:
    """Return a function that reads a reference at indices."""
    return lambda at: ref[at]


def make_storer(ref: jax.Ref, like: jax.Array) -> StoreFunction:
    """Return a function that writes lanes, or a number for all, to a reference at indices."""

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
