"""Where robots hold the body that they carry together."""

import numpy as np
from scipy.spatial.transform import Rotation

from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.world.obstacles import BOX, CAPSULE


def locate_grips(
    scene: ReplayScene, time_s: np.ndarray, body_m: np.ndarray, body_q: np.ndarray
) -> np.ndarray:
    """Return the points [N, R, 3] of the body, m in W, that robots hold; NaN where they do not.

    A robot holds the point of the body's axis that was nearest to it at the start, until its
    episode ends other than by arriving.

    Args:
        scene: the world.
        time_s: [N] times of the frames.
        body_m: [N, M, 3] positions of all obstacles in the frames, m, in W.
        body_q: [N, M, 4] their attitudes.
    """
    points = np.full((len(time_s), len(scene.robots), 3), np.nan)
    if scene.cargo is None:
        return points
    half_m = _half_axis(scene, scene.cargo)
    first = Rotation.from_quat(scene.obstacle_q[0, scene.cargo], scalar_first=True)
    turn = Rotation.from_quat(body_q[:, scene.cargo], scalar_first=True)
    for i, robot in enumerate(scene.robots):
        at = first.inv().apply(robot.p_m[0] - scene.obstacle_p_m[0, scene.cargo])
        grip = np.clip(at, -half_m, half_m)
        holds = robot.arrived | (time_s < robot.end_time_s)
        held = body_m[:, scene.cargo] + turn.apply(grip)
        points[holds, i] = held[holds]
    return points


def _half_axis(scene: ReplayScene, row: int) -> np.ndarray:
    """Return how far [3] the axis of an obstacle reaches along its own axes, m; boxes as wide."""
    obstacles = scene.environment.obstacles
    kind, size_m = int(obstacles.kind[row]), np.asarray(obstacles.size_m[row], float)
    if kind == BOX:
        return size_m
    return np.array([0.0, 0.0, size_m[1] if kind == CAPSULE else 0.0])
