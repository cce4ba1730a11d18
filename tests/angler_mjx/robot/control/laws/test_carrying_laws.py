"""Laws of robots that carry a body by the force of their grips, against closed forms in numpy."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    GripReading,
    PoseTarget,
)
from angler_mjx.robot.control.laws import admittance, grip_moment, leader_follower
from angler_mjx.robot.control.laws.admittance import AdmittanceGains
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains, find_excess, find_wrench
from angler_mjx.robot.control.laws.grip_moment import GripMomentGains
from angler_mjx.robot.control.laws.leader_follower import LeaderFollowerGains
from angler_mjx.robot.control.stages import build_stack
from angler_mjx.scenario.scenario import load_scenario

DT = 0.05
PART = {"depth_m": 0.4, "weight_n": 8.0, "drag_x_n": 60.0, "drag_y_n": 10.0, "drag_z_n": 70.0}
CENTER = np.array([1.2, 0.0, -0.4])
LEVER = np.array([0.5, -0.1, -0.3])
VEHICLE = SimpleNamespace(terminal_speed_mps=jnp.array([1.5, 1.2, 1.0]), steered=False)


def believe(attitude, wrench, nu=(0.0,) * 6, flow=None):
    """Return an estimate with a measured wrench [6] in F."""
    return Estimate(
        p=jnp.array([1.0, 2.0, -6.0]),
        q=jnp.asarray(attitude.as_quat(scalar_first=True), jnp.float32),
        nu=jnp.asarray(nu, jnp.float32),
        flow=None if flow is None else jnp.asarray(flow, jnp.float32),
        grip=GripReading(
            wrench=jnp.asarray(wrench, jnp.float32),
            center_m=jnp.asarray(CENTER, jnp.float32),
            lever_m=jnp.asarray(LEVER, jnp.float32),
        ),
    )


def pull(attitude, force, moment=(0.0,) * 3):
    """Return an estimate of a robot at rest that the body pulls, beyond its part; in W."""
    beyond = [*attitude.inv().apply(force), *attitude.inv().apply(moment)]
    weight = attitude.inv().apply([0.0, 0.0, -8.0])
    part = [*weight, *np.cross([0.0, 0.0, -0.4], weight)]
    return believe(attitude, np.add(beyond, part))


def test_a_part_of_the_load_weighs_and_drags():
    rng = np.random.default_rng(0)
    for _ in range(20):
        attitude, nu, flow = (
            Rotation.from_rotvec(rng.normal(size=3)),
            rng.normal(size=6),
            rng.normal(size=3),
        )
        lever = np.array([0.0, 0.0, -0.4])
        through = nu[:3] + np.cross(nu[3:], lever) - attitude.inv().apply(flow)
        force = attitude.inv().apply([0.0, 0.0, -8.0])
        force = force - np.array([60.0, 10.0, 70.0]) * np.abs(through) * through
        want = np.concatenate([force, np.cross(lever, force)])
        now, gains = believe(attitude, rng.normal(size=6), nu, flow), CargoPartGains(**PART)
        np.testing.assert_allclose(find_wrench(gains, now, now.flow), want, rtol=1e-4, atol=1e-3)
        beyond = find_excess("law", gains, now)
        np.testing.assert_allclose(beyond, now.grip.wrench - want, rtol=1e-4, atol=1e-3)
    nothing = believe(attitude, np.zeros(6), nu, flow)
    np.testing.assert_array_equal(find_excess("law", gains, nothing), 0.0)


def test_a_part_is_at_the_centre_of_mass_where_no_depth_is_stated():
    attitude = Rotation.from_euler("ZYX", [1.0, 0.3, -0.2])
    wrench = find_wrench(CargoPartGains(weight_n=8.0), believe(attitude, np.zeros(6)))
    np.testing.assert_allclose(wrench[:3], attitude.inv().apply([0.0, 0.0, -8.0]), atol=1e-5)
    np.testing.assert_array_equal(wrench[3:], 0.0)


def follow_admittance(gains, estimate, seconds, command):
    """Return the targets [time, ...] of the law under a constant measurement."""
    carry, targets = admittance.reset(estimate), []
    for _ in range(round(seconds / DT)):
        carry, target = admittance.step(gains, None, carry, estimate, command, DT, 1000.0, 9.81)
        targets.append([*target.position_m, *target.velocity_mps, target.yaw_rad])
    return np.array(targets)


def test_a_reference_gives_way_as_a_mass_on_damper_and_spring():
    gains = AdmittanceGains(
        **PART,
        mass_kg=15.0,
        damping_ns_per_m=40.0,
        stiffness_n_per_m=60.0,
        inertia_kgm2=2.0,
        damping_nms_per_rad=3.0,
        stiffness_nm_per_rad=8.0,
    )
    attitude = Rotation.from_euler("ZYX", [2.0, 0.3, -0.2])
    force, moment = np.array([6.0, -3.0, 4.0]), np.array([0.5, -0.7, 1.6])
    command = PoseTarget(
        position_m=jnp.array([1.0, 2.0, -6.0]),
        velocity_mps=jnp.array([0.1, 0.0, 0.0]),
        yaw_rad=jnp.array(3.1),
    )
    found = follow_admittance(gains, pull(attitude, force, moment), 12.0, command)
    time = DT * np.arange(1, len(found) + 1)

    def respond(force, mass, damping, stiffness):
        def rate(_, x):
            return [x[1], (force - damping * x[1] - stiffness * x[0]) / mass]

        return solve_ivp(rate, (0.0, 12.0), [0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-10).y

    for axis in range(3):
        offset, velocity = respond(force[axis], 15.0, 40.0, 60.0)
        scale = abs(force[axis]) / 60.0
        want = command.position_m[axis] + offset
        np.testing.assert_allclose(found[:, axis], want, atol=0.05 * scale)
        np.testing.assert_allclose(
            found[:, 3 + axis], command.velocity_mps[axis] + velocity, atol=0.05 * scale
        )
    turned, _ = respond(1.6, 2.0, 3.0, 8.0)
    apart = np.exp(1j * found[:, 6]) / np.exp(1j * (3.1 + turned))
    assert np.abs(np.angle(apart)).max() < 0.01
    np.testing.assert_allclose(found[-1, :3] - command.position_m, force / 60.0, rtol=0.01)
    assert np.all(np.abs(found[:, 6]) <= np.pi + 1e-6)


def test_the_measured_force_is_fed_forward_with_its_lever_and_not_its_moment():
    """tau = tau_robot - [0; r x f], with f behind a filter of first order."""
    gains, attitude = GripMomentGains(filter_s=0.4), Rotation.from_euler("ZYX", [1.0, 0.2, -0.1])
    force, command = np.array([5.0, -3.0, -8.0]), np.array([1.0, 2.0, 3.0, 0.4, 0.5, 0.6])
    now = believe(attitude, [*force, 7.0, -9.0, 11.0])
    carry, out = grip_moment.reset(now), []
    for _ in range(40):
        carry, wrench = grip_moment.step(
            gains, None, carry, now, BodyWrench(tau=jnp.asarray(command)), DT, 1000.0, 9.81
        )
        out.append(np.asarray(wrench.tau))
    time = DT * np.arange(1, 41)
    risen = 1.0 - np.exp(-time / 0.4)
    want = command[3:] - risen[:, None] * np.cross(LEVER, force)
    np.testing.assert_allclose(np.array(out)[:, 3:], want, atol=0.03 * np.abs(want).max())
    np.testing.assert_allclose(out[-1][3:], want[-1], rtol=5e-3)
    np.testing.assert_array_equal(np.array(out)[:, :3], np.broadcast_to(command[:3], (40, 3)))
    open_grip = believe(attitude, np.zeros(6))
    for _ in range(40):
        carry, wrench = grip_moment.step(
            gains, None, carry, open_grip, BodyWrench(tau=jnp.asarray(command)), DT, 1000.0, 9.81
        )
    np.testing.assert_allclose(wrench.tau, command, atol=0.05)


def test_grip_moment_is_refused_where_nothing_is_held():
    with pytest.raises(ConfigError, match="grip_moment"):
        load_scenario(
            "reef_fleet",
            controller={"stages": ["follow", "pose", "velocity", "grip_moment", "pseudo_inverse"]},
        )
    with pytest.raises(ConfigError, match="gains of grip_moment: filter_s = -1"):
        grip_moment.check(GripMomentGains(filter_s=-1.0))


def step_follower(gains, carry, estimate, leads=False, command=(0.1, 0.2, 0.3, 0.01, 0.02, 0.03)):
    """Return memory and velocity [6] in F of a step."""
    twist = BodyTwist(nu=jnp.asarray(command, jnp.float32))
    carry, out = leader_follower.step(
        gains, VEHICLE, jnp.asarray(leads), carry, estimate, twist, DT
    )
    return carry, np.asarray(out.nu)


def test_a_follower_goes_where_it_is_pulled():
    """M v_e' = f; v = v_e + f / D; in W, whatever the robot's heading."""
    gains = LeaderFollowerGains(**PART)
    attitude = Rotation.from_euler("z", 2.0)
    force, moment = np.array([6.0, -3.0, 5.0]), np.array([0.0, 0.0, 2.0])
    carry = leader_follower.reset(believe(attitude, np.zeros(6)))
    for _ in range(20):
        carry, nu = step_follower(gains, carry, pull(attitude, force, moment))
    in_world = attitude.apply(nu[:3])
    want = force * (1.0 / gains.mass_kg * np.array([1, 1, 0]) + 1.0 / gains.damping_ns_per_m)
    np.testing.assert_allclose(in_world, want, rtol=1e-4)
    turn = 2.0 * (1.0 / gains.inertia_kgm2 + 1.0 / gains.damping_nms_per_rad)
    np.testing.assert_allclose(nu[3:], [0.0, 0.0, turn], rtol=1e-4, atol=1e-6)
    carry, nu = step_follower(gains, carry, pull(attitude, np.zeros(3)))
    want = force * [1, 1, 0] / gains.mass_kg
    np.testing.assert_allclose(attitude.apply(nu[:3]), want, rtol=1e-4, atol=1e-6)


def test_a_follower_whose_grip_has_opened_stops():
    gains, attitude = LeaderFollowerGains(**PART), Rotation.from_euler("ZYX", [2.0, -0.1, 0.0])
    carry = leader_follower.reset(believe(attitude, np.zeros(6)))
    for _ in range(20):
        carry, nu = step_follower(gains, carry, pull(attitude, [6.0, -3.0, 5.0], [0.0, 0.0, 2.0]))
    assert np.linalg.norm(nu[:3]) > 0.05
    carry, nu = step_follower(gains, carry, believe(attitude, np.zeros(6)))
    np.testing.assert_allclose(nu, [0, 0, 0, 0, gains.attitude_per_s * 0.1, 0], atol=1e-3)


def test_a_follower_is_bounded_and_does_not_wind_up():
    gains, level = LeaderFollowerGains(**PART), Rotation.identity()
    carry = leader_follower.reset(believe(level, np.zeros(6)))
    for _ in range(400):
        carry, nu = step_follower(gains, carry, pull(level, [80.0, 0.0, 0.0]))
    np.testing.assert_allclose(nu[:3], [0.9, 0.0, 0.0], rtol=1e-4, atol=1e-6)
    for _ in range(20):
        carry, nu = step_follower(gains, carry, pull(level, [-80.0, 0.0, 0.0]))
    np.testing.assert_allclose(
        nu[0], 0.9 - 80.0 / gains.mass_kg - 80.0 / gains.damping_ns_per_m, rtol=1e-4
    )


def test_a_follower_reads_no_command_and_the_leader_no_force():
    gains, attitude = (
        LeaderFollowerGains(**PART, turn_gain=1.0),
        Rotation.from_euler("ZYX", [1.0, 0.1, 0.2]),
    )
    now = pull(attitude, [3.0, 2.0, 1.0], [0.1, 0.2, 0.3])
    carry = leader_follower.reset(now)
    first = step_follower(gains, carry, now)
    other = step_follower(gains, carry, now, command=(-1.0, 0.0, 5.0, 0.0, 9.0, -2.0))
    np.testing.assert_array_equal(first[1], other[1])
    command = (0.1, 0.2, 0.3, 0.01, 0.02, 0.03)
    _, nu = step_follower(gains, carry, now, leads=True, command=command)
    np.testing.assert_allclose(nu, command, atol=1e-6)


def test_the_leader_turns_by_more_than_it_is_commanded():
    gains, attitude = (
        LeaderFollowerGains(**PART, turn_gain=5.0),
        Rotation.from_euler("ZYX", [1.0, 0.2, -0.1]),
    )
    now = believe(attitude, np.ones(6), nu=[0.0, 0.0, 0.0, 0.02, 0.0, 0.04])
    command = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.13])
    _, nu = step_follower(gains, leader_follower.reset(now), now, leads=True, command=command)
    up = attitude.inv().apply([0.0, 0.0, 1.0])
    error = up @ (command[3:] - [0.02, 0.0, 0.04])
    want = np.concatenate([command[:3], command[3:] + 4.0 * error * up])
    np.testing.assert_allclose(nu, want, rtol=1e-4, atol=1e-6)


def test_a_follower_climbs_after_a_body_that_the_leader_has_lifted():
    """Pitch with the bow up: the body's centre, ahead, is above where it is when level."""
    gains = LeaderFollowerGains(**PART)
    attitude = Rotation.from_euler("ZYX", [2.0, -0.1, 0.0])  # FLU: a negative pitch lifts x
    now = pull(attitude, np.zeros(3))
    _, nu = step_follower(gains, leader_follower.reset(now), now)
    height = attitude.apply(CENTER)[2] - CENTER[2]
    assert height > 0.1
    in_world = attitude.apply(nu[:3])
    np.testing.assert_allclose(in_world, [0.0, 0.0, gains.level_per_s * height], atol=1e-5)
    np.testing.assert_allclose(nu[3:], [0.0, gains.attitude_per_s * 0.1, 0.0], atol=1e-3)


def test_robots_that_hold_nothing_are_refused():
    free = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    with pytest.raises(ConfigError, match=r'task\.type = "carry"'):
        find_excess("admittance", CargoPartGains(), free)
    held = believe(Rotation.identity(), np.ones(6))
    with pytest.raises(ConfigError, match=r"controller\.leader"):
        leader_follower.step(
            LeaderFollowerGains(),
            VEHICLE,
            None,
            leader_follower.reset(held),
            held,
            BodyTwist(nu=jnp.zeros(6)),
            DT,
        )


@pytest.mark.parametrize(
    ("stage", "gain"),
    [
        ("admittance", "mass_kg"),
        ("admittance", "inertia_kgm2"),
        ("leader_follower", "mass_kg"),
        ("leader_follower", "damping_ns_per_m"),
        ("leader_follower", "inertia_kgm2"),
        ("leader_follower", "damping_nms_per_rad"),
    ],
)
def test_gains_that_divide_must_not_be_zero(stage, gain):
    above = ["follow", stage, "pose"] if stage == "admittance" else ["follow", "pose", stage]
    with pytest.raises(ConfigError, match=f"{stage}: {gain} = 0"):
        build_stack([*above, "velocity", "pseudo_inverse"], {stage: {gain: 0.0}})


FOLLOWING = ["follow", "pose", "leader_follower", "velocity", "cargo_wrench", "pseudo_inverse"]
YIELDING = ["follow", "admittance", "pose", "velocity", "cargo_wrench", "pseudo_inverse"]


@pytest.mark.parametrize("stages", [FOLLOWING, YIELDING])
def test_the_task_fills_in_the_part_of_the_load(stages):
    name = stages[1] if stages is YIELDING else stages[2]
    scenario = load_scenario(
        "carry_pipe",
        controller={"stages": stages, "gains": {name: {"mass_kg": 33.0, "drag_x_n": 1.0}}},
    )
    spec = scenario.sim_spec()
    by_name = dict(zip((stage.name for stage in spec.stages), spec.gains, strict=True))
    gains, wrench = by_name[name], by_name["cargo_wrench"]
    assert (gains.mass_kg, gains.drag_x_n) == (33.0, 1.0)
    assert wrench.drag_x_n > 2.0
    for key in ("depth_m", "weight_n", "drag_y_n", "drag_z_n"):
        assert getattr(gains, key) == getattr(wrench, key) > 0.0
    assert spec.leader == (0 if stages is FOLLOWING else None)


@pytest.mark.parametrize(
    ("name", "keys", "text"),
    [
        (
            "reef_fleet",
            {"controller": {"stages": [*YIELDING[:4], "pseudo_inverse"]}},
            "'admittance' takes the measured",
        ),
        (
            "reef_fleet",
            {"controller": {"stages": [*FOLLOWING[:4], "pseudo_inverse"]}},
            "'leader_follower' takes",
        ),
        (
            "carry_pipe",
            {"controller": {"stages": FOLLOWING, "leader": 2}},
            "= 2: the fleet has 2 robots",
        ),
        (
            "carry_pipe",
            {"controller": {"stages": YIELDING, "leader": 1}},
            "no stage is 'leader_follower'",
        ),
    ],
)
def test_stages_without_a_grip_and_leaders_who_are_not_there_are_refused(name, keys, text):
    with pytest.raises((ConfigError, ValueError), match=text):
        load_scenario(name, **keys)


def test_digests_do_not_depend_on_the_law():
    assert (
        load_scenario("carry_pipe").digest()
        == load_scenario("carry_pipe", controller={"stages": FOLLOWING, "leader": 1}).digest()
    )
