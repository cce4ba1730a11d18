"""Vehicles with links in the lock-step: pulses of an autopilot, and joints of ours beside them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import Scenario
from angler_sitl.scene.scene import AutopilotScene

from ...angler_mjx.sim.physics.recursive import Chain

VEHICLE, SET = "bluerov2_heavy_alpha5", "wu2018"
SCENARIO = {
    "name": "armed",
    "engine": "mjx",
    "time": {"horizon_s": 20.0, "physics_dt_s": 0.0025},  # that of the lock-step
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": [[0.0, 0.0, -10.0]],
        "goal_m": [[8.0, 0.0, -10.0]],
    },
    "fleet": [{"vehicle": VEHICLE, "parameter_set": SET}],
}
NEUTRAL = np.full((1, 16), 1500, np.int32)
GRAVITY_NED = np.array([0.0, 0.0, 9.80665])


@pytest.fixture(scope="module")
def scene():
    return AutopilotScene(Scenario.model_validate(SCENARIO))


@pytest.fixture
def afloat(scene):
    scene.reset()
    scene.moored = False
    return scene


def turning(scene, speeds):
    """A target [1, 1, J] of joints at home that turn at these speeds."""
    home = np.asarray(scene.worlds.control.vehicle.links.home)
    velocity = np.zeros_like(home)
    velocity[0, 0, : len(speeds)] = speeds
    return JointTarget(position=home, velocity=velocity, acceleration=np.zeros_like(home))


def moved_on(target, seconds):
    return replace(target, position=target.position + seconds * target.velocity)


def test_pulses_and_joints_make_the_same_motion_as_in_the_simulator(afloat):
    scene, worlds, simulator = afloat, afloat.worlds, afloat.simulator
    theirs = simulator.reset(worlds)
    rng = np.random.default_rng(1)
    begin = turning(scene, (0.3, 0.4, -0.2, 0.5))
    period_s, dtype = simulator.spec.control_dt_s, theirs.vehicles.p.dtype
    for k in range(40):
        pwm = NEUTRAL.copy()
        pwm[:, :8] += rng.integers(-90, 90, (1, 8), dtype=np.int32)
        target = moved_on(begin, k * period_s)
        scene.command_joints(target)
        for _ in range(scene.steps_per_period):
            scene.step(pwm)
        scene.judge()
        command = WholeBodyCommand(
            base=ThrusterPwm(pwm_us=jnp.asarray(pwm[None, :, :8], dtype)),
            joints=jax.tree.map(lambda x: jnp.asarray(x, dtype), target),
        )
        theirs, _ = simulator.step(worlds, theirs, command)
    ours = scene.state
    # float32 there, float64 here, over 800 steps; see test_scene.
    np.testing.assert_allclose(ours.vehicles.p, theirs.vehicles.p, atol=1e-3)
    np.testing.assert_allclose(ours.vehicles.q, theirs.vehicles.q, atol=1e-3)
    np.testing.assert_allclose(ours.vehicles.nu, theirs.vehicles.nu, atol=1e-3)
    for part in ("position", "velocity"):
        np.testing.assert_allclose(
            getattr(ours.vehicles.joints, part),
            getattr(theirs.vehicles.joints, part),
            atol=2e-3,
        )
    home = np.asarray(worlds.control.vehicle.links.home)[0, 0]
    assert np.abs(np.asarray(ours.vehicles.joints.position)[0, 0] - home)[:2].min() > 0.3


def to_ned(vector):
    return np.array([vector[1], vector[0], -vector[2]])


def matrix(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def vehicle_now(scene):
    """Pose, velocity, and joints of the vehicle in float64."""
    rows = np.asarray(scene._moving[0])[0, 17:]
    with jax.enable_x64(True):
        vehicle = scene._motion.vehicles.unpack_row(rows)
    joints = vehicle.joints
    return [np.asarray(x) for x in (vehicle.p, vehicle.q, vehicle.nu, joints.position)] + [
        np.asarray(joints.velocity)
    ]


def free_acceleration(chain, state, speed_rate):
    """Acceleration [6] of a base that nothing pushes, with joints accelerated so."""
    still = np.zeros(3)

    def wrench(nu_dot):
        return chain.inverse(*state, nu_dot, speed_rate, still, still)[:6]

    begin = wrench(np.zeros(6))
    columns = [wrench(unit) - begin for unit in np.eye(6)]
    return np.linalg.solve(np.array(columns).T, -begin)


def test_the_specific_force_is_that_of_an_independent_recursion(afloat):
    """Thrusters off: what accelerates the base are its weight, the water and the moving arm."""
    chain = Chain(library.load_vehicle(VEHICLE), SET)
    begin = turning(afloat, (0.4, 0.5, -0.3, 0.6))
    away, sizes = [], []
    for k in range(8):
        afloat.command_joints(moved_on(begin, k * 0.05))
        for _ in range(afloat.steps_per_period):
            before = vehicle_now(afloat)
            states = afloat.step(NEUTRAL)
            after = vehicle_now(afloat)
            if k < 4:  # servos have brought the arm up to speed
                continue
            middle = [0.5 * (a + b) for a, b in zip(before, after, strict=True)]
            middle[1] /= np.linalg.norm(middle[1])
            nu, nu_dot = (
                middle[2],
                free_acceleration(chain, middle, (after[4] - before[4]) / afloat.dt_s),
            )
            in_world = matrix(middle[1]) @ (nu_dot[:3] + np.cross(nu[3:], nu[:3]))
            sent = matrix(states.q[0]) @ states.accel_body[0] + GRAVITY_NED
            away.append(np.abs(sent - to_ned(in_world)).max())
            sizes.append(np.abs(in_world).max())
        afloat.judge()
    assert max(sizes) > 0.02
    # The mean over a step against the middle of it: of second order in 2.5 ms.
    assert max(away) < 1e-5


def test_a_moving_arm_is_felt_and_a_moored_one_is_not(scene):
    scene.reset()
    scene.command_joints(turning(scene, (0.5, 0.5)))
    moored = [scene.step(NEUTRAL).accel_body[0].copy() for _ in range(20)]
    np.testing.assert_allclose(moored, [[0, 0, -9.80665]] * 20, atol=1e-12)

    def rates(speeds):
        scene.reset()
        scene.moored = False
        scene.command_joints(turning(scene, speeds))
        return np.array([scene.step(NEUTRAL).gyro[0].copy() for _ in range(40)])

    assert np.abs(rates((0.5, 0.5)) - rates(())).max() > 0.01


def test_accelerations_sum_to_the_velocities_with_an_arm_too(afloat):
    velocity = afloat.states.v_ned[0].copy()
    afloat.command_joints(turning(afloat, (0.4, 0.5, 0.3)))
    for _ in range(60):
        now = afloat.step(NEUTRAL)
        velocity += afloat.dt_s * (matrix(now.q[0]) @ now.accel_body[0] + GRAVITY_NED)
        np.testing.assert_allclose(velocity, now.v_ned[0], atol=1e-11)
