"""Properties of the step itself: gradients, batches, strong damping, reset."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.physics import step as physics
from angler_mjx.world.currents import Uniform, Vortices

from ...compiling import quickly
from . import plants as plant_module
from .plants import WATER

DT, N_STEP = 0.01, 20


@pytest.fixture(scope="module")
def current(x64):
    return (
        Uniform(velocity_mps=jnp.array([0.2, -0.1, 0.05])),
        Vortices(
            centre_m=jnp.array([[0.5, -0.5]]),
            circulation_m2ps=jnp.array([3.0]),
            core_m=jnp.array([1.0]),
        ),
    )


def run(plants, current, body, vehicle, p, q, nu, thrust):
    """State after 20 steps."""
    state = physics.VehicleState(
        p=p, q=q, nu=nu, force_before=jnp.zeros_like(nu), thrust=jnp.zeros_like(thrust)
    )
    zero = jnp.zeros(())
    state = physics.start_multistep(plants.engine, body, vehicle, state, current, zero, WATER)

    def one(state, i):
        state = physics.step(
            plants.engine, body, vehicle, state, thrust, current, i * DT, DT, WATER
        )
        return state, None

    return jax.lax.scan(one, state, jnp.arange(N_STEP))[0]


@pytest.fixture(scope="module")
def single(plants):
    """`run` of one vehicle, compiled: (current, body, vehicle, p, q, nu, thrust) -> state."""
    return quickly(partial(run, plants))


@pytest.mark.nightly(by="engines/test_gradients.py")
def test_gradients_equal_finite_differences(plants, current, deviation):
    vehicle, body = (plant_module.pick(x, 4) for x in (plants.params, plants.body))
    p, q, nu = (x[0] for x in plant_module.random_states(11, (1,)))
    rng = np.random.default_rng(12)
    weights = rng.normal(size=13)
    sizes = {"p": p, "q": q, "nu": nu, "thrust": rng.uniform(-10, 10, 8), "scale": np.ones(3)}
    splits = np.cumsum([np.size(x) for x in sizes.values()])[:-1]

    @jax.jit
    def loss(x):
        # scale: added mass, damping and the strength of the vortex, as an identification has them.
        p, q, nu, thrust, scale = jnp.split(x, splits)
        other = replace(
            vehicle,
            M_A=vehicle.M_A * scale[0],
            D_l=vehicle.D_l * scale[1],
            D_q=vehicle.D_q * scale[1],
        )
        vortex = current[1]
        flow = (
            current[0],
            replace(vortex, circulation_m2ps=vortex.circulation_m2ps * scale[2]),
        )
        end = run(plants, flow, body, other, p, q / jnp.linalg.norm(q), nu, thrust)
        return weights @ jnp.concatenate([end.p, end.q, end.nu])

    x = np.concatenate([np.ravel(part) for part in sizes.values()])
    gradient = np.asarray(quickly(jax.grad(loss))(x))
    h = 1e-5
    difference = [
        (float(loss(x + h * e)) - float(loss(x - h * e))) / (2 * h) for e in np.eye(x.size)
    ]
    # Central differences: h^2 of truncation and 1e-16 / h of rounding, both 1e-10, on values to 10.
    deviation.close("step.gradient", gradient, difference, rtol=1e-7, atol=1e-8)
    assert np.all(gradient != 0)


def test_a_batch_equals_a_loop(plants, single, current, deviation):
    n = len(plants)
    p, q, nu = plant_module.random_states(13, (n,))
    exists = np.asarray(plants.params.thruster_exists)
    thrust = np.random.default_rng(14).uniform(-20, 20, exists.shape) * exists
    one = partial(run, plants, current)
    batch = quickly(jax.vmap(one))(plants.body, plants.params, p, q, nu, thrust)
    for i in range(n):
        alone = single(
            current,
            *(plant_module.pick(x, i) for x in (plants.body, plants.params)),
            *(x[i] for x in (p, q, nu, thrust)),
        )
        for field in ("p", "q", "nu", "thrust"):
            # XLA fuses by shape, so the last bits differ: a few roundings of float64 a step.
            ours, theirs = getattr(batch, field)[i], getattr(alone, field)
            deviation.close("step.batch", ours, theirs, rtol=1e-12, atol=1e-12)


def test_strong_damping_is_stable(plants, single):
    """A roll of the light vehicle at 10 rad/s, where damping acts with 800 1/s, dies out."""
    vehicle, body = (plant_module.pick(x, 0) for x in (plants.params, plants.body))
    assert plants.names[0] == "bluerov2/blue_gazebo"
    vehicle = replace(vehicle, p_cb_m=jnp.zeros(3))  # No righting moment.
    inertia = float(vehicle.inertia_kgm2[0, 0] + vehicle.M_A[3, 3])
    D_q = float(vehicle.D_q[3])
    assert DT * 2 * D_q * 10 / inertia > 8  # Explicit formulas are stable below 1 to 2.
    nu = np.array([0, 0, 0, 10.0, 0, 0])
    p, q = np.array([0, 0, -9.0]), np.array([1.0, 0, 0, 0])
    end = single(plant_module.still(), body, vehicle, p, q, nu, np.zeros(8))
    # The closed form is 1/p = 1/10 + D_q t / I. The first steps are too long to be accurate, and
    # the speed changes sign in them, but no more of it is left than in truth.
    assert abs(float(end.nu[3])) < 1 / (0.1 + D_q * N_STEP * DT / inertia)


def test_reset_is_at_rest_with_its_force_known(plants, current):
    vehicle, body = (plant_module.pick(x, 2) for x in (plants.params, plants.body))
    p, q = jnp.array([1.0, 2.0, -8.0]), jnp.array([1.0, 0, 0, 0])

    @quickly
    def begin(body, vehicle, p, q):
        state = physics.reset(plants.engine, body, vehicle, p, q, current, WATER)
        zero = jnp.zeros(())
        _, force, _ = physics.smooth_force(
            plants.engine, body, vehicle, state, current, zero, WATER
        )
        return state, force

    state, force = begin(body, vehicle, p, q)
    np.testing.assert_array_equal(state.nu, 0)
    np.testing.assert_array_equal(state.thrust, 0)
    # The same function on the same numbers.
    np.testing.assert_array_equal(state.force_before, force)
