"""Entities common to replays and live views; imported only where Rerun is installed.

Everything in space lies under ``ROOT/space``: rock, floor and bounds, obstacles, the current at
the robots, and each robot under its name, with its goal, its plan, its vehicle's shapes, its
trail and its label.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import rerun as rr
from matplotlib import colors

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.outlines import rotation_matrix
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.robot.vehicles.config import Box, Cylinder, Sphere, VehicleConfig
from angler_mjx.robot.vehicles.hull import Capsule
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC

DOT, LARGE_DOT = -3.0, -6.0
"""Radii of label points.

Negative values are pixels, so that a robot of half a metre is visible in a world of thirty."""

MAX_NAMED = 16
"""Max fleet size with all robots named in space.

In a larger fleet only failed robots are named, to keep the view clear."""

_PLAN, _TRAIL = -0.75, -1.5
"""Radii of lines, in pixels: visible from afar, and thin for a camera beside them."""

ARROW_S = 4.0
"""Time scale of current arrows: 0.25 m/s shows as 1 m."""

type Rgba = tuple[int, int, int, int]

type RerunShape = type[rr.Boxes3D] | type[rr.Capsules3D] | type[rr.Ellipsoids3D]


def log_surroundings(recording: rr.RecordingStream, scene: ReplayScene, root: str) -> None:
    """Log rock, floor and bounds of a world under ``root``, and the style of currents."""
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
            colors=[to_rgba("#8d8064")],
            fill_mode="solid",
        ),
        static=True,
    )
    recording.log(
        f"{root}/bounds",
        rr.Boxes3D(
            centers=[middle],
            half_sizes=[half],
            colors=[to_rgba("#7fa6bd")],
            radii=[0.02],
            fill_mode="majorwireframe",
        ),
        static=True,
    )
    arrow = rr.Arrows3D.from_fields(colors=[to_rgba("#9fd3ee")], radii=[0.03])
    recording.log(f"{root}/current", arrow, static=True)


def log_obstacles(recording: rr.RecordingStream, scene: ReplayScene, root: str) -> None:
    """Log sizes and colours of the obstacles under ``root``: one entity a shape."""
    obstacles = scene.environment.obstacles
    for kind, name, rows in _group_by_shape(scene):
        size = np.asarray(obstacles.size_m)[rows]
        tint = [
            to_rgba(style.OBSTACLE_STATIC if motion == STATIC else "#b39ad6")
            for motion in np.asarray(obstacles.motion)[rows]
        ]
        if kind == CAPSULE:
            solid: rr.AsComponents = rr.Capsules3D.from_fields(
                lengths=2 * size[:, 1], radii=size[:, 0], colors=tint, fill_mode="solid"
            )
        elif kind == BOX:
            solid = rr.Boxes3D.from_fields(half_sizes=size, colors=tint, fill_mode="solid")
        else:
            half = np.repeat(size[:, :1], 3, axis=1)
            solid = rr.Ellipsoids3D.from_fields(half_sizes=half, colors=tint, fill_mode="solid")
        recording.log(f"{root}/{name}", solid, static=True)


def obstacle_poses(scene: ReplayScene) -> list[tuple[str, RerunShape, dict[str, Any]]]:
    """Return the poses of the obstacles at the times of the scene, one entry per entity.

    Returns:
        Name below ``obstacles``, archetype, and its fields: [T, n, 3] in W or [T, n, 4].
    """
    size_m = np.asarray(scene.environment.obstacles.size_m)
    result: list[tuple[str, RerunShape, dict[str, Any]]] = []
    for kind, name, rows in _group_by_shape(scene):
        p, q = scene.obstacle_p_m[:, rows], scene.obstacle_q[:, rows]
        if kind == CAPSULE:
            axis = np.array([[rotation_matrix(b)[:, 2] for b in a] for a in q])
            ends = p - axis * size_m[rows, 1:2]
            result.append((name, rr.Capsules3D, {"translations": ends, "quaternions": to_xyzw(q)}))
        elif kind == BOX:
            result.append((name, rr.Boxes3D, {"centers": p, "quaternions": to_xyzw(q)}))
        else:
            result.append((name, rr.Ellipsoids3D, {"centers": p}))
    return result


def _group_by_shape(scene: ReplayScene) -> list[tuple[int, str, np.ndarray]]:
    """Return the occurring obstacle shapes: kind, name and rows."""
    obstacles = scene.environment.obstacles
    kind, exists = np.asarray(obstacles.kind), np.asarray(obstacles.exists)
    shapes = ((SPHERE, "spheres"), (BOX, "boxes"), (CAPSULE, "capsules"))
    groups = [(shape, name, np.flatnonzero(exists & (kind == shape))) for shape, name in shapes]
    return [group for group in groups if group[2].size > 0]


def _to_entity_capsules(
    capsules: Sequence[Capsule],
    center_m: np.ndarray,
    color: Rgba,
    fill_mode: Literal["solid", "majorwireframe"],
) -> rr.Capsules3D:
    """Return capsules about a centre [3] of their frame."""
    start = np.array([capsule.from_m for capsule in capsules]) - center_m
    axis = np.array([capsule.to_m for capsule in capsules]) - center_m - start
    return rr.Capsules3D(
        translations=start,
        lengths=np.linalg.norm(axis, axis=1),
        radii=[capsule.radius_m for capsule in capsules],
        quaternions=[_z_axis_rotation(a) for a in axis],
        colors=[color] * len(capsules),
        line_radii=[0.004] * len(capsules),
        fill_mode=fill_mode,
    )


def log_links(
    recording: rr.RecordingStream, config: VehicleConfig, path: str, color: Rgba
) -> dict[str, str]:
    """Log the shapes of a vehicle's links; their poses are logged in time.

    Args:
        recording: destination.
        config: of the vehicle.
        path: of the vehicle's entity.
        color: of the links.

    Returns:
        Paths of the links by their names, in the simulator's order.
    """
    paths = {link.name: f"{path}/links/{link.name}" for link in config.find_links(None)}
    for link in config.links:
        if link.capsules:
            shape = _to_entity_capsules(link.capsules, np.zeros(3), color, "solid")
            recording.log(f"{paths[link.name]}/hull", shape, static=True)
    return paths


def _log_vehicle(
    recording: rr.RecordingStream, config: VehicleConfig, path: str, color: Rgba
) -> None:
    """Log the visible shapes of a vehicle, and its hull's capsules in the robot's colour."""
    center = np.asarray(config.base.center_of_mass_m)
    for shape in config.visual.shapes:
        tint = [tuple(round(255 * value) for value in shape.rgba)]
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
                    quaternions=[_z_axis_rotation(end - start)],
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
    hull = _to_entity_capsules(config.hull.capsules, center, color, "majorwireframe")
    recording.log(f"{path}/hull", hull, static=True)


def log_robot(
    recording: rr.RecordingStream,
    config: VehicleConfig,
    robot: int,
    space: str,
    *,
    goal_m: np.ndarray,
    plan_m: np.ndarray,
    named: bool = True,
) -> None:
    """Log the static entities of a robot: goal, shapes, and the styles of the others.

    The pose of its vehicle, its label and its trail are logged in time.

    Args:
        recording: destination.
        config: of its vehicle.
        robot: its index.
        space: path of its entities.
        goal_m: [3] in W; NaN where it has none of its own.
        plan_m: [n, 3] way-points in W.
        named: whether its goal has a visible label; else only on a click.
    """
    color = robot_rgba(robot)
    if np.isfinite(goal_m).all():
        goal = rr.Points3D(
            [goal_m], radii=[0.3], colors=[color], labels=[f"goal {robot}"], show_labels=named
        )
        recording.log(f"{space}/goal", goal, static=True)
    plan = rr.LineStrips3D([plan_m], colors=[color], radii=[_PLAN])
    recording.log(f"{space}/plan", plan, static=True)
    _log_vehicle(recording, config, f"{space}/vehicle", color)
    label = rr.Points3D.from_fields(positions=[[0.0, 0.0, 0.45]])
    recording.log(f"{space}/vehicle/label", label, static=True)
    trail = rr.LineStrips3D.from_fields(colors=[color], radii=[_TRAIL])
    recording.log(f"{space}/trail", trail, static=True)


def current_arrows(current_mps: np.ndarray) -> np.ndarray:
    """Return arrows [..., 3], m, of the water's velocity, m/s in W; logged as ``current``."""
    return ARROW_S * current_mps


def time_column(seconds: np.ndarray) -> rr.TimeColumn:
    """Return times [n], s, as a column of the timeline."""
    return rr.TimeColumn("time", duration=seconds)


def to_xyzw(q: np.ndarray) -> np.ndarray:
    """Convert quaternions wxyz to Rerun's order."""
    reordered: np.ndarray = q[..., [1, 2, 3, 0]]
    return reordered


def _z_axis_rotation(axis: np.ndarray) -> np.ndarray:
    """Return the quaternion xyzw from the z axis to ``axis`` [3], by the half-way formula."""
    length = float(np.linalg.norm(axis))
    x, y, z = axis / length if length > 0 else (0.0, 0.0, 1.0)
    if z < -1 + 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    half = np.array([-y, x, 0.0, 1.0 + z])
    unit: np.ndarray = half / np.linalg.norm(half)
    return unit


def robot_rgba(robot: int) -> Rgba:
    """Return the figures' colour of a robot, half-way to white: legible on a dark background."""
    r, g, b, a = to_rgba(style.robot_color(robot))
    return (r + 255) // 2, (g + 255) // 2, (b + 255) // 2, a


def ending_color(*, arrived: bool) -> Rgba:
    """Return the label colour of a robot whose episode is over."""
    return to_rgba("#4fd6a4" if arrived else "#ff6b57")


def to_rgba(name: str) -> Rgba:
    """Convert a colour name or number to Rerun's form."""
    r, g, b, a = (round(255 * value) for value in colors.to_rgba(name))
    return r, g, b, a
