"""The equations of motion of vehicles with arms: what is timed moves, joints and all."""

import jax
import numpy as np
import pytest

from angler_mjx.robot.vehicles import library, params
from angler_mjx.studies.speed.measured import arm_motion, free_motion

VEHICLES = 3


@pytest.fixture(scope="module")
def vehicle():
    config = library.load_vehicle(arm_motion.VEHICLE)
    return params.build_vehicle(config, arm_motion.PARAMETER_SET, arm_motion.BATTERY_V)


def test_joints_begin_at_home_and_have_targets_within_their_limits(vehicle):
    state, thrust, targets = arm_motion.sample_states(jax.random.key(3), VEHICLES, vehicle)
    links = vehicle.links
    np.testing.assert_array_equal(state.joints.position, np.tile(links.home, (VEHICLES, 1)))
    assert not np.any(state.joints.velocity)
    assert np.all((targets.position >= links.lower) & (targets.position <= links.upper))
    assert len(np.unique(targets.position, axis=0)) == VEHICLES
    assert state.force_before.shape == state.change.shape == (VEHICLES, 6 + links.home.size)
    assert thrust.shape == (VEHICLES, vehicle.B.shape[-1])


def test_a_row_of_vehicles_with_arms(vehicle, monkeypatch):
    """Joints come to their targets, or move at their greatest speeds, in the timed region."""
    ends = []
    monkeypatch.setattr(arm_motion.free_motion, "require_different", lambda *two: ends.append(two))
    row = arm_motion.measure(vehicles=VEHICLES, repeats=10)
    assert (row.workload, row.worlds, row.robots) == ("dynamics_arm", VEHICLES, 1)
    assert (row.engine, row.kernels, row.unit) == ("mjx", "xla", "vehicle-steps/s")
    assert 0 < row.low <= row.median <= row.high
    # Five links and a base: more than ten times what a rigid body takes, less than a hundred.
    assert 5e3 < row.flops < 5e5
    assert "200 physics steps (2 s" in row.inside
    before, after = ends[-1]
    targets = arm_motion.sample_states(jax.random.key(0), VEHICLES, vehicle)[2]
    moved = np.abs(after.joints.position - before.joints.position)
    way = np.abs(targets.position - before.joints.position)
    least = np.minimum(0.8 * way, 0.8 * 2.0 * vehicle.links.max_speed)
    assert np.all(moved >= least - 0.05 * (vehicle.links.upper - vehicle.links.lower))


def test_a_cpu_gets_fewer_steps_of_many_vehicles():
    assert arm_motion.count_steps(10**6, "gpu") == arm_motion.STEPS
    assert arm_motion.count_steps(64, "cpu") == arm_motion.STEPS
    assert arm_motion.count_steps(2**20, "cpu") == free_motion.MIN_STEPS
