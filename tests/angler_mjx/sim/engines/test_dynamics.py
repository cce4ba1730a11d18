"""Vehicles alone in still water: on lanes, in a kernel, and one by one."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import RunError
from angler_mjx.robot.vehicles import library, params
from angler_mjx.sim.engines import dynamics
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState

STEPS = 100


@pytest.fixture(scope="module")
def begun():
    """A program's worth of vehicles that drift and turn, and their thrusts."""
    n = dynamics.BLOCK
    keys = jax.random.split(jax.random.key(1), 2)
    state = VehicleState(
        p=jnp.zeros((n, 3)).at[:, 2].set(-20.0),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)),
        nu=0.3 * jax.random.normal(keys[0], (n, 6)),
        force_before=jnp.zeros((n, 6)),
        thrust=jnp.zeros((n, 8)),
    )
    return state, 5.0 * jax.random.normal(keys[1], (n, 8))


@pytest.fixture(scope="module")
def ours():
    return dynamics.build_dynamics("bluerov2_heavy", "wu2018")


@pytest.fixture(scope="module")
def plain(begun, ours):
    return jax.jit(partial(ours.simulate, n_steps=STEPS))(*begun)


def assert_close(a, b):
    # 100 steps of numbers of order 10 in float32: each rounds by 1e-6 at most, and damping forgets.
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-4)


def test_lanes_do_what_the_step_does(begun, ours, plain):
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    engine, zero = ClosedForm(gravity_mps2=ours.water.gravity_mps2), jnp.zeros(())

    def one(state, thrust):
        def step(_, now):
            return physics.step(
                engine, vehicle, vehicle, now, thrust, (), zero, ours.physics_dt_s, ours.water
            )

        return jax.lax.fori_loop(0, STEPS, step, state)

    assert_close(plain, jax.jit(jax.vmap(one))(*begun))
    assert float(jnp.median(jnp.linalg.norm(plain.p - begun[0].p, axis=1))) > 0.05


def test_the_kernel_does_what_plain_jax_does(begun, ours, plain, monkeypatch):
    monkeypatch.setattr(launch, "LaunchShape", partial(launch.LaunchShape, interpret=True))
    assert_close(plain, jax.jit(partial(ours.simulate, n_steps=STEPS, kernels="cuda"))(*begun))


def test_more_places_than_a_kernel_can_count_are_refused(ours):
    n = 2**31 // 8
    huge = jax.ShapeDtypeStruct((n, 8), jnp.float32)
    small = {"p": 3, "q": 4, "nu": 6, "force_before": 6, "thrust": 8}
    state = VehicleState(
        **{name: jax.ShapeDtypeStruct((n, k), jnp.float32) for name, k in small.items()}
    )
    with pytest.raises(RunError, match="tile 4 times smaller"):
        jax.eval_shape(partial(ours.simulate, n_steps=1, kernels="cuda"), state, huge)
