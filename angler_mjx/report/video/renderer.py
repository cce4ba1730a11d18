"""Program that renders frames of a MuJoCo model: ``python -m angler_mjx.report.video.renderer``.

It runs in a process of its own, because a broken OpenGL ends the process that uses it. Frames go to
standard output as raw bytes, height x width x RGB.
"""

import sys
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

_ARROW_RADIUS_M, _ARROW_ABOVE_M, _ARROW_RGBA = 0.04, 0.3, (0.75, 0.92, 1.0, 1.0)
_MUJOCO_ARROW_LENGTH = 2.0
"""MuJoCo draws an arrow between two points half as long as their distance."""
_MARKER_FRACTION, _MIN_MARKER_M, _MARKER_ALPHA = 0.009, 0.25, 0.4
"""Radius of the ball about a robot, of the camera's distance, and the smallest that is added.

So robots of half a metre are seen from afar, and bare from nearby."""
_GRIP_RADIUS_M = 0.015
_MAX_SCENE_GEOMS = 60_000
_SHOWN_GROUPS = (0, 1, 2)
_UPRIGHT = np.eye(3).reshape(-1)


def main(arguments: list[str]) -> int:
    """Render frames of a folder with a model and arrays of poses.

    Args:
        arguments: folder, width, height, width of lines, first frame, and from frame to frame;
            widths and height in pixels.
    """
    folder = Path(arguments[0])
    width, height, line_px, first, step = map(int, arguments[1:6])
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    with np.load(folder / "frames.npz") as stored:
        frames = {name: stored[name] for name in stored.files}
    data = mujoco.MjData(model)
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group in _SHOWN_GROUPS for group in range(len(option.geomgroup))]
    option.sitegroup[:] = 0
    with mujoco.Renderer(model, height, width, max_geom=_MAX_SCENE_GEOMS) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = False
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        for i in range(first, len(frames["qpos"]), step):
            data.qpos[:] = frames["qpos"][i]
            data.mocap_pos[:], data.mocap_quat[:] = frames["mocap_pos"][i], frames["mocap_quat"][i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, _build_camera(frames, i), option)
            _add_trails(renderer.scene, frames, i, line_px)
            _add_arrows(renderer.scene, frames, i)
            _add_grips(renderer.scene, frames, i)
            _add_markers(renderer.scene, frames, i)
            _add_marks(renderer.scene, frames, i)
            sys.stdout.buffer.write(renderer.render().tobytes())
        sys.stdout.buffer.flush()
    return 0


def _build_camera(frames: dict[str, np.ndarray], i: int) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = frames["lookat_m"][i]
    camera.distance = frames["distance_m"][i]
    camera.azimuth, camera.elevation = frames["azimuth_deg"][i], frames["elevation_deg"][i]
    return camera


def _add_trails(
    scene: mujoco.MjvScene, frames: dict[str, np.ndarray], i: int, width_px: int
) -> None:
    """Add the robots' paths until now, as lines."""
    for robot, points in enumerate(frames["trail_m"]):
        ends = [*points[: frames["trail_count"][i, robot]], frames["robot_m"][i, robot]]
        for a, b in pairwise(ends):
            _connect(scene, mujoco.mjtGeom.mjGEOM_LINE, width_px, a, b, frames["rgba"][robot])


def _add_arrows(scene: mujoco.MjvScene, frames: dict[str, np.ndarray], i: int) -> None:
    """Add the velocity of the water at each robot, above it."""
    for robot_m, arrow in zip(frames["robot_m"][i], frames["arrow_m"][i], strict=True):
        start = robot_m + np.array([0.0, 0.0, _ARROW_ABOVE_M])
        end = start + _MUJOCO_ARROW_LENGTH * arrow
        if np.linalg.norm(arrow) > 1e-3:
            kind, rgba = mujoco.mjtGeom.mjGEOM_ARROW, np.array(_ARROW_RGBA)
            _connect(scene, kind, _ARROW_RADIUS_M, start, end, rgba)


def _add_grips(scene: mujoco.MjvScene, frames: dict[str, np.ndarray], i: int) -> None:
    """Add a rod from each robot to the body that it holds."""
    rows = zip(frames["robot_m"][i], frames["grip_m"][i], frames["rgba"], strict=True)
    for robot_m, grip_m, rgba in rows:
        _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, _GRIP_RADIUS_M, robot_m, grip_m, rgba)


def _add_markers(scene: mujoco.MjvScene, frames: dict[str, np.ndarray], i: int) -> None:
    """Add a ball about each robot where the camera is far away."""
    radius_m = _MARKER_FRACTION * frames["distance_m"][i]
    if radius_m < _MIN_MARKER_M:
        return
    size = np.full(3, radius_m)
    for robot_m, rgba in zip(frames["robot_m"][i], frames["rgba"], strict=True):
        look = np.array([*rgba[:3], _MARKER_ALPHA])
        _add_shape(scene, mujoco.mjtGeom.mjGEOM_SPHERE, size, robot_m, look)


def _add_marks(scene: mujoco.MjvScene, frames: dict[str, np.ndarray], i: int) -> None:
    """Add the shapes of the task."""
    rgba = frames["mark_palette"][frames["mark_tint"][i]]
    position_m = frames["mark_position_m"][i].astype(float)
    for k, kind in enumerate(frames["mark_kind"].tolist()):
        _add_shape(scene, kind, frames["mark_size_m"][k], position_m[k], rgba[k])


def _add_shape(
    scene: mujoco.MjvScene, kind: int, size: np.ndarray, position_m: np.ndarray, rgba: np.ndarray
) -> None:
    """Add an upright shape to a scene, if there is room and its position is known."""
    if scene.ngeom >= scene.maxgeom or not np.isfinite(position_m).all():
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, position_m, _UPRIGHT, rgba.astype(np.float32))
    scene.ngeom += 1


def _connect(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    width: float,
    start: np.ndarray,
    end: np.ndarray,
    rgba: np.ndarray,
) -> None:
    """Add a line or an arrow to a scene, if there is room and its ends are known."""
    if scene.ngeom >= scene.maxgeom or not np.isfinite([start, end]).all():
        return
    geom = scene.geoms[scene.ngeom]
    zero = np.zeros(3)
    mujoco.mjv_initGeom(geom, kind, zero, zero, _UPRIGHT, rgba.astype(np.float32))
    mujoco.mjv_connector(geom, kind, width, start, end)
    scene.ngeom += 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
