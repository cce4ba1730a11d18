"""The simulator's session: what every session must do, and what it does beyond that.

And the suite of all sessions finds those that are broken on purpose. In one file, so that the
session is compiled once.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    as_tracking,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint, build_trajectory
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, from_path
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.state_view import apply_belief, belief_covariance, view_state
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import Outcome
from angler_mjx.testing import CHECKS, Bounds, NonConformanceError, check_session
from angler_mjx.testing.driving import heading, make_pose, make_twist, position, run_steps

from .broken import broken


def every_kind(session):
    """An order of each type that robot 0 can follow from where it is."""
    now = session.observe()
    p, yaw = position(now, 0), heading(now, 0)
    path = Trajectory(
        time_s=np.array([0.0, 4.0]),
        position_m=np.array([p, p + np.array([0.5, 0, 0])]),
        found=np.array(True),
    )
    goal = JointGoal(
        joint_names=("x", "yaw"), points=(JointPoint(time_s=4.0, positions=(p[0] + 0.5, yaw)),)
    )
    here = make_pose(p, yaw)
    return [
        path,
        from_path(path, np.array(yaw)),
        build_trajectory(goal, joints=VEHICLE_JOINTS, position=[*p, yaw]),
        goal,
        here,
        as_tracking(here),
        make_twist(0.1, 0, 0, 0, 0, 0),
        BodyWrench(tau=np.array([5.0, 0, 0, 0, 0, 0])),
        ThrusterPwm(pwm_us=np.full(8, 1520.0)),
    ]


def test_nobody_told_anything_robots_fly_the_planners_paths(heavies):
    """As if they were told the paths of the world that a run would fly."""
    heavies.reset()
    inside = heavies.inside()
    path = jax.tree.map(lambda leaf: np.asarray(leaf)[0], inside.worlds.path)
    start = np.asarray(inside.worlds.environment.start_m)[0]
    assert path.found.all()
    sent = {robot: jax.tree.map(lambda leaf, i=robot: leaf[i], path) for robot in (0, 1)}
    alone = [now.estimate.p for now in run_steps(heavies, 2.0)]
    heavies.reset()
    sent = [now.estimate.p for now in run_steps(heavies, 2.0, sent)]
    np.testing.assert_array_equal(sent, alone)
    assert np.linalg.norm(alone[-1] - start, axis=1).min() > 0.3
    for points, corners in zip(np.moveaxis(alone, 1, 0), path.position_m, strict=True):
        a, legs = corners[:-1], np.diff(corners, axis=0)
        along = np.sum((points[:, None] - a) * legs, axis=-1)
        share = np.clip(along / np.maximum(np.sum(legs**2, axis=-1), 1e-9), 0.0, 1.0)
        gap = np.linalg.norm(points[:, None] - a - share[..., None] * legs, axis=-1)
        # In still water, along a straight line.
        assert gap.min(axis=1).max() < 0.05


@pytest.mark.nightly(
    by="test_nobody_told_anything_robots_fly_the_planners_paths; control/test_mixed.py for how a "
    "command among many is chosen"
)
def test_it_is_the_same_world_as_that_of_a_run(heavies):
    """Nobody told anything else, robots fly as in `Simulator.step` along the planner's paths."""
    heavies.reset()
    inside = heavies.inside()
    simulator, state = inside.simulator, inside.simulator.reset(inside.worlds)
    for _ in range(40):
        state, _ = simulator.step(inside.worlds, state)
        now = heavies.step()
    p = np.asarray(state.vehicles.p)[0]
    assert np.linalg.norm(p - np.asarray(inside.worlds.environment.start_m)[0], axis=1).min() > 0.3
    # Two programs in float32: rounding of 1e-7 of 10 m, grown over 40 steps.
    np.testing.assert_allclose(now.estimate.p, p, atol=1e-4)


def test_no_command_compiles_anything(heavies, caplog):
    heavies.reset()
    orders = every_kind(heavies)
    with jax.log_compiles(), caplog.at_level("WARNING", logger="jax"):
        for order in orders:
            heavies.reset()
            status = heavies.step({0: order}).status[0]
            assert not status.refused
            heavies.step()
            heavies.resume_plan(0)
            heavies.step()
    messages = [record.getMessage() for record in caplog.records]
    assert not [text for text in messages if "XLA compilation" in text]


def test_each_robot_follows_its_own_kind(heavies):
    begin = heavies.reset()
    target = position(begin, 1) + np.array([0.4, 0.0, -0.3])
    end = run_steps(heavies, 8.0, {0: make_twist(0, 0, -0.1, 0, 0, 0), 1: make_pose(target, 0.5)})[
        -1
    ]
    assert [status.command for status in end.status] == ["BodyTwist", "PoseTarget"]
    np.testing.assert_allclose(end.estimate.nu[0][2], -0.1, atol=0.02)
    np.testing.assert_allclose(position(end, 1), target, atol=0.05)
    np.testing.assert_allclose(end.target_m[1], target, atol=1e-5)
    # What was asked for is what the thrusters settle at: nothing saturates here.
    np.testing.assert_allclose(end.demanded.tau, end.realised.tau, atol=0.2)


def test_signals_have_no_demand_and_are_what_is_sent(heavies):
    heavies.reset()
    signals = np.linspace(1450.0, 1550.0, 8)
    now = heavies.step({0: ThrusterPwm(pwm_us=signals)})
    np.testing.assert_allclose(now.pwm.pwm_us[0], signals)
    assert np.isnan(now.demanded.tau[0]).all()
    assert np.isfinite(now.demanded.tau[1]).all()


def test_a_seed_draws_another_world_and_none_the_scenarios_own(heavies):
    initial, other, again = heavies.reset(), heavies.reset(seed=8), heavies.reset()
    np.testing.assert_array_equal(initial.estimate.p, again.estimate.p)
    assert np.abs(initial.estimate.p - other.estimate.p).max() > 1.0


def goal_x(t, x, stamp_s=0.0):
    point = JointPoint(time_s=t, positions=(float(x),), velocities=(0.0,), accelerations=(0.0,))
    return JointGoal(joint_names=("x",), points=(point,), stamp_s=stamp_s)


def test_a_trajectory_of_later_begins_later(heavies):
    begin = heavies.reset()
    x = position(begin, 0)[0]
    hold = {0: make_pose(position(begin, 0), heading(begin, 0))}
    heavies.step(hold)
    seen = run_steps(heavies, 4.0, {0: goal_x(5.0, x + 1.0, stamp_s=2.0)})
    waiting = [now.status[0].command == "PoseTarget" for now in seen]
    assert waiting.index(False) == round(2.0 / heavies.dt_s) - 1
    assert all(abs(position(now, 0)[0] - x) < 0.05 for now in seen[: waiting.index(False)])
    end = run_steps(heavies, 8.0)[-1]
    assert abs(position(end, 0)[0] - x - 1.0) < 0.1


def test_of_a_trajectory_of_before_the_rest_is_followed(heavies):
    begin = heavies.reset()
    x = position(begin, 0)[0]
    run_steps(heavies, 4.0, {0: make_pose(position(begin, 0), heading(begin, 0))})
    points = tuple(JointPoint(time_s=t, positions=(x + 0.2 * t,)) for t in (1.0, 2.0, 6.0))
    goal = JointGoal(joint_names=("x",), points=points, stamp_s=1.0)
    end = run_steps(heavies, 3.5, {0: goal})[-1]
    # It ends 6 s after its stamp, that is 3 s from when it was given.
    assert end.status[0].note.startswith("SUCCESSFUL")
    old = JointGoal(joint_names=("x",), points=points, stamp_s=1e-3)
    messages = heavies.step({0: old}).status[0].refused
    assert "OLD_HEADER_TIMESTAMP" in messages


def test_a_robot_that_leaves_its_trajectory_holds_where_it_is(heavies):
    """At 1.5 m/s along a path, told to keep to it within half a metre, it falls behind."""
    begin = heavies.reset()
    x = position(begin, 0)[0]
    seen = run_steps(heavies, 6.0, {0: goal_x(3.0, x - 3.0)})
    notes = [now.status[0].note for now in seen]
    fell = next(i for i, note in enumerate(notes) if note.startswith("PATH_TOLERANCE_VIOLATED"))
    assert "joint 'x' is off by" in notes[fell]
    assert seen[fell].status[0].command == "hold"
    assert notes[fell] == notes[-1]
    moved = np.linalg.norm(position(seen[-1], 0) - position(seen[fell], 0))
    assert moved < 0.5 < np.linalg.norm(position(begin, 0) - position(seen[fell], 0))


def test_a_refused_robot_holds_where_it_was_refused_first(heavies):
    heavies.reset()
    bad = {0: make_twist(np.nan, 0, 0, 0, 0, 0)}
    first = heavies.step(bad)
    run_steps(heavies, 1.0, {0: make_twist(0.2, 0, 0, 0, 0, 0)})
    target = position(heavies.step(bad), 0)
    for _ in range(60):
        now = heavies.step(bad)
    assert np.linalg.norm(now.target_m[0] - target) < 0.02
    assert first.status[0].refused == now.status[0].refused


def test_a_robot_that_failed_takes_no_command(heavies):
    begin = heavies.reset()
    fast = {0: make_twist(2.0, 0, 0, 0, 0, 0)}
    heavies.step(fast)
    for _ in range(400):
        now = heavies.step()
        if now.status[0].outcome is not Outcome.RUNNING:
            break
    assert now.status[0].outcome is Outcome.OUT_OF_BOUNDS
    after = run_steps(heavies, 1.0, fast)[-1]
    assert "OUT_OF_BOUNDS" in after.status[0].refused
    np.testing.assert_array_equal(after.estimate.p[0], now.estimate.p[0])
    with pytest.raises(ConfigError, match="robot_0: cannot go on"):
        heavies.resume_plan(0)
    assert position(begin, 1).tolist() != position(after, 1).tolist()


def test_what_makes_no_sense_is_refused_before_anything_is_compiled(calm):
    path = calm("bluerov2")
    with pytest.raises(ConfigError, match="world = -1"):
        BatchSession(path, world=-1)
    with pytest.raises(ConfigError, match="engine = 'gazebo'"):
        BatchSession(path, engine="gazebo")


def test_commands_of_too_many_points_are_refused_with_the_number(heavies):
    begin = heavies.reset()
    p = position(begin, 0)
    points = tuple(JointPoint(time_s=1.0 + t, positions=(p[0],)) for t in range(300))
    with pytest.raises(ConfigError, match=r"robot_0: points: 300 of them.*at most 255"):
        heavies.check(0, JointGoal(joint_names=("x",), points=points))
    path = Trajectory(
        time_s=np.array([0.0, 1.0]), position_m=np.array([p, p + 9.0]), found=np.array(True)
    )
    with pytest.raises(ConfigError, match=r"position_m\[1\]: 15.6 m in 1 s"):
        heavies.check(0, path)
    fast = PoseTarget(position_m=p, velocity_mps=np.array([9.0, 0, 0]), yaw_rad=np.array(0.0))
    with pytest.raises(ConfigError, match="velocity_mps: 9 m/s"):
        heavies.check(0, fast)


def test_what_controllers_believe_is_the_estimate(heavies):
    """Their belief stands for the truth; its deviations are the diagonal of a covariance."""
    heavies.reset()
    view = look_again(heavies)
    turn = np.array([[np.cos(0.2), 0, 0, np.sin(0.2)], [1.0, 0, 0, 0]])
    belief = Belief(
        p=view.p[None] + 0.5,
        q=turn[None],
        nu=view.nu[None] - 0.1,
        flow=None,
        position_std_m=np.full((1, 2, 3), 0.1),
        velocity_std_mps=np.full((1, 2, 3), 0.2),
        attitude_std_rad=np.full((1, 2, 3), 0.3),
    )
    seen = apply_belief(view, belief)
    np.testing.assert_array_equal(seen.p, view.p + 0.5)
    np.testing.assert_allclose(seen.yaw_rad, [0.4, 0.0])
    np.testing.assert_array_equal(seen.clearance_m, view.clearance_m)
    expected = np.diag([0.01] * 3 + [0.09] * 3 + [0.04] * 3)
    np.testing.assert_allclose(belief_covariance(belief)[1], expected)
    assert apply_belief(view, None) is view
    assert belief_covariance(None) is None


def look_again(session):
    """The view of a session as it is now."""
    inside = session.inside()
    shape = (1, len(session.robots), 8)
    signals = np.full(shape, 1500.0, np.float32)
    return jax.device_get(view_state(inside.worlds, inside.state, signals, None))


def test_the_fused_engine_conforms(heavies, borrowed):
    results = check_session(lambda: borrowed(heavies))
    assert [result.name for result in results] == [check.name for check in CHECKS]
    assert not [result for result in results if result.skipped]


@pytest.mark.nightly(by="test_the_fused_engine_conforms")
def test_the_mjx_engine_conforms_with_another_vehicle(calm):
    """Six thrusters beside the eight of the other robot; this session is really closed."""
    results = check_session(
        lambda: BatchSession(calm("bluerov2"), engine="mjx"), bounds=Bounds(robot=1)
    )
    assert not [result for result in results if result.skipped]


@pytest.mark.parametrize("name", broken(object))
def test_the_suite_finds_what_is_broken(name, heavies, borrowed):
    faulty = broken(borrowed)[name]
    with pytest.raises(NonConformanceError, match=f"1 of 1 checks failed\n{name}: "):
        check_session(lambda: faulty(heavies), only={name})


def test_a_check_is_skipped_where_nothing_takes_its_command(heavies, borrowed):
    class NoTwists(borrowed):
        @property
        def robots(self):
            kept = [kind for kind in self._session.robots[0].accepts if kind is not BodyTwist]
            return [replace(robot, accepts=tuple(kept)) for robot in self._session.robots]

    (result,) = check_session(lambda: NoTwists(heavies), only={"commands_are_latched"})
    assert result.skipped == "robot_0 takes no BodyTwist"
