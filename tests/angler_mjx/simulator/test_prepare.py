"""Worlds from their indices: what a world looks like does not depend on how many are made."""

import jax
import numpy as np
import pytest

from angler_mjx.simulator.simulator import Simulator


@pytest.mark.nightly(by="test_generate.py: test_a_world_is_the_same_in_a_batch_of_any_size")
def test_a_world_made_alone_is_that_of_a_tile(scenario):
    tile = Simulator(scenario).worlds(0)
    alone = Simulator(scenario.model_copy(update={"tile": 1})).worlds(1)
    assert jax.tree.structure(alone) == jax.tree.structure(tile)
    for (path, one), many in zip(
        jax.tree.leaves_with_path(alone), jax.tree.leaves(tile), strict=True
    ):
        # Compiled on its own, a world may be rounded otherwise in the last place.
        np.testing.assert_allclose(
            one[0], many[1], rtol=3e-7, atol=1e-7, err_msg=jax.tree_util.keystr(path)
        )
