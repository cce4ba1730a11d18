"""Poses of a recorded world at the times of the frames of a picture or video."""

from dataclasses import dataclass, fields
from pathlib import Path

import mujoco
import numpy as np

from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.video.grip_marks import locate_grips
from angler_mjx.report.video.scene_model import list_obstacles
from angler_mjx.report.video.task_marks import Marks, build_marks
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_params import build_links

ARROW_S = 4.0
"""Time scale of the arrows of currents: 0.25 m/s shows as 1 m."""

TRAIL_TOLERANCE_M = 0.01
"""Max distance of recorded positions from a robot's trail, unless it needs too many points."""

MAX_TRAIL_POINTS = 240
"""Max number of points of a robot's trail."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """What changes from frame to frame, of N frames, R robots and M obstacles."""

    qpos: np.ndarray
    """[N, nq] positions of the model's joints; wxyz."""
    mocap_pos: np.ndarray
    """[N, M, 3] m in W."""
    mocap_quat: np.ndarray
    """[N, M, 4] wxyz."""
    robot_m: np.ndarray
    """[N, R, 3] m in W."""
    arrow_m: np.ndarray
    """[N, R, 3] velocity of the water at the robots, times `ARROW_S`."""
    grip_m: np.ndarray
    """[N, R, 3] point of a carried body that each robot holds; NaN where it holds none."""
    trail_m: np.ndarray
    """[R, K, 3] path of each robot, with few points where it is straight; NaN behind its end."""
    trail_count: np.ndarray
    """int [N, R] number of points of the trails that lie before a frame."""
    rgba: np.ndarray
    """[R, 4] colour of each robot's trail and arrow."""
    lookat_m: np.ndarray
    """[N, 3] point that the camera looks at."""
    distance_m: np.ndarray
    """[N] distance of the camera."""
    azimuth_deg: np.ndarray
    """[N] MuJoCo's azimuth of the camera: direction of view about z, 0 = east."""
    elevation_deg: np.ndarray
    """[N] elevation of the direction of view; -90 = down."""

    marks: Marks

    def save(self, path: Path) -> None:
        """Write all arrays to an ``.npz`` file, those of the marks as ``mark_...``."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        marks = arrays.pop("marks")
        arrays |= {f"mark_{field.name}": getattr(marks, field.name) for field in fields(marks)}
        np.savez(path, **arrays)


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """Camera of N frames; fields as of `Frames`."""

    lookat_m: np.ndarray
    distance_m: np.ndarray
    azimuth_deg: np.ndarray
    elevation_deg: np.ndarray


def build_frames(
    model: mujoco.MjModel,
    scene: ReplayScene,
    time_s: np.ndarray,
    camera: CameraPath,
    rgba: np.ndarray,
) -> Frames:
    """Interpolate the recorded poses.

    Args:
        model: of `scene_model.build_model`.
        scene: the world.
        time_s: [N] times of the frames.
        camera: of the same frames.
        rgba: [R, 4] colours of the robots.

    Returns:
        The frames. A robot stays where it ended, and where its record ends.
    """
    qpos = np.tile(model.qpos0, (len(time_s), 1))
    for robot in scene.robots:
        _set_robot(model, scene, robot, time_s, qpos)
    rows = list_obstacles(scene)
    trail_m, trail_count = _build_trails(scene, time_s)
    shape = (len(rows), len(time_s))
    obstacle_m, obstacle_q = np.zeros((*shape, 3)), np.zeros((*shape, 4))
    for i, row in enumerate(rows):
        obstacle_m[i] = interpolate(scene.time_s, scene.obstacle_p_m[:, row], time_s)
        obstacle_q[i] = interpolate_attitude(scene.time_s, scene.obstacle_q[:, row], time_s)
    every = (len(time_s), scene.obstacle_p_m.shape[1])
    body_m, body_q = np.zeros((*every, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (*every, 1))
    body_m[:, rows], body_q[:, rows] = obstacle_m.swapaxes(0, 1), obstacle_q.swapaxes(0, 1)
    return Frames(
        qpos=qpos,
        grip_m=locate_grips(scene, time_s, body_m, body_q),
        mocap_pos=obstacle_m.swapaxes(0, 1),
        mocap_quat=obstacle_q.swapaxes(0, 1),
        robot_m=_stack(scene, "p_m", time_s).swapaxes(0, 1),
        arrow_m=ARROW_S * np.nan_to_num(_stack(scene, "current_mps", time_s)).swapaxes(0, 1),
        trail_m=trail_m,
        trail_count=trail_count,
        rgba=rgba,
        marks=build_marks(scene, time_s),
        **{field.name: getattr(camera, field.name) for field in fields(camera)},
    )


def empty_frames() -> Frames:
    """Return one frame of a model without joints: no robots, no obstacles, no marks."""
    zero = np.zeros((1, 0, 3))
    return Frames(
        qpos=np.zeros((1, 0)),
        mocap_pos=zero,
        mocap_quat=np.zeros((1, 0, 4)),
        robot_m=zero,
        arrow_m=zero,
        grip_m=zero,
        trail_m=np.zeros((0, 1, 3)),
        trail_count=np.zeros((1, 0), int),
        rgba=np.zeros((0, 4)),
        lookat_m=np.zeros((1, 3)),
        distance_m=np.full(1, 5.0),
        azimuth_deg=np.zeros(1),
        elevation_deg=np.zeros(1),
        marks=Marks(
            kind=np.zeros(0, int),
            size_m=np.zeros((0, 3)),
            position_m=np.zeros((1, 0, 3), np.float32),
            tint=np.zeros((1, 0), np.uint8),
            palette=np.zeros((1, 4)),
        ),
    )


def interpolate(recorded_s: np.ndarray, values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Interpolate values [T, n] linearly; rows with NaN are left out, ends are held.

    Returns:
        [N, n]; NaN if no row is finite.
    """
    finite = np.isfinite(values).all(axis=1)
    if not finite.any():
        return np.full((len(time_s), values.shape[1]), np.nan)
    times, rows = recorded_s[finite], values[finite]
    return np.stack([np.interp(time_s, times, column) for column in rows.T], axis=1)


def interpolate_attitude(recorded_s: np.ndarray, q: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Interpolate unit quaternions [T, 4] along the shorter way, normalised.

    Samples lie so close that the speed of the turn between two of them does not show.

    Returns:
        [N, 4]; upright if no row is finite.
    """
    flips = np.sum(q[1:] * q[:-1], axis=1) < 0
    signs = np.where(np.cumsum(np.r_[False, flips]) % 2, -1.0, 1.0)
    mixed = interpolate(recorded_s, signs[:, None] * q, time_s)
    mixed[~np.isfinite(mixed).all(axis=1)] = [1.0, 0.0, 0.0, 0.0]
    unit: np.ndarray = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-9)
    return unit


def _stack(scene: ReplayScene, name: str, time_s: np.ndarray) -> np.ndarray:
    """Return a recorded field of all robots [R, N, n] until their ends."""
    return np.stack(
        [
            interpolate(scene.time_s, getattr(robot, name), np.minimum(time_s, robot.end_time_s))
            for robot in scene.robots
        ]
    )


def _build_trails(scene: ReplayScene, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the trails [R, K, 3] and their numbers of points [N, R] before times [N]."""
    trails, counts = [], []
    for robot in scene.robots:
        is_flown = (scene.time_s <= robot.end_time_s + 1e-6) & np.isfinite(robot.p_m).all(axis=1)
        rows = np.flatnonzero(is_flown)
        rows = rows[_thin_out(robot.p_m[rows])]
        trails.append(robot.p_m[rows])
        counts.append(np.searchsorted(scene.time_s[rows], time_s, side="right"))
    filled = np.full((len(trails), max(map(len, trails), default=0), 3), np.nan)
    for robot_index, trail in enumerate(trails):
        filled[robot_index, : len(trail)] = trail
    return filled, np.stack(counts, axis=1)


def _thin_out(points_m: np.ndarray) -> np.ndarray:
    """Return the rows of points [T, 3] that a polyline keeps, at most `MAX_TRAIL_POINTS`."""
    tolerance_m = TRAIL_TOLERANCE_M
    while len(rows := _simplify(points_m, tolerance_m)) > MAX_TRAIL_POINTS:
        tolerance_m *= 2.0
    return rows


def _simplify(points_m: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Return the rows of points [T, 3] that the algorithm of Douglas and Peucker keeps."""
    is_kept = np.zeros(len(points_m), bool)
    is_kept[:1] = is_kept[-1:] = True
    parts = [(0, len(points_m) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        chord, offset = (
            points_m[last] - points_m[first],
            points_m[first + 1 : last] - points_m[first],
        )
        along = offset @ chord / max(float(chord @ chord), 1e-12)
        nearest = np.clip(along, 0.0, 1.0)[:, None] * chord
        distance = np.linalg.norm(offset - nearest, axis=1)
        if distance.max() > tolerance_m:
            middle = first + 1 + int(distance.argmax())
            is_kept[middle] = True
            parts += [(first, middle), (middle, last)]
    return np.flatnonzero(is_kept)


def _set_robot(
    model: mujoco.MjModel,
    scene: ReplayScene,
    robot: RobotTrack,
    time_s: np.ndarray,
    qpos: np.ndarray,
) -> None:
    """Set the columns of a robot's free joint, and those of its arm."""
    until_end = np.minimum(time_s, robot.end_time_s)
    config, prefix = library.load_vehicle(robot.vehicle_file), f"robot_{robot.index}/"
    first = model.joint(f"{prefix}{config.name}").qposadr[0]
    position = interpolate(scene.time_s, robot.p_m, until_end)
    qpos[:, first : first + 3] = np.where(np.isfinite(position), position, robot.start_m)
    qpos[:, first + 3 : first + 7] = interpolate_attitude(scene.time_s, robot.q, until_end)
    links = build_links(config, None)
    if links is None:
        return
    home = np.asarray(links.home)
    angles = np.tile(home, (len(time_s), 1))
    if robot.joint_position is not None:
        recorded = interpolate(scene.time_s, robot.joint_position, until_end)
        angles = np.where(np.isfinite(recorded), recorded, home)
    for column, joint in enumerate(config.find_joints()):
        qpos[:, model.joint(f"{prefix}joint/{joint.name}").qposadr[0]] = angles[:, column]
