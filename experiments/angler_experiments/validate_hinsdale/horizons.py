"""Errors after one, ten and a hundred steps of 50 Hz, as published of a vehicle in a tank.

Windows begin every `STRIDE_S` in a run, at the state of a smoothing spline through its motion
capture, and are predicted for two seconds. The spline also gives the recorded state at the end. A
window in which markers change is left out: its step is no motion of the body.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from angler_experiments.validate_hinsdale.batch import euler_angles, simulate_marker_body
from angler_experiments.validate_hinsdale.campaign import Run
from angler_experiments.validate_hinsdale.motion import ArmMotion, BodyState
from angler_experiments.validate_hinsdale.tracks import (
    MAX_TURN_RADPS,
    SMALL_STEP_RAD,
    Track,
    euler_zyx,
    mask_swaps,
    smooth,
    smooth_joints,
)
from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle
from angler_kernels import quaternion

type Array = np.ndarray

RATE_HZ = 50.0
STEPS = (1, 10, 100)
STRIDE_S = 0.5
GUARD_S = 0.25
"""Time around a window that must be free of changed markers: the spline's reach."""
PUBLISHED = {
    "fossen_thrusters": (0.0760, 0.2007, 0.5406),
    "double_integrator": (0.0785, 0.1115, 0.4174),
}
"""Endpoint errors of 12 states after `STEPS` of two models of a BlueROV2 in the KTH tank
(ViktorNfa/bluerov2_dynamics, arXiv 2602.23053)."""
GROUPS = {
    "position_m": (0, 3),
    "attitude_rad": (3, 6),
    "velocity_mps": (6, 9),
    "rate_radps": (9, 12),
}
"""Components of a state of 12 numbers."""


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Windows [w] of all judged runs."""

    begin: BodyState
    """[w, ...] of the marker body."""
    joints: ArmMotion
    """[w, 2 n - 1, 5] with n = 101 times."""
    flow_mps: jax.Array
    """[w, 3]."""
    recorded: Array
    """[w, 4, 12] states at the begin and after `STEPS`."""


class _Spline(NamedTuple):
    """Smooth motion of the marker body."""

    p_m: Array
    angles_rad: Array
    v_mps: Array
    rates_radps: Array
    """[n, 3] of the angles."""


def cut_windows(runs: Sequence[Run], tracks: Sequence[Track]) -> Windows:
    """Return the windows of runs, whose judged parts are given in the same order."""
    pieces = [_cut_run(run, track) for run, track in zip(runs, tracks, strict=True)]
    begin, joints, flow, recorded = (
        [np.concatenate(column) for column in zip(*parts, strict=True)]
        for parts in zip(*(piece for piece in pieces if piece is not None), strict=True)
    )
    return Windows(
        begin=BodyState(*map(jnp.asarray, begin)),
        joints=ArmMotion(*map(jnp.asarray, joints)),
        flow_mps=jnp.asarray(flow[0]),
        recorded=recorded[0],
    )


def _cut_run(run: Run, track: Track) -> tuple[list[Array], ...] | None:
    """Return begin, joints, flow and recorded states of a run's windows; None if it has none."""
    keep = mask_swaps(run.mocap)
    t = run.mocap.t_s[keep]
    euler = euler_zyx(run.mocap.q[keep])
    last = STEPS[-1] / RATE_HZ
    starts = np.arange(track.t_s[0], track.t_s[-1] - last, STRIDE_S)
    starts = np.array([s for s in starts if _is_smooth(t, euler, s - GUARD_S, s + last + GUARD_S)])
    if not len(starts):
        return None
    ends = starts[:, None] + np.array([0, *STEPS]) / RATE_HZ
    poses = np.hstack([run.mocap.p_m[keep], euler])
    pose, rate = (x.reshape(*ends.shape, 6) for x in smooth(t, poses, ends.ravel(), 0, 1))
    spline = _Spline(pose[..., :3], pose[..., 3:], rate[..., :3], rate[..., 3:])
    states = _states(spline)
    q = Rotation.from_euler("ZYX", spline.angles_rad[:, 0, ::-1]).as_quat(scalar_first=True)
    to_body = Rotation.from_quat(q, scalar_first=True).inv()
    nu = np.concatenate([to_body.apply(states[:, 0, 6:9]), states[:, 0, 9:]], axis=1)
    half = starts[:, None] + 0.5 / RATE_HZ * np.arange(2 * STEPS[-1] + 1)
    joints = [
        np.pad(values.reshape(*half.shape, 4), ((0, 0), (0, 0), (0, 1)))
        for values in smooth_joints(run.joints, half.ravel())
    ]
    flow = np.tile(track.initial_v_mps * [1.0, 1.0, 0.0], (len(starts), 1))
    return [states[:, 0, :3], q, nu], joints, [flow], [states]


def _is_smooth(t: Array, euler: Array, first: float, last: float) -> bool:
    """Return whether no markers change between two times, and no frames are missing for long."""
    inside = (t >= first) & (t <= last)
    gap = np.diff(t[inside])
    turn = np.abs(np.diff(euler[inside], axis=0)).max(axis=1, initial=0.0)
    is_whole = t[0] <= first and t[-1] >= last and gap.max(initial=0.0) < GUARD_S
    return bool(is_whole and np.all(turn < SMALL_STEP_RAD + MAX_TURN_RADPS * gap))


def _states(spline: _Spline) -> Array:
    """Return states [..., 12]: position, roll, pitch and yaw, velocity in the world, body rates."""
    roll, pitch = spline.angles_rad[..., 0], spline.angles_rad[..., 1]
    dr, dp, dy = np.moveaxis(spline.rates_radps, -1, 0)
    omega = np.stack(
        [
            dr - np.sin(pitch) * dy,
            np.cos(roll) * dp + np.sin(roll) * np.cos(pitch) * dy,
            -np.sin(roll) * dp + np.cos(roll) * np.cos(pitch) * dy,
        ],
        axis=-1,
    )
    states: Array = np.concatenate([spline.p_m, spline.angles_rad, spline.v_mps, omega], axis=-1)
    return states


def predict_windows(vehicle: CampaignVehicle, windows: Windows) -> Array:
    """Return simulated states [w, 3, 12] after `STEPS`."""

    def one_window(begin: BodyState, joints: ArmMotion, flow: jax.Array) -> jax.Array:
        states = simulate_marker_body(vehicle, begin, joints, flow, 1.0 / RATE_HZ)
        chosen: BodyState = jax.tree.map(lambda x: x[jnp.array(STEPS)], states)
        v = jax.vmap(quaternion.rotate)(chosen.q, chosen.nu[:, :3])
        angles = jax.vmap(euler_angles)(chosen.q)
        return jnp.concatenate([chosen.p, angles, v, chosen.nu[:, 3:]], axis=1)

    batched = jax.jit(jax.vmap(one_window))
    return np.asarray(batched(windows.begin, windows.joints, windows.flow_mps), float)


def predict_drift(windows: Windows) -> Array:
    """Return states [w, 3, 12] after `STEPS` with the velocity and rates of the begin."""
    begin = windows.recorded[:, :1]
    roll, pitch = begin[..., 3], begin[..., 4]
    p, q, r = np.moveaxis(begin[..., 9:], -1, 0)
    turn = np.sin(roll) * q + np.cos(roll) * r
    rates = np.stack(
        [
            p + np.tan(pitch) * turn,
            np.cos(roll) * q - np.sin(roll) * r,
            turn / np.cos(pitch),
        ],
        axis=-1,
    )
    t = np.array(STEPS)[:, None] / RATE_HZ
    states: Array = begin + np.concatenate(
        [t * begin[..., 6:9], t * rates, np.zeros((len(begin), len(STEPS), 6))], axis=-1
    )
    return states


def score_windows(windows: Windows, predicted: Array) -> dict[str, list[float]]:
    """Return root mean square errors after `STEPS`: of all 12 numbers, and of each group.

    ``states`` mixes units, as the published number does: the mean is over windows and components.
    """
    error = predicted - windows.recorded[:, 1:]
    error[..., 3:6] = (error[..., 3:6] + np.pi) % (2.0 * np.pi) - np.pi
    groups = {"states": (0, 12), **GROUPS}
    return {
        name: np.sqrt(np.mean(error[..., first:after] ** 2, axis=(0, 2))).tolist()
        for name, (first, after) in groups.items()
    }


def describe_horizons(
    windows: Windows, vehicles: Mapping[str, CampaignVehicle]
) -> dict[str, object]:
    """Return the errors of constant velocity and of vehicles, with the published ones."""
    made = {name: predict_windows(vehicle, windows) for name, vehicle in vehicles.items()}
    predicted = {"constant_velocity": predict_drift(windows), **made}
    return {
        "steps": list(STEPS),
        "rate_hz": RATE_HZ,
        "windows": len(windows.recorded),
        "errors": {name: score_windows(windows, states) for name, states in predicted.items()},
        "published": {name: list(errors) for name, errors in PUBLISHED.items()},
    }
