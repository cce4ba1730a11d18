"""Inverse kinematics of base and arm, and the feed-forward of the arm's wrench."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyWrench, Estimate
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    hold_joints,
)
from angler_mjx.robot.control.laws import link_wrench, whole_body
from angler_mjx.robot.vehicles import library, link_motion, params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics import step as physics

DT, DENSITY, GRAVITY = 0.05, 1000.0, 9.81
GAINS = whole_body.WholeBodyGains()


def build_vehicle(change=lambda config: config):
    config = change(library.load_vehicle("bluerov2_heavy_alpha5"))
    return params.build_vehicle(config, "wu2018", 16.0)


@pytest.fixture
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def vehicle(x64):
    return build_vehicle()


def sample_positions(links, count, seed=0):
    lower, upper = np.asarray(links.lower), np.asarray(links.upper)
    return np.random.default_rng(seed).uniform(lower, upper, (count, lower.size))


def test_the_jacobian_is_the_derivative_of_the_pose(vehicle):
    links, step = vehicle.links, 1e-6
    locate = jax.jit(lambda theta: link_motion.locate_end_effector(links, theta))
    for theta in sample_positions(links, 20):
        tip = locate(theta)
        np.testing.assert_allclose(tip.jacobian[:, :3], np.eye(6)[:, :3], atol=1e-15)
        expected = np.vstack([np.cross(np.eye(3), tip.position).T, np.eye(3)])
        np.testing.assert_allclose(tip.jacobian[:, 3:6], expected, atol=1e-12)
        for j in range(theta.size):
            before, after = (
                locate(theta + sign * step * np.eye(theta.size)[j]) for sign in (-1, 1)
            )
            turned = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
            column = np.r_[after.position - before.position, turned] / (2 * step)
            np.testing.assert_allclose(tip.jacobian[:, 6 + j], column, atol=1e-8)


def test_the_end_effector_lies_on_its_link(vehicle):
    """With the arm straight up on the base, by the lengths of the datasheet."""
    links = vehicle.links
    tip = link_motion.locate_end_effector(links, jnp.array([np.pi, np.pi / 2, np.pi, 0.0, 0.0]))
    shoulder = np.array([0.25, -0.10965, 0.016])
    reach = np.linalg.norm(np.asarray(tip.position) - shoulder)
    assert 0.3 < reach < 0.0462 + 0.02 + 0.150705 + 0.02 + 0.13965 + 0.075
    np.testing.assert_allclose(tip.rotation @ tip.rotation.T, np.eye(3), atol=1e-12)


def test_targets_need_an_end_effector(x64):
    links = build_vehicle(lambda config: config.model_copy(update={"end_effector": None})).links
    with pytest.raises(ValueError, match=r"no table \[end_effector\]"):
        link_motion.locate_end_effector(links, links.home)


def test_an_end_effector_needs_its_link(x64):
    config = library.load_vehicle("bluerov2_heavy_alpha5").model_dump(mode="json")
    config["end_effector"]["link"] = "hand"
    with pytest.raises(ValueError, match=r"end_effector.link = 'hand': no such link; there is"):
        VehicleConfig.model_validate_json(json.dumps(config))


def test_without_bounds_it_is_the_weighted_pseudo_inverse(x64):
    rng = np.random.default_rng(1)
    for _ in range(20):
        J, wanted, preferred = rng.normal(size=(6, 9)), rng.normal(size=6), rng.normal(size=9)
        span = rng.uniform(50.0, 100.0, 9)
        velocity = whole_body.resolve(0.0, J, wanted, preferred, -span, span)
        root = span[:, None] * np.linalg.pinv(J * span)
        expected = preferred + root @ (wanted - J @ preferred)
        np.testing.assert_allclose(velocity, expected, rtol=1e-8, atol=1e-9)


def test_an_axis_at_its_bound_leaves_the_rest_to_the_others(x64):
    J = np.zeros((6, 3))
    J[0] = 1.0
    bound = np.array([0.2, 0.3, 5.0])
    wanted = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    velocity = whole_body.resolve(0.0, J, wanted, np.array([0.2, 0.0, 0.0]), -bound, bound)
    assert np.all(np.abs(velocity) <= bound)
    np.testing.assert_allclose(np.sum(velocity), 2.0, rtol=1e-6)


def test_velocities_stay_within_bounds(x64):
    rng = np.random.default_rng(2)
    resolve = jax.jit(whole_body.resolve)
    for _ in range(200):
        J, wanted = rng.normal(size=(6, 9)), 3.0 * rng.normal(size=6)
        lower, upper = -rng.uniform(0.0, 1.0, 9), rng.uniform(0.0, 1.0, 9)
        velocity = resolve(0.01, J, wanted, rng.normal(size=9), lower, upper)
        assert np.all((velocity >= lower) & (velocity <= upper))


def test_a_stretched_arm_asks_for_no_wild_speeds(vehicle):
    """All columns of the arm's Jacobian along one line: speeds stay near those elsewhere."""
    links = vehicle.links
    stretched = JointMotion(position=jnp.array([np.pi, 1.6, 3.1, 1.6, 0.0]), velocity=jnp.zeros(5))
    at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6), joints=stretched)
    tip = link_motion.locate_end_effector(links, stretched.position)
    target = make_target(tip.position.at[0].add(1.0), [1.0, 0.0, 0.0, 0.0], True)
    _, command = whole_body.step(
        GAINS, links, whole_body.reset(at), at, target, hold_joints(stretched), DT
    )
    assert np.all(np.isfinite(command.base.nu))
    assert np.all(np.abs(command.joints.velocity) <= np.asarray(links.max_speed))


def make_target(position, q, is_oriented):
    return EndEffectorTarget(
        position_m=jnp.asarray(position),
        q=jnp.asarray(q),
        velocity_mps=jnp.zeros(3),
        angular_velocity_radps=jnp.zeros(3),
        is_oriented=jnp.asarray(is_oriented),
    )


def follow_kinematics(links, target, steps):
    """Errors [steps] of the end effector, and joints, of a base and joints that obey at once."""

    def advance(now, _):
        p, q, nu, joints, carry = now
        at = Estimate(p=p, q=q, nu=nu, joints=joints)
        carry, command = whole_body.step(GAINS, links, carry, at, target, hold_joints(joints), DT)
        nu = command.base.nu
        p = p + DT * quaternion.rotate(q, nu[:3])
        q = quaternion.multiply(q, quaternion.exp(DT * nu[3:]))
        position = joints.position + DT * command.joints.velocity
        joints = JointMotion(position=position, velocity=command.joints.velocity)
        tip = link_motion.locate_end_effector(links, position)
        error = p + quaternion.rotate(q, tip.position) - target.position_m
        R = quaternion.to_matrix(target.q).T @ quaternion.to_matrix(q) @ tip.rotation
        turn = jnp.arccos(jnp.clip(0.5 * (jnp.trace(R) - 1.0), -1.0, 1.0))
        return (p, q, nu, joints, carry), (jnp.sqrt(jnp.sum(error**2)), turn, position)

    joints = JointMotion(position=links.home, velocity=jnp.zeros_like(links.home))
    begin = Estimate(
        p=jnp.zeros(3), q=jnp.array([1.0, 0.0, 0.0, 0.0]), nu=jnp.zeros(6), joints=joints
    )
    now = (begin.p, begin.q, begin.nu, joints, whole_body.reset(begin))
    return jax.lax.scan(advance, now, length=steps)[1]


@pytest.mark.parametrize(("is_oriented", "fraction"), [(False, 1.0), (True, 0.6)])
def test_targets_within_reach_are_reached_within_the_joints_limits(vehicle, is_oriented, fraction):
    """Targets that other postures of base and arm have.

    The method is local: with attitude 70 % are reached from home, the others end at a limit.
    """
    links, count = vehicle.links, 60
    rng, positions = np.random.default_rng(3), sample_positions(vehicle.links, count, seed=4)
    yaw, base = rng.uniform(-np.pi, np.pi, count), rng.uniform(-2.0, 2.0, (count, 3))
    locate = jax.vmap(lambda theta: link_motion.locate_end_effector(links, theta))
    tips = locate(jnp.asarray(positions))
    heading = Rotation.from_euler("z", yaw[:, None])
    q = (heading * Rotation.from_matrix(np.asarray(tips.rotation))).as_quat()[:, [3, 0, 1, 2]]
    p = base + heading.apply(np.asarray(tips.position))
    targets = jax.vmap(make_target)(jnp.asarray(p), jnp.asarray(q), jnp.full(count, is_oriented))
    error, turn, joints = jax.jit(jax.vmap(lambda t: follow_kinematics(links, t, 1000)))(targets)
    arrived = error[:, -1] < 1e-3
    if is_oriented:
        arrived &= turn[:, -1] < 0.02
    assert np.mean(arrived) >= fraction
    lower, upper = np.asarray(links.lower) - 1e-9, np.asarray(links.upper) + 1e-9
    assert np.all((joints >= lower) & (joints <= upper))


def test_grippers_follow_their_command_beside_a_target(vehicle):
    links = vehicle.links
    joints = JointMotion(position=links.home, velocity=jnp.zeros(5))
    at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6), joints=joints)
    commanded = replace(hold_joints(joints), position=links.home.at[4].set(0.01))
    target = make_target([0.8, 0.2, 0.1], [1.0, 0.0, 0.0, 0.0], False)
    _, command = whole_body.step(GAINS, links, whole_body.reset(at), at, target, commanded, DT)
    assert command.joints.position[4] == 0.01
    assert command.joints.velocity[4] == 0.0
    assert np.any(np.asarray(command.joints.velocity[:4]) != 0.0)


def test_the_reference_of_a_joint_leads_it_by_no_more_than_the_lag(vehicle):
    """Of joints that stay while their targets move on."""
    links = vehicle.links
    joints = JointMotion(position=0.5 * (links.lower + links.upper), velocity=jnp.zeros(5))
    at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6), joints=joints)
    target = make_target([3.0, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0], False)
    carry, held = whole_body.reset(at), hold_joints(joints)
    step = jax.jit(lambda carry: whole_body.step(GAINS, links, carry, at, target, held, DT)[0])
    for _ in range(100):
        carry = step(carry)
    assert np.max(np.abs(carry.position - joints.position)) == pytest.approx(0.1)


@pytest.mark.parametrize("angle", [0.3, 1.5, 1.7, 3.0])
def test_a_rotation_vector_is_the_axis_times_the_sine_up_to_a_quarter_turn(x64, angle):
    axis = np.array([0.36, -0.48, 0.8])
    R = jnp.asarray(Rotation.from_rotvec(angle * axis).as_matrix())
    length = np.sin(angle) if angle < np.pi / 2 else 1.0
    np.testing.assert_allclose(whole_body.rotation_vector(R), length * axis, atol=1e-9)


def test_the_end_effector_turns_about_the_axis_to_its_target(x64):
    """By the attitudes of base, end effector and target."""
    base, tip, wanted = Rotation.random(3, random_state=8)
    at = Estimate(
        p=jnp.zeros(3),
        q=jnp.asarray(base.as_quat()[[3, 0, 1, 2]]),
        nu=jnp.zeros(6),
        joints=None,
    )
    pose = link_motion.EndEffectorMotion(
        position=jnp.zeros(3), rotation=jnp.asarray(tip.as_matrix()), jacobian=jnp.zeros((6, 6))
    )
    target = make_target([0.0, 0.0, 0.0], wanted.as_quat()[[3, 0, 1, 2]], True)
    gains = replace(GAINS, turn_radps=10.0)
    velocity = whole_body.end_effector_velocity(gains, at, pose, target)
    turn = (base.inv() * wanted * tip.inv()).as_rotvec()
    angle = np.linalg.norm(turn)
    length = np.sin(angle) if angle < np.pi / 2 else 1.0
    np.testing.assert_allclose(velocity[:3], 0.0, atol=1e-12)
    np.testing.assert_allclose(velocity[3:], length * turn / angle, atol=1e-9)


def test_gains_that_make_no_sense_are_refused():
    with pytest.raises(ConfigError, match="whole_body: speed_mps = 0"):
        whole_body.check(replace(GAINS, speed_mps=0.0))
    with pytest.raises(ConfigError, match="link_wrench: present = -1"):
        link_wrench.check(link_wrench.LinkWrenchGains(present=-1.0))


def test_the_base_feels_nothing_of_an_arm_that_is_fed_forward(vehicle):
    """Level at rest, the base's net buoyancy is all that is left to accelerate it."""
    links, rng = vehicle.links, np.random.default_rng(5)
    water = physics.Water()
    for theta in sample_positions(links, 20, seed=6):
        speed = 0.3 * rng.normal(size=theta.size) * np.asarray(links.max_speed)
        joints = JointMotion(position=jnp.asarray(theta), velocity=jnp.asarray(speed))
        at = Estimate(
            p=jnp.array([0.0, 0.0, -9.0]),
            q=quaternion.from_yaw(jnp.asarray(rng.uniform(-3, 3))),
            nu=jnp.zeros(6),
            joints=joints,
        )
        acceleration = rng.normal(size=theta.size)
        # A target that the servos answer with these accelerations over a control period.
        target = JointTarget(
            position=joints.position,
            velocity=joints.velocity,
            acceleration=jnp.asarray(acceleration),
        )
        wrench = link_wrench.step(
            link_wrench.LinkWrenchGains(),
            vehicle,
            at,
            target,
            BodyWrench(tau=jnp.zeros(6)),
            DT,
            DENSITY,
            GRAVITY,
        )
        state = physics.VehicleState(
            p=at.p, q=at.q, nu=at.nu, force_before=jnp.zeros(11), thrust=jnp.zeros(8), joints=joints
        )
        still = jnp.zeros(3)
        forces = physics.join_forces(vehicle, state, still, still, water)
        left = forces.force[:6] + wrench.tau - forces.M[:6, 6:] @ acceleration
        lift = (DENSITY * vehicle.volume_m3 - vehicle.mass_kg) * GRAVITY
        np.testing.assert_allclose(left, [0, 0, lift, 0, 0, 0], atol=1e-9)


def test_a_vehicle_without_links_is_left_alone(x64):
    plain = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    command = BodyWrench(tau=jnp.arange(6.0))
    gains = link_wrench.LinkWrenchGains()
    assert link_wrench.step(gains, plain, at, None, command, DT, DENSITY, GRAVITY) is command


def test_servos_ask_for_speeds_by_error_and_speed_of_their_target(x64):
    """Within the limit of the speed; nothing where there is no servo."""
    links = replace(
        build_vehicle().links,
        stiffness=jnp.array([6.0, 6.0, 6.0, 0.0, 6.0]),
        damping=jnp.array([3.0, 3.0, 2.0, 0.0, 0.5]),
        max_speed=jnp.array([2.0, 0.5, 2.0, 2.0, 9.0]),
    )
    joints = JointMotion(position=jnp.full(5, 0.3), velocity=jnp.full(5, 7.0))
    target = JointTarget(
        position=jnp.full(5, 0.7), velocity=jnp.full(5, 0.1), acceleration=jnp.zeros(5)
    )
    speed = link_wrench.servo_speed(links, joints, target)
    np.testing.assert_allclose(speed, [0.9, 0.5, 1.3, 0.0, 4.9])


@pytest.mark.parametrize("missing", ["links", "joints", "target"])
def test_without_links_joints_or_target_the_wrench_is_that_of_the_base(vehicle, missing):
    joints = JointMotion(position=vehicle.links.home, velocity=jnp.zeros(5))
    at = Estimate(
        p=jnp.zeros(3),
        q=jnp.array([1.0, 0, 0, 0]),
        nu=jnp.zeros(6),
        joints=None if missing == "joints" else joints,
    )
    command = BodyWrench(tau=jnp.arange(6.0))
    target = None if missing == "target" else hold_joints(joints)
    robot = replace(vehicle, links=None) if missing == "links" else vehicle
    gains = link_wrench.LinkWrenchGains()
    assert link_wrench.step(gains, robot, at, target, command, DT, DENSITY, GRAVITY) is command


def test_the_acceleration_of_the_target_is_fed_forward(vehicle):
    """The joints' inertia, times the acceleration that brings them to the servos' speeds."""
    rng = np.random.default_rng(9)
    joints = JointMotion(
        position=vehicle.links.home, velocity=jnp.asarray(0.1 * rng.normal(size=5))
    )
    at = Estimate(
        p=jnp.array([0.0, 0.0, -9.0]), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6), joints=joints
    )
    gains = link_wrench.LinkWrenchGains(present=0.0)
    state = physics.VehicleState(
        p=at.p, q=at.q, nu=at.nu, force_before=jnp.zeros(11), thrust=jnp.zeros(8), joints=joints
    )
    still = jnp.zeros(3)
    inertia = physics.join_forces(vehicle, state, still, still, physics.Water()).M
    for fraction, acceleration in ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0)):
        velocity = fraction * vehicle.links.max_speed
        target = JointTarget(
            position=joints.position,
            velocity=velocity,
            acceleration=jnp.full(5, acceleration),
        )
        wrench = link_wrench.step(
            gains, vehicle, at, target, BodyWrench(tau=jnp.zeros(6)), DT, DENSITY, GRAVITY
        )
        change = (velocity + DT * acceleration - joints.velocity) / DT
        np.testing.assert_allclose(wrench.tau, inertia[:6, 6:] @ change, atol=1e-9)
