"""One bit for each job, 32 to a word: small enough for a packet."""

import jax
import jax.numpy as jnp

WORD = 32


def pack_flags(flags: jax.Array) -> jax.Array:
    """Pack flags bool [..., M] into words uint32 [..., W]; job j is bit j % 32 of word j // 32."""
    # Each flag is computed separately, not 32 in sequence.
    jobs, flags = flags.shape[-1], jax.lax.optimization_barrier(flags)
    words = -(-jobs // WORD)
    fill = [(0, 0)] * (flags.ndim - 1) + [(0, words * WORD - jobs)]
    bits = jnp.pad(flags, fill).reshape(*flags.shape[:-1], words, WORD)
    weight = jnp.uint32(1) << jnp.arange(WORD, dtype=jnp.uint32)
    return jnp.sum(jnp.where(bits, weight, jnp.uint32(0)), axis=-1, dtype=jnp.uint32)


def unpack_flags(words: jax.Array, jobs: int) -> jax.Array:
    """Unpack flags bool [..., M] from words uint32 [..., W]."""
    bit_index = jnp.arange(WORD, dtype=jnp.uint32)
    flags = ((words[..., None] >> bit_index) & 1).astype(bool)
    return flags.reshape(*words.shape[:-1], -1)[..., :jobs]


def union_words(words: jax.Array) -> jax.Array:
    """Return the union uint32 [R, W] of the bits of words [R, n, W]."""
    union: jax.Array = jax.lax.reduce(words, jnp.uint32(0), jax.lax.bitwise_or, (1,))
    return union
