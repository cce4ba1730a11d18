"""Worlds that several files look at."""

import jax
import numpy as np
import pytest

from angler_mjx.world.generate import generate_batch

from .recipe import COUNT, RADIUS, RECIPE, SEED


@pytest.fixture(scope="session")
def worlds():
    """[COUNT] of the recipe, on the host."""
    return jax.tree.map(np.asarray, generate_batch(RECIPE, RADIUS, SEED, 0, COUNT))
