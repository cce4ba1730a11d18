"""Contact detection against scenes whose distances are known by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.link_hull import max_link_reach_m
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim import detection
from angler_mjx.sim.detection import SEPARATION_RADIUS_M, detect_contacts
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.posture import bounding_radii, hull_capsules
from angler_mjx.sim.state import Touched
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, DRIFT, SPHERE, STATIC, Obstacles, ObstacleState
from angler_mjx.world.rock.grid import Grid

from ..compiling import quickly
from ..link_poses import locate_by_mujoco

# Distances are sums and roots of numbers of some metres in float32: a few ulp of 16 m.
TOLERANCE_M = 1e-5


def obstacles(rows):
    """Obstacles from (kind, size, motion) rows; what only matters to motion is left at zero."""
    n = len(rows)
    return Obstacles(
        kind=jnp.array([row[0] for row in rows], jnp.int32),
        size_m=jnp.array([row[1] for row in rows], float).reshape(n, 3),
        motion=jnp.array([row[2] for row in rows], jnp.int32),
        path=jnp.zeros((n, 8)),
        p0=jnp.zeros((n, 3)),
        q0=jnp.tile(jnp.array([1.0, 0, 0, 0]), (n, 1)),
        nu0=jnp.zeros((n, 6)),
        mass_kg=jnp.ones(n),
        inertia_kgm2=jnp.ones((n, 3)),
        volume_m3=jnp.ones(n),
        M_A=jnp.zeros((n, 6)),
        D_l=jnp.zeros((n, 6)),
        D_q=jnp.zeros((n, 6)),
        exists=jnp.ones(n, bool),
        kinds=(SPHERE, BOX),
        motions=(STATIC, DRIFT),
    )


def environment(occupied, rows, n_robot):
    """A world of 8 x 8 x 8 cells of 1.5 m, x and y from -6 to 6, z from -14 to -2."""
    cells = np.zeros((8, 8, 8), bool)
    for cell in occupied:
        cells[cell] = True
    return Environment(
        grid=Grid(
            occupied=jnp.array(cells),
            origin_m=jnp.array([-6.0, -6.0, -14.0]),
            cell_m=jnp.array(1.5),
        ),
        floor_z_m=jnp.array(-14.0),
        obstacles=obstacles(rows),
        current=(),
        start_m=jnp.zeros((n_robot, 3)),
        start_yaw_rad=jnp.zeros(n_robot),
        goal_m=jnp.zeros((n_robot, 3)),
        density=jnp.array(0.0),
        path_ratio=jnp.ones(n_robot),
        line_free=jnp.ones(n_robot, bool),
        redraws=jnp.array(0),
        valid=jnp.array(True),
    )


@pytest.fixture(scope="module")
def heavy():
    return params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)


def fleet_of(vehicle, places, velocities=None):
    n = len(places)
    vehicles = jax.tree.map(lambda leaf: jnp.stack([leaf] * n), vehicle)
    nu = jnp.zeros((n, 6))
    if velocities is not None:
        nu = nu.at[:, :3].set(jnp.array(velocities))
    state = VehicleState(
        p=jnp.array(places, float),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)),
        nu=nu,
        force_before=jnp.zeros((n, 6)),
        thrust=jnp.zeros((n, 8)),
    )
    return vehicles, state


def still(p):
    n = len(p)
    return ObstacleState(
        p=jnp.array(p, float).reshape(n, 3),
        q=jnp.tile(jnp.array([1.0, 0, 0, 0]), (n, 1)),
        nu=jnp.zeros((n, 6)),
        nu_dot=jnp.zeros((n, 6)),
    )


def test_distance_ahead_of_the_bow_to_a_cell(heavy):
    # Cell (5, 4, 4) spans x from 1.5 to 3, y from 0 to 1.5, z from -8 to -6.5; the hull reaches
    # 0.2285 m ahead of base_link, whose x is that of the centre of mass.
    world = environment([(5, 4, 4)], [], 1)
    vehicles, state = fleet_of(heavy, [[0.5, 0.75, -7.25]])
    contact = quickly(detect_contacts)(world, vehicles, state, still([]))
    assert contact.clearance_m[0] == pytest.approx(1.0 - 0.2285, abs=TOLERANCE_M)
    assert contact.nearest[0] == Touched.CELL
    assert contact.nearest_is_static[0]


def test_distance_to_the_floor_counts_the_lowest_capsule(heavy):
    # Capsules of radius 0.127 at base_link's height, 0.011 m below the centre of mass.
    world = environment([], [], 1)
    vehicles, state = fleet_of(heavy, [[0.0, 0.0, -13.5]])
    contact = quickly(detect_contacts)(world, vehicles, state, still([]))
    assert contact.clearance_m[0] == pytest.approx(0.5 - 0.011 - 0.127, abs=TOLERANCE_M)
    assert contact.nearest[0] == Touched.FLOOR


def test_nearest_obstacle_and_whether_it_stands(heavy):
    rows = [(SPHERE, (0.5, 0, 0), DRIFT), (BOX, (0.4, 0.4, 0.4), STATIC)]
    world = environment([], rows, 2)
    vehicles, state = fleet_of(heavy, [[-3.0, 0.0, -8.0], [3.0, 0.0, -8.0]], [[0.5, 0, 0]] * 2)
    around = still([[-2.0, 0.0, -8.011], [4.0, 0.0, -8.011]])
    around = ObstacleState(
        p=around.p, q=around.q, nu=around.nu.at[0, 0].set(-0.25), nu_dot=around.nu_dot
    )
    contact = quickly(detect_contacts)(world, vehicles, state, around)
    # Along x, at the height of the capsules: gap between centres less the reach of both.
    np.testing.assert_allclose(
        contact.clearance_m, [1.0 - 0.2285 - 0.5, 1.0 - 0.2285 - 0.4], atol=TOLERANCE_M
    )
    np.testing.assert_array_equal(contact.nearest_index, [0, 1])
    np.testing.assert_array_equal(contact.nearest_is_static, [False, True])
    np.testing.assert_allclose(contact.closing_speed_mps, [0.75, 0.5], atol=1e-6)


def test_hulls_side_by_side(heavy):
    world = environment([], [], 3)
    # The one in the middle comes first: robot 0 is a neighbour as any other.
    places = [[0.0, 0.0, -8.0], [0.0, -1.5, -8.0], [0.0, 1.0, -8.0]]
    vehicles, state = fleet_of(heavy, places, [[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0]])
    contact = quickly(detect_contacts)(world, vehicles, state, still([]))
    # Half width 0.1605 + 0.127 on each side.
    width = 2 * 0.2875
    np.testing.assert_allclose(
        contact.separation_m, [1.0 - width, 1.5 - width, 1.0 - width], atol=TOLERANCE_M
    )
    np.testing.assert_array_equal(contact.nearest, [Touched.ROBOT] * 3)
    np.testing.assert_array_equal(contact.nearest_index, [2, 0, 0])
    np.testing.assert_allclose(contact.closing_speed_mps, [0.4, 0.3, 0.4], atol=1e-6)


def test_robots_that_are_far_apart_are_not_the_nearest_thing(heavy):
    # 6 m to the faces of the grid and to the floor; the first two are 5 m apart.
    world = environment([], [], 3)
    places = [[-2.5, 0.0, -8.0], [2.5, 0.0, -8.0], [0.0, 4.0, -8.0]]
    vehicles, state = fleet_of(heavy, places)
    contact = quickly(detect_contacts)(world, vehicles, state, still([]))
    np.testing.assert_array_equal(contact.separation_m, SEPARATION_RADIUS_M)
    assert np.all(contact.clearance_m > SEPARATION_RADIUS_M)
    assert np.all(contact.nearest != Touched.ROBOT)
    np.testing.assert_array_equal(contact.nearest_index, -1)


def test_a_robot_alone_has_no_separation(heavy):
    vehicles, state = fleet_of(heavy, [[0.0, 0.0, -8.0]])
    contact = quickly(detect_contacts)(environment([], [], 1), vehicles, state, still([]))
    assert np.isinf(contact.separation_m[0])


def test_a_large_fleet_is_searched_with_the_same_result(heavy, monkeypatch):
    rng = np.random.default_rng(0)
    places = rng.uniform([-6, -6, -14], [6, 6, -2], (48, 3))
    vehicles, state = fleet_of(heavy, places, rng.uniform(-1, 1, (48, 3)))
    q = rng.normal(size=(48, 4))
    q = jnp.asarray(q / np.linalg.norm(q, axis=1, keepdims=True), float)
    state = dataclasses.replace(state, q=q)
    world = environment([(5, 4, 4), (1, 1, 1)], [], 48)

    def run():
        return quickly(lambda state: detect_contacts(world, vehicles, state, still([])))(state)

    searched = run()
    monkeypatch.setattr(detection, "ALL_PAIRS_UP_TO", 48)
    every = run()
    # The same function of the same pairs, compiled twice.
    np.testing.assert_allclose(
        searched.separation_m,
        np.minimum(every.separation_m, SEPARATION_RADIUS_M),
        atol=TOLERANCE_M,
    )
    near = np.asarray(every.separation_m) < SEPARATION_RADIUS_M
    assert 10 < near.sum() < 40, "some robots have a neighbour, some have none"
    for field in ("nearest", "nearest_index", "nearest_is_static", "closing_speed_mps"):
        got, want = (np.asarray(getattr(contact, field)) for contact in (searched, every))
        np.testing.assert_allclose(got[near], want[near], atol=1e-6, err_msg=field)
    np.testing.assert_array_equal(searched.clearance_m, every.clearance_m)
    assert np.all(np.asarray(searched.nearest)[~near] != Touched.ROBOT)


@pytest.fixture(scope="module")
def armed():
    """The shipped arm, stacked with a vehicle without one."""
    vehicles = [
        params.build_vehicle(library.load_vehicle(name), "von_benzon2022", 16.0)
        for name in ("bluerov2_heavy_alpha5", "bluerov2_heavy")
    ]
    return params.stack_vehicles(vehicles)


POSTURES = ((3.1416, 0.01, 1.5708, 0.0, 0.0), (4.0, 1.5, 2.7, 0.5, 0.01), (1.0, 3.0, 0.2, 2.0, 0.0))


def postured(armed, posture, p, q):
    """Two robots of the same pose [3] and [4], with an arm in a posture and without."""
    _, state = fleet_of(armed, [p, p])
    joints = JointMotion(position=jnp.array([posture, [0.0] * 5]), velocity=jnp.zeros((2, 5)))
    return dataclasses.replace(state, q=jnp.array([q, q]), joints=joints)


def distance_to_links(config, p, q, posture, points):
    """Least distance of points [n, 3] to the capsules of links, by MuJoCo's kinematics."""
    gaps = []
    poses = locate_by_mujoco(config, p, q, posture)
    for link in config.links:
        origin, turn = poses[link.name]
        for capsule in link.capsules:
            a, b = (origin + turn @ np.array(end) for end in (capsule.from_m, capsule.to_m))
            along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            nearest = a + along[:, None] * (b - a)
            gaps.append(np.linalg.norm(points - nearest, axis=1) - capsule.radius_m)
    return np.min(gaps, axis=0)


@pytest.mark.parametrize("posture", POSTURES)
def test_an_arm_is_part_of_the_hull_as_it_lies(armed, posture):
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    p, q = np.array([0.1, 0.2, -8.0]), np.array([0.9, 0.1, -0.2, 0.37])
    q = q / np.linalg.norm(q)
    state = postured(armed, posture, p, q)
    tip = locate_by_mujoco(config, p, q, posture)["jaws"][0]
    outward = p + 1.6 * (tip - p)
    points = outward + np.array([[0.0, 0.0, 0.0], [0.05, 0.1, -0.1]])
    for point in points:
        world = environment([], [(SPHERE, [0.05, 0.0, 0.0], STATIC)], 2)
        contact = quickly(detect_contacts)(world, armed, state, still([point]))
        to_arm, to_hull = np.asarray(contact.clearance_m, float)
        want = distance_to_links(config, p, q, posture, point[None])[0] - 0.05
        assert want < to_hull  # The arm is nearer than the vehicle.
        assert to_arm == pytest.approx(want, abs=TOLERANCE_M)
        distances = quickly(detection.compute_distances)(
            world, armed, state.p, state.q, still([point]), state.joints.position
        )
        assert float(distances[1][0]) == pytest.approx(want, abs=TOLERANCE_M)


def test_an_arm_touches_rock_that_the_vehicle_does_not(armed):
    # Cells begin 0.5 m ahead of the centres of mass; the hull reaches 0.23 m, the arm 0.6 m.
    world = environment([(5, 4, 4), (5, 1, 4)], [], 2)
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    home = [joint.home for joint in config.find_joints()]
    state = postured(armed, home, [1.0, 0.85, -7.25], [1.0, 0.0, 0.0, 0.0])
    state = dataclasses.replace(state, p=state.p.at[1, 1].set(-3.65))
    contact = quickly(detect_contacts)(world, armed, state, still([]))
    assert contact.clearance_m[0] < 0.0 < contact.clearance_m[1]
    assert contact.nearest[0] == Touched.CELL
    assert contact.nearest_is_static[0]


def test_a_robot_without_arms_has_its_hull_alone(armed):
    """Whatever its joints are said to be, in a fleet with arms."""
    world = environment([], [(SPHERE, [0.1, 0.0, 0.0], STATIC)], 2)
    p, point = [0.0, 0.0, -8.0], np.array([[0.8, 0.3, -8.2]])
    alone = jax.tree.map(lambda leaf: leaf[1:], armed)
    alone = dataclasses.replace(alone, links=None, link_capsules=None)
    state = postured(armed, [np.nan] * 5, p, [1.0, 0.0, 0.0, 0.0])
    joints = dataclasses.replace(state.joints, position=jnp.full((2, 5), jnp.nan))
    contact = quickly(detect_contacts)(
        world, armed, dataclasses.replace(state, joints=joints), still(point)
    )
    _, lone = fleet_of(alone, [p])
    world = environment([], [(SPHERE, [0.1, 0.0, 0.0], STATIC)], 1)
    want = quickly(detect_contacts)(world, alone, lone, still(point)).clearance_m[0]
    assert contact.clearance_m[1] == want


def test_arms_of_two_robots_meet(armed):
    """Two robots face each other; their arms touch where their hulls are apart."""
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    home = jnp.array([joint.home for joint in config.find_joints()])
    vehicles = jax.tree.map(lambda leaf: leaf[jnp.array([0, 0])], armed)
    _, state = fleet_of(vehicles, [[0.0, 0.0, -8.0], [1.05, -0.22, -8.0]])
    facing = jnp.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    joints = JointMotion(position=jnp.stack([home, home]), velocity=jnp.zeros((2, 5)))
    state = dataclasses.replace(state, q=facing, joints=joints)
    contact = quickly(detect_contacts)(environment([], [], 2), vehicles, state, still([]))
    bare = quickly(detect_contacts)(
        environment([], [], 2), vehicles, dataclasses.replace(state, joints=None), still([])
    )
    assert contact.separation_m[0] < 0.0 < bare.separation_m[0]
    assert contact.nearest[0] == Touched.ROBOT


def test_radii_hold_the_arm_at_home_and_as_it_lies(armed):
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    home = np.array([joint.home for joint in config.find_joints()])
    lower, upper = (
        np.array([getattr(joint, end) for joint in config.find_joints()])
        for end in ("lower", "upper")
    )
    positions = lower + (upper - lower) * np.random.default_rng(2).random((4000, 5))
    positions[0] = home
    vehicles = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], (4000, *leaf.shape[1:])), armed)
    hulls = quickly(hull_capsules)(vehicles, jnp.asarray(positions))
    radii = np.asarray(bounding_radii(vehicles, hulls))
    a, b, r = map(np.asarray, hulls)
    ends = np.maximum(np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1))
    np.testing.assert_allclose(radii, np.max(ends + r, axis=1), rtol=1e-6)
    assert radii[0] == pytest.approx(float(armed.radius_m[0]), rel=1e-6)
    assert radii[0] == pytest.approx(library.reach_m(config), rel=1e-6)
    assert 0.9 * max_link_reach_m(config) < radii.max() <= max_link_reach_m(config)
    heavy = library.load_vehicle("bluerov2_heavy")
    assert float(armed.radius_m[1]) == pytest.approx(library.reach_m(heavy))


def test_the_search_finds_arms_of_a_large_fleet(armed):
    """Beyond `ALL_PAIRS_UP_TO` robots; arms drawn out meet a metre and more from the centres."""
    n = detection.ALL_PAIRS_UP_TO + 2
    vehicles = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], (n, *leaf.shape[1:])), armed)
    rng = np.random.default_rng(4)
    _, state = fleet_of(vehicles, rng.uniform([-4, -4, -12], [4, 4, -4], (n, 3)))
    position = jnp.asarray(np.tile([3.1416, 1.6, 2.9, 0.0, 0.0], (n, 1)))
    joints = JointMotion(position=position, velocity=jnp.zeros((n, 5)))
    state = dataclasses.replace(state, joints=joints)
    found = quickly(detect_contacts)(environment([], [], n), vehicles, state, still([]))
    a, b, r = hull_capsules(vehicles, position)
    gap, _ = detection._nearest_of_all(a + state.p[:, None], b + state.p[:, None], r)
    np.testing.assert_allclose(found.separation_m, gap, atol=TOLERANCE_M)
