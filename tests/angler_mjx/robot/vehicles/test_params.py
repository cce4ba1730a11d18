"""The parameter pytree: wrench matrix, hull, terminal speeds, padding."""

import dataclasses

import jax
import numpy as np
import pytest

from angler_mjx import frames
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.drive import full_force, terminal_speed, wrench_matrix
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.params import build_vehicle, stack_vehicles
from angler_mjx.sim.physics.rotors import advance_rotors

# Wrench of one newton of each thruster of the Heavy that blue's own geometry gives: x forward,
# y starboard, z down, moments about the centre of mass. As published: rounded.
PUBLISHED_FRD = np.array(
    [
        [-0.707, -0.707, 0.707, 0.707, 0, 0, 0, 0],
        [0.707, -0.707, 0.707, -0.707, 0, 0, 0, 0],
        [0, 0, 0, 0, 1, 1, 1, 1],
        [-0.0078, 0.0078, -0.0078, 0.0078, 0.215, -0.215, 0.215, -0.215],
        [-0.0078, -0.0078, 0.0078, 0.0078, -0.118, -0.118, 0.118, 0.118],
        [0.1641, -0.1640, -0.1711, 0.1711, 0, 0, 0, 0],
    ]
)
# Half a unit of the last printed place; the yaw row also bears the 0.0004 rad by which 0.785 and
# 2.356 differ from 45 and 135 degrees, on arms up to 0.06 m along the force.
TABLE_ROUNDING = np.array([5e-4, 5e-4, 5e-4, 5e-5, 5e-5, 5e-5 + 0.0004 * 0.06])[:, None]


@pytest.fixture(scope="module")
def heavy():
    return load_vehicle("bluerov2_heavy")


@pytest.fixture(scope="module")
def light():
    return load_vehicle("bluerov2")


def test_wrench_matrix_is_the_true_one_of_the_geometry(heavy):
    ours = frames.body_flu_to_frd(wrench_matrix(heavy).T).T
    assert np.all(np.abs(ours - PUBLISHED_FRD) <= TABLE_ROUNDING)


def test_moments_do_the_work_of_the_force_in_a_turn(heavy):
    center = np.array(heavy.base.center_of_mass_m)
    # By virtual work: what the force does when the vehicle turns by a unit about each axis.
    for thruster, column in zip(heavy.thrusters.layout, wrench_matrix(heavy).T, strict=True):
        arm = np.array(thruster.position_m) - center
        for axis in range(3):
            turn = np.zeros(3)
            turn[axis] = 1.0
            work = np.dot(thruster.direction, np.cross(turn, arm))
            assert column[3 + axis] == pytest.approx(work, abs=1e-15)


def test_reaction_torque_opposes_the_spin(heavy):
    data = heavy.model_dump()
    data["rotor"]["reaction_torque"]["coefficient_m"] = 0.02
    with_torque = wrench_matrix(VehicleConfig.model_validate(data))
    spin = np.array([t.spin for t in heavy.thrusters.layout])
    direction = np.array([t.direction for t in heavy.thrusters.layout]).T
    np.testing.assert_allclose(
        with_torque[3:] - wrench_matrix(heavy)[3:], -0.02 * spin * direction, atol=1e-15
    )


@pytest.mark.parametrize(
    ("name", "surge_mps"), [("wu2018", 2.56), ("blue_gazebo", 1.49), ("von_benzon2022", 0.91)]
)
def test_surge_terminal_speed_at_16_v(heavy, name, surge_mps):
    # The published comparison has two decimals.
    assert float(build_vehicle(heavy, name, 16.0).terminal_speed_mps[0]) == pytest.approx(
        surge_mps, abs=0.01
    )


def test_full_force_uses_both_ends_of_the_table(heavy):
    force = full_force(wrench_matrix(heavy)[:3], -39.91, 51.44)
    horizontal = np.sqrt(0.5) * 2 * (39.91 + 51.44)
    # Heave up is the weak way: positive thrust of the vertical thrusters pushes down.
    np.testing.assert_allclose(force, [horizontal, horizontal, 4 * 39.91], rtol=1e-12)


def test_terminal_speed_balances_damping():
    force, d_l, d_q = np.array([130.0, 50, 7]), np.array([4.0, 0, 3]), np.array([18.0, 2, 0])
    v = terminal_speed(force, d_l, d_q)
    np.testing.assert_allclose(d_l * v + d_q * v * v, force, rtol=1e-14)


def test_hull_is_about_the_center_of_mass_and_inside_its_sphere(heavy):
    params = build_vehicle(heavy, "wu2018", 16.0)
    # float32 of numbers below 1.
    np.testing.assert_allclose(np.asarray(params.capsule_a_m)[:, 2], -0.011, atol=1e-7)
    ends = np.concatenate([params.capsule_a_m, params.capsule_b_m])
    reach = np.linalg.norm(ends, axis=1) + np.tile(params.capsule_r_m, 2)
    assert float(params.radius_m) == pytest.approx(reach.max(), abs=1e-6)


def test_numbers_of_the_file_arrive_unchanged(heavy):
    params = build_vehicle(heavy, None, 16.0)

    def same(leaf, numbers):
        np.testing.assert_array_equal(leaf, np.asarray(numbers, dtype=leaf.dtype))

    same(params.mass_kg, 13.5)
    same(params.volume_m3, 0.0134)
    same(params.inertia_kgm2, np.diag([0.26, 0.23, 0.37]))
    same(params.M_A, np.diag([6.36, 7.12, 18.68, 0.189, 0.135, 0.222]))
    same(params.D_l, [13.7, 0, 33, 0, 0.8, 0])
    same(params.D_q, [141, 217, 190, 1.19, 0.47, 1.5])
    same(params.p_cb_m, [0, 0, 0.01])
    same(params.tau_s, 0.02)
    assert params.thrust_n.shape == params.power_w.shape == (201,)


def test_a_fault_is_in_the_numbers_of_the_robot(heavy):
    sound = build_vehicle(heavy, "wu2018", 16.0)
    faulty = build_vehicle(
        heavy, "wu2018", 16.0, thruster_health={"thruster_8": 0.0, "thruster_1": 0.5}
    )
    np.testing.assert_array_equal(faulty.thruster_health, [0.5, 1, 1, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(faulty.thruster_exists, [True] * 7 + [False])
    # Geometry and speeds stay those of the sound vehicle.
    np.testing.assert_array_equal(faulty.B, sound.B)
    np.testing.assert_array_equal(faulty.terminal_speed_mps, sound.terminal_speed_mps)


def test_stack_pads_without_changing_a_robot(heavy, light):
    robots = [build_vehicle(light, None, 14.8), build_vehicle(heavy, "wu2018", 16.0)]
    fleet = stack_vehicles(robots)
    assert fleet.B.shape == (2, 6, 8)
    assert fleet.capsule_a_m.shape == (2, 3, 3)
    np.testing.assert_array_equal(fleet.thruster_exists.sum(axis=1), [6, 8])
    first = jax.tree.map(lambda leaf: leaf[0], fleet)
    np.testing.assert_array_equal(first.B[:, :6], robots[0].B)
    np.testing.assert_array_equal(first.B[:, 6:], 0)
    # The padded capsule repeats the last one, so distances to the hull do not change.
    np.testing.assert_array_equal(first.capsule_a_m[2], robots[0].capsule_a_m[1])
    np.testing.assert_array_equal(first.capsule_r_m[2], robots[0].capsule_r_m[1])
    second = jax.tree.map(lambda leaf: leaf[1], fleet)
    for field in dataclasses.fields(second):
        np.testing.assert_array_equal(
            getattr(second, field.name), getattr(robots[1], field.name), err_msg=field.name
        )


def test_lags_of_single_thrusters():
    data = load_vehicle("bluerov2_heavy").model_dump()
    data["thrusters"]["layout"][3]["time_constant_s"] = 0.3
    config = VehicleConfig.model_validate(data)
    params = build_vehicle(config, None, 16.0)
    expected = [0.02, 0.02, 0.02, 0.3, 0.02, 0.02, 0.02, 0.02]
    np.testing.assert_allclose(params.tau_s, expected, rtol=1e-6)
    assert build_vehicle(load_vehicle("bluerov2"), None, 16.0).tau_s.shape == ()
    fleet = stack_vehicles([params, build_vehicle(load_vehicle("bluerov2"), None, 16.0)])
    np.testing.assert_allclose(fleet.tau_s, [expected, [0.02] * 8], rtol=1e-6)
    thrust, mean = advance_rotors(params, np.zeros(8, np.float32), np.ones(8, np.float32), 0.1)
    np.testing.assert_allclose(thrust[3], 1 - np.exp(-1 / 3), rtol=1e-5)
    np.testing.assert_allclose(thrust[2], 1 - np.exp(-5), rtol=1e-5)
    # The mean of 1 - exp(-t / tau) over the step.
    np.testing.assert_allclose(mean[3], 1 - 3 * (1 - np.exp(-1 / 3)), rtol=1e-4)
