"""One world of a run as entities of a Rerun recording; imported only where Rerun is installed.

What `entities` draws, with the whole run on the timeline ``time``, in seconds; beside it the
fleet's table, distances to goal, and events.
"""

import numpy as np
import rerun as rr

from angler_mjx.vehicles import library
from angler_mjx.viewing import entities, style
from angler_mjx.viewing.scene import RobotTrack, Scene

_TRAIL_POINTS = 2_000_000
"""Points in all growing trails of a world, at most: 24 MB."""


def log_world(recording: rr.RecordingStream, scene: Scene, root: str) -> None:
    """Log one world.

    Args:
        recording: where to.
        scene: the world.
        root: path of its entities.
    """
    recording.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    entities.log_surroundings(recording, scene, f"{root}/space")
    entities.log_obstacles(recording, scene, f"{root}/space/obstacles")
    times = [entities.times(scene.time_s)]
    for name, shape, fields in entities.poses(scene):
        recording.send_columns(f"{root}/space/obstacles/{name}", times, shape.columns(**fields))
    for robot in scene.robots:
        _robot(recording, scene, robot, root)
    origins = np.stack([robot.p_m for robot in scene.robots], axis=1)
    current = np.stack([robot.current_mps for robot in scene.robots], axis=1)
    recording.send_columns(
        f"{root}/space/current",
        times,
        rr.Arrows3D.columns(origins=origins, vectors=entities.arrows(current)),
    )
    recording.log(f"{root}/fleet", _fleet_table(scene), static=True)
    _events(recording, scene, f"{root}/events")


def _robot(recording: rr.RecordingStream, scene: Scene, robot: RobotTrack, root: str) -> None:
    name = f"robot_{robot.index}"
    space, times = f"{root}/space/{name}", [entities.times(scene.time_s)]
    entities.log_still(
        recording,
        library.load(robot.vehicle_file),
        robot.index,
        space,
        goal_m=robot.goal_m,
        plan_m=robot.plan_m,
        named=len(scene.robots) <= entities.MOST_NAMED,
    )
    recording.send_columns(
        f"{space}/vehicle",
        times,
        rr.Transform3D.columns(translation=robot.p_m, quaternion=entities.xyzw(robot.q)),
    )
    _trail(recording, scene, robot, f"{space}/trail")
    _label(recording, scene, robot, f"{space}/vehicle/label")
    if not np.isfinite(robot.goal_m).all():
        return
    away = np.linalg.norm(robot.p_m - robot.goal_m, axis=1)
    series = f"{root}/distance_to_goal_m/{name}"
    color = entities.color_of(robot.index)
    recording.log(
        series, rr.SeriesLines(colors=[color], names=[str(robot.index)], widths=[2]), static=True
    )
    recording.send_columns(series, times, rr.Scalars.columns(scalars=away))


def _trail(recording: rr.RecordingStream, scene: Scene, robot: RobotTrack, path: str) -> None:
    """The way taken so far: a line that grows about once a second."""
    flown = scene.way_taken(robot)
    count = len(flown)
    step = max(1, round(1.0 / max(float(scene.time_s[1]), 1e-3))) if len(scene.time_s) > 1 else 1
    # n updates of a line of T points hold n T / 2 points; a large fleet gets fewer updates.
    most = max(2 * _TRAIL_POINTS // (len(scene.robots) * max(count, 1)), 1)
    step = max(step, -(-count // most))
    ends = np.unique(np.r_[np.arange(2, count, step), count])
    recording.send_columns(
        path,
        [entities.times(scene.time_s[ends - 1])],
        rr.LineStrips3D.columns(strips=[flown[:end] for end in ends]),
    )


def _label(recording: rr.RecordingStream, scene: Scene, robot: RobotTrack, path: str) -> None:
    """The robot's number above it, with the outcome once it is known; a crowd's failures alone."""
    few = len(scene.robots) <= entities.MOST_NAMED
    ended = f"{robot.index}: {style.OUTCOME_TEXT[robot.outcome]}"
    colors = [entities.color_of(robot.index), entities.ending(arrived=robot.arrived)]
    recording.send_columns(
        path,
        [entities.times(np.array([0.0, robot.end_time_s]))],
        rr.Points3D.columns(
            labels=[str(robot.index), ended],
            colors=colors,
            radii=[entities.DOT, entities.LARGE_DOT],
            show_labels=[few, few or not robot.arrived],
        ),
    )


def _events(recording: rr.RecordingStream, scene: Scene, path: str) -> None:
    for robot in sorted(scene.robots, key=lambda robot: robot.end_time_s):
        recording.set_time("time", duration=robot.end_time_s)
        text = f"{robot.end_time_s:.1f} s: robot {robot.index} {style.OUTCOME_TEXT[robot.outcome]}"
        if robot.failure_pair != "none":
            text += f" ({robot.failure_pair})"
        level = "INFO" if robot.arrived else "ERROR"
        recording.log(path, rr.TextLog(text, level=level))
    recording.reset_time()


def _fleet_table(scene: Scene) -> rr.TextDocument:
    lines = ["| | vehicle | set | end | after |", "|---|---|---|---|---|"]
    lines += [
        f"| **{robot.index}** | {robot.vehicle} | {robot.parameter_set} "
        f"| {style.OUTCOME_TEXT[robot.outcome]} | {robot.end_time_s:.1f} s |"
        for robot in scene.robots
    ]
    if scene.replan_hz:
        lines += [
            "",
            "Thin lines are the plans before the start; in flight, plans were made anew at "
            f"{scene.replan_hz:g} Hz.",
        ]
    return rr.TextDocument(
        f"# World {scene.world}\n\n" + "\n".join(lines), media_type=rr.MediaType.MARKDOWN
    )
