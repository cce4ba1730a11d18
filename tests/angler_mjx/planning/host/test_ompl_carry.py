"""OMPL on the manifold of a grasp: its constraint, and a gap that a pipe passes lengthwise."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.ompl.carry import Grasp, carrier_poses
from angler_mjx.planning.host.ompl.carry_planner import CarryOmplSettings, OmplCarry
from angler_mjx.robot.control import plans
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario

OFFSET = np.array([[-1.0, 0.2, 0.4], [1.0, -0.1, 0.4], [0.3, 0.5, 0.4]])
GAP_M = 1.5
START, GOAL = [0.0, -2.8, -6.0], [0.0, 2.8, -6.5]
LENGTH, RADIUS = 2.0, 0.05


def table(**planner):
    """Return two robots with a pipe of 2.1 m before a wall with a gap of 1.5 m."""
    half = 0.5 * (6.0 - 0.5 * GAP_M)
    walls = [
        {
            "type": "box",
            "position_m": [side * (6.0 - half), 0.0, -6.0],
            "size_m": [2.0 * half, 0.4, 9.0],
        }
        for side in (-1.0, 1.0)
    ]
    pipe = {
        "type": "capsule",
        "radius_m": RADIUS,
        "length_m": LENGTH,
        "position_m": START,
        "rpy_deg": [0.0, 90.0, 0.0],
        "mass_kg": 18.5,
        "motion": {"type": "drift"},
    }
    return {
        "name": "gap",
        "engine": "mjx",
        "contacts": True,
        "worlds": 1,
        "tile": 1,
        "seed": 2,
        "time": {"horizon_s": 90.0, "physics_dt_s": 0.01},
        "planner": {"name": "carry_ompl", "deadline_s": 30.0, **planner},
        "task": {"type": "carry", "offset_m": [0.0, 0.0, 0.55], "to_m": GOAL},
        "world": {
            "preset": "open",
            "shape": [8, 8, 6],
            "obstacles": {"explicit": [pipe, *walls]},
        },
        "fleet": [
            {
                "vehicle": "bluerov2_heavy",
                "parameter_set": "wu2018",
                "count": 2,
                "cruise_speed_mps": 0.4,
            }
        ],
    }


def paths(**planner):
    """Return the plans of both robots."""
    world = Simulator(Scenario.model_validate(table(**planner))).worlds()
    return jax.tree.map(lambda x: np.asarray(x)[0], world.path)


def test_the_grasp_holds_robots_where_a_rotation_has_them():
    rng = np.random.default_rng(0)
    grasp = Grasp(OFFSET)
    for _ in range(20):
        body = rng.normal(size=4) * 2.0
        turned = Rotation.from_euler("z", body[3]).apply(OFFSET)
        wanted = np.concatenate([body[:3] + turned, np.full((3, 1), body[3])], axis=1)
        np.testing.assert_allclose(carrier_poses(body, OFFSET), wanted, atol=1e-12)
        out = np.ones(12)
        grasp.function(np.concatenate([body, wanted.ravel()]), out)
        np.testing.assert_allclose(out, 0.0, atol=1e-12)


def test_the_derivative_of_the_grasp_is_that_by_differences():
    rng = np.random.default_rng(1)
    grasp, x = Grasp(OFFSET), rng.normal(size=16)
    found = np.full((12, 16), np.nan)
    grasp.jacobian(x, found)
    for column in range(16):
        step = 1e-6 * (np.arange(16) == column)
        more, less = np.zeros(12), np.zeros(12)
        grasp.function(x + step, more)
        grasp.function(x - step, less)
        np.testing.assert_allclose(found[:, column], (more - less) / 2e-6, atol=1e-8)


def test_a_pipe_is_turned_to_pass_a_gap_narrower_than_it_is_long():
    path = paths()
    assert path.found.all()
    time = np.linspace(0.0, path.time_s[0, -1], 600)
    states = [plans.joints_at(plans.of_robot(path, robot), time) for robot in range(2)]
    first, second = (np.asarray(state.position) for state in states)
    apart = second[:, :3] - first[:, :3]
    # Cubics between way-points leave the grasp by centimetres at most.
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), LENGTH, atol=0.03)
    heading = np.arctan2(apart[:, 1], apart[:, 0])
    turn = first[:, 3] - first[0, 3]
    np.testing.assert_allclose(np.cos(heading - turn), 1.0, atol=1e-3)
    middle = 0.5 * (first + second)[:, :3]
    np.testing.assert_allclose(middle[0], np.add(START, [0, 0, 0.55]), atol=1e-4)
    np.testing.assert_allclose(middle[-1], np.add(GOAL, [0, 0, 0.55]), atol=1e-4)
    # No point of the pipe or of a robot's ball is in the wall.
    along = np.linspace(-1.0, 1.0, 41)[:, None] * 0.5 * LENGTH
    pipe = middle[:, None] + along * (apart / np.linalg.norm(apart, axis=1)[:, None])[:, None]
    in_wall = np.abs(pipe[..., 1]) < 0.2 + RADIUS
    assert in_wall.any()
    assert np.all(np.abs(pipe[..., 0][in_wall]) < 0.5 * GAP_M - RADIUS)
    for robot in (first, second):
        passes = np.abs(robot[:, 1]) < 0.2
        assert passes.any()
        assert np.all(np.abs(robot[passes, 0]) < 0.5 * GAP_M - 0.32)
    speed = np.linalg.norm(np.diff(first[:, :3], axis=0), axis=1) / np.diff(time)
    assert speed.max() < 0.4 * 1.01
    assert not paths(name="carry").found.any()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"planner": "FMT"}, "planner = 'FMT': there is RRTConnect"),
        ({"time_limit_s": 0.0}, "time_limit_s = 0"),
    ],
)
def test_settings_are_checked(settings, text):
    with pytest.raises(ValueError, match=text):
        CarryOmplSettings(**settings)


def test_without_a_body_it_is_refused():
    scenario = table()
    del scenario["task"], scenario["contacts"]
    scenario["world"] |= {"placement": "given", "start_m": [[0, -3, -5], [2, -3, -5]]}
    scenario["world"] |= {"goal_m": [[0, 3, -5], [2, 3, -5]]}
    scenario["world"]["obstacles"] = {"explicit": []}
    with pytest.raises(ConfigError, match="carry"):
        Simulator(Scenario.model_validate(scenario | {"planner": {"name": "carry"}})).worlds()
    with pytest.raises(ConfigError, match="carry_ompl"):
        OmplCarry().plan(SimpleNamespace(cargo=None))
