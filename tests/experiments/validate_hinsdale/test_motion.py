"""Vehicle of the campaign and its motion with prescribed joints."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_experiments.validate_hinsdale import parameters, references
from angler_experiments.validate_hinsdale.batch import build_batch, simulate_batch
from angler_experiments.validate_hinsdale.campaign import read_campaign
from angler_experiments.validate_hinsdale.motion import ArmMotion, BodyState, simulate
from angler_experiments.validate_hinsdale.scores import median_scores, score_run
from angler_experiments.validate_hinsdale.tracks import build_track
from angler_experiments.validate_hinsdale.vehicle import (
    EXTRAS,
    FOLDED_RAD,
    SOURCE_SET,
    WATER,
    build_campaign_vehicle,
    lift_moment,
)
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics.prescribed import accelerate_base

from . import recordings


@pytest.fixture(scope="module")
def track(tmp_path_factory):
    """Return a run of 20 s with the arm folded."""
    folder = tmp_path_factory.mktemp("runs")
    recordings.write_run(folder, "traj001-0", recordings.poses(seconds=20.0, roll=0.1, pitch=0.0))
    (run,) = read_campaign(folder)
    return build_track(run)


def test_the_authors_vehicle_weighs_what_its_parts_do():
    lift, _ = lift_moment(build_campaign_vehicle(SOURCE_SET), jnp.array(FOLDED_RAD))
    arm = 9.81 * (997.0 * 0.623e-3 - 1.462)
    expected = 9.81 * (13.082 - 13.17) + sum(extra.lift_n for extra in EXTRAS) + arm
    # A difference of weights of 250 N in float32.
    assert float(lift) == pytest.approx(expected, abs=1e-3)


def test_the_authors_moment_is_that_of_their_numbers():
    """Moments about the bare vehicle's centre of mass, without arm: by hand."""
    vehicle = build_campaign_vehicle(SOURCE_SET)
    massless = replace(
        vehicle.links,
        mass_kg=0.0 * vehicle.links.mass_kg,
        volume_m3=0.0 * vehicle.links.volume_m3,
    )
    params = replace(vehicle.params, links=massless)
    lift, moment = lift_moment(replace(vehicle, params=params), jnp.array(FOLDED_RAD))
    middle = np.array([0.25, -0.10965, 0.005]) - np.asarray(vehicle.links.position_m[0])
    parts = sum(extra.lift_n * np.array(extra.position_m) for extra in EXTRAS)
    expected = 13.082 * 9.81 * np.array([0.0074, 0.0, 0.02]) + parts
    np.testing.assert_allclose(moment + lift * middle, expected, atol=1e-4)


@pytest.mark.parametrize("name", ["wu2018", "von_benzon2022", "blue_gazebo"])
def test_published_sets_are_trimmed_like_the_authors_vehicle(name):
    folded = jnp.array(FOLDED_RAD)
    lift, moment = lift_moment(build_campaign_vehicle(name), folded)
    other_lift, other_moment = lift_moment(build_campaign_vehicle(SOURCE_SET), folded)
    assert float(lift) == pytest.approx(float(other_lift), abs=1e-3)
    np.testing.assert_allclose(moment[:2], other_moment[:2], atol=1e-3)


def test_released_vehicle_comes_to_rest_where_weights_balance(track):
    vehicle = build_campaign_vehicle(SOURCE_SET)
    damped = replace(vehicle.params, D_l=vehicle.params.D_l.at[3:].set(2.0))
    motion = simulate_batch(replace(vehicle, params=damped), build_batch([track]))
    balance = references.predict_balance(vehicle, track)
    # The drag of the rise turns it by as much.
    np.testing.assert_allclose(motion.angles_rad[0, -1, :2], balance.angles_rad[-1, :2], atol=3e-3)


def test_turned_markers_turn_the_recorded_angles(track):
    """The same attitude of the vehicle: recorded with markers yawed by 1.57 it is another one."""
    vehicle = build_campaign_vehicle(SOURCE_SET)
    balance = references.predict_balance(vehicle, track)
    quarter = replace(vehicle, marker_yaw_rad=jnp.asarray(0.5 * np.pi))
    turned = references.predict_balance(quarter, track)
    roll, pitch = balance.angles_rad[0, :2]
    np.testing.assert_allclose(turned.angles_rad[0, :2], [pitch, -roll], atol=1e-3)
    motion = simulate_batch(quarter, build_batch([track]))
    # Turned there and back: the motion begins where it was recorded.
    np.testing.assert_allclose(motion.angles_rad[0, 0], track.initial_angles_rad, atol=1e-5)


def test_balance_explains_most_of_the_campaign():
    """Found are 0.0168 and 0.0139 rad; each run's mean leaves 0.042 and 0.040 rad."""
    runs = [run for run in read_campaign(recordings.real_folder()) if run.copy_of is None]
    tracks = [build_track(run) for run in runs]
    vehicle = build_campaign_vehicle(SOURCE_SET)
    balances = [references.predict_balance(vehicle, track) for track in tracks]
    scores = {
        track.stem: score_run(track, balance.angles_rad, balance.p_m)
        for track, balance in zip(tracks, balances, strict=True)
    }
    medians = median_scores(scores)
    assert medians["roll"] < 0.02
    assert medians["pitch"] < 0.016


SWINGS_RAD = np.array([0.3, 0.5, 0.4, 0.6, 0.0])
"""Amplitudes with which the joints swing at 3 rad/s, each at its phase."""


def _swing(t):
    """Return position, velocity and acceleration [..., 5] of the joints at times [...]."""
    phase = 3.0 * np.asarray(t)[..., None] + np.arange(5.0)
    rest = np.append(FOLDED_RAD, 0.0)
    return (
        rest + SWINGS_RAD * np.sin(phase),
        3.0 * SWINGS_RAD * np.cos(phase),
        -9.0 * SWINGS_RAD * np.sin(phase),
    )


def _integrate(vehicle, p, q, nu, flow, dt, n):
    """Return states [n + 1, 13] by the classical Runge-Kutta method in float64, formula by formula.

    Only the acceleration is the simulator's, in float32. The attitude is normalised after a step.
    """

    @jax.jit
    def acceleration(q, nu, position, velocity, joint_acceleration):
        return accelerate_base(
            vehicle.params,
            jnp.array([0.0, 0.0, -10.0]),
            q,
            nu,
            JointMotion(position=position, velocity=velocity),
            joint_acceleration,
            v_c=jnp.asarray(flow),
            water=WATER,
        )

    def slope(t, y):
        q, nu = y[3:7], y[7:]
        w, v = q[0], q[1:]
        return np.concatenate(
            [
                # `Rotation` normalises; the quaternion within a step is not quite one.
                (q @ q) * Rotation.from_quat(q, scalar_first=True).apply(nu[:3]),
                [-0.5 * v @ nu[3:]],
                0.5 * (w * nu[3:] + np.cross(v, nu[3:])),
                np.asarray(acceleration(*map(jnp.asarray, (q, nu, *_swing(t)))), float),
            ]
        )

    y = np.concatenate([p, q, nu])
    states = [y]
    for i in range(n):
        t = i * dt
        k1 = slope(t, y)
        k2 = slope(t + dt / 2, y + dt / 2 * k1)
        k3 = slope(t + dt / 2, y + dt / 2 * k2)
        k4 = slope(t + dt, y + dt * k3)
        y = y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        y[3:7] /= np.linalg.norm(y[3:7])
        states.append(y)
    return np.stack(states)


def test_steps_are_those_of_the_classical_runge_kutta_method():
    """Steps of 0.1 s while the arm swings: each derivative at its time, each with its weight."""
    vehicle = build_campaign_vehicle(SOURCE_SET)
    dt, n = 0.1, 15
    p, q = np.array([0.0, 0.0, 0.4]), Rotation.from_euler("ZYX", [1.8, 0.2, -0.3])
    q, nu = q.as_quat(scalar_first=True), np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.5])
    flow = np.array([0.1, -0.05, 0.0])
    joints = ArmMotion(*map(jnp.asarray, _swing(0.5 * dt * np.arange(2 * n + 1))))
    begin = BodyState(*map(jnp.asarray, (p, q, nu)))
    states = jax.jit(simulate, static_argnums=4)(vehicle, begin, joints, jnp.asarray(flow), dt)
    expected = _integrate(vehicle, p, q, nu, flow, dt, n)
    assert np.ptp(expected[:, 10]) > 0.2
    # Fifteen steps round some six times in float32, by 6e-8 of numbers up to 1.
    np.testing.assert_allclose(np.hstack(states), expected, rtol=0.0, atol=5e-6)


def test_parameters_at_zero_change_nothing():
    vehicle = build_campaign_vehicle(SOURCE_SET)
    same = parameters.apply_parameters(vehicle, jnp.zeros(len(parameters.LABELS)))
    jax.tree.map(np.testing.assert_array_equal, vehicle, same)


@pytest.mark.parametrize("index", range(len(parameters.LABELS)))
def test_every_parameter_changes_the_vehicle(index):
    vehicle = build_campaign_vehicle(SOURCE_SET)
    vector = jnp.zeros(len(parameters.LABELS)).at[index].set(1.0)
    changed = parameters.apply_parameters(vehicle, vector)
    differences = jax.tree.map(lambda a, b: bool(jnp.any(a != b)), vehicle, changed)
    assert any(jax.tree.leaves(differences))
