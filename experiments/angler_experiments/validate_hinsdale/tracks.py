"""Judged part of a run: masked motion capture on a regular grid, and smooth motion of the arm."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.spatial.transform import Rotation

from angler_experiments.validate_hinsdale.campaign import JointTrack, PoseTrack, Run

type Array = np.ndarray

STEP_S = 0.1
"""Step of the grid on which runs are simulated and judged."""
MAX_TURN_RADPS, MAX_SPEED_MPS = 1.0, 1.0
"""Rates that the vehicle never reaches without thrusters: the fastest recorded ones are a third."""
MAX_NOISE_RAD, MAX_NOISE_M = 0.2, 0.1
"""Jump between two frames that motion capture makes without a marker swap."""
SMALL_STEP_RAD = 0.008
"""Jump between two frames above which the markers in view have changed."""
CUTOFF_HZ = 2.0
"""Frequency at which the smoothing spline of the joints halves an oscillation."""
LEAD_S = 1.0
"""Length of the part before the arm's command that belongs to the judged part."""
INITIAL_S = 1.0
"""Length of the beginning of the judged part that gives the initial state and is not judged."""
MAX_JUDGED_S = 25.0
"""Greatest length of the judged part: runs with the arm at rest last a minute."""
SURFACE_Z_M = 1.2
"""Height of the markers above which the hull may touch the surface; hulls float at 1.3 m."""


@dataclass(frozen=True, kw_only=True)
class MaskCounts:
    """Frames of motion capture in the judged part, and what was left out of them."""

    frames: int
    masked: int
    """Frames within marker swaps."""
    swaps: int
    """Contiguous groups of masked frames."""
    small_steps: int
    """Jumps above `SMALL_STEP_RAD` that stay in: the markers in view change, the body does not."""
    blank_rows: int
    surface_cut_s: float
    """Time at the end that was cut off because the hull may touch the surface."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """Judged part of a run on a grid of `STEP_S`, from the end of its first second."""

    stem: str
    t_s: Array
    """[n] time of the files."""
    angles_rad: Array
    """[n, 3] recorded roll, pitch, yaw (ZYX); NaN where masked or not recorded."""
    p_m: Array
    """[n, 3] recorded position of the marker body; NaN as the angles."""
    imu_rad: Array
    """[n, 2] roll and pitch of the inertial unit, interpolated; NaN outside its time."""
    joint_rad: Array
    """[2 n - 1, 4] smooth joint positions at half steps, as recorded (no zero offset)."""
    joint_radps: Array
    """[2 n - 1, 4]."""
    joint_radps2: Array
    """[2 n - 1, 4]."""
    initial_angles_rad: Array
    """[3] at the first time, by straight lines through the first second."""
    initial_rates_radps: Array
    """[3] rates of roll, pitch, yaw."""
    initial_p_m: Array
    """[3]."""
    initial_v_mps: Array
    """[3] in the world."""
    counts: MaskCounts


def build_track(run: Run) -> Track:
    """Return the judged part of a run.

    It begins `LEAD_S` before the arm's command, or where all three files have begun, and ends
    before the surface.
    """
    keep = mask_swaps(run.mocap)
    begin, end, surface_cut = find_limits(run, keep)
    t = begin + INITIAL_S + STEP_S * np.arange(int((end - begin - INITIAL_S) / STEP_S) + 1)
    euler = euler_zyx(run.mocap.q)
    angles = bin_median(run.mocap.t_s[keep], euler[keep], t)
    p = bin_median(run.mocap.t_s[keep], run.mocap.p_m[keep], t)
    is_first = keep & (run.mocap.t_s >= begin) & (run.mocap.t_s <= begin + INITIAL_S)
    poses = np.hstack([euler, run.mocap.p_m])[is_first]
    line = fit_line(run.mocap.t_s[is_first] - t[0], poses)
    half = t[0] + 0.5 * STEP_S * np.arange(2 * len(t) - 1)
    position, velocity, acceleration = smooth_joints(run.joints, half)
    is_judged = (run.mocap.t_s >= t[0]) & (run.mocap.t_s <= t[-1])
    return Track(
        stem=run.stem,
        t_s=t,
        angles_rad=angles,
        p_m=p,
        imu_rad=_interpolate_imu(run.imu, t),
        joint_rad=position,
        joint_radps=velocity,
        joint_radps2=acceleration,
        initial_angles_rad=line[0, :3],
        initial_rates_radps=line[1, :3],
        initial_p_m=line[0, 3:],
        initial_v_mps=line[1, 3:],
        counts=_count(run, keep, is_judged, surface_cut),
    )


def find_limits(run: Run, keep: Array) -> tuple[float, float, float]:
    """Return begin and end [s] of the judged part, and the time cut off at the surface [s]."""
    tracks = (run.mocap, run.imu, run.joints)
    begin = max(float(track.t_s[0]) for track in tracks)
    end = min(float(track.t_s[-1]) for track in tracks)
    if run.start_s is not None:
        begin = max(begin, run.start_s - LEAD_S)
    is_high = keep & (run.mocap.t_s > begin) & (run.mocap.p_m[:, 2] > SURFACE_Z_M)
    surface = float(run.mocap.t_s[is_high][0]) if is_high.any() else end
    last = min(end, surface, begin + MAX_JUDGED_S)
    return begin, last, max(0.0, end - surface)


def mask_swaps(track: PoseTrack) -> Array:
    """Return which frames [n] belong to the vehicle's track and not to a marker swap.

    The track is cut where attitude or position jump by more than a body can move between two
    frames. From the longest piece outwards, a piece belongs to the track if the body can have
    moved there since the last frame of the track.
    """
    rotation = Rotation.from_quat(track.q, scalar_first=True)
    turn = (rotation[:-1].inv() * rotation[1:]).magnitude()
    shift = np.linalg.norm(np.diff(track.p_m, axis=0), axis=1)
    gap = np.diff(track.t_s)
    is_jump = ~_can_move(turn, shift, gap)
    bounds = np.concatenate([[0], np.flatnonzero(is_jump) + 1, [len(track.t_s)]])
    pieces = list(pairwise(bounds))
    longest = int(np.argmax(np.diff(bounds)))
    keep = np.zeros(len(track.t_s), bool)
    keep[slice(*pieces[longest])] = True
    last = pieces[longest][1] - 1
    for first, after in pieces[longest + 1 :]:
        if _joins(track, rotation, last, first):
            keep[first:after], last = True, after - 1
    next_first = pieces[longest][0]
    for first, after in reversed(pieces[:longest]):
        if _joins(track, rotation, after - 1, next_first):
            keep[first:after], next_first = True, first
    return keep


def _joins(track: PoseTrack, rotation: Rotation, before: int, after: int) -> bool:
    """Return whether the body can move from one frame to a later one."""
    turn = (rotation[before].inv() * rotation[after]).magnitude()
    shift = np.linalg.norm(track.p_m[after] - track.p_m[before])
    return bool(_can_move(turn, shift, track.t_s[after] - track.t_s[before]))


def _can_move(turn: Array, shift: Array, gap: Array) -> Array:
    """Return whether a body can turn [rad] and shift [m] so far in a time [s]."""
    is_slow: Array = (turn < MAX_NOISE_RAD + MAX_TURN_RADPS * gap) & (
        shift < MAX_NOISE_M + MAX_SPEED_MPS * gap
    )
    return is_slow


def smooth_joints(joints: JointTrack, t: Array) -> tuple[Array, Array, Array]:
    """Return joint positions, velocities and accelerations [n, 4] at times t [n]; see `smooth`.

    The recorded velocities are noisy and not used.
    """
    position, velocity, acceleration = smooth(joints.t_s, joints.position_rad, t, 0, 1, 2)
    return position, velocity, acceleration


def smooth(t_s: Array, values: Array, t: Array, *orders: int) -> list[Array]:
    """Return derivatives [n, k] of smooth values [m, k] at times t [n], one array for each order.

    By a cubic smoothing spline through the values, interpolated to 50 Hz before; it halves
    oscillations of `CUTOFF_HZ`, with no delay.
    """
    h = 0.02
    grid = np.arange(t_s[0], t_s[-1], h)
    strength = 1.0 / (h * (2.0 * np.pi * CUTOFF_HZ) ** 4)
    splines = [
        make_smoothing_spline(grid, np.interp(grid, t_s, column), lam=strength)
        for column in values.T
    ]
    t = np.clip(t, grid[0], grid[-1])
    return [np.stack([spline(t, nu=order) for spline in splines], axis=1) for order in orders]


def euler_zyx(q: Array) -> Array:
    """Return roll, pitch and continuous yaw [n, 3] rad of attitudes [n, 4] wxyz."""
    yaw_pitch_roll: Array = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")
    yaw_pitch_roll[:, 0] = np.unwrap(yaw_pitch_roll[:, 0])
    return yaw_pitch_roll[:, ::-1]


def bin_median(t: Array, values: Array, grid: Array) -> Array:
    """Return the median [n, k] of the values [m, k] within half a step of each grid time [n].

    NaN where there is none.
    """
    index = np.rint((t - grid[0]) / STEP_S).astype(int)
    out = np.full((len(grid), values.shape[1]), np.nan)
    is_inside = (index >= 0) & (index < len(grid))
    for i in np.unique(index[is_inside]):
        out[i] = np.median(values[index == i], axis=0)
    return out


def fit_line(t: Array, poses: Array) -> Array:
    """Return value and slope [2, 6] at t = 0 of straight lines through poses [m, 6] at times [m].

    The slope is the median of the slopes between frames half the length apart. Steps of angles
    between frames, where other markers come into view, are replaced by the mean turn before.

    Args:
        t: increasing, s.
        poses: roll, pitch, yaw, rad, and position, m.
    """
    change, gap = np.diff(poses[:, :3], axis=0), np.diff(t)[:, None]
    is_step = np.abs(change).max(axis=1) > SMALL_STEP_RAD
    mean_rate = change[~is_step].sum(axis=0) / gap[~is_step].sum()
    change[is_step] = gap[is_step] * mean_rate
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(change, axis=0)])
    smooth = np.hstack([turned, poses[:, 3:]])
    half = len(t) // 2
    span = (t[half : 2 * half] - t[:half])[:, None]
    slope = np.median((smooth[half : 2 * half] - smooth[:half]) / span, axis=0)
    return np.stack([np.median(poses - t[:, None] * slope, axis=0), slope])


def _interpolate_imu(imu: PoseTrack, t: Array) -> Array:
    euler = euler_zyx(imu.q)
    return np.stack(
        [np.interp(t, imu.t_s, euler[:, k], left=np.nan, right=np.nan) for k in range(2)], axis=1
    )


def _count(run: Run, keep: Array, is_judged: Array, surface_cut: float) -> MaskCounts:
    judged = keep[is_judged]
    edges = np.diff(np.concatenate([[False], ~judged, [False]]).astype(int))
    rotation = Rotation.from_quat(run.mocap.q[keep & is_judged], scalar_first=True)
    turn = (rotation[:-1].inv() * rotation[1:]).magnitude()
    gap = np.diff(run.mocap.t_s[keep & is_judged])
    return MaskCounts(
        frames=len(judged),
        masked=int((~judged).sum()),
        swaps=int((edges == 1).sum()),
        small_steps=int((turn > SMALL_STEP_RAD + MAX_TURN_RADPS * gap).sum()),
        blank_rows=run.mocap.blank_rows,
        surface_cut_s=surface_cut,
    )
