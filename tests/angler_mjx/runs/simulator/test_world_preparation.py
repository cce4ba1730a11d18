"""Worlds from their indices: what a world looks like does not depend on how many are made."""

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import check_key_number


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


@pytest.mark.parametrize("value", [-1, 2**32, 10**20, 1.5, "7", None])
def test_what_keys_cannot_hold_is_refused(value):
    with pytest.raises(ConfigError, match=r"seed = .*: give a whole number from 0 to 4294967295"):
        check_key_number("seed", value)


def test_whole_numbers_of_any_kind_make_keys():
    for value in (2**32 - 1, np.int64(2**32 - 1), np.uint32(2**32 - 1)):
        assert check_key_number("first", value) == 2**32 - 1
        assert check_key_number("first", value).dtype == np.uint32
