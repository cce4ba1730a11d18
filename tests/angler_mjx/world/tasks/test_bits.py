"""Bits of jobs: what goes in comes out, and what any has set is set together."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world.tasks import bits


@pytest.mark.parametrize("jobs", [1, 31, 32, 33, 512])
def test_flags_come_out_of_words_as_they_went_in(jobs: int) -> None:
    flags = np.random.default_rng(jobs).random((3, jobs)) < 0.5
    words = bits.pack_flags(jnp.array(flags))
    assert words.shape == (3, -(-jobs // 32))
    assert np.array_equal(bits.unpack_flags(words, jobs), flags)
    assert int(words[0, 0]) == sum(int(f) << i for i, f in enumerate(flags[0, :32]))


def test_together_has_every_bit_that_any_has() -> None:
    flags = np.random.default_rng(2).random((5, 4, 40)) < 0.2
    words = bits.union_words(bits.pack_flags(jnp.array(flags)))
    assert np.array_equal(bits.unpack_flags(words, 40), flags.any(axis=1))
