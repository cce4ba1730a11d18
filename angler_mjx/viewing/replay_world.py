"""One world as entities of a Rerun recording; imported only where Rerun is installed.

Everything in space lies under ``ROOT/space``: rock, floor and bounds, goals, plans and obstacles,
and each robot as its vehicle's shapes with its trail, its label and the current that it feels. The
timeline is ``time``, in seconds.
"""

import numpy as np
import rerun as rr
from matplotlib import colors

from angler_mjx.vehicles import library
from angler_mjx.vehicles.config import Box, Cylinder, Sphere, VehicleConfig
from angler_mjx.viewing import style
from angler_mjx.viewing.outlines import rotation
from angler_mjx.viewing.scene import RobotTrack, Scene
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC

_TRAIL_POINTS = 2_000_000
"""Points in all growing trails of a world, at most: 24 MB."""

_ARROW_S = 4.0
"""Length of a current arrow: the way of the water in this time, so that 0.25 m/s shows as 1 m."""

type _Rgba = tuple[int, int, int, int]


def log_world(recording: rr.RecordingStream, scene: Scene, root: str) -> None:
    """Log one world.

    Args:
        recording: where to.
        scene: the world.
        root: path of its entities.
    """
    recording.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_surroundings(recording, scene, f"{root}/space")
    log_obstacles(recording, scene, f"{root}/space/obstacles")
    for robot in scene.robots:
        _robot(recording, scene, robot, root)
    recording.log(f"{root}/fleet", _fleet_table(scene), static=True)
    _events(recording, scene, f"{root}/events")


def log_surroundings(recording: rr.RecordingStream, scene: Scene, root: str) -> None:
    """Log rock, floor and bounds of a world under ``root``."""
    grid = scene.environment.grid
    low, high = scene.bounds_m
    cell, floor = float(grid.cell_m), float(scene.environment.floor_z_m)
    occupied = np.argwhere(np.asarray(grid.occupied))
    centers = low + cell * (occupied + 0.5)
    height = (centers[:, 2] - low[2]) / max(high[2] - low[2], 1e-9)
    if len(occupied):
        recording.log(
            f"{root}/rock",
            rr.Boxes3D(
                centers=centers,
                half_sizes=np.full((len(occupied), 3), 0.49 * cell),
                colors=(255 * style.ROCK(height)).astype(np.uint8),
                fill_mode="solid",
            ),
            static=True,
        )
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    recording.log(
        f"{root}/floor",
        rr.Boxes3D(
            centers=[[middle[0], middle[1], floor - 0.1]],
            half_sizes=[[half[0], half[1], 0.1]],
            colors=[_rgba("#8d8064")],
            fill_mode="solid",
        ),
        static=True,
    )
    recording.log(
        f"{root}/bounds",
        rr.Boxes3D(
            centers=[middle],
            half_sizes=[half],
            colors=[_rgba("#7fa6bd")],
            radii=[0.02],
            fill_mode="majorwireframe",
        ),
        static=True,
    )


def log_obstacles(recording: rr.RecordingStream, scene: Scene, root: str) -> None:
    """Spheres, boxes and capsules, one entity a shape: size and colour once, poses in time."""
    given = scene.environment.obstacles
    kind, exists = np.asarray(given.kind), np.asarray(given.exists)
    shades = [
        _rgba(style.OBSTACLE_STATIC if motion == STATIC else "#b39ad6")
        for motion in np.asarray(given.motion)
    ]
    for shape, name in ((SPHERE, "spheres"), (BOX, "boxes"), (CAPSULE, "capsules")):
        rows = np.flatnonzero(exists & (kind == shape))
        if rows.size == 0:
            continue
        size, tint = np.asarray(given.size_m)[rows], [shades[i] for i in rows]
        p, q = scene.obstacle_p_m[:, rows], scene.obstacle_q[:, rows]
        path, times = f"{root}/{name}", [_times(scene.time_s)]
        if shape == CAPSULE:
            axis = np.array([[rotation(b)[:, 2] for b in a] for a in q])
            ends = p - axis * size[:, 1:2]
            solid = rr.Capsules3D.from_fields(
                lengths=2 * size[:, 1], radii=size[:, 0], colors=tint, fill_mode="solid"
            )
            recording.log(path, solid, static=True)
            moving = rr.Capsules3D.columns(translations=ends, quaternions=_xyzw(q))
        elif shape == BOX:
            box = rr.Boxes3D.from_fields(half_sizes=size, colors=tint, fill_mode="solid")
            recording.log(path, box, static=True)
            moving = rr.Boxes3D.columns(centers=p, quaternions=_xyzw(q))
        else:
            half = np.repeat(size[:, :1], 3, axis=1)
            ball = rr.Ellipsoids3D.from_fields(half_sizes=half, colors=tint, fill_mode="solid")
            recording.log(path, ball, static=True)
            moving = rr.Ellipsoids3D.columns(centers=p)
        recording.send_columns(path, times, moving)


def _robot(recording: rr.RecordingStream, scene: Scene, robot: RobotTrack, root: str) -> None:
    name = f"robot_{robot.index}"
    color = bright(style.robot_color(robot.index))
    space = f"{root}/space/{name}"
    times = [_times(scene.time_s)]
    recording.log(
        f"{space}/goal",
        rr.Points3D([robot.goal_m], radii=[0.3], colors=[color], labels=[f"goal {robot.index}"]),
        static=True,
    )
    recording.log(
        f"{space}/plan",
        rr.LineStrips3D([robot.plan_m], colors=[color], radii=[0.02]),
        static=True,
    )
    recording.send_columns(
        f"{space}/vehicle",
        times,
        rr.Transform3D.columns(translation=robot.p_m, quaternion=_xyzw(robot.q)),
    )
    log_vehicle(recording, library.load(robot.vehicle), f"{space}/vehicle", color)
    recording.send_columns(
        f"{space}/current",
        times,
        rr.Arrows3D.columns(origins=robot.p_m, vectors=_ARROW_S * robot.current_mps),
    )
    recording.log(
        f"{space}/current",
        rr.Arrows3D.from_fields(colors=[_rgba("#9fd3ee")], radii=[0.03]),
        static=True,
    )
    _trail(recording, scene, robot, f"{space}/trail", color)
    _label(recording, robot, f"{space}/vehicle/label", color)
    away = np.linalg.norm(robot.p_m - robot.goal_m, axis=1)
    series = f"{root}/distance_to_goal_m/{name}"
    recording.log(
        series, rr.SeriesLines(colors=[color], names=[str(robot.index)], widths=[2]), static=True
    )
    recording.send_columns(series, times, rr.Scalars.columns(scalars=away))


def log_vehicle(
    recording: rr.RecordingStream, config: VehicleConfig, path: str, color: _Rgba
) -> None:
    """The visible shapes of a vehicle, and its hull's capsules in the robot's colour."""
    center = np.asarray(config.base.center_of_mass_m)
    for shape in config.visual.shapes:
        tint = [tuple(round(255 * share) for share in shape.rgba)]
        match shape:
            case Box():
                entity: rr.AsComponents = rr.Boxes3D(
                    centers=[shape.position_m - center],
                    sizes=[shape.size_m],
                    colors=tint,
                    fill_mode="solid",
                )
            case Cylinder():
                start, end = np.asarray(shape.from_m), np.asarray(shape.to_m)
                entity = rr.Cylinders3D(
                    centers=[0.5 * (start + end) - center],
                    lengths=[float(np.linalg.norm(end - start))],
                    radii=[shape.radius_m],
                    quaternions=[_z_to(end - start)],
                    colors=tint,
                    fill_mode="solid",
                )
            case Sphere():
                entity = rr.Ellipsoids3D(
                    centers=[shape.position_m - center],
                    half_sizes=[[shape.radius_m] * 3],
                    colors=tint,
                    fill_mode="solid",
                )
        recording.log(f"{path}/{shape.name}", entity, static=True)
    hull = config.hull.capsules
    start = np.array([capsule.from_m for capsule in hull]) - center
    axis = np.array([capsule.to_m for capsule in hull]) - center - start
    recording.log(
        f"{path}/hull",
        rr.Capsules3D(
            translations=start,
            lengths=np.linalg.norm(axis, axis=1),
            radii=[capsule.radius_m for capsule in hull],
            quaternions=[_z_to(a) for a in axis],
            colors=[color] * len(hull),
            line_radii=[0.004] * len(hull),
            fill_mode="majorwireframe",
        ),
        static=True,
    )


def _trail(
    recording: rr.RecordingStream, scene: Scene, robot: RobotTrack, path: str, color: _Rgba
) -> None:
    """The way taken so far: a line that grows about once a second."""
    flown = scene.way_taken(robot)
    count = len(flown)
    step = max(1, round(1.0 / max(float(scene.time_s[1]), 1e-3))) if len(scene.time_s) > 1 else 1
    # n updates of a line of T points hold n T / 2 points; a large fleet gets fewer updates.
    most = max(2 * _TRAIL_POINTS // (len(scene.robots) * max(count, 1)), 1)
    step = max(step, -(-count // most))
    ends = np.unique(np.r_[np.arange(2, count, step), count])
    recording.log(path, rr.LineStrips3D.from_fields(colors=[color], radii=[0.045]), static=True)
    recording.send_columns(
        path,
        [_times(scene.time_s[ends - 1])],
        rr.LineStrips3D.columns(strips=[flown[:end] for end in ends]),
    )


def _label(recording: rr.RecordingStream, robot: RobotTrack, path: str, color: _Rgba) -> None:
    """The robot's number above it, with the outcome once it is known."""
    ended = f"{robot.index}: {style.OUTCOME_TEXT[robot.outcome]}"
    final = _rgba("#4fd6a4" if robot.arrived else "#ff6b57")
    recording.log(path, rr.Points3D.from_fields(positions=[[0.0, 0.0, 0.45]]), static=True)
    recording.send_columns(
        path,
        [_times(np.array([0.0, robot.end_time_s]))],
        rr.Points3D.columns(
            labels=[str(robot.index), ended], colors=[color, final], radii=[0.08, 0.16]
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
    return rr.TextDocument(
        f"# World {scene.world}\n\n" + "\n".join(lines), media_type=rr.MediaType.MARKDOWN
    )


def _times(seconds: np.ndarray) -> rr.TimeColumn:
    return rr.TimeColumn("time", duration=seconds)


def _xyzw(q: np.ndarray) -> np.ndarray:
    """Quaternions wxyz in the order that Rerun takes."""
    turned: np.ndarray = q[..., [1, 2, 3, 0]]
    return turned


def _z_to(axis: np.ndarray) -> np.ndarray:
    """Quaternion xyzw that takes the z axis to ``axis`` [3], by the half-way formula."""
    length = float(np.linalg.norm(axis))
    x, y, z = axis / length if length > 0 else (0.0, 0.0, 1.0)
    if z < -1 + 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    half = np.array([-y, x, 0.0, 1.0 + z])
    unit: np.ndarray = half / np.linalg.norm(half)
    return unit


def bright(name: str) -> _Rgba:
    """A colour of the figures, half-way to white: legible on the viewer's dark ground."""
    r, g, b, a = _rgba(name)
    return (r + 255) // 2, (g + 255) // 2, (b + 255) // 2, a


def _rgba(name: str) -> _Rgba:
    r, g, b, a = (round(255 * share) for share in colors.to_rgba(name))
    return r, g, b, a
