"""After a demand that the thrusters cannot meet, the loops come back in bounded time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion, thruster
from angler_kernels.rigid_body import matrix_times
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench
from angler_mjx.robot.control.laws import ismc, model, pid_velocity
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US
from angler_mjx.sim.physics import step as physics
from angler_mjx.world.currents import Uniform

from ....compiling import quickly

DT, FULL, N = 0.05, 300, 500
"""15 s of a surge of 3 m/s, that no set has, then 10 s of rest."""


def surge(robots, pool, law, gains, realised):
    """Surge [runs, N] of wu2018 under each of some gains, stacked."""
    vehicle, thrusters = jax.tree.map(lambda x: x[0], robots)
    current = (Uniform(velocity_mps=jnp.zeros(3)),)

    def run(gains):
        q = quaternion.from_yaw(jnp.zeros(()))
        start = physics.reset(
            pool.engine, vehicle, vehicle, jnp.asarray(pool.deep), q, current, pool.water
        )

        def control(row, k):
            state, carry, given = row
            command = BodyTwist(nu=jnp.zeros(6).at[0].set(jnp.where(k < FULL, 3.0, 0.0)))
            more = {"realised": BodyWrench(tau=given)} if realised else {}
            at = pool.estimate_of(state)
            carry, wrench = law.step(gains, vehicle, carry, at, command, DT, 1000.0, 9.81, **more)
            pwm = allocation.allocate(thrusters, wrench).pwm_us
            look = jax.vmap(thruster.lookup, (None, 0, None, None))
            thrust = look(vehicle.thrust_n, pwm, PWM_LOW_US, PWM_STEP_US)

            def advance(state, _):
                return physics.step(
                    pool.engine, vehicle, vehicle, state, thrust, current, 0.0, 0.01, pool.water
                ), None

            after, _ = jax.lax.scan(advance, state, length=5)
            return (after, carry, matrix_times(vehicle.B, thrust)), state.nu[0]

        row = (start, law.reset(pool.estimate_of(start)), jnp.zeros(6))
        return jax.lax.scan(control, row, jnp.arange(N))[1]

    return np.asarray(quickly(jax.vmap(run))(gains))


def back_at(u):
    """Seconds after the demand fell until the surge stays within 5 cm/s."""
    return DT * (np.nonzero(np.abs(u[FULL:]) > 0.05)[0].max() + 1)


def stacked(*gains):
    """Gains side by side, as arrays."""
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *gains)


def test_the_velocity_loop_recovers(robots, pool):
    gains = pid_velocity.PidVelocityGains(velocity_per_s=2.5, velocity_integral_per_s2=2.0)
    wound = dataclasses.replace(gains, integral_limit_mps2=60.0, back_calculation_per_s=0.0)
    clamped = dataclasses.replace(gains, back_calculation_per_s=0.0)
    unclamped = dataclasses.replace(gains, integral_limit_mps2=60.0)
    u = surge(robots, pool, pid_velocity, stacked(wound, clamped, unclamped, gains), True)
    wound, clamped, unclamped, both = (back_at(row) for row in u)
    # Without either, the integral of 15 s is still pushing at the end.
    assert wound == DT * (N - FULL)
    # Either alone ends it within the time the integral itself has (1.25 s), a few times over.
    assert clamped < 6
    assert unclamped < 6
    assert both < 6


def test_ismc_recovers(robots, pool):
    u = surge(robots, pool, ismc, stacked(ismc.IsmcGains()), False)
    # A few times 1 / K = 0.5 s, for s is kept within two layers.
    assert back_at(u[0]) < 4


def test_integrals_keep_their_bound():
    z = jnp.array([0.0, 3.9, -3.9])
    growth = jnp.array([1.0, 100.0, -100.0])
    after = model.hold_integral(z, growth, jnp.asarray(4.0), DT)
    np.testing.assert_allclose(after, [0.05, 4.0, -4.0], rtol=1e-6)
    # What was not delivered is taken out: 2 /s of 1 m/s^2 over 50 ms.
    held = model.hold_integral(z, 0 * growth, jnp.asarray(4.0), DT, jnp.ones(3), 2.0)
    np.testing.assert_allclose(held, [-0.1, 3.8, -4.0], rtol=1e-6)
