"""Float64 for the tests of this folder that ask for it, and the plants they share."""

import jax
import pytest

from . import plants as plant_module


@pytest.fixture(scope="module")
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def plants(x64):
    """Every shipped variant and one with all off-diagonal terms, in float64."""
    return plant_module.build(plant_module.configs())
