"""All judged runs as one batch of arrays, and their simulation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from angler_experiments.validate_hinsdale.motion import ArmMotion, BodyState, simulate
from angler_experiments.validate_hinsdale.tracks import STEP_S, Track
from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle
from angler_kernels import quaternion

type Array = np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RunBatch:
    """Runs padded to a common length: joints hold still behind the end, records are masked."""

    begin: BodyState
    """[run, ...] of the marker body at the first time, from the first second."""
    joints: ArmMotion
    """[run, 2 n - 1, 5]."""
    flow_mps: jax.Array
    """[run, 3] velocity of the water: the vehicle's horizontal velocity in the first second.
    Without thrust it drifts with the water; recorded drifts keep their velocity over runs."""
    angles_rad: jax.Array
    """[run, n, 3] recorded roll, pitch, yaw; 0 where masked."""
    p_m: jax.Array
    """[run, n, 3] recorded position."""
    is_recorded: jax.Array
    """bool [run, n]."""


class Motion(NamedTuple):
    """Simulated or recorded motion of the marker body."""

    angles_rad: jax.Array
    """[..., 3] roll, pitch, yaw."""
    p_m: jax.Array
    """[..., 3]."""


def build_batch(tracks: Sequence[Track]) -> RunBatch:
    """Return runs as a batch in JAX's default float type."""
    n = max(len(track.t_s) for track in tracks)
    return RunBatch(
        begin=BodyState(
            jnp.array([track.initial_p_m for track in tracks]),
            jnp.array([_attitude(track.initial_angles_rad) for track in tracks]),
            jnp.array([_initial_velocity(track) for track in tracks]),
        ),
        joints=ArmMotion(
            jnp.array([_hold(_add_gripper(track.joint_rad), 2 * n - 1, 1.0) for track in tracks]),
            jnp.array([_hold(_add_gripper(track.joint_radps), 2 * n - 1, 0.0) for track in tracks]),
            jnp.array(
                [_hold(_add_gripper(track.joint_radps2), 2 * n - 1, 0.0) for track in tracks]
            ),
        ),
        flow_mps=jnp.array([track.initial_v_mps * [1.0, 1.0, 0.0] for track in tracks]),
        angles_rad=jnp.array([_hold(np.nan_to_num(x.angles_rad), n, 0.0) for x in tracks]),
        p_m=jnp.array([_hold(np.nan_to_num(x.p_m), n, 0.0) for x in tracks]),
        is_recorded=jnp.array(
            [_hold(np.isfinite(x.p_m[:, 0]).astype(float), n, 0.0) > 0.0 for x in tracks]
        ),
    )


def simulate_run(vehicle: CampaignVehicle, run: RunBatch) -> Motion:
    """Return the motion [n] of the marker body in one run, of a batch without its run axis."""
    states = simulate_marker_body(vehicle, run.begin, run.joints, run.flow_mps, STEP_S)
    return Motion(jax.vmap(euler_angles)(states.q), states.p)


def simulate_marker_body(
    vehicle: CampaignVehicle, begin: BodyState, joints: ArmMotion, flow: jax.Array, dt: float
) -> BodyState:
    """Return states [n] of the marker body; see `motion.simulate`.

    The marker body is yawed in the vehicle; attitude and velocity are turned there and back.
    """
    yaw = quaternion.from_yaw(vehicle.marker_yaw_rad)
    back = quaternion.conjugate(yaw)
    vehicle_begin = BodyState(
        begin.p,
        quaternion.multiply(begin.q, back),
        jnp.concatenate(
            [quaternion.rotate(yaw, begin.nu[:3]), quaternion.rotate(yaw, begin.nu[3:])]
        ),
    )
    states = simulate(vehicle, vehicle_begin, joints, flow, dt)
    turn = jax.vmap(quaternion.rotate, (None, 0))
    nu = jnp.concatenate([turn(back, states.nu[:, :3]), turn(back, states.nu[:, 3:])], axis=1)
    return BodyState(states.p, jax.vmap(quaternion.multiply, (0, None))(states.q, yaw), nu)


@jax.jit
def simulate_batch(vehicle: CampaignVehicle, batch: RunBatch) -> Motion:
    """Return the motion [run, n] of all runs with one vehicle."""
    return jax.vmap(simulate_run, (None, 0))(vehicle, batch)


def euler_angles(q: jax.Array) -> jax.Array:
    """Return roll, pitch, yaw [3] rad (ZYX) of an attitude [4]."""
    w, x, y, z = q
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1.0, 1.0))
    return jnp.stack([roll, pitch, quaternion.yaw(q)])


def _attitude(angles: Array) -> Array:
    rotation: Array = Rotation.from_euler("ZYX", angles[::-1]).as_quat(scalar_first=True)
    return rotation


def _initial_velocity(track: Track) -> Array:
    """Return velocity [6] in the frame of the marker body, from rates of angles and position."""
    roll, pitch, yaw = track.initial_angles_rad
    roll_rate, pitch_rate, yaw_rate = track.initial_rates_radps
    omega = [
        roll_rate - np.sin(pitch) * yaw_rate,
        np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
        -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
    ]
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    return np.concatenate([rotation.inv().apply(track.initial_v_mps), omega])


def _hold(values: Array, n: int, factor: float) -> Array:
    """Return values [m, ...] extended to length n by the last one times a factor."""
    tail = np.repeat(factor * values[-1:], n - len(values), axis=0)
    return np.concatenate([values, tail])


def _add_gripper(values: Array) -> Array:
    """Return joint values [m, 5] with the gripper, which stays closed, behind those of the arm."""
    return np.concatenate([values, np.zeros((len(values), 1))], axis=1)
