"""Pairs that are shortest first, against a plain search among all that are left."""

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import matching

ROWS, COLUMNS = 5, 11


def by_hand(way: np.ndarray) -> list[int]:
    taken, way = [-1] * len(way), way.copy()
    while np.isfinite(way).any():
        row, column = np.unravel_index(np.argmin(way), way.shape)  # the first of equal ones
        taken[row] = int(column)
        way[row], way[:, column] = np.inf, np.inf
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
    ways = lengths()
    found = np.asarray(jax.jit(jax.vmap(matching.match_pairs))(jnp.array(ways)))
    assert found.tolist() == [by_hand(way) for way in ways]


def test_the_program_for_gpus_gives_the_same() -> None:
    pairs = matching.MatchedPairs.of((ROWS, COLUMNS), lanes_per_warp=64, interpret=True)
    kernel = matching._ShortestMatchingKernel(pairs)
    ways = lengths()
    found = np.asarray(jax.jit(jax.vmap(kernel.run))(jnp.array(ways)))
    assert found.tolist() == [by_hand(way) for way in ways]
