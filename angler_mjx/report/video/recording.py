"""Pictures and videos of one world of a run."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from matplotlib import colors
from PIL import Image

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import scene as worlds
from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.report.video import render_pool, scene_model
from angler_mjx.report.video.camera import CameraKind, build_camera_path
from angler_mjx.report.video.encoder import encode_video
from angler_mjx.report.video.frames import build_frames
from angler_mjx.report.video.overlay import Overlay
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.runs.storage.folder import Run

MAX_PROCESSES = 8
"""Max number of renderers: more are slower than the encoder."""

_PICTURE_SUPERSAMPLING, _VIDEO_SUPERSAMPLING = 2, 1.5
"""Ratio of the rendered size to that of pictures, and of videos."""

_LINE_PX = 3.0
"""Width of lines."""

_HELD_S = 1.0
"""Time for which a video shows its end, s."""

MIN_SIDE_PX = 64
"""Min width and height."""

type ReportFrame = Callable[[int, int], None]
"""Receives the number of frames that are ready, and of all."""


@dataclass(frozen=True, kw_only=True)
class View:
    """How a world is looked at."""

    camera: CameraKind = "fixed"
    robot: int | None = None
    """Robot that "follow" follows; the first that did not arrive, or robot 0, if left out."""
    size_px: tuple[int, int] = (1280, 720)
    """Width and height."""
    speed: float = 4.0
    """Simulated seconds in a second of a video."""
    fps: int = 24

    def __post_init__(self) -> None:
        """Refuse values that no picture has.

        Raises:
            ConfigError: the size is odd, too small or too large, or the speed is not positive.
        """
        for side, limit in zip(self.size_px, scene_model.MAX_SIZE_PX, strict=True):
            if side % 2 or not MIN_SIDE_PX <= side <= limit:
                raise ConfigError(
                    f"--size {self.size_px[0]} {self.size_px[1]}: must be even, from {MIN_SIDE_PX} "
                    f"to {scene_model.MAX_SIZE_PX[0]} wide and {scene_model.MAX_SIZE_PX[1]} high"
                )
        if not 0 < self.speed < np.inf:
            raise ConfigError(f"--speed {self.speed:g}: must be positive")


def write_picture(
    run: Run, world: int, path: Path, *, at_s: float | None = None, view: View | None = None
) -> Path:
    """Render one moment of a world as a PNG file; an older file is replaced.

    Args:
        run: run folder.
        world: global index.
        path: file to write.
        at_s: time, s; the end of the record if left out.
        view: how the world is looked at.

    Returns:
        The file.

    Raises:
        ConfigError: the run stored no trajectories, or does not hold the world, time or robot.
        UnsupportedError: no OpenGL works here.
        RunError: the file cannot be written.
    """
    view = View() if view is None else view
    scene = worlds.read_scene(run, world)
    end_s = _find_end_s(scene)
    if at_s is not None and not 0 <= at_s <= end_s:
        raise ConfigError(f"--at {at_s:g}: world {world} was recorded from 0 to {end_s:g} s")
    time_s = np.array([end_s if at_s is None else at_s])
    pictures = _render(run, scene, time_s, view, _PICTURE_SUPERSAMPLING)
    with replace_file(path, flag="--png", force=True) as writing:
        Image.fromarray(next(pictures)).reduce(_PICTURE_SUPERSAMPLING).save(
            writing, format="png", optimize=True
        )
    return path


def write_video(
    run: Run,
    world: int,
    path: Path,
    *,
    view: View | None = None,
    report: ReportFrame | None = None,
) -> Path:
    """Render a world from beginning to end as an MP4 file; an older file is replaced.

    Args:
        run: run folder.
        world: global index.
        path: file to write.
        view: how the world is looked at.
        report: receives the progress.

    Returns:
        The file.

    Raises:
        ConfigError: the run stored no trajectories, or does not hold the world or robot.
        UnsupportedError: no OpenGL works here, or PyAV is missing.
        RunError: the file cannot be written.
    """
    view = View() if view is None else view
    scene = worlds.read_scene(run, world)
    end_s = _find_end_s(scene)
    count = ceil(end_s / view.speed * view.fps) + 1 + round(_HELD_S * view.fps)
    time_s = np.minimum(np.arange(count) * view.speed / view.fps, end_s)

    frames = _render(run, scene, time_s, view, _VIDEO_SUPERSAMPLING)

    def pictures() -> Iterator[np.ndarray]:
        for i, picture in enumerate(frames, 1):
            yield picture
            if report is not None:
                report(i, count)

    with replace_file(path, flag="--video", force=True) as writing:
        encode_video(writing, pictures(), view.size_px, view.fps)
    return path


def _find_end_s(scene: ReplayScene) -> float:
    """Return the time of the last robot's outcome, or of the last sample if that is later."""
    return max(float(scene.time_s[-1]), *(robot.end_time_s for robot in scene.robots))


def _render(
    run: Run, scene: ReplayScene, time_s: np.ndarray, view: View, supersampling: float
) -> Iterator[np.ndarray]:
    """Yield the pictures of a world at times [N], with their text, larger by a factor."""
    width, height = view.size_px
    robot = scene.robots[_choose_robot(scene, view.robot)]
    model = scene_model.build_model(scene)
    camera = build_camera_path(view.camera, scene, robot, time_s, width / height)
    rgba = np.array([colors.to_rgba(style.robot_color(robot.index)) for robot in scene.robots])
    frames = build_frames(model, scene, time_s, camera, rgba)
    rendered_px = (round(supersampling * width), round(supersampling * height))
    title = f"{run.scenario.name}, world {scene.world}, seed {run.scenario.seed}"
    overlay = Overlay(scene, title, rendered_px[1])
    processes = min(os.cpu_count() or 1, MAX_PROCESSES)
    pictures = render_pool.render(
        model, frames, rendered_px, processes=processes, line_px=round(_LINE_PX * supersampling)
    )
    for picture, at_s in zip(pictures, time_s.tolist(), strict=True):
        yield overlay.write_on(picture, at_s)


def _choose_robot(scene: ReplayScene, robot: int | None) -> int:
    """Return the robot to follow.

    Raises:
        ConfigError: there is no such robot.
    """
    if robot is None:
        return next((r.index for r in scene.robots if not r.arrived), 0)
    if not 0 <= robot < len(scene.robots):
        raise ConfigError(f"--robot {robot}: robots 0 to {len(scene.robots) - 1} are in the world")
    return robot
