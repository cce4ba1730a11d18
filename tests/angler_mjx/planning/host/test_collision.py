"""The team's model by Pinocchio and coal, beside the distances that the simulation judges by."""

import pytest

pytest.importorskip("numba", reason="needs the extra plan (numba)")
pytest.importorskip("coal", reason="needs the extra plan (coal)")
pytest.importorskip("pinocchio", reason="needs the extra plan (pin)")

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin

from angler_kernels import clearance
from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.collision import TeamModel
from angler_mjx.planning.host.compiled.advancing import TOLERANCE_M
from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.hulls import HullChecker
from angler_mjx.planning.host.robots import PlannedRobot, build_arm
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.params import build_vehicle

from ...compiling import quickly
from ...link_poses import locate_by_mujoco
from . import scenes


@pytest.fixture(scope="module")
def world():
    return scenes.reef(7, (1.0, 0.7, 1.3))


@pytest.fixture(scope="module")
def model(world):
    return TeamModel.from_problem(world)


def poses(world, n, seed=0):
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-np.pi, np.pi, (n, world.robots, 1))
    return np.concatenate([scenes.places(world, rng, n), turn], axis=-1)


def simulated(world):
    """Distance [n] of teams [n, R, 4] to anything, by the kernels that the simulation judges by."""
    grid, known, team = world.grid, world.obstacles, world.team
    low, high = scenes.corners(world)
    low[2] = max(low[2], float(world.floor_z_m))

    def placed(pose, a, b):
        c, s = jnp.cos(pose[3]), jnp.sin(pose[3])
        turn = jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return a @ turn.T + pose[:3], b @ turn.T + pose[:3]

    def one(pose, a, b, r):
        rock = clearance.capsules_grid(a, b, r, pose[:3], grid.occupied, grid.origin_m, grid.cell_m)
        to_body = jax.vmap(clearance.capsules_obstacle, (None, None, None, 0, 0, 0, 0))
        bodies = to_body(a, b, r, known.p_m[:, 0], known.q[:, 0], known.kind, known.half_size_m)
        ends = jnp.concatenate([a, b])
        sides = jnp.minimum(ends - low, high - ends) - jnp.concatenate([r, r])[:, None]
        return jnp.minimum(rock, jnp.min(sides)), jnp.min(bodies, initial=jnp.inf)

    def team_of(pose):
        a, b = jax.vmap(placed)(pose, team.capsule_a_m, team.capsule_b_m)
        r = jnp.asarray(team.capsule_r_m)
        i, j = np.triu_indices(world.robots, 1)
        pairs = jax.vmap(clearance.capsules_capsules)(a[i], b[i], r[i], a[j], b[j], r[j])
        return jnp.min(jnp.stack([*map(jnp.min, jax.vmap(one)(pose, a, b, r)), jnp.min(pairs)]))

    return quickly(jax.vmap(team_of))


def agree(world, model, n, seed):
    """How far coal and the kernels are apart on n states, and in how many they were compared."""
    rows = poses(world, n, seed)
    with jax.enable_x64(True):
        theirs = np.asarray(simulated(world)(rows))
    ours = np.array([model.clearance(model.q(row)) for row in rows])
    # The kernels' distance to cells ends at a cell's edge less the hull's radius.
    cap = float(world.grid.cell_m) - world.team.radius_m.max() - 1e-9
    asked = (theirs > 0.0) & (theirs < cap)
    assert ((ours > 0.0) == (theirs > 0.0)).all()
    assert (ours[theirs >= cap] >= cap).all()
    return np.abs(ours - theirs)[asked].max(), asked.sum()


def test_coal_and_the_kernels_agree_on_clearances(world, model):
    far, compared = agree(world, model, 1500, 1)
    assert compared > 200
    assert far < 1e-5


@pytest.mark.nightly(by="test_coal_and_the_kernels_agree_on_clearances")
def test_coal_and_the_kernels_agree_on_a_hundred_thousand_clearances():
    world = scenes.reef(13, (0.8, 0.8, 0.6, 0.6), n=16, share=0.06, cell_m=1.5)
    far, compared = agree(world, TeamModel.from_problem(world), 100_000, 2)
    assert compared > 10_000
    print(f"{compared} of 100,000 compared, at most {far:.3g} m apart")
    assert far < 1e-5


def test_a_state_is_free_where_its_clearance_is_positive(world, model):
    rows = [model.q(row) for row in poses(world, 600, 3)]
    free = [model.state(q) for q in rows]
    assert free == [model.clearance(q) > 0.0 for q in rows]
    assert 0.1 < np.mean(free) < 0.9


def test_balls_of_the_model_have_the_clearance_of_the_compiled_check(world):
    balls = TeamModel([PlannedRobot.from_radius(r) for r in world.team.radius_m], world)
    rows = poses(world, 600, 4)
    compiled = EdgeChecker(world).clearances(rows[..., :3])
    coals = np.array([balls.clearance(balls.q(row)) for row in rows])
    assert np.abs(compiled - coals)[compiled > 0.0].max() < 1e-5
    assert ((compiled > 0.0) == (coals > 0.0)).all()


def test_hulls_have_the_clearance_of_the_compiled_check(world, model):
    rows = poses(world, 600, 5)
    compiled = HullChecker(world).clearances(rows)
    coals = np.array([model.clearance(model.q(row)) for row in rows])
    exact = (coals > 0.0) & (coals < world.team.radius_m.min())
    assert exact.sum() > 100
    assert np.abs(compiled - coals)[exact].max() < 1e-5
    assert (compiled[coals > 0.0] < coals[coals > 0.0] + 1e-5).all()
    assert ((compiled > 0.0) == (coals > 0.0)).all()


def hull_edges(world, checker, n):
    """Edges from free states, [n, R, 4] each; turns of up to 2 rad."""
    rng = np.random.default_rng(9)
    a = poses(world, 40 * n, 6)
    a = a[checker.states(a)][:n]
    b = a + rng.uniform(-2.0, 2.0, a.shape)
    b[..., :3] = scenes.steps(rng, a[..., :3], 0.0, 1.0)
    return a, b


def test_no_edge_of_hulls_is_called_free_that_touches(world, model):
    checker = HullChecker(world)
    a, b = hull_edges(world, checker, 1000)
    free = checker.edges(a, b)
    balls = EdgeChecker(world).edges(a[..., :3], b[..., :3])
    assert not (balls & ~free).any()
    assert 0.1 < free.mean() < 0.9
    assert free.sum() > balls.sum()
    tight = np.flatnonzero(free & ~balls)[:40]
    assert all(model.edge(model.q(a[i]), model.q(b[i]), 0.05) for i in tight)
    # What is called hit comes within the tolerance somewhere, but for what samples miss.
    least = np.full(len(a), np.inf)
    for share in np.linspace(0.0, 1.0, 201):
        least = np.minimum(least, checker.clearances(a + share * (b - a)))
    assert (least[~free] < TOLERANCE_M + 0.01).all()


def test_a_hull_turns_where_its_sphere_does_not_fit():
    occupied = np.zeros((5, 5, 5), bool)
    occupied[:, 3], occupied[:, 1] = True, True  # A corridor 1 m wide, 0.76 of it for the sphere.
    world = scenes.problem(occupied, cell_m=0.55, scale=(1.0,))
    r = float(world.team.radius_m[0])
    middle = 2.5 * 0.55
    assert r > 0.5 * 0.55
    along, across = ([[middle, middle, middle, yaw]] for yaw in (0.0, 0.5 * np.pi))
    checker = HullChecker(world)
    assert not EdgeChecker(world).state([along[0][:3]])
    assert checker.state(along)
    assert not checker.state([[middle, middle + 0.1, middle, 0.0]])
    assert checker.edge(along, across) is TeamModel.from_problem(world).edge(
        np.array(along[0]), np.array(across[0]), 0.001
    )


def test_the_model_names_what_is_nearest_and_where():
    occupied = np.zeros((6, 6, 6), bool)
    occupied[4, 2, 3] = True
    world = scenes.problem(occupied, cell_m=2.0, scale=(1.0, 1.0))
    model = TeamModel([PlannedRobot.from_radius(0.4), PlannedRobot.from_radius(0.3)], world)
    found = model.nearest(model.q([[7.0, 5.0, 7.0, 0.0], [3.0, 9.0, 3.0, 0.0]]))
    assert (found.name_a, found.name_b) == ("robot_0_capsule_0", "cell_4_2_3")
    assert found.distance_m == pytest.approx(0.6)
    assert found.point_a_m == pytest.approx([7.4, 5.0, 7.0])
    assert found.point_b_m == pytest.approx([8.0, 5.0, 7.0])
    found = model.nearest(model.q([[5.0, 5.0, 5.0, 0.0], [5.0, 6.0, 5.0, 0.0]]))
    assert {found.name_a, found.name_b} == {"robot_0_capsule_0", "robot_1_capsule_0"}
    assert found.distance_m == pytest.approx(0.3)
    found = model.nearest(model.q([[5.0, 0.9, 5.0, 0.0], [3.0, 9.0, 3.0, 0.0]]))
    assert (found.name_b, found.distance_m) == ("south", pytest.approx(0.5))


def test_what_is_deep_in_rock_is_not_free():
    occupied = np.zeros((9, 9, 9), bool)
    occupied[2:7, 2:7, 2:7] = True
    world = scenes.problem(occupied, cell_m=1.0)
    model = TeamModel.from_problem(world)
    middle = model.q([[4.5, 4.5, 4.5, 0.0]])
    assert sum(name.startswith("cell") for name in model._names) == 5**3 - 3**3
    assert not model.state(middle)
    assert model.clearance(middle) == -np.inf
    assert model.nearest(middle).name_b == "rock"


def test_obstacles_are_where_they_are_known_to_be_at_a_time():
    way = [[2.0, 5.0, 5.0], [8.0, 5.0, 5.0]]
    world = scenes.problem(
        np.zeros((5, 5, 5)),
        cell_m=2.0,
        bodies=[scenes.body("sphere", (0.5, 0.0, 0.0), way, moves=True)],
        time_s=(0.0, 6.0),
    )
    model = TeamModel([PlannedRobot.from_radius(0.4)], world)
    q = model.q([[5.0, 5.0, 5.0, 0.0]])
    expected = {0.0: 2.1, 2.0: 0.1, 3.0: -0.9, 6.0: 2.1, 60.0: 2.1}
    for time_s, distance in expected.items():
        model.at(time_s)
        assert model.clearance(q) == pytest.approx(distance, abs=1e-6)
        assert model.state(q) is (distance > 0.0)


def arm():
    """One link, 1 m along x, that turns about the vertical axis of its own base."""
    own, bodies = pin.Model(), pin.GeometryModel()
    joint = own.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "shoulder")
    turn = pin.SE3(scenes.rotation([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]), np.array([0.5, 0, 0]))
    bodies.addGeometryObject(pin.GeometryObject("link", joint, turn, coal.Capsule(0.05, 1.0)))
    return own, bodies


def test_an_arm_adds_its_joints_and_bodies_to_its_robot():
    occupied = np.zeros((6, 6, 6), bool)
    occupied[4, 2, 2] = True
    world = scenes.problem(occupied, cell_m=2.0)
    ball = dict(
        capsule_a_m=np.zeros((1, 3)), capsule_b_m=np.zeros((1, 3)), capsule_r_m=np.array([0.3])
    )
    model = TeamModel([PlannedRobot(**ball, arm=arm()), PlannedRobot(**ball)], world)
    assert model.model.nq == 4 + 1 + 4
    q = model.q([[6.5, 5.0, 5.0, 0.0], [3.0, 3.0, 3.0, 0.0]])
    assert list(q) == [6.5, 5.0, 5.0, 0.0, 0.0, 3.0, 3.0, 3.0, 0.0]
    found = model.nearest(q)
    assert (found.name_a, found.name_b) == ("robot_0_link", "cell_4_2_2")
    assert found.distance_m == pytest.approx(0.45, abs=1e-6)
    q[4] = np.pi
    assert model.nearest(q).name_a == "robot_0_capsule_0"
    q[3] = np.pi  # The robot turned about brings the arm back.
    assert model.nearest(q).name_a == "robot_0_link"


def armed_team(posture, *, fixed):
    """The shipped arm in a posture, by its joints or fixed, and a small robot far away."""
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    vehicle = build_vehicle(config, None, 16.0)
    robot = (
        PlannedRobot.of(vehicle, joints=posture)
        if fixed
        else PlannedRobot.of(vehicle, arm=build_arm(config))
    )
    return config, [robot, PlannedRobot.from_radius(0.1)]


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("posture", [(3.1416, 0.01, 1.5708, 0.0, 0.0), (4.0, 1.5, 2.7, 0.5, 0.01)])
def test_links_of_a_vehicle_file_are_bodies_in_their_posture(posture, fixed):
    config, robots = armed_team(posture, fixed=fixed)
    p, heading = np.array([5.0, 5.0, 5.0]), 0.7
    turn = np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)])
    poses = locate_by_mujoco(config, p, turn, posture)
    point = p + 1.7 * (poses["jaws"][0] - p)
    ball = scenes.body("sphere", (0.05, 0.0, 0.0), point)
    model = TeamModel(robots, scenes.problem(np.zeros((5, 5, 5)), cell_m=2.0, bodies=[ball]))
    q = model.q([[*p, heading], [1.0, 1.0, 1.0, 0.0]], None if fixed else [posture, ()])
    gaps = []
    for link in config.links:
        origin, rotation = poses[link.name]
        for capsule in link.capsules:
            a, b = (origin + rotation @ np.array(end) for end in (capsule.from_m, capsule.to_m))
            along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            gaps.append(np.linalg.norm(point - a - along * (b - a)) - capsule.radius_m - 0.05)
    nearest = model.nearest(q)
    assert nearest.distance_m == pytest.approx(min(gaps), abs=1e-5)
    assert nearest.name_b == "obstacle_0"
    assert fixed or nearest.name_a.startswith("robot_0_link/")


def test_the_turning_of_an_edge_counts_with_its_arm_drawn_out():
    """The reach that edges are sampled by holds bodies in any posture, and no more than needed."""
    _, robots = armed_team((), fixed=False)
    team = TeamModel(robots, scenes.problem(np.zeros((5, 5, 5)), cell_m=2.0))
    lower, upper = team.model.lowerPositionLimit[4:9], team.model.upperPositionLimit[4:9]
    postures = np.random.default_rng(3).uniform(lower, upper, (2000, 5))
    items = team.geometry.geometryObjects
    data, placed = team.model.createData(), pin.GeometryData(team.geometry)
    reach = []
    for posture in postures:
        q = team.q([[0.0, 0.0, 0.0, 0.0], [9.0, 9.0, 9.0, 0.0]], [posture, ()])
        pin.updateGeometryPlacements(team.model, data, team.geometry, placed, q)
        rows = [i for i, item in enumerate(items) if item.name.startswith("robot_0_")]
        centres = np.array([placed.oMg[i].translation for i in rows])
        reach.append(np.max(np.hypot(*centres[:, :2].T) + team._radius[rows]))
    assert 0.85 * team._reach[0] < np.max(reach) <= team._reach[0]


def test_joints_of_an_arm_have_the_limits_and_the_order_of_the_file():
    config, robots = armed_team((), fixed=False)
    model = TeamModel(robots, scenes.problem(np.zeros((5, 5, 5)), cell_m=2.0)).model
    names = [f"robot_0_joint/{joint.name}" for joint in config.find_joints()]
    assert list(model.names)[3:8] == names
    lower, upper = model.lowerPositionLimit[4:9], model.upperPositionLimit[4:9]
    np.testing.assert_allclose(lower, [joint.lower for joint in config.find_joints()])
    np.testing.assert_allclose(upper, [joint.upper for joint in config.find_joints()])


def test_a_team_without_robots_is_refused(world):
    with pytest.raises(ConfigError, match="one robot at least"):
        TeamModel([], world)


def test_hulls_come_from_vehicle_files():
    vehicles = [
        build_vehicle(library.load_vehicle(name), None, 16.0)
        for name in ("bluerov2", "bluerov2_heavy")
    ]
    world = scenes.problem(np.zeros((5, 5, 5)), cell_m=2.0)
    model = TeamModel([PlannedRobot.of(vehicle) for vehicle in vehicles], world)
    # On its axis to the north each is as wide as its widest capsule reaches to its left.
    wide = [
        float(np.max(np.maximum(v.capsule_a_m[:, 1], v.capsule_b_m[:, 1]) + v.capsule_r_m))
        for v in vehicles
    ]
    assert wide[0] < wide[1]
    for robot, reach in enumerate(wide):
        rows = np.array([[3.0, 5.0, 5.0, 0.0], [7.0, 5.0, 5.0, 0.0]])
        rows[robot, 1] = 9.5
        found = model.nearest(model.q(rows))
        assert (found.name_a[:7], found.name_b) == (f"robot_{robot}", "north")
        assert found.distance_m == pytest.approx(0.5 - reach, abs=1e-6)
