"""Compiled checks of teams with arms against coal and Pinocchio, state by state."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario

pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
pytest.importorskip("coal", reason="needs the extra plan: coal")
import pinocchio as pin

from angler_mjx.planning.host.arm_checks import ArmChecker, _describe_joints
from angler_mjx.planning.host.ompl.arm_space import RESOLUTION_M, ArmSpace
from angler_mjx.planning.host.robots import PlannedRobot

TEAM = {
    "name": "team",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "world": {
        "preset": "open",
        "placement": "given",
        "shape": [6, 6, 6],
        "cell_m": 2.0,
        "depth_m": 2.0,
        "start_m": [[-3.0, -1.0, -8.0], [-3.0, 2.0, -8.0]],
        "goal_m": [[3.0, -1.0, -8.0], [3.0, 2.0, -8.0]],
        "obstacles": {
            "explicit": [
                {
                    "type": "box",
                    "position_m": [0.0, 0.0, -8.0],
                    "size_m": [0.8, 0.4, 1.2],
                    "rpy_deg": [20.0, -25.0, 50.0],
                },
                {"type": "sphere", "position_m": [1.5, 1.5, -7.5], "radius_m": 0.6},
                {
                    "type": "capsule",
                    "position_m": [-1.0, -2.0, -8.5],
                    "radius_m": 0.3,
                    "length_m": 1.0,
                    "rpy_deg": [40.0, 10.0, 0.0],
                },
            ]
        },
    },
    "task": {"type": "goal", "reached_by": "end_effector"},
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "count": 2}],
}


@pytest.fixture(scope="module")
def problem():
    """Two robots among obstacles of all shapes, and five cells of rock."""
    made = Simulator(Scenario.model_validate(TEAM)).problems(0, 1)[0]
    rock = np.zeros(np.shape(made.grid.occupied), bool)
    for cell in ((2, 2, 2), (2, 2, 3), (3, 4, 3), (4, 1, 2), (4, 2, 2)):
        rock[cell] = True
    return replace(made, grid=replace(made.grid, occupied=rock))


@pytest.fixture(scope="module")
def space(problem):
    return ArmSpace.build(problem, range(2), 0.05)


def sample(space, random, count):
    """Configurations [n, R, d]; robots are within 3 m of the middle, so that many of them touch."""
    q = random.uniform(space.lower, space.upper, (count, *space.start.shape))
    middle = 0.5 * (space.lower + space.upper)[:, :3]
    q[..., :3] = middle + random.uniform(-2.5, 2.5, q[..., :3].shape)
    return q


def test_states_are_those_of_coal(space):
    states = sample(space, np.random.default_rng(1), 3000)
    known = np.array([space.model.state(q.reshape(-1)) for q in states])
    compiled = np.array([space.checks.state(q) for q in states])
    assert 0.1 < known.mean() < 0.9
    # None of these configurations is nearer than rounding to a contact.
    differing = np.flatnonzero(known != compiled)
    assert all(abs(space.clearance(states[i])) < 1e-5 for i in differing)
    assert len(differing) <= 2


def test_edges_are_free_where_all_their_states_are(space):
    """At the states that the model of coal is asked for, although most are left out."""
    random = np.random.default_rng(2)
    free = [q for q in sample(space, random, 400) if space.state(q)]
    ends = [(a, a + random.uniform(0.02, 1.0) * (b - a)) for a, b in pairwise(free)]
    known = np.array([space._edge_by_model(a, b) for a, b in ends])
    compiled = np.array([space.edge(a, b) for a, b in ends])
    assert 0.05 < known.mean() < 0.95
    assert np.count_nonzero(known != compiled) <= 1
    path = np.array([free[0], *(end for pair in ends[:4] for end in pair)])
    legs = [space.edge(a, b) for a, b in pairwise(path)]
    assert space.path(path) == all(legs)


def test_a_hit_in_the_middle_of_a_long_edge_is_found(space):
    """Past the sphere and the box by a few centimetres, and through them."""
    a, b = space.start.copy(), space.start.copy()
    a[0, :3], b[0, :3] = [-2.5, 1.5, -7.5], [2.9, 1.5, -7.5]
    a[1, :3] = b[1, :3] = [-2.5, -2.5, -10.5]
    assert space.state(a)
    assert space.state(b)
    assert not space.edge(a, b)
    for height_m, is_free in ((1.2, True), (0.75, False)):
        over_a, over_b = a.copy(), b.copy()
        over_a[0, 2], over_b[0, 2] = a[0, 2] + height_m, b[0, 2] + height_m
        assert space.edge(over_a, over_b) is is_free
        assert space._edge_by_model(over_a, over_b) is is_free


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_not_free(space, value):
    for column in (0, 3, 6):
        q = space.start.copy()
        q[0, column] = value
        assert not space.state(q)
        assert not space.edge(space.start, q)


def test_points_of_another_shape_are_refused(space):
    with pytest.raises(ValueError, match="must be"):
        space.path(np.zeros((2, 1, 9)))


def test_moving_obstacles_are_left_to_the_model(problem):
    moves = np.asarray(problem.obstacles.moves).copy()
    moves[1] = True
    moving = replace(problem, obstacles=replace(problem.obstacles, moves=moves))
    space = ArmSpace.build(moving, range(2), 0.05)
    assert space.checks is None
    assert space.state(space.start)


def test_arms_of_other_joints_and_bodies():
    """A prismatic joint about a tilted axis is read off; other joints are refused by name."""
    axis = np.array([0.6, 0.0, 0.8])
    model = pin.Model()
    placement = pin.SE3(pin.utils.rotate("x", 0.4), np.array([0.1, 0.2, 0.3]))
    slide = model.addJoint(0, pin.JointModelPrismaticUnaligned(axis), placement, "slide")
    model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    kinds, numbers = _describe_joints(model)
    np.testing.assert_array_equal(kinds, [[2, -1, 0], [1, 0, 1]])
    np.testing.assert_allclose(numbers[:, 12:], [axis, [0.0, 1.0, 0.0]], atol=1e-12)
    model.addJoint(0, pin.JointModelFreeFlyer(), placement, "free")
    with pytest.raises(TypeError, match="joint 'free'"):
        _describe_joints(model)


def test_robots_without_arms_are_checked_too(problem):
    ball = PlannedRobot.from_radius(0.3)
    levers = np.tile([1.0, 1.0, 1.0, 0.3], (2, 1))
    checks = ArmChecker([ball, ball], problem, levers, RESOLUTION_M)
    apart = np.array([[2.5, -2.5, -10.5, 0.0], [2.5, -1.8, -10.5, 0.0]])
    assert checks.state(apart)
    near = apart.copy()
    near[1, 1] = -1.91
    assert not checks.state(near)
