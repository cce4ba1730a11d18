"""Scenarios in which end effectors hold a body: starts, and what is refused."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.world.materials import find_material

from ..link_poses import locate_by_mujoco


def locate_tip(start_m, yaw_rad):
    """Return the end effector [3], m in W, of the shipped arm at home, by MuJoCo's kinematics."""
    config = load_vehicle("bluerov2_heavy_alpha5")
    home = [joint.home for joint in config.find_joints()]
    q = [np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]
    origin, turn = locate_by_mujoco(config, start_m, q, home)[config.end_effector.link]
    return origin + turn @ config.end_effector.position_m


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, -150.0])
def test_robots_start_and_end_with_their_end_effectors_at_the_body(turn_deg):
    """They head for their goals at the start, as all robots do, and turn with the body."""
    world = load_scenario("carry_arms", task={"turn_deg": turn_deg}).world
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    for i, along in enumerate((-1.2, 1.2)):
        way = np.subtract(world.goal_m[i], world.start_m[i])
        yaw = np.arctan2(way[1], way[0])
        at_start = locate_tip(world.start_m[i], yaw)
        np.testing.assert_allclose(at_start, [-1.0 + along, -3.0, -6.0], atol=1e-6)
        at_goal = locate_tip(world.goal_m[i], yaw + np.radians(turn_deg))
        np.testing.assert_allclose(at_goal, [1.0 + along * c, 3.0 + along * s, -9.0], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fleet": [{"vehicle": "bluerov2_heavy", "count": 2}]}, r"no table \[end_effector\]"),
        (
            {"task": {"offset_m": [0.0, 0.0, 0.3]}},
            "grip 0 is 0.27 m from the surface of the body; grip 1 is 0.27 m",
        ),
        (
            {"task": {"grips_m": [[0.0, 0.0, 0.0], [1.26, 0.0, 0.0]]}},
            "grip 1 is 0.03 m from the surface",
        ),
        (
            {
                "controller": {
                    "stages": ["follow", "pose", "velocity", "cargo_wrench", "pseudo_inverse"]
                }
            },
            "'cargo_wrench' knows a load below the robot.*take the stage grip_moment",
        ),
        (
            {
                "task": {
                    "grips_m": [[-0.28, 0.0, 0.0], [0.28, 0.0, 0.0]],
                    "turn_deg": 109.0,
                    "to_m": [-0.7, -3.05, -6.32],
                }
            },
            "no heading of the robots",
        ),
        (
            {"task": {"closing_force_n": 9.0}},
            "task.break_force_n, task.closing_force_n: a weld breaks and jaws slip",
        ),
        ({"task": {"jaw_m": 0.1}}, "task.jaw_m: of jaws; give task.closing_force_n"),
        ({"task": {"max_slip_m": 0.1}}, "task.max_slip_m: of jaws; give task.closing_force_n"),
        (
            {"task": {"closing_force_n": 9.0, "hold": "hull", "break_force_n": None}},
            'closing_force_n: jaws are those of end effectors; give task.hold = "end_effector"',
        ),
    ],
)
def test_what_end_effectors_cannot_hold_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        load_scenario("carry_arms", **changes)


def test_boxes_are_held_at_their_faces():
    box = {
        "type": "box",
        "size_m": [1.0, 0.4, 0.2],
        "position_m": [0.0, 0.0, -6.0],
        "rpy_deg": [0.0, 0.0, 90.0],
        "motion": {"type": "drift"},
    }
    world = {"obstacles": {"explicit": [box]}}
    load_scenario(
        "carry_arms", world=world, task={"grips_m": [[0.0, 0.51, 0.0], [0.0, -0.51, 0.0]]}
    )
    with pytest.raises(ConfigError, match=r"grip 1 is 0\.31 m"):
        load_scenario(
            "carry_arms", world=world, task={"grips_m": [[0.0, 0.51, 0.0], [-0.51, 0.0, 0.0]]}
        )


def test_the_digest_of_hulls_is_that_from_before():
    scenario = load_scenario("carry_pipe")
    assert "hold" not in scenario.task.problem_table()
    assert load_scenario("carry_pipe", task={"hold": "hull"}).digest() == scenario.digest()
    assert load_scenario("carry_arms").task.problem_table()["hold"] == "end_effector"


def test_jaws_hold_by_the_friction_of_the_materials():
    """HDPE and PVC, the geometric mean of their coefficients."""
    task = {"closing_force_n": 40.0, "jaw_m": 0.03, "max_slip_m": 0.2, "break_force_n": None}
    scenario = load_scenario("carry_arms", task=task)
    grip = scenario.sim_spec().contact.grip
    friction = np.sqrt(find_material("hdpe").friction * find_material("pvc").friction)
    np.testing.assert_allclose(
        grip.friction_limits,
        [2 * friction * 40, 40.0, 2 * friction * 40, 1.2, 2 * friction * 40 * 0.02, 1.2],
    )
    assert grip.max_slip_m == 0.2
    assert "jaw_m" in scenario.task.problem_table()
    assert not {"jaw_m", "max_slip_m"} & load_scenario("carry_arms").task.problem_table().keys()
