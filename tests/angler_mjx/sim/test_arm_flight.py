"""Station keeping while the arm sweeps at full speed, with and without feed-forward."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.vehicles.params import joint_names
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario

FLIGHT = {
    "name": "station",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "time": {"horizon_s": 12.0, "record_hz": 20.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": [[-4.0, -6.0, -5.0]],
        "goal_m": [[4.0, -6.0, -5.0]],
    },
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
}
SWEEP = ((0.52, 1.0, 5.2), (0.52, 0.0, 3.0), (0.52, 0.2, 3.0), (0.87, 0.0, 3.0))
"""Speed and ends of each joint's sweep: 1 % below its servo's limit, with a turn at once at the
ends."""


def sweep_arm(worlds, names, home, horizon_s):
    """Plans that keep the base where it starts, and move four joints as `SWEEP` says."""
    time = np.arange(0.0, horizon_s + 0.5, 0.5)
    position = np.zeros((1, 1, time.size, 4 + len(names)), np.float32)
    position[..., :3] = np.asarray(worlds.environment.start_m)[:, :, None]
    position[..., 3] = np.asarray(worlds.environment.start_yaw_rad)[:, :, None]
    position[..., 4:] = home
    for j, (speed, low, high) in enumerate(SWEEP):
        span = high - low
        phase = np.mod(home[j] - low + speed * time, 2.0 * span)
        position[0, 0, :, 4 + j] = low + span - np.abs(span - phase)
    still = jnp.zeros(position.shape)
    return JointTrajectory(
        joints=VEHICLE_JOINTS + names,
        time_s=jnp.asarray(time, jnp.float32)[None, None],
        position=jnp.asarray(position),
        velocity=still,
        acceleration=still,
        degree=jnp.full((1, 1, time.size), LINEAR, jnp.int32),
        commanded=jnp.ones((1, 1, position.shape[-1]), bool),
    )


def keep_station(fraction):
    """Return greatest distance, m, and tilt, degrees, of the base, and the joints at the end."""
    gains = {"link_wrench": {"present": fraction, "acceleration": fraction}}
    table = FLIGHT | {"controller": {"name": "arm", "gains": gains}}
    simulator = Simulator(Scenario.model_validate(table))
    vehicle = simulator.fleet.control.vehicle
    worlds = simulator.worlds()
    plan = sweep_arm(worlds, joint_names(vehicle), np.asarray(vehicle.links.home)[0], 12.0)
    worlds, state = replace(worlds, path=plan), None
    state = simulator.reset(worlds)
    p, q = [], []
    for _ in range(simulator.segments):
        state, sample, _ = simulator.advance(worlds, state)
        p.append(np.asarray(sample.p)[0, :, 0])
        q.append(np.asarray(sample.q)[0, :, 0])
    p, q = np.concatenate(p), np.concatenate(q)
    away = np.linalg.norm(p - np.asarray(worlds.environment.start_m)[0, 0], axis=-1)
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0)))
    joints = np.asarray(state.vehicles.joints.position)[0, 0]
    np.testing.assert_allclose(joints, np.asarray(plan.position)[0, 0, -1, 4:], atol=0.05)
    assert int(state.carry.joints_clipped[0, 0]) == 0
    return away.max(), tilt.max()


@pytest.fixture(scope="module")
def kept():
    return {fraction: keep_station(fraction) for fraction in (0.0, 1.0)}


def test_the_base_stays_within_3_cm_and_2_degrees(kept):
    away, tilt = kept[1.0]
    assert away < 0.03
    assert tilt < 2.0


def test_feed_forward_is_what_keeps_it_there(kept):
    assert kept[0.0][0] > 3.0 * kept[1.0][0]
    assert kept[0.0][1] > 2.0 * kept[1.0][1]
