"""One robot and its state, for stacks of controllers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library, params


@pytest.fixture(scope="module")
def robot():
    """A Heavy with all it knows, and a state: moving, tilted, off its path."""
    given = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 14.8)
    stacked = allocation.build_allocation(jax.tree.map(lambda leaf: leaf[None], given))
    known = ControlParams(
        vehicle=given,
        allocation=jax.tree.map(lambda leaf: leaf[0], stacked),
        cruise_speed_mps=jnp.array(0.5),
    )
    q = np.array([1.0, 0.05, -0.08, 0.2])
    at = Estimate(
        p=jnp.array([0.1, -0.2, -10.1]),
        q=jnp.asarray(q / np.linalg.norm(q)),
        nu=jnp.array([0.2, -0.1, 0.05, 0.02, 0.03, -0.1]),
        flow=jnp.array([0.1, 0.2, 0.0]),
    )
    return known, at
