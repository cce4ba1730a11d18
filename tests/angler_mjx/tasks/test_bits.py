"""Bits of jobs: what goes in comes out, and merging takes from those that were heard alone."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.tasks import bits


@pytest.mark.parametrize("jobs", [1, 31, 32, 33, 512])
def test_flags_come_out_of_words_as_they_went_in(jobs: int) -> None:
    flags = np.random.default_rng(jobs).random((3, jobs)) < 0.5
    words = bits.pack(jnp.array(flags))
    assert words.shape == (3, -(-jobs // 32))
    assert np.array_equal(bits.unpack(words, jobs), flags)
    assert int(words[0, 0]) == sum(int(f) << i for i, f in enumerate(flags[0, :32]))


def test_robots_learn_what_those_say_whom_they_hear() -> None:
    random = np.random.default_rng(2)
    knows, said = (random.random((5, 40)) < 0.3 for _ in range(2))
    delivered = random.random((5, 5)) < 0.4
    after = bits.unpack(
        bits.merged(bits.pack(jnp.array(knows)), jnp.array(delivered), bits.pack(jnp.array(said))),
        40,
    )
    expected = [
        knows[r] | np.any([said[s] for s in range(5) if delivered[r, s]] or [knows[r]], axis=0)
        for r in range(5)
    ]
    assert np.array_equal(after, expected)
