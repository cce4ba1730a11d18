"""Keys of random numbers for programs that a CPU's compiler finds short.

JAX writes the rounds of Threefry as a loop over arrays of the caller's shape. XLA compiles some ten
kernels for each call, and unrolls those of short rows at length: for the worlds of `reef_fleet`
that was a third of the compile time. Here all numbers of a call are one flat row, under ``vmap``
too, and the rounds are one kernel. The numbers are JAX's.
"""

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import define_prng_impl, threefry_prng_impl

from angler_kernels.programs import on_gpu

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = np.uint32(0x1BD11BDA)

type _Hash = Callable[..., jax.Array]
"""Function of arrays of equal shape, element by element."""


def seed_key(seed: jax.Array) -> jax.Array:
    """Return the key of a seed; its numbers are those of ``jax.random.key(seed)``.

    Args:
        seed: [] integer.

    Returns:
        [] key.
    """
    return jax.random.key(seed, impl="threefry2x32" if on_gpu() else _FLAT_THREEFRY)


def _flat_under_vmap(hash_words: _Hash) -> _Hash:
    """Return the function as a kernel of its own, on a flat row whatever axes ``vmap`` adds."""

    @jax.custom_batching.custom_vmap
    def hash_flat(*words: jax.Array) -> jax.Array:
        # Fused with what follows, the rounds would be compiled again for each user of the numbers.
        hashed: jax.Array = jax.lax.optimization_barrier(hash_words(*words))
        return hashed

    @hash_flat.def_vmap
    def _batch(size: int, batched: Sequence[bool], *words: jax.Array) -> tuple[jax.Array, bool]:
        rows = [
            word if is_one else jnp.broadcast_to(word, (size, *jnp.shape(word)))
            for word, is_one in zip(words, batched, strict=True)
        ]
        return hash_flat(*(row.reshape(-1) for row in rows)).reshape(rows[0].shape), True

    flat: _Hash = hash_flat
    return flat


@_flat_under_vmap
def _hash_keys(
    key0: jax.Array, key1: jax.Array, count: jax.Array, is_second: jax.Array
) -> jax.Array:
    """Return the first or the second word of the keys of counts."""
    first, second = _apply_rounds(key0, key1, count)
    word: jax.Array = jnp.where(is_second, second, first)
    return word


@_flat_under_vmap
def _hash_bits(key0: jax.Array, key1: jax.Array, count: jax.Array) -> jax.Array:
    """Return random bits, uint32."""
    first, second = _apply_rounds(key0, key1, count)
    bits: jax.Array = first ^ second
    return bits


@jax.jit
def _apply_rounds(
    key0: jax.Array, key1: jax.Array, count: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the two words of Threefry-2x32 with 20 rounds, of counts below 2^32."""
    keys = (key0, key1, key0 ^ key1 ^ _PARITY)
    x, y = key0, count + key1
    for turn in range(5):
        for rotation in _ROTATIONS[turn % 2]:
            x = x + y
            y = x ^ (y << np.uint32(rotation) | y >> np.uint32(32 - rotation))
        x = x + keys[(turn + 1) % 3]
        y = y + keys[(turn + 2) % 3] + np.uint32(turn + 1)
    return x, y


def _keys_of_counts(key: jax.Array, counts: jax.Array) -> jax.Array:
    """Return the words [..., 2] of keys, of a key [2] and counts uint32 [...]."""
    shape = (*counts.shape, 2)
    key0, key1 = (jnp.broadcast_to(word, shape) for word in key)
    is_second = jnp.broadcast_to(np.array([False, True]), shape)
    return _hash_keys(key0, key1, jnp.broadcast_to(counts[..., None], shape), is_second)


def _fold_in(key: jax.Array, data: jax.Array | int) -> jax.Array:
    """Fold a number, uint32 [], into a key [2]."""
    return _keys_of_counts(key, jnp.asarray(data, jnp.uint32))


def _split(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Return keys [*shape, 2] of a key [2]."""
    return _keys_of_counts(key, _counts(shape))


def _sample_bits(key: jax.Array, width: int, shape: tuple[int, ...]) -> jax.Array:
    """Sample bits [*shape] of a key [2], in words of 32 bits."""
    if width != 32:
        bits: jax.Array = threefry_prng_impl.random_bits(key, width, shape)
        return bits
    key0, key1 = (jnp.broadcast_to(word, shape) for word in key)
    return _hash_bits(key0, key1, _counts(shape))


def _counts(shape: tuple[int, ...]) -> jax.Array:
    """Return the counts of numbers [*shape], uint32."""
    return jax.lax.iota(jnp.uint32, math.prod(shape)).reshape(shape)


_FLAT_THREEFRY = define_prng_impl(
    key_shape=(2,),
    seed=threefry_prng_impl.seed,
    split=_split,
    random_bits=_sample_bits,
    fold_in=_fold_in,
    name="flat_threefry2x32",
    tag="flat_fry",
)
