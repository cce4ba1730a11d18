"""The moment of a load that hangs below a robot, against numpy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyWrench, Estimate
from angler_mjx.robot.control.laws import cargo_wrench
from angler_mjx.robot.control.laws.cargo_wrench import CargoWrenchGains
from angler_mjx.scenario.scenario import load_scenario

GAINS = CargoWrenchGains(depth_m=0.4, weight_n=8.0, drag_x_n=60.0, drag_y_n=10.0, drag_z_n=70.0)


def step(attitude, nu, flow, tau=(0.0,) * 6):
    at = Estimate(
        p=jnp.zeros(3),
        q=jnp.asarray(attitude.as_quat(scalar_first=True), jnp.float32),
        nu=jnp.asarray(nu, jnp.float32),
    )
    wrench = BodyWrench(tau=jnp.asarray(tau, jnp.float32))
    current = None if flow is None else jnp.asarray(flow, jnp.float32)
    _, made = cargo_wrench.step(GAINS, None, (), at, wrench, 0.05, 1000.0, 9.81, flow=current)
    return np.asarray(made.tau)


def test_the_moment_of_weight_and_drag_is_fed_forward():
    rng = np.random.default_rng(0)
    for _ in range(50):
        attitude = Rotation.from_rotvec(rng.normal(size=3))
        nu, flow, tau = rng.normal(size=6), rng.normal(size=3), rng.normal(size=6) * 10.0
        lever = np.array([0.0, 0.0, -0.4])
        through = nu[:3] + np.cross(nu[3:], lever) - attitude.inv().apply(flow)
        force = attitude.inv().apply([0.0, 0.0, -8.0])
        force = force - np.array([60.0, 10.0, 70.0]) * np.abs(through) * through
        want = tau - np.concatenate([np.zeros(3), np.cross(lever, force)])
        np.testing.assert_allclose(step(attitude, nu, flow, tau), want, rtol=1e-4, atol=1e-4)


def test_a_level_robot_at_rest_in_still_water_has_no_moment_to_bear():
    level = Rotation.from_euler("z", 1.0)
    np.testing.assert_allclose(step(level, np.zeros(6), None), 0.0, atol=1e-6)


def test_a_current_from_ahead_pitches_the_robot_that_does_not_bear_it():
    """Water from ahead pushes the load backwards; the moment fed forward is against that."""
    tau = step(Rotation.identity(), np.zeros(6), [-0.3, 0.0, 0.0])
    np.testing.assert_allclose(tau, [0, 0, 0, 0, -0.4 * 60.0 * 0.09, 0], rtol=1e-5)


def test_the_task_fills_in_what_the_file_leaves_out():
    stages = ["follow", "pose", "velocity", "cargo_wrench", "pseudo_inverse"]
    scenario = load_scenario("carry_pipe", controller={"stages": stages})
    spec = scenario.sim_spec()
    (gains,) = [g for g in spec.gains if isinstance(g, CargoWrenchGains)]
    load = scenario.cargo_load()
    np.testing.assert_allclose(gains.depth_m, 0.4, atol=1e-6)
    volume = np.pi * 0.05**2 * 2.4 + 4.0 / 3.0 * np.pi * 0.05**3
    np.testing.assert_allclose(gains.weight_n, (21.0 - 1000.0 * volume) / 2 * 9.81, rtol=1e-3)
    drag = [gains.drag_x_n, gains.drag_y_n, gains.drag_z_n]
    np.testing.assert_allclose(drag, 500.0 * np.array(load.drag_area_m2), rtol=1e-6)
    stated = load_scenario(
        "carry_pipe",
        controller={"stages": stages, "gains": {"cargo_wrench": {"depth_m": 0.0}}},
    )
    (gains,) = [g for g in stated.sim_spec().gains if isinstance(g, CargoWrenchGains)]
    assert gains.depth_m == 0.0


def test_gains_below_zero_are_refused():
    with pytest.raises(ConfigError, match="weight_n"):
        cargo_wrench.check(CargoWrenchGains(weight_n=-1.0))
