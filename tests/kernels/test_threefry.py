"""Keys with flat programs against JAX's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.threefry import seed_key

SAMPLES = {
    "uniform": lambda key: jax.random.uniform(key, (3, 5)),
    "normal": lambda key: jax.random.normal(key, ()),
    "integers": lambda key: jax.random.randint(key, (4,), 0, jnp.arange(1, 5)),
    "choices": lambda key: jax.random.categorical(key, jnp.zeros(4)),
    "bytes": lambda key: jax.random.bits(key, (3,), jnp.uint8),
    "nothing": lambda key: jax.random.uniform(key, (0,)),
    "keys": lambda key: jax.random.key_data(jax.random.split(key, (2, 3))),
    "folded": lambda key: jax.random.key_data(jax.random.fold_in(key, 2**32 - 1)),
}


def _folded_twice(key):
    """Return keys [5, 2] of a key."""
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    return jax.vmap(fold, (0, None))(fold(key, jnp.arange(5)), jnp.arange(2))


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("seed", [0, 2**32 - 1])
def test_numbers_are_those_of_jax(name, seed):
    sample = jax.jit(jax.vmap(jax.vmap(SAMPLES[name])))
    actual = np.asarray(sample(_folded_twice(seed_key(jnp.uint32(seed)))))
    expected = np.asarray(sample(_folded_twice(jax.random.key(jnp.uint32(seed)))))
    assert actual.shape == expected.shape
    assert actual.tobytes() == expected.tobytes()


def test_a_cpu_compiles_few_kernels_for_a_sample():
    if jax.default_backend() != "cpu":
        pytest.skip("counts kernels of XLA's CPU compiler")

    def sample(seed):
        keys = jax.vmap(jax.random.fold_in, (None, 0))(seed_key(seed), jnp.arange(128))
        return jax.vmap(lambda key: jax.random.uniform(key, (4, 12)))(keys)

    program = jax.jit(sample).lower(jnp.uint32(7)).compile().as_text()
    assert program.count(" while(") == 0
    assert program.count(" fusion(") <= 6
