"""A session over a world whose plans have headings and velocities, and its recording."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands.joint_trajectory import CUBIC, JointTrajectory, from_path
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.testing.driving import heading, heading_difference, make_pose, position, run_steps

YAW, POINTS = 1.0, 300
"""Headings of all plans, whichever way they go; more points than sessions take by themselves."""


def cubics(path, yaw):
    """Way-points as cubics, slow at every point, with one heading from the first to the last."""
    made = from_path(path, yaw)
    velocities = jnp.diff(path.position_m, axis=0) / jnp.diff(path.time_s)[:, None]
    rate = jnp.pad(jnp.where(jnp.isfinite(velocities), velocities, 0.0), ((0, 1), (0, 1)))
    return replace(
        made,
        position=made.position.at[:, 3].set(YAW),
        velocity=(0.8 * rate).at[-1].set(0.0),
        degree=jnp.full_like(made.degree, CUBIC),
    )


@pytest.fixture(scope="module")
def sampled(calm):
    """A session of two Heavies with such plans."""
    planned = Simulator.worlds

    def worlds(self, first=0, *, seed=None):
        made = planned(self, first, seed=seed)
        more = [(0, 0), (0, 0), (0, POINTS - made.path.time_s.shape[2])]
        path = replace(
            made.path,
            time_s=jnp.pad(made.path.time_s, more, mode="edge"),
            position_m=jnp.pad(made.path.position_m, [*more, (0, 0)], mode="edge"),
        )
        joints = jax.vmap(jax.vmap(cubics))(path, made.environment.start_yaw_rad)
        return replace(made, path=jax.device_put(joints, made.variant.sharding))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulator, "worlds", worlds)
        file = calm("bluerov2_heavy")
        yield BatchSession(file, engine="fused"), file


@pytest.mark.nightly(by="session/test_plan.py; engines/test_plans.py")
def test_robots_fly_them_leave_them_and_take_them_up_again(sampled, tmp_path):
    session, file = sampled
    begin = session.reset()
    path = session.inside().worlds.path
    assert isinstance(path, JointTrajectory)
    assert {status.command for status in begin.status} == {"plan"}
    with SessionRecording(tmp_path / "run", load_scenario(file), 0) as recording:
        recording.begin(session)

        def fly(seconds, orders=None):
            seen = []
            for _ in range(round(seconds / session.dt_s)):
                seen.append(session.step(orders))
                recording.after(seen[-1])
                orders = None
            return seen

        now = fly(8.0)[-1]
        assert heading_difference(heading(now, 0), YAW) < 0.1
        aside = position(now, 0) + np.array([0.0, 0.0, -1.0])
        fly(5.0, {0: make_pose(aside, YAW + 1.5)})
        session.resume_plan(0)
        back = fly(6.0)
        assert [status.command for status in back[-1].status] == ["plan", "plan"]
        assert heading_difference(heading(back[-1], 0), YAW) < 0.1
        # What is left of the longer plan, and what the way back and the wait took.
        rest = fly(float(path.time_s.max()))
        assert {status.outcome for status in rest[-1].status} == {Outcome.REACHED}
        made = recording.close(RecordedCourse(steps=980, wall_s=1.0, compile_s=0.0, more={}))
    np.testing.assert_array_equal(
        made.trajectories["plan_velocity"][0], np.asarray(path.velocity)[0]
    )
    np.testing.assert_array_equal(made.trajectories["plan_yaw_rad"][0], np.float32(YAW))


@pytest.mark.nightly(by="session/test_plan.py")
def test_a_joint_order_joins_the_plan_without_a_step(sampled):
    """A JointTrajectory that comes in mid-plan begins where the plan has the robot."""
    session, _ = sampled
    session.reset()
    before = run_steps(session, 6.0)[-1]
    p = position(before, 0)
    order = jax.tree.map(lambda leaf: np.asarray(leaf)[0, 0], session.inside().worlds.path)
    stay = replace(
        order, position=np.tile([*p, YAW], (POINTS, 1)), velocity=0 * np.asarray(order.velocity)
    )
    after = session.step({0: stay})
    assert not after.status[0].refused
    assert np.linalg.norm(np.asarray(after.target_m)[0] - np.asarray(before.target_m)[0]) < 0.06
