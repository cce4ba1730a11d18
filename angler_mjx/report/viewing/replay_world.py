"""One world of a run as entities of a Rerun recording; imported only where Rerun is installed.

The entities of `entities`, with the whole run on the timeline ``time``, in seconds; beside them the
fleet's table, distances to goal or progress of the task, and events.
"""

import numpy as np
import rerun as rr

from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.report.viewing import entities
from angler_mjx.report.viewing.entities import task as of_task
from angler_mjx.report.viewing.entities.water import log_flow
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_params import build_links
from angler_mjx.sim.posture import trace_links
from angler_mjx.world.tasks.history import GoodsStatus, RobotActivity, TaskHistory

_TRAIL_POINTS = 2_000_000
"""Max points in all growing trails of a world: 24 MB."""


def log_world(recording: rr.RecordingStream, scene: ReplayScene, root: str) -> None:
    """Log one world.

    Args:
        recording: destination.
        scene: the world.
        root: path of its entities.
    """
    recording.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    entities.log_surroundings(recording, scene, f"{root}/space")
    entities.log_obstacles(recording, scene, f"{root}/space/obstacles")
    times = [entities.time_column(scene.time_s)]
    for name, shape, fields in entities.obstacle_poses(scene):
        recording.send_columns(f"{root}/space/obstacles/{name}", times, shape.columns(**fields))
    for robot in scene.robots:
        _log_robot(recording, scene, robot, root)
    scale_s = log_flow(recording, scene, f"{root}/space/flow")
    origins = np.stack([robot.p_m for robot in scene.robots], axis=1)
    current = np.stack([robot.current_mps for robot in scene.robots], axis=1)
    recording.send_columns(
        f"{root}/space/current",
        times,
        rr.Arrows3D.columns(origins=origins, vectors=scale_s * current),
    )
    if scene.task is None:
        recording.log(f"{root}/fleet", _fleet_table(scene), static=True)
    else:
        of_task.log_task(recording, scene, scene.task, f"{root}/space/task")
        _log_progress(recording, scene, scene.task, root)
    _log_events(recording, scene, f"{root}/events")


def _log_robot(
    recording: rr.RecordingStream, scene: ReplayScene, robot: RobotTrack, root: str
) -> None:
    name = f"robot_{robot.index}"
    space, times = f"{root}/space/{name}", [entities.time_column(scene.time_s)]
    entities.log_robot(
        recording,
        library.load_vehicle(robot.vehicle_file),
        robot.index,
        space,
        goal_m=robot.goal_m,
        plan_m=robot.plan_m,
        named=len(scene.robots) <= entities.MAX_NAMED,
    )
    recording.send_columns(
        f"{space}/vehicle",
        times,
        rr.Transform3D.columns(translation=robot.p_m, quaternion=entities.to_xyzw(robot.q)),
    )
    _log_links(recording, scene, robot, f"{space}/vehicle")
    _log_trail(recording, scene, robot, f"{space}/trail")
    _log_label(recording, scene, robot, f"{space}/vehicle/label")
    if not np.isfinite(robot.goal_m).all():
        return
    distance_m = np.linalg.norm(robot.p_m - robot.goal_m, axis=1)
    series = f"{root}/distance_to_goal_m/{name}"
    color = entities.robot_rgba(robot.index)
    recording.log(
        series, rr.SeriesLines(colors=[color], names=[str(robot.index)], widths=[2]), static=True
    )
    recording.send_columns(series, times, rr.Scalars.columns(scalars=distance_m))


def _log_links(
    recording: rr.RecordingStream, scene: ReplayScene, robot: RobotTrack, path: str
) -> None:
    """Log a robot's links, moved by its recorded joints; at home where a run recorded none."""
    config = library.load_vehicle(robot.vehicle_file)
    links = build_links(config, None)
    if links is None:
        return
    paths = entities.log_links(recording, config, path, entities.robot_rgba(robot.index))
    position = robot.joint_position
    if position is None:
        position = np.tile(links.home, (len(scene.time_s), 1))
    origin, rotation = trace_links(links, position)
    for i, link_path in enumerate(paths.values()):
        columns = rr.Transform3D.columns(translation=origin[:, i], mat3x3=rotation[:, i])
        recording.send_columns(link_path, [entities.time_column(scene.time_s)], columns)


def _log_trail(
    recording: rr.RecordingStream, scene: ReplayScene, robot: RobotTrack, path: str
) -> None:
    """Log the path so far: a line that grows about once a second."""
    path_m = scene.flown_path(robot)
    count = len(path_m)
    step = max(1, round(1.0 / max(float(scene.time_s[1]), 1e-3))) if len(scene.time_s) > 1 else 1
    # n updates of a line of T points hold n T / 2 points; a large fleet gets fewer updates.
    max_lines = max(2 * _TRAIL_POINTS // (len(scene.robots) * max(count, 1)), 1)
    step = max(step, -(-count // max_lines))
    ends = np.unique(np.r_[np.arange(2, count, step), count])
    recording.send_columns(
        path,
        [entities.time_column(scene.time_s[ends - 1])],
        rr.LineStrips3D.columns(strips=[path_m[:end] for end in ends]),
    )


def _log_label(
    recording: rr.RecordingStream, scene: ReplayScene, robot: RobotTrack, path: str
) -> None:
    """Log the robot's number above it, with its outcome after its end; in a crowd only failures."""
    is_named = len(scene.robots) <= entities.MAX_NAMED
    times_s, labels = [0.0], [str(robot.index)]
    if scene.task is not None:
        times_s, labels = _label_phases(scene.task, robot)
    times_until_end = [t for t in times_s if t < robot.end_time_s]
    count = len(times_until_end)
    labels = [*labels[:count], f"{robot.index}: {scene.ended(robot)}"]
    color, end = entities.robot_rgba(robot.index), entities.ending_color(arrived=robot.arrived)
    recording.send_columns(
        path,
        [entities.time_column(np.array([*times_until_end, robot.end_time_s]))],
        rr.Points3D.columns(
            labels=labels,
            colors=[*[color] * count, end],
            radii=[*[entities.DOT] * count, entities.LARGE_DOT],
            show_labels=[*[is_named] * count, is_named or not robot.arrived],
        ),
    )


def _label_phases(task: TaskHistory, robot: RobotTrack) -> tuple[list[float], list[str]]:
    """Return the times at which a robot's activity changes, and its label from then on."""
    labels = [
        str(robot.index)
        if doing == RobotActivity.GOES
        else f"{robot.index}: {task.describe_activity(k, robot.index)}"
        for k, doing in enumerate(task.doing[:, robot.index])
    ]
    samples = [k for k in range(len(labels)) if k == 0 or labels[k] != labels[k - 1]]
    return task.time_s[samples].tolist(), [labels[k] for k in samples]


def _log_events(recording: rr.RecordingStream, scene: ReplayScene, path: str) -> None:
    events = [] if scene.task is None else _job_events(scene.task)
    for robot in scene.robots:
        text = f"robot {robot.index} {scene.ended(robot)}"
        if robot.failure_pair != "none":
            text += f" ({robot.failure_pair})"
        events.append((robot.end_time_s, text, "INFO" if robot.arrived else "ERROR"))
    for at_s, text, level in sorted(events, key=lambda event: event[0]):
        recording.set_time("time", duration=at_s)
        recording.log(path, rr.TextLog(f"{at_s:.1f} s: {text}", level=level))
    recording.reset_time()


def _job_events(task: TaskHistory) -> list[tuple[float, str, str]]:
    """Return times, texts and levels of finished jobs of a task; not of survey viewpoints."""
    events = []
    for job in np.flatnonzero(task.exists).tolist():
        at_s, by = float(task.done_at_s[job]), int(task.by[job])
        if np.isfinite(at_s) and task.spec.kind == "tour":
            doer = f"by robot {by}" if task.spec.shared else f"by all, robot {by} the last"
            events.append((at_s, f"place {job} visited {doer}", "INFO"))
        elif np.isfinite(at_s) and task.spec.kind == "deliver":
            events.append((at_s, f"goods {job} brought by robot {by}", "INFO"))
        if task.spec.kind == "deliver":
            events += _goods_events(task, job)
    if np.isfinite(task.completed_s):
        events.append((task.completed_s, "the task is complete", "INFO"))
    return events


def _goods_events(task: TaskHistory, job: int) -> list[tuple[float, str, str]]:
    """Return when goods were taken up, and lost or returned, within the sample interval."""
    goods_state, events = task.goods[:, job], []
    for k in (np.flatnonzero(goods_state[1:] != goods_state[:-1]) + 1).tolist():
        at_s, robot = float(task.time_s[k]), int(task.carrier[k - 1, job])
        if goods_state[k] == GoodsStatus.TRAVEL:
            taken = f"goods {job} taken up by robot {task.carrier[k, job]}"
            events.append((at_s, taken, "INFO"))
        elif goods_state[k] in (GoodsStatus.LOST, GoodsStatus.WAIT):
            fate = "lost" if goods_state[k] == GoodsStatus.LOST else "back where they were"
            events.append((at_s, f"goods {job} {fate}: robot {robot} ended", "ERROR"))
    return events


def _log_progress(
    recording: rr.RecordingStream, scene: ReplayScene, task: TaskHistory, root: str
) -> None:
    """Log the fraction of a task over time; and its text with a table of the robots' activities."""
    fraction_path = f"{root}/progress/share"
    line = rr.SeriesLines(colors=[of_task.SEEN], names=["share"], widths=[2])
    recording.log(fraction_path, line, static=True)
    columns = rr.Scalars.columns(scalars=100.0 * task.progress)
    recording.send_columns(fraction_path, [entities.time_column(task.time_s)], columns)
    texts: list[str] = []
    samples: list[int] = []
    for sample in range(len(task.time_s)):
        text = _task_table(scene, task, sample)
        if not texts or text != texts[-1]:
            texts.append(text)
            samples.append(sample)
    recording.send_columns(
        f"{root}/fleet",
        [entities.time_column(task.time_s[samples])],
        rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(samples)),
    )


def _task_table(scene: ReplayScene, task: TaskHistory, sample: int) -> str:
    def does(robot: RobotTrack) -> str:
        return task.describe_activity(sample, robot.index) or scene.ended(robot)

    lines = [f"# World {scene.world}", "", f"**{task.describe_progress(sample)}**", ""]
    lines += ["| | vehicle | does | jobs done |", "|---|---|---|---|"]
    lines += [
        f"| **{robot.index}** | {robot.vehicle} | {does(robot)} | {task.did[sample, robot.index]} |"
        for robot in scene.robots
    ]
    return "\n".join(lines)


def _fleet_table(scene: ReplayScene) -> rr.TextDocument:
    lines = ["| | vehicle | set | end | after |", "|---|---|---|---|---|"]
    lines += [
        f"| **{robot.index}** | {robot.vehicle} | {robot.parameter_set} "
        f"| {scene.ended(robot)} | {robot.end_time_s:.1f} s |"
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
