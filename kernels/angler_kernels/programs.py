"""GPU programs, one for each problem of a batch, as CUDA C.

For searches whose number of steps depends on the problem. A program has a lane for each cell of a
layer, or each column, of a grid; lanes exchange values through scratch memory small enough to stay
in the caches, with a barrier between writing and reading. Under ``vmap`` each problem of the batch
gets a program.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, wraps

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from angler_kernels.cuda import kernel_call

MAX_LANES = 2048
"""Maximum number of lanes, two for each thread that a program can have; more would not fit its
registers."""

_THREADS_PER_WARP, _MAX_WARPS = 32, 32
"""Threads of a warp, and maximum number of warps that a program can have."""

_are_allowed = jax.make_user_context(True)
"""Whether programs that are traced may call kernels; part of the keys under which JAX keeps
traces."""


def on_gpu() -> bool:
    """Return whether JAX's default device is a GPU."""
    return jax.default_backend() == "gpu"


def use_kernels() -> bool:
    """Return whether JAX's default device can run these programs, and may: `without_kernels`."""
    return on_gpu() and _are_allowed.value


def without_kernels[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that is plain JAX wherever it is traced: it needs no CUDA compiler."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with _are_allowed(False):
            return function(*args, **kwargs)

    if isinstance(function, partial):
        run.__name__ = function.func.__name__  # the name of its program
    return run


@dataclass(frozen=True, kw_only=True)
class BlockProgram:
    """Program of ``lanes`` or more lanes.

    Attributes:
        lanes: a power of two on a GPU, at least 32.
        lanes_per_warp: two for each thread where lanes wait for memory.
        interpret: run as ordinary JAX, on any device.
    """

    lanes: int
    lanes_per_warp: int = 64
    interpret: bool = False

    @classmethod
    def of(
        cls, min_lanes: int, *, lanes_per_warp: int = 64, interpret: bool = False
    ) -> "BlockProgram":
        """Build a program with at least ``min_lanes`` lanes."""
        return cls(
            lanes=max(32, 1 << (min_lanes - 1).bit_length()),
            lanes_per_warp=lanes_per_warp,
            interpret=interpret,
        )

    @property
    def warps(self) -> int:
        """Return the number of warps; lanes beyond the last are further lanes of the threads."""
        return min(max(1, self.lanes // self.lanes_per_warp), _MAX_WARPS)

    def run(
        self,
        kernel: Callable[..., None],
        arrays: Sequence[jax.Array],
        out: Sequence[jax.ShapeDtypeStruct],
    ) -> Sequence[jax.Array]:
        """Run a kernel on references to flat arrays and to the arrays that it fills."""
        return kernel_call.call_block(
            kernel,
            arrays,
            out,
            lanes=self.lanes,
            threads=_THREADS_PER_WARP * self.warps,
            interpret=self.interpret,
        )

    def load(self, ref: jax.Ref, at: jax.Array, mask: jax.Array, other: ArrayLike) -> jax.Array:
        """Read values at the lanes' indices; ``other`` where the mask is false."""
        return jnp.where(mask, ref[jnp.where(mask, at, 0)], jnp.asarray(other, ref.dtype))

    def store(self, ref: jax.Ref, at: jax.Array, value: jax.Array, mask: jax.Array) -> None:
        """Write at the lanes' indices where the mask is true."""
        # Behind the end, nothing is written.
        ref[jnp.where(mask, at, ref.shape[0])] = value

    def barrier(self) -> None:
        """Make all writes of any lane visible to all lanes."""
        kernel_call.wait_for_lanes()

    def when(self, condition: jax.Array, action: Callable[[], None]) -> None:
        """Run an action if a number of the whole program is true."""
        jax.lax.cond(condition, action, lambda: None)
