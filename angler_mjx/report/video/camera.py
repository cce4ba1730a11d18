"""Cameras of pictures and videos: fixed, from above, and near one robot."""

from typing import Literal

import jax
import numpy as np

from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.video.frames import CameraPath, interpolate
from angler_mjx.report.video.scene_model import list_obstacles
from angler_mjx.robot.vehicles import library
from angler_mjx.world.obstacles import bounding_radius

type CameraKind = Literal["fixed", "above", "follow"]

VIEW_DEG = 45.0
"""Vertical angle of view, MuJoCo's default of free cameras."""

_FIXED_AZIMUTH_DEG, _FIXED_ELEVATION_DEG = 60.0, -28.0
_FOLLOW_ELEVATION_DEG = -22.0
_BEHIND_M, _BEHIND_DEG = 4.0, 25.0
_BEFORE_M, _BEFORE_DEG = 2.2, 145.0
"""Distance of the camera that follows, and its turn from the robot's heading.

It is behind a robot without arm, and before one with an arm, which is at the front."""
_NEAREST_M, _ROCK_MARGIN_M, _ROCK_STEP_M = 1.2, 0.25, 0.05
"""Least distance of the camera that follows, its distance from rock, and the step of the search.

It comes nearer where rock would hide the robot."""
_APPROACH_FRAMES = 12
"""Number of frames before and after rock in which the camera comes nearer, and goes back."""
_ROBOT_MARGIN_M = 0.5
"""Distance from robots' centres to the edge of what fixed cameras show: a vehicle's length."""
_FILLED, _FIT_ITERATIONS = 0.97, 20
"""Fraction of the picture that the fixed camera fills, and steps of the search for its place."""
_SMOOTHING_S = 2.0
"""Time constant of the camera that follows: it does not turn with every turn of the robot."""


def build_camera_path(
    kind: CameraKind,
    scene: ReplayScene,
    robot: RobotTrack,
    time_s: np.ndarray,
    aspect: float,
) -> CameraPath:
    """Return the camera at the times of the frames.

    Args:
        kind: which camera.
        scene: the world.
        robot: the robot that "follow" follows.
        time_s: [N] times of the frames.
        aspect: width of the picture by its height.
    """
    if kind == "follow":
        return _follow(scene, robot, time_s)
    points, count = find_shown_points(scene), len(time_s)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = 0.5 * (low + high), high - low
    half_view = np.tan(np.radians(VIEW_DEG) / 2)
    if kind == "above":
        # North is up: the camera looks down with its top towards +y.
        reach = 0.5 * max(size[1], size[0] / aspect) / half_view
        distance, azimuth, elevation = 1.05 * reach + 0.5 * size[2], 90.0, -90.0
    else:
        azimuth, elevation = _FIXED_AZIMUTH_DEG, _FIXED_ELEVATION_DEG
        middle, distance = _fit(points, azimuth, elevation, aspect)
    return CameraPath(
        lookat_m=np.tile(middle, (count, 1)),
        distance_m=np.full(count, distance),
        azimuth_deg=np.full(count, azimuth),
        elevation_deg=np.full(count, elevation),
    )


def find_shown_points(scene: ReplayScene) -> np.ndarray:
    """Return points [n, 3], m in W, that fixed cameras have to show.

    They surround the rock, all robots from their starts to their ends and goals, and the obstacles
    as far as they stay in the region; with a task of many places, the whole region.
    """
    region = np.stack(scene.bounds_m)
    if scene.task is not None:
        return _surround(region.mean(axis=0)[None], 0.5 * (region[1] - region[0]))
    robots = [scene.flown_path(robot) for robot in scene.robots]
    robots += [np.stack([robot.start_m, robot.goal_m]) for robot in scene.robots]
    cell_m = float(scene.environment.grid.cell_m)
    cells = np.argwhere(np.asarray(scene.environment.grid.occupied)) + 0.5
    shown = [
        _surround(np.concatenate(robots), np.full(3, _ROBOT_MARGIN_M)),
        _surround(region[0] + cell_m * cells, np.full(3, 0.5 * cell_m)),
    ]
    bodies, rows = scene.environment.obstacles, list_obstacles(scene)
    radius = np.asarray(jax.vmap(bounding_radius)(bodies.kind, bodies.size_m))[rows]
    for row, radius_m in zip(rows, radius, strict=True):
        # Corners on the sphere around it.
        around = _surround(scene.obstacle_p_m[:, row], np.full(3, radius_m / np.sqrt(3.0)))
        shown.append(np.clip(around, *region))
    points = np.concatenate(shown)
    finite: np.ndarray = points[np.isfinite(points).all(axis=1)]
    return finite


def _surround(centers: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the corners [8 n, 3] of boxes of half the edges [3] about centres [n, 3]."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    corners: np.ndarray = (centers[:, None] + half * signs).reshape(-1, 3)
    return corners


def _fit(
    points: np.ndarray, azimuth_deg: float, elevation_deg: float, aspect: float
) -> tuple[np.ndarray, float]:
    """Return the point [3] and the distance from which points [n, 3] fill the picture.

    The point is the middle of them, moved along the picture's axes until the margins of opposite
    sides are equal.

    Args:
        points: [n, 3] m in W.
        azimuth_deg: of the camera.
        elevation_deg: of the camera.
        aspect: width of the picture by its height.
    """
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    axes = np.stack([right, np.cross(right, forward)])
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.tan(np.radians(VIEW_DEG) / 2) * np.array([aspect, 1.0]) * _FILLED
    middle, distance = 0.5 * (low + high), float(np.linalg.norm(high - low))
    for _ in range(_FIT_ITERATIONS):
        away = (points - middle) @ forward
        # Distance at which each point lies on the picture's edge; each side has its farthest.
        sideways = (points - middle) @ axes.T
        upper = np.max(sideways / half - away[:, None], axis=0)
        lower = np.max(-sideways / half - away[:, None], axis=0)
        distance = float(np.max([upper, lower]))
        middle = middle + 0.5 * half * (upper - lower) @ axes
    return middle, distance


def _follow(scene: ReplayScene, robot: RobotTrack, time_s: np.ndarray) -> CameraPath:
    """Return a camera that keeps to a robot's place and its smoothed heading."""
    w, x, y, z = robot.q.T
    forward = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], axis=1)
    step_s = float(np.median(np.diff(scene.time_s))) if len(scene.time_s) > 1 else _SMOOTHING_S
    heading = _smooth(forward, step_s)
    until_end = np.minimum(time_s, robot.end_time_s)
    direction = interpolate(scene.time_s, heading, until_end)
    position = interpolate(scene.time_s, robot.p_m, until_end)
    has_arm = bool(library.load_vehicle(robot.vehicle_file).links)
    distance_m, turn_deg = (_BEFORE_M, _BEFORE_DEG) if has_arm else (_BEHIND_M, _BEHIND_DEG)
    azimuth = np.degrees(np.arctan2(direction[:, 1], direction[:, 0])) + turn_deg
    lookat_m = np.where(np.isfinite(position), position, robot.start_m)
    elevation = np.full(len(time_s), _FOLLOW_ELEVATION_DEG)
    view = _point(np.nan_to_num(azimuth), elevation)
    return CameraPath(
        lookat_m=lookat_m,
        distance_m=_approach(_find_clear_distance(scene, lookat_m, -view, distance_m)),
        azimuth_deg=np.nan_to_num(azimuth),
        elevation_deg=elevation,
    )


def _point(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    """Return directions of view [N, 3] in W."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    view: np.ndarray = np.cos(elevation)[..., None] * level + np.sin(elevation)[..., None] * up
    return view


def _find_clear_distance(
    scene: ReplayScene, from_m: np.ndarray, direction: np.ndarray, max_distance_m: float
) -> np.ndarray:
    """Return the distances [N] up to which no rock hides points [N, 3] along directions [N, 3]."""
    grid = scene.environment.grid
    along_m = np.arange(_NEAREST_M, max_distance_m + _ROCK_MARGIN_M, _ROCK_STEP_M)
    points = from_m[:, None] + along_m[:, None] * direction[:, None]
    cells = np.floor((points - np.asarray(grid.origin_m)) / float(grid.cell_m)).astype(int)
    occupied = np.asarray(grid.occupied)
    is_inside = ((cells >= 0) & (cells < occupied.shape)).all(axis=-1)
    x, y, z = np.where(is_inside[..., None], cells, 0).transpose(2, 0, 1)
    is_rock = is_inside & occupied[x, y, z]
    first_m = np.where(is_rock.any(axis=1), along_m[is_rock.argmax(axis=1)], np.inf)
    clear: np.ndarray = np.clip(first_m - _ROCK_MARGIN_M, _NEAREST_M, max_distance_m)
    return clear


def _approach(clear_m: np.ndarray) -> np.ndarray:
    """Return distances [N] that change smoothly and never exceed the clear ones [N]."""
    window = 2 * _APPROACH_FRAMES + 1
    padded = np.pad(clear_m, 2 * _APPROACH_FRAMES, mode="edge")
    lowest = np.lib.stride_tricks.sliding_window_view(padded, window).min(axis=1)
    smooth: np.ndarray = np.lib.stride_tricks.sliding_window_view(lowest, window).mean(axis=1)
    return smooth


def _smooth(values: np.ndarray, step_s: float) -> np.ndarray:
    """Return values [T, n] smoothed forwards and backwards, so that nothing lags."""
    weight = 1.0 - np.exp(-step_s / _SMOOTHING_S)
    smoothed = np.where(np.isfinite(values), values, 0.0)
    for rows in (range(1, len(values)), range(len(values) - 2, -1, -1)):
        step = rows.step
        for i in rows:
            smoothed[i] = smoothed[i - step] + weight * (smoothed[i] - smoothed[i - step])
    return smoothed
