"""MuJoCo model of one recorded world: rock, floor, obstacles, goals and vehicles.

Nothing in it is simulated: frames set the poses of its bodies. Obstacles are mocap bodies, vehicles
free bodies with their joints.
"""

from math import ceil

import mujoco
import numpy as np
from matplotlib import colors

from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.robot.vehicles import library, mjcf
from angler_mjx.world.obstacles import BOX, CAPSULE, STATIC

MAX_SIZE_PX = (1920, 1080)
"""Max width and height of pictures."""

MAX_SUPERSAMPLING = 2.0
"""Max ratio of the rendered size to that of pictures."""

_SLICES, _STACKS = 20, 12
"""Number of strips about a round geom, and along it."""

_WATER_RGB, _DEEP_RGB = (0.16, 0.42, 0.52), (0.02, 0.13, 0.21)
_FLOOR_RGB, _FLOOR_MARK_RGB = (0.52, 0.46, 0.35), (0.44, 0.39, 0.30)
_DRIFTING_RGBA = (0.70, 0.60, 0.84, 1.0)
_ROCK_BANDS = 6
"""Number of colours of rock, by height."""
_GOAL_RADIUS_M, _END_EFFECTOR_GOAL_RADIUS_M = 0.3, 0.05
_HORIZON = 12.0
"""Extent of the floor, in sizes of the region."""
_NO_CONTACT = {"contype": 0, "conaffinity": 0}

_CORNERS = np.array([[(i >> a) & 1 for a in (0, 1, 2)] for i in range(8)])
_CELL_SIDES = (
    ((-1, 0, 0), (0, 4, 6, 2)),
    ((1, 0, 0), (1, 3, 7, 5)),
    ((0, -1, 0), (0, 1, 5, 4)),
    ((0, 1, 0), (2, 6, 7, 3)),
    ((0, 0, -1), (0, 2, 3, 1)),
    ((0, 0, 1), (4, 5, 7, 6)),
)
"""Normals of a cell's faces, and their corners (rows of `_CORNERS`) anticlockwise from outside."""


def build_model(scene: ReplayScene) -> mujoco.MjModel:
    """Build the model of a world.

    Args:
        scene: the world.

    Returns:
        A model whose mocap bodies are ``obstacle_I`` and whose free joints and joints of arms have
        the names of their vehicle's MJCF behind ``robot_I/``.

    Raises:
        ConfigError: a vehicle file has faults.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"world_{scene.world}"
    spec.compiler.degree = False
    _add_look(spec, scene)
    _add_floor(spec, scene)
    _add_rock(spec, scene)
    for i in list_obstacles(scene):
        _add_obstacle(spec, scene, int(i))
    for robot in scene.robots:
        _add_robot(spec, robot)
    return spec.compile()


def list_obstacles(scene: ReplayScene) -> np.ndarray:
    """Return the rows of the obstacles that exist and were recorded."""
    exists = np.asarray(scene.environment.obstacles.exists)
    rows: np.ndarray = np.flatnonzero(exists[: scene.obstacle_p_m.shape[1]])
    return rows


def _add_look(spec: mujoco.MjSpec, scene: ReplayScene) -> None:
    """Add light, haze and the gradient behind everything."""
    low, high = scene.bounds_m
    size = float(np.max(high - low))
    visual = spec.visual
    offscreen = [ceil(MAX_SUPERSAMPLING * side) for side in MAX_SIZE_PX]
    visual.global_.offwidth, visual.global_.offheight = offscreen
    visual.headlight.ambient, visual.headlight.diffuse = [0.40, 0.44, 0.46], [0.28, 0.30, 0.30]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.fog = [*_WATER_RGB, 1.0]
    spec.stat.center, spec.stat.extent = 0.5 * (low + high), size
    visual.map.fogstart, visual.map.fogend = 1.2, 6.0  # of the extent
    visual.map.znear, visual.map.zfar = 0.002, 60.0
    visual.quality.shadowsize = 0
    # Pictures are rendered larger and reduced: on a processor that costs less than several samples
    # a pixel of OpenGL.
    visual.quality.offsamples = 0
    visual.quality.numslices, visual.quality.numstacks = _SLICES, _STACKS
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[*(0.5 * (low + high))[:2], float(high[2]) + size],
        dir=[0.3, 0.2, -1.0],
        diffuse=[0.38, 0.40, 0.38],
        castshadow=False,
    )
    spec.add_texture(
        name="water",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_WATER_RGB,
        rgb2=_DEEP_RGB,
        width=64,
        height=384,
    )


def _add_floor(spec: mujoco.MjSpec, scene: ReplayScene) -> None:
    """Add the sea floor."""
    low, high = scene.bounds_m
    middle, half = 0.5 * (low + high), 0.5 * _HORIZON * float(np.max(high - low))
    spec.add_texture(
        name="sand",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_RANDOM,
        random=0.02,
        rgb1=_FLOOR_RGB,
        markrgb=_FLOOR_MARK_RGB,
        width=256,
        height=256,
    )
    sand = spec.add_material(name="sand", texrepeat=[0.2, 0.2], texuniform=True)
    sand.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "sand"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[middle[0], middle[1], float(scene.environment.floor_z_m)],
        size=[half, half, 1.0],
        material="sand",
        **_NO_CONTACT,
    )


def _add_rock(spec: mujoco.MjSpec, scene: ReplayScene) -> None:
    """Add the visible faces of the occupied cells: a mesh for each band of height."""
    grid = scene.environment.grid
    occupied, cell_m = np.asarray(grid.occupied), float(grid.cell_m)
    cells = np.argwhere(occupied)
    if not len(cells):
        return
    band = cells[:, 2] * _ROCK_BANDS // occupied.shape[2]
    for number in np.unique(band).tolist():
        vertices, triangles = _mesh_surface(occupied, cells[band == number])
        if not len(triangles):
            continue
        name = f"rock_{number}"
        mesh = spec.add_mesh(name=name)
        mesh.uservert = (np.asarray(grid.origin_m) + cell_m * vertices).reshape(-1)
        mesh.userface = triangles.reshape(-1)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            rgba=style.ROCK((number + 0.5) / _ROCK_BANDS),
            **_NO_CONTACT,
        )


def _mesh_surface(occupied: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the faces of cells [n, 3] that no other cell hides.

    Returns:
        Vertices [4 f, 3] in cells, four a face, so that edges stay sharp, and triangles [2 f, 3].
    """
    padded = np.pad(occupied, 1)
    corners = []
    for normal, rows in _CELL_SIDES:
        beside = cells + 1 + np.array(normal)
        free = cells[~padded[tuple(beside.T)]]
        corners.append(free[:, None, :] + _CORNERS[list(rows)])
    vertices = np.concatenate(corners).reshape(-1, 3).astype(float)
    first = 4 * np.arange(len(vertices) // 4)[:, None]
    triangles = np.concatenate([first + np.array(half) for half in ((0, 1, 2), (0, 2, 3))])
    return vertices, triangles


def _add_obstacle(spec: mujoco.MjSpec, scene: ReplayScene, row: int) -> None:
    obstacles = scene.environment.obstacles
    kind, size_m = int(obstacles.kind[row]), np.asarray(obstacles.size_m[row], float)
    shapes = {BOX: mujoco.mjtGeom.mjGEOM_BOX, CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE}
    is_static = int(obstacles.motion[row]) == STATIC
    rgba = colors.to_rgba(style.OBSTACLE_STATIC) if is_static else _DRIFTING_RGBA
    body = spec.worldbody.add_body(name=f"obstacle_{row}", mocap=True)
    body.add_geom(
        type=shapes.get(kind, mujoco.mjtGeom.mjGEOM_SPHERE), size=size_m, rgba=rgba, **_NO_CONTACT
    )


def _add_robot(spec: mujoco.MjSpec, robot: RobotTrack) -> None:
    """Add a robot's vehicle, with its hull in the robot's colour, and its goal."""
    config = library.load_vehicle(robot.vehicle_file)
    vehicle = mjcf.to_spec(config, None)
    red, green, blue = colors.to_rgb(style.robot_color(robot.index))
    for geom in vehicle.geoms:
        if geom.name.startswith("hull/") and geom.name.count("/") == 1:
            geom.rgba = [red, green, blue, 0.25]
    prefix = f"robot_{robot.index}/"
    frame = spec.worldbody.add_frame()
    frame.attach_body(vehicle.bodies[1], prefix, "")
    if np.isfinite(robot.goal_m).all():
        reached_by_link = config.end_effector is not None
        radius_m = _END_EFFECTOR_GOAL_RADIUS_M if reached_by_link else _GOAL_RADIUS_M
        spec.worldbody.add_geom(
            name=f"{prefix}goal",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=robot.goal_m,
            size=[radius_m, 0, 0],
            rgba=[red, green, blue, 0.55],
            **_NO_CONTACT,
        )
