"""Efforts on joints, by hand."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics import joints as efforts

DT = 0.1


def motion(position, velocity):
    """Return the motion of joints from lists."""
    return JointMotion(position=jnp.array(position), velocity=jnp.array(velocity))


def test_a_step_moves_joints_by_their_mean_speed():
    end = efforts.at_end(motion([1.0, -2.0], [3.0, 0.5]), jnp.array([2.0, -1.0]), DT)
    np.testing.assert_allclose(end.velocity, [5.0, -0.5])
    np.testing.assert_allclose(end.position, [1.4, -2.0], rtol=1e-6)


@pytest.mark.parametrize("x", [0.0, 0.5, 3.0, 1e3])
def test_a_speed_decays_by_the_approximant_of_its_docstring(x):
    weight = efforts.end_weight(jnp.array([4.0 * x]), jnp.array([2.0]), 0.5)
    # v' = -x ((1 - weight) v + weight v_end) over a step of unit length.
    decay = (1.0 - x * (1.0 - weight)) / (1.0 + x * weight)
    np.testing.assert_allclose(decay, (6.0 - 2.0 * x) / (6.0 + 4.0 * x + x * x), atol=1e-5)


def test_a_servo_asks_for_the_speed_that_brings_it_to_its_reference():
    links = SimpleNamespace(
        stiffness=jnp.array([10.0, 10.0, 1e3, 8.0]),
        damping=jnp.array([5.0, 5.0, 1.0, 0.0]),
        max_speed=jnp.array([9.0, 0.5, 9.0, 9.0]),
    )
    reference, now = motion([3.0] * 4, [0.4] * 4), motion([2.5] * 4, [0.2] * 4)
    wanted = efforts.wanted_speed(links, reference, now, DT)
    error = 0.5 + 0.5 * DT * 0.2
    # Stiffness over damping; the limit; at most the error in one step; no damping.
    expected = [2.0 * error + 0.4, 0.5, error / DT + 0.4, 8.0 * error + 0.4]
    np.testing.assert_allclose(wanted, expected, rtol=1e-5)


def test_motors_are_limited_and_rubbed():
    links = SimpleNamespace(
        damping=jnp.array([5.0, 5.0]),
        viscous_friction=jnp.array([0.3, 0.3]),
        max_effort=jnp.array([1.0, 100.0]),
    )
    motors = efforts.Motors(
        links=links,
        wanted=jnp.array([2.0, 2.0]),
        begin=jnp.array([0.5, 0.5]),
        weight=jnp.array([0.75, 0.75]),
    )
    change = jnp.array([0.4, 0.4])
    speed = 0.5 + 0.75 * 0.4
    unlimited = motors.servo_effort(change)
    np.testing.assert_allclose(unlimited, [5.0 * (2.0 - speed)] * 2, rtol=1e-6)
    free, limited = motors.effort(change, None), motors.effort(change, unlimited)
    np.testing.assert_allclose(free.effort, [6.0 - 0.3 * speed] * 2, rtol=1e-6)
    np.testing.assert_allclose(free.by_change, [0.75 * 5.3] * 2, rtol=1e-6)
    np.testing.assert_allclose(limited.effort, [1.0 - 0.3 * speed, 6.0 - 0.3 * speed], rtol=1e-6)
    np.testing.assert_allclose(limited.by_change, [0.75 * 0.3, 0.75 * 5.3], rtol=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["lower", "upper"])
def test_a_stop_pushes_inwards_by_depth_and_speed(side):
    """Of four joints beyond a stop: at rest, on the way further, on the way back, back too fast."""
    links = SimpleNamespace(
        lower=jnp.full(4, -1.0),
        upper=jnp.full(4, 1.0),
        max_effort=jnp.full(4, 2.0),
        coulomb_friction=jnp.zeros(4),
    )
    depth, speed = 0.01, np.array([0.0, 0.1, -0.1, -10.0])
    end = motion([side * (1.0 + depth)] * 4, (side * speed).tolist())
    contact = efforts.find_contact(links, end, jnp.full(4, 0.5), DT)
    acts = efforts.stop_acts(end, contact)
    assert acts.tolist() == [True, True, True, False]
    stiffness = 2.0 / (2.0 * efforts.STOP_FRACTION)
    push = stiffness * (depth + efforts.STOP_TIME_S * speed)
    got = efforts.contact_effort(end, contact, acts, DT)
    np.testing.assert_allclose(got.effort, -side * np.append(push[:3], 0.0), rtol=1e-4)
    slope = stiffness * (efforts.STOP_TIME_S + 0.5 * DT)
    np.testing.assert_allclose(got.by_change, [slope] * 3 + [0.0], rtol=1e-5)
    pulled = efforts.contact_effort(end, contact, None, DT)
    np.testing.assert_allclose(pulled.effort, -side * push, rtol=1e-4)


def test_friction_holds_slow_joints_and_brakes_others():
    links = SimpleNamespace(
        lower=jnp.full(3, -1.0),
        upper=jnp.full(3, 1.0),
        max_effort=jnp.full(3, 2.0),
        coulomb_friction=jnp.full(3, 0.6),
    )
    speed = [0.1, 0.2, -0.2]
    end = motion([0.0] * 3, speed)
    contact = efforts.find_contact(links, end, jnp.full(3, 0.5), DT)
    got = efforts.contact_effort(end, contact, None, DT)
    damper = efforts.STICKING * 0.5 / DT
    np.testing.assert_allclose(got.effort, [-damper * 0.1, -0.6, 0.6], rtol=1e-5)
    np.testing.assert_allclose(got.by_change, [damper, 0.0, 0.0], rtol=1e-5)
