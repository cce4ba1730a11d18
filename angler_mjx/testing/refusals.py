"""Checks of a session's refusals, and of its behaviour after them."""

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget, ThrusterPwm
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.runs.session.interface import Observation, Session, SessionCommand
from angler_mjx.testing.driving import (
    Bounds,
    NonConformanceError,
    Skipped,
    heading,
    make_pose,
    make_twist,
    position,
    refusal_reason,
    require,
    require_accepts,
    run_steps,
)


def bad_commands_are_refused(session: Session, bounds: Bounds) -> None:
    """Require that NaN, wrong shapes, excess speed, unknown joints and false times are refused."""
    begin = session.reset()
    robot = session.robots[bounds.robot]
    for label, order, value in _bad_commands(session, begin, bounds.robot):
        if type(order) not in robot.accepts:
            continue
        reason = refusal_reason(session, bounds.robot, order)
        require(bool(reason), f"{label} is not refused by check")
        for word in (robot.name, value):
            require(word in reason, f"{label}: {reason!r} does not name {word!r}")
        status = session.step({bounds.robot: order}).status[bounds.robot]
        require(value in status.refused, f"{label}: its status says refused = {status.refused!r}")
    good = make_pose(position(begin, bounds.robot), heading(begin, bounds.robot))
    if PoseTarget in robot.accepts:
        status = session.step({bounds.robot: good}).status[bounds.robot]
        require(not status.refused, f"after a good command it still says {status.refused!r}")


def _bad_commands(
    session: Session, now: Observation, robot: int
) -> list[tuple[str, SessionCommand, str]]:
    """Return labels, infeasible orders, and the texts that the refusal must name."""
    info, p, yaw = session.robots[robot], position(now, robot), heading(now, robot)
    count = len(info.thrusters)
    short, loud = as_leaf(np.zeros(5)), as_leaf(np.full(count, 2000.0))
    signals = np.full(count, 1500.0)
    hole = as_leaf(np.where(np.arange(count) == 0, np.nan, signals))
    return [
        ("a twist of NaN", make_twist(0.1, np.nan, 0, 0, 0, 0), "nan"),
        ("a twist of five numbers", BodyTwist(nu=short), "(5,)"),
        ("a twist at 50 m/s", make_twist(50.0, 0, 0, 0, 0, 0), "50"),
        ("a pose of NaN", make_pose(p * np.nan, yaw), "nan"),
        ("a signal of 2000 us", ThrusterPwm(pwm_us=loud), "2000"),
        ("a signal of NaN", ThrusterPwm(pwm_us=hole), "nan"),
        ("a signal too few", ThrusterPwm(pwm_us=as_leaf(signals[:-1])), f"({count - 1},)"),
        ("an unknown joint", _make_joint_goal("elbow", (2.0, 0.0)), "elbow"),
        ("times that go back", _make_joint_goal("x", (2.0, p[0]), (1.0, p[0])), "points[1]"),
        ("a point of NaN", _make_joint_goal("x", (2.0, np.nan)), "nan"),
        ("a start 40 m off", _make_joint_goal("x", (0.0, p[0] + 40.0), (90.0, p[0])), "points[0]"),
        ("a speed of 100 m/s", _make_joint_goal("x", (0.5, p[0] + 50.0)), "points[0]"),
    ]


def _make_joint_goal(joint: str, *rows: tuple[float, float]) -> JointGoal:
    """Return a JointTrajectory of one joint: times and positions."""
    points = tuple(JointPoint(time_s=t, positions=(float(x),)) for t, x in rows)
    return JointGoal(joint_names=(joint,), points=points)


def a_refused_robot_holds_and_others_go_on(session: Session, bounds: Bounds) -> None:
    """Require that a robot refused in flight holds its position, and that the others go on."""
    require_accepts(session, bounds.robot, BodyTwist)
    session.reset()
    others = [i for i in range(len(session.robots)) if i != bounds.robot]
    drive = {i: make_twist(bounds.speed_mps, 0, 0, 0, 0, 0) for i in (bounds.robot, *others[:1])}
    before = run_steps(session, 4.0, drive)[-1]
    nonsense = {bounds.robot: make_twist(np.nan, 0, 0, 0, 0, 0)}
    seen = run_steps(session, 6.0, nonsense)
    position_m = position(before, bounds.robot)
    for now in seen:
        distance_m = float(np.linalg.norm(position(now, bounds.robot) - position_m))
        require(
            distance_m <= bounds.hold_m, f"refused, it went {distance_m:.3g} m from where it was"
        )
        require(bool(now.status[bounds.robot].refused), "its status does not say that it refused")
    if not others:
        raise Skipped("a fleet of one has no others that could go on")
    status, other_position_m = seen[-1].status[others[0]], position(seen[-1], others[0])
    require(not status.refused, f"another robot says refused = {status.refused!r}")
    travelled_m = float(np.linalg.norm(other_position_m - position(before, others[0])))
    require(
        travelled_m > 3.0 * bounds.speed_mps,
        f"another robot, told {bounds.speed_mps} m/s, went {travelled_m:.3g} m in 6 s meanwhile",
    )


def robots_that_are_not_there_are_refused(session: Session, bounds: Bounds) -> None:
    """Require that a command for a missing robot raises ConfigError, and nothing moves."""
    begin = session.reset()
    for index in (len(session.robots), -1):
        try:
            session.step({index: make_twist(0, 0, 0, 0, 0, 0)})
        except ConfigError as error:
            require(str(index) in str(error), f"{error} does not name the robot {index}")
        else:
            raise NonConformanceError(f"a command for robot {index} was taken")
    now = session.observe()
    require(now.time_s == begin.time_s, "time moved although the commands were refused")


def a_closed_session_is_closed(session: Session, bounds: Bounds) -> None:
    """Require that a step after close raises RunError."""
    session.reset()
    session.close()
    try:
        session.step()
    except RunError:
        return
    raise NonConformanceError("a closed session took a step")
