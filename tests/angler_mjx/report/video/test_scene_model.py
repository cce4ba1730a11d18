"""The MuJoCo model of a world, its poses and its camera, against records and arithmetic."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from angler_mjx.report.plotting import scene as worlds
from angler_mjx.report.video import camera, frames, scene_model
from angler_mjx.robot.vehicles import library
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE

from ...armed import ARM, LIMP, RIGID
from ...link_poses import locate_by_mujoco

ASPECT = 16 / 9


@pytest.fixture(scope="module")
def model(scene):
    return scene_model.build_model(scene)


def build(scene, model, time_s, kind="fixed", robot=0):
    path = camera.build_camera_path(kind, scene, scene.robots[robot], time_s, ASPECT)
    return frames.build_frames(model, scene, time_s, path, np.ones((len(scene.robots), 4)))


def pose(model, found, i):
    """The model's data at a frame."""
    data = mujoco.MjData(model)
    data.qpos[:] = found.qpos[i]
    data.mocap_pos[:], data.mocap_quat[:] = found.mocap_pos[i], found.mocap_quat[i]
    mujoco.mj_kinematics(model, data)
    return data


def matrix(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True).as_matrix()


def test_vehicles_and_obstacles_are_where_they_were_recorded(scene, model):
    found = build(scene, model, scene.time_s)
    for k in (0, 99, 300):
        data = pose(model, found, k)
        for robot in scene.robots:
            name = f"robot_{robot.index}/{library.load_vehicle(robot.vehicle_file).name}"
            last = min(k, round(robot.end_time_s / 0.2))
            np.testing.assert_allclose(data.body(name).xpos, robot.p_m[last], atol=1e-6)
        for row in np.flatnonzero(scene.environment.obstacles.exists):
            body = data.body(f"obstacle_{row}")
            np.testing.assert_allclose(body.xpos, scene.obstacle_p_m[k, row], atol=1e-6)
            turn = matrix(scene.obstacle_q[k, row])
            np.testing.assert_allclose(body.xmat.reshape(3, 3), turn, atol=1e-6)


def test_obstacles_have_their_shapes(scene, model):
    obstacles = scene.environment.obstacles
    kinds = {SPHERE: "SPHERE", BOX: "BOX", CAPSULE: "CAPSULE"}
    numbers = {SPHERE: 1, BOX: 3, CAPSULE: 2}
    rows = np.flatnonzero(obstacles.exists)
    assert len(rows) == len(obstacles.exists) - 1 == model.nmocap
    for row in rows:
        geom = model.body(f"obstacle_{row}").geomadr[0]
        kind = int(obstacles.kind[row])
        assert model.geom_type[geom] == getattr(mujoco.mjtGeom, f"mjGEOM_{kinds[kind]}")
        size = model.geom_size[geom][: numbers[kind]]
        np.testing.assert_allclose(size, obstacles.size_m[row][: numbers[kind]])


def test_links_lie_as_their_joints_were_recorded(armed_run):
    scene = worlds.read_scene(armed_run, 0)
    model = scene_model.build_model(scene)
    found = build(scene, model, scene.time_s)
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    for k in (0, 5, len(scene.time_s) - 1):
        data = pose(model, found, k)
        for index in (ARM, LIMP):
            robot = scene.robots[index]
            last = min(k, int(np.searchsorted(scene.time_s, robot.end_time_s + 1e-6)) - 1)
            joints = robot.joint_position[last]
            for name, (origin, _) in locate_by_mujoco(
                config, robot.p_m[last], robot.q[last], joints
            ).items():
                place = data.body(f"robot_{index}/link/{name}").xpos
                np.testing.assert_allclose(place, origin, atol=2e-5)
    names = [model.body(i).name for i in range(model.nbody)]
    assert not [name for name in names if name.startswith(f"robot_{RIGID}/link/")]


def test_rock_is_closed_and_has_the_volume_of_its_cells(scene, model):
    """Divergence theorem: a flux of x / 3 through outward faces is the volume."""
    grid = scene.environment.grid
    vertices, triangles = scene_model._mesh_surface(grid.occupied, np.argwhere(grid.occupied))
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    volume = np.sum(np.cross(a, b) * c) / 6
    assert volume == pytest.approx(grid.occupied.sum(), rel=1e-12)
    padded = np.pad(grid.occupied, 1).astype(int)
    exposed = sum(np.abs(np.diff(padded, axis=axis)).sum() for axis in range(3))
    assert len(triangles) == 2 * exposed
    drawn = sum(model.mesh_facenum)
    assert drawn == len(triangles)
    cells = vertices * float(grid.cell_m) + grid.origin_m
    placed = []
    for i in range(model.ngeom):
        if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[i]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[first : first + count] @ matrix(model.geom_quat[i]).T
            placed.append(points + model.geom_pos[i])
    placed = np.concatenate(placed)
    for side in (np.min, np.max):
        np.testing.assert_allclose(side(placed, axis=0), side(cells, axis=0), atol=1e-4)


def test_attitudes_turn_the_shorter_way():
    rng = np.random.default_rng(1)
    steps = Rotation.from_rotvec(0.1 * rng.normal(size=(20, 3)))
    turns = [Rotation.identity()]
    for step in steps:
        turns.append(turns[-1] * step)
    turns = Rotation.concatenate(turns)
    time_s = np.arange(21.0)
    q = turns.as_quat(scalar_first=True) * rng.choice([-1, 1], 21)[:, None]
    between = np.linspace(0, 20, 173)
    found = frames.interpolate_attitude(time_s, q, between)
    expected = Slerp(time_s, turns)(between).as_matrix()
    np.testing.assert_allclose(matrix(found), expected, atol=1e-3)


def test_what_is_not_known_is_held():
    values = np.array([[np.nan], [1.0], [np.nan], [3.0], [np.nan]])
    found = frames.interpolate(np.arange(5.0), values, np.array([0.0, 1.5, 2.0, 4.0]))
    np.testing.assert_allclose(found[:, 0], [1.0, 1.5, 2.0, 3.0])
    assert np.isnan(frames.interpolate(np.arange(5.0), np.full((5, 1), np.nan), np.ones(2))).all()
    lost = frames.interpolate_attitude(np.arange(5.0), np.full((5, 4), np.nan), np.ones(2))
    np.testing.assert_array_equal(lost, [[1, 0, 0, 0]] * 2)


def test_a_robot_that_diverged_stays_where_it_was_last(scene):
    lost = replace(scene.robots[0], p_m=np.array(scene.robots[0].p_m), end_time_s=60.0)
    lost.p_m[100:] = np.nan
    changed = replace(scene, robots=(lost, *scene.robots[1:]))
    model = scene_model.build_model(changed)
    found = build(changed, model, np.array([30.0]), "follow")
    np.testing.assert_allclose(found.robot_m[0, 0], lost.p_m[99])
    np.testing.assert_allclose(found.lookat_m[0], lost.p_m[99])
    assert np.isfinite(found.qpos).all()


def view_axes(path, i):
    """Position, direction of view, and the right and upper axis of a free camera of MuJoCo."""
    azimuth, elevation = np.radians([path.azimuth_deg[i], path.elevation_deg[i]])
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return path.lookat_m[i] - path.distance_m[i] * forward, forward, right, np.cross(right, forward)


@pytest.mark.parametrize("kind", ["fixed", "above"])
@pytest.mark.parametrize("aspect", [16 / 9, 1.0, 9 / 16])
def test_the_whole_region_is_in_the_picture(scene, kind, aspect):
    path = camera.build_camera_path(kind, scene, scene.robots[0], np.array([0.0]), aspect)
    eye, forward, right, up = view_axes(path, 0)
    low, high = scene.bounds_m
    inset = 0.1 * (high - low)  # nobody flies in its corners
    half = np.tan(np.radians(camera.VIEW_DEG) / 2)
    for corner in np.ndindex(2, 2, 2):
        point = np.where(corner, high - inset, low + inset) - eye
        depth = point @ forward
        assert abs(point @ up) < half * depth, (kind, corner)
        assert abs(point @ right) < half * depth * aspect, (kind, corner)
    if kind == "above":
        np.testing.assert_allclose(up, [0, 1, 0], atol=1e-9)
        np.testing.assert_allclose(right, [1, 0, 0], atol=1e-9)


@pytest.mark.parametrize("aspect", [16 / 9, 1.0, 9 / 16])
def test_the_fixed_camera_is_as_near_as_what_it_shows_allows(scene, aspect):
    path = camera.build_camera_path("fixed", scene, scene.robots[0], np.array([0.0]), aspect)
    eye, forward, right, up = view_axes(path, 0)
    half = np.tan(np.radians(camera.VIEW_DEG) / 2)
    points = camera.find_shown_points(scene) - eye
    tall = np.array([point @ up / (half * (point @ forward)) for point in points])
    wide = np.array([point @ right / (half * aspect * (point @ forward)) for point in points])
    assert np.abs([tall, wide]).max() < 1.0
    limiting = max(tall, wide, key=lambda sides: sides.max())
    assert limiting.max() > 0.95
    assert limiting.min() < -0.95


def wall_off(scene, first, last):
    """The scene with a wall of rock, from one plane of x to another, m."""
    grid = scene.environment.grid
    x = np.asarray(grid.origin_m)[0] + float(grid.cell_m) * (
        np.arange(grid.occupied.shape[0]) + 0.5
    )
    occupied = np.zeros_like(grid.occupied)
    occupied[(x > first) & (x < last)] = True
    return replace(
        scene, environment=replace(scene.environment, grid=replace(grid, occupied=occupied))
    )


def test_no_rock_is_between_the_robot_and_the_camera_that_follows(scene):
    time_s = np.arange(0.0, 60.0, 0.1)
    x = np.linspace(-10.0, 10.0, scene.time_s.size)  # through a gap behind which rock begins
    line = np.stack([x, 0 * x, 0 * x - 14.0], axis=1)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (x.size, 1))
    robot = replace(scene.robots[3], p_m=line, q=level, end_time_s=60.0)
    walled = wall_off(scene, -3.0, 0.0)
    path = camera.build_camera_path("follow", walled, robot, time_s, ASPECT)
    bare = camera.build_camera_path("follow", wall_off(scene, 0.0, 0.0), robot, time_s, ASPECT)
    np.testing.assert_allclose(bare.distance_m, camera._BEHIND_M)
    at = np.interp(time_s, scene.time_s, x)
    grid = walled.environment.grid
    low = np.asarray(grid.origin_m)
    hidden = []
    for i in np.flatnonzero(at > camera._NEAREST_M + 0.5):  # out of the wall
        eye = view_axes(path, i)[0]
        points = np.linspace(path.lookat_m[i], eye, 200)
        cells = np.floor((points - low) / float(grid.cell_m)).astype(int)
        hidden.append(bool(np.asarray(grid.occupied)[tuple(cells.T)].any()))
    assert not any(hidden)
    assert path.distance_m.min() < 3.0  # it had to come nearer
    assert path.distance_m[-1] == pytest.approx(camera._BEHIND_M)  # and went back
    assert np.max(np.abs(np.diff(path.distance_m))) < 0.2


def test_trails_keep_to_the_record_with_few_points(scene, model):
    found = build(scene, model, scene.time_s)
    for r, robot in enumerate(scene.robots):
        flown = scene.flown_path(robot)
        trail = found.trail_m[r][np.isfinite(found.trail_m[r]).all(axis=1)]
        assert len(trail) < len(flown) / 3
        np.testing.assert_array_equal(trail[[0, -1]], flown[[0, -1]])
        ends = np.stack([trail[:-1], trail[1:]], axis=1)
        for point in flown:
            chord = ends[:, 1] - ends[:, 0]
            offset = point - ends[:, 0]
            along = np.sum(chord * offset, axis=1) / np.sum(chord * chord, axis=1)
            gap = offset - np.clip(along, 0, 1)[:, None] * chord
            assert np.linalg.norm(gap, axis=1).min() < frames.TRAIL_TOLERANCE_M * 1.001
        # No point of a trail is of a later time than its frame.
        for i in (0, 60, 150):
            count = found.trail_count[i, r]
            reached = np.flatnonzero((flown == trail[count - 1]).all(axis=1))[0]
            assert scene.time_s[reached] <= scene.time_s[i]


def test_a_trail_never_has_too_many_points(scene):
    rough = np.random.default_rng(0).normal(size=(3000, 3))
    kept = frames._thin_out(rough)
    assert len(kept) <= frames.MAX_TRAIL_POINTS
    assert kept[0] == 0
    assert kept[-1] == 2999


def test_the_camera_follows_from_behind(scene):
    yaw = np.linspace(0.5, 2.5, scene.time_s.size)
    q = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=1)
    robot = replace(scene.robots[3], q=q)
    time_s = np.arange(5.0, 55.0)
    path = camera.build_camera_path("follow", scene, robot, time_s, ASPECT)
    headings = np.degrees(np.interp(time_s, scene.time_s, yaw))
    lag = (path.azimuth_deg - headings - camera._BEHIND_DEG + 180) % 360 - 180
    assert np.max(np.abs(lag)) < 3.0
    behind = [(view_axes(path, i)[0] - path.lookat_m[i])[:2] for i in range(len(time_s))]
    forward = np.stack([np.cos(np.radians(headings)), np.sin(np.radians(headings))], axis=1)
    assert np.all(np.sum(behind * forward, axis=1) < 0)


def test_a_camera_before_an_arm(armed_run):
    scene = worlds.read_scene(armed_run, 0)
    robot = scene.robots[ARM]
    path = camera.build_camera_path("follow", scene, robot, scene.time_s[:1], ASPECT)
    eye = view_axes(path, 0)[0]
    assert (eye - path.lookat_m[0]) @ matrix(robot.q[0])[:, 0] > 0
