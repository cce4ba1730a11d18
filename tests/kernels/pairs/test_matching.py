"""Pairs that are shortest first, against a plain search among all that are left."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import matching

ROWS, COLUMNS = 5, 11


def by_hand(distances: np.ndarray) -> list[int]:
    taken, distances = [-1] * len(distances), distances.copy()
    while np.isfinite(distances).any():
        row, column = np.unravel_index(
            np.argmin(distances), distances.shape
        )  # the first of equal ones
        taken[row] = int(column)
        distances[row], distances[:, column] = np.inf, np.inf
    return taken


def lengths() -> np.ndarray:
    """Different ones, equal ones, and more rows than columns that are left."""
    random = np.random.default_rng(8)
    whole = random.uniform(0.0, 9.0, (40, ROWS, COLUMNS))
    whole[10:30] = np.floor(whole[10:30] / 2.0)
    whole[random.random(whole.shape) < random.choice([0.0, 0.5, 0.9, 1.0], (40, 1, 1))] = np.inf
    whole[-1, :, 2:] = np.inf
    return whole.astype(np.float32)


def test_the_shortest_is_taken_of_all_that_are_left() -> None:
    batch = lengths()
    found = np.asarray(jax.jit(jax.vmap(matching.match_pairs))(jnp.array(batch)))
    assert found.tolist() == [by_hand(distances) for distances in batch]


@pytest.mark.parametrize("lanes_per_warp", [64, 1024])
def test_the_program_for_gpus_gives_the_same(block_form: Callable, lanes_per_warp: int) -> None:
    def match(distances: jax.Array, interpret: bool) -> jax.Array:
        pairs = matching.MatchedPairs.of(
            distances.shape, lanes_per_warp=lanes_per_warp, interpret=interpret
        )
        return matching._ShortestMatchingKernel(pairs).run(distances)

    batch = lengths()
    found = np.asarray(jax.jit(jax.vmap(block_form(match)))(jnp.array(batch)))
    assert found.tolist() == [by_hand(distances) for distances in batch]
