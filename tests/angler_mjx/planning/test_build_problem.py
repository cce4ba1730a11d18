"""Teams of problems: hulls and radii of robots with arms."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.build_problem import build_team
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.thrusters import tables_at
from angler_mjx.sim import fleet
from angler_mjx.sim.fleet import Member, Variant

from ..link_poses import locate_by_mujoco


def team(*names, joint_position=None):
    members = [
        Member(
            variants=(Variant(vehicle=name, parameter_set="von_benzon2022", battery_v=16.0),),
            weights=(1.0,),
            cruise_speed_mps=0.5,
        )
        for name in names
    ]
    control = fleet.sample_variants(fleet.build_fleet(members), jax.random.key(0))[1]
    zeros = jnp.zeros((len(names), 3))
    return build_team(control, zeros, jnp.zeros(len(names)), zeros, joint_position)


def test_hulls_hold_arms_at_home():
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    home = [joint.home for joint in config.find_joints()]
    poses = locate_by_mujoco(config, np.zeros(3), [1.0, 0.0, 0.0, 0.0], home)
    both = team("bluerov2_heavy_alpha5", "bluerov2_heavy")
    base = len(config.hull.capsules)
    capsules = [(link.name, item) for link in config.find_links(None) for item in link.capsules]
    assert both.capsule_r_m.shape == (2, base + len(capsules))
    for i, (name, capsule) in enumerate(capsules):
        origin, turn = poses[name]
        want = origin + turn @ capsule.from_m
        np.testing.assert_allclose(both.capsule_a_m[0, base + i], want, atol=1e-6)
    assert float(both.radius_m[0]) == np.float32(library.reach_m(config))


def test_hulls_and_radii_are_those_of_the_posture_at_the_start():
    """In flight an arm may be stretched out; its links lie by MuJoCo's kinematics."""
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    home = np.array([joint.home for joint in config.find_joints()])
    posture = home + np.array([0.0, 1.2, 0.4, 0.3, 0.1])
    poses = locate_by_mujoco(config, np.zeros(3), [1.0, 0.0, 0.0, 0.0], posture)
    rows = np.stack([posture, np.zeros(5)])
    both = team("bluerov2_heavy_alpha5", "bluerov2_heavy", joint_position=jnp.asarray(rows))
    folded = team("bluerov2_heavy_alpha5", "bluerov2_heavy")
    base = len(config.hull.capsules)
    capsules = [(link.name, item) for link in config.find_links(None) for item in link.capsules]
    reach_m = 0.0
    for i, (name, capsule) in enumerate(capsules):
        origin, turn = poses[name]
        ends = [origin + turn @ np.asarray(end) for end in (capsule.from_m, capsule.to_m)]
        np.testing.assert_allclose(both.capsule_a_m[0, base + i], ends[0], atol=1e-6)
        np.testing.assert_allclose(both.capsule_b_m[0, base + i], ends[1], atol=1e-6)
        reach_m = max(reach_m, *(np.linalg.norm(end) + capsule.radius_m for end in ends))
    assert float(both.radius_m[0]) == pytest.approx(reach_m, abs=1e-6)
    assert float(both.radius_m[0]) > float(folded.radius_m[0]) + 0.05
    np.testing.assert_array_equal(both.arms.joint_position[0], posture.astype(np.float32))
    assert float(both.radius_m[1]) == pytest.approx(float(folded.radius_m[1]), abs=1e-6)


def test_a_robot_without_arms_keeps_hull_and_radius():
    both, alone = team("bluerov2_heavy_alpha5", "bluerov2_heavy"), team("bluerov2_heavy")
    assert both.radius_m[1] == alone.radius_m[0]
    capsules = (both.capsule_a_m[1], both.capsule_b_m[1], both.capsule_r_m[1][:, None])
    rows = {tuple(row) for row in np.concatenate(capsules, axis=1).tolist()}
    own = (alone.capsule_a_m[0], alone.capsule_b_m[0], alone.capsule_r_m[0][:, None])
    assert rows == {tuple(row) for row in np.concatenate(own, axis=1).tolist()}


def test_power_is_that_of_each_thruster_s_curve(tmp_path):
    """Surge at constant speeds: drag by the pseudo-inverse, at the power of equal thrust."""
    text = library.locate_vehicle("bluerov2_heavy").read_text(encoding="utf-8")
    curve = "curve = { pwm_us = [1100, 1500, 1900], thrust_n = [-20.0, 0.0, 90.0] }"
    text, count = re.subn(r"(spin = -?1) \}", rf"\1, {curve} }}", text, count=1)
    assert count == 1
    path = tmp_path / "odd.toml"
    path.write_text(text)
    config = library.load_vehicle(str(path))
    both = team(str(path), "bluerov2_heavy")
    damping = config.find_set("von_benzon2022").damping
    matrix = wrench_matrix(config)
    file_n, file_w = tables_at(library.load_thruster("t200"), 16.0)
    for i, curved in ((0, True), (1, False)):
        speeds = float(both.terminal_speed_mps[i, 0]) * np.linspace(0, 1, both.power_w.shape[-1])
        for k in (2, 4):  # at which no thruster is at its end
            v = speeds[k]
            drag = (damping.linear_diagonal[0] + damping.quadratic_diagonal[0] * v) * v
            thrust = np.linalg.pinv(matrix) @ [drag, 0, 0, 0, 0, 0]
            power = [np.interp(f, file_n, file_w) for f in thrust]
            if curved:
                # The file's power at the thrusts of signals 4 us apart, and lines between.
                step = 0.2 if thrust[0] < 0 else 0.9
                low = step * np.floor(thrust[0] / step)
                ends = np.interp([low, low + step], file_n, file_w)
                power[0] = ends[0] + (ends[1] - ends[0]) * (thrust[0] - low) / step
            assert float(both.power_w[i, 0, k]) == pytest.approx(sum(power), rel=1e-3)
    assert both.terminal_speed_mps[0, 0] != both.terminal_speed_mps[1, 0]
