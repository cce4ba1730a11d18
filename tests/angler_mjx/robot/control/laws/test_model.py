"""The model that the laws undo is the physics' own, term by term."""

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import as_tracking
from angler_mjx.robot.control.laws import model, tracking
from angler_mjx.sim.physics import step as physics
from angler_mjx.world.currents import Uniform

from ....compiling import quickly


def test_the_model_wrench_gives_the_acceleration_asked_for(robots, states, pool):
    vehicles, _ = robots
    estimate, _ = states
    rng = np.random.default_rng(0)
    wanted = jnp.asarray(rng.normal(size=(4, 6)))
    flow = jnp.asarray(rng.normal(size=(4, 3)) * 0.4)

    def one(vehicle, at, acceleration, flow):
        tau = model.model_wrench(vehicle, at, acceleration, flow, 1000.0, 9.81)
        state = physics.VehicleState(
            p=at.p, q=at.q, nu=at.nu, force_before=jnp.zeros(6), thrust=jnp.zeros(8)
        )
        M, force, _ = physics.smooth_force(
            pool.engine, vehicle, vehicle, state, (Uniform(velocity_mps=flow),), 0.0, pool.water
        )
        return M, force + tau

    M, total = quickly(jax.vmap(one))(vehicles, estimate, wanted, flow)
    found = np.linalg.solve(np.asarray(M, float), np.asarray(total, float)[..., None])[..., 0]
    # float32 on forces of 130 N over moments of inertia of 0.1 kg m^2.
    np.testing.assert_allclose(found, wanted, atol=2e-4)


def test_a_pose_target_is_a_target_that_does_not_turn(states, pool):
    _, target = states
    one = jax.tree.map(lambda x: x[0], target)
    same = as_tracking(pool.as_pose(one))
    assert as_tracking(one) is one
    np.testing.assert_array_equal(same.velocity_mps, one.velocity_mps)
    assert not np.any(same.acceleration_mps2)
    assert float(same.yaw_rate_radps) == 0.0


def test_attitude_error_leads_to_the_target(states):
    """Against rotation matrices: R exp(error) is level with the heading, to third order."""
    estimate, target = states
    for i in range(4):
        yaw = float(target.yaw_rad[i]) * 0.2
        w, x, y, z = np.asarray(estimate.q[i], float)
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        wanted = np.array(
            [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
        )
        between = R.T @ wanted
        angle = np.arccos((np.trace(between) - 1) / 2)
        axis = np.array(
            [
                between[2, 1] - between[1, 2],
                between[0, 2] - between[2, 0],
                between[1, 0] - between[0, 1],
            ]
        ) / (2 * np.sin(angle))
        error = np.asarray(model.attitude_error(estimate.q[i], jnp.asarray(yaw)))
        # Twice the sine of half the angle, along its axis.
        np.testing.assert_allclose(error, 2 * np.sin(angle / 2) * axis, atol=1e-5)


def test_tracking_does_not_fight_the_righting_moment(robots, states):
    """At rest on its target but tilted, the law asks for the weight and for the turn back only."""
    vehicles, _ = robots
    vehicle = jax.tree.map(lambda x: x[0], vehicles)
    estimate, _ = states
    q = jnp.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    at = type(estimate)(p=estimate.p[0], q=q, nu=jnp.zeros(6))
    held = model.holding_wrench(vehicle, q, 1000.0, 9.81)
    up = np.array([0.0, np.sin(0.2), np.cos(0.2)])
    lift = (1000 * float(vehicle.volume_m3) - float(vehicle.mass_kg)) * 9.81
    # float32 on a difference of 115 N and 113 N.
    np.testing.assert_allclose(held[:3], -lift * up, atol=1e-3)
    assert not np.any(held[3:])
    assert tracking.reset(at).integral.shape == (6,)
