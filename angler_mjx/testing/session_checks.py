"""Checks of a session's time and of its response to valid commands; each drives one robot."""

import itertools

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, PoseTarget, ThrusterPwm
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_tolerance import ResultCode
from angler_mjx.runs.session.interface import Floats, Observation, Session
from angler_mjx.testing.driving import (
    Bounds,
    Skipped,
    heading,
    heading_difference,
    make_pose,
    make_twist,
    position,
    require,
    require_accepts,
    run_steps,
    velocity,
)


def reset_repeats(session: Session, bounds: Bounds) -> None:
    """Require that the same seed and commands lead to the same position."""
    ends = []
    for _ in range(2):
        begin = session.reset(seed=11)
        require(begin.time_s == 0.0, f"time after a reset is {begin.time_s}, not 0")
        commands = {bounds.robot: make_twist(bounds.speed_mps, 0, 0, 0, 0, 0)}
        require_accepts(session, bounds.robot, BodyTwist)
        ends.append((begin, run_steps(session, 1.0, commands)[-1]))
    for first, second in zip(*ends, strict=True):
        apart = np.abs(np.asarray(first.estimate.p) - np.asarray(second.estimate.p)).max()
        require(
            apart <= bounds.repeat_m,
            f"two runs of one seed are {apart:.3g} m apart at {first.time_s:.3g} s",
        )


def time_advances(session: Session, bounds: Bounds) -> None:
    """Require that each step takes one control period."""
    before = session.reset().time_s
    for number, now in enumerate(run_steps(session, 0.5), 1):
        due = before + number * session.dt_s
        require(
            abs(now.time_s - due) <= bounds.clock_s,
            f"time is {now.time_s} s after {number} steps, {due:.6g} s was due",
        )


def observing_changes_nothing(session: Session, bounds: Bounds) -> None:
    """Require that repeated observations are equal, and equal to that of the step."""
    session.reset()
    after = run_steps(session, 0.5)[-1]
    for look in ("first", "second"):
        now = session.observe()
        require(now.time_s == after.time_s, f"time moved at the {look} look")
        same = jax.tree.map(np.array_equal, (after.estimate, after.pwm), (now.estimate, now.pwm))
        require(all(jax.tree.leaves(same)), f"the {look} look shows something else than the step")


def commands_are_latched(session: Session, bounds: Bounds) -> None:
    """Require that a robot keeps its last command until it receives another."""
    require_accepts(session, bounds.robot, BodyTwist)
    session.reset()
    seen = run_steps(session, 5.0, {bounds.robot: make_twist(bounds.speed_mps, 0, 0, 0, 0, 0)})
    for now in seen:
        name = now.status[bounds.robot].command
        require(name == "BodyTwist", f"it follows {name!r} at {now.time_s:.3g} s, not BodyTwist")
    speed = velocity(seen[-1], bounds.robot)[0]
    require(
        speed > 0.5 * bounds.speed_mps,
        f"5 s after a twist of {bounds.speed_mps} m/s it surges at {speed:.3g} m/s",
    )


def twists_are_in_the_body_frame(session: Session, bounds: Bounds) -> None:
    """Require that a twist moves a robot along its own axes, and left for a positive yaw rate."""
    require_accepts(session, bounds.robot, BodyTwist)
    for axis, name in ((0, "surge"), (1, "sway"), (2, "heave"), (5, "yaw")):
        begin = session.reset()
        wanted = np.zeros(6)
        # Downwards: a start may be just below the surface.
        wanted[axis] = -bounds.speed_mps if axis == 2 else bounds.speed_mps
        seen = run_steps(session, 5.0, {bounds.robot: make_twist(*wanted)})
        late = np.mean([velocity(now, bounds.robot) for now in seen[-20:]], axis=0)
        held = [0, 1, 2, 5]  # the vehicle balances roll and pitch itself
        off = np.abs(late - wanted)[held].max()
        require(
            off <= bounds.velocity_mps,
            f"told a {name} of {wanted[axis]:.3g} it moves with nu = {np.round(late, 3)}",
        )
        _require_direction(begin, seen[-1], bounds, axis, name)


def _require_direction(
    begin: Observation, end: Observation, bounds: Bounds, axis: int, name: str
) -> None:
    """Require that the path in W has the commanded direction, by the heading at the start."""
    if axis == 5:
        left = heading(end, bounds.robot) - heading(begin, bounds.robot)
        require(
            heading_difference(left, 0.0) > 0.5 and np.sin(left) > 0,
            f"told to turn left it turned {left:.3g}",
        )
        return
    yaw = heading(begin, bounds.robot)
    direction = {
        0: np.array([np.cos(yaw), np.sin(yaw), 0.0]),
        1: np.array([-np.sin(yaw), np.cos(yaw), 0.0]),
        2: np.array([0.0, 0.0, -1.0]),
    }[axis]
    offset_m = position(end, bounds.robot) - position(begin, bounds.robot)
    distance_m = float(offset_m @ direction)
    require(
        distance_m > 2.0 * bounds.speed_mps
        and np.linalg.norm(offset_m - distance_m * direction) < 0.5 * distance_m,
        f"told a {name} for 5 s it went {np.round(offset_m, 3)} m in W, heading {yaw:.3g} rad",
    )


def poses_are_reached(session: Session, bounds: Bounds) -> None:
    """Require that a pose at 1 m, turned by a radian, is reached and kept."""
    require_accepts(session, bounds.robot, PoseTarget)
    begin = session.reset()
    goal = position(begin, bounds.robot) + np.array([0.6, 0.5, -0.6])
    yaw = heading(begin, bounds.robot) + 1.0
    seen = run_steps(session, bounds.settle_s + 2.0, {bounds.robot: make_pose(goal, yaw)})
    for now in seen[round(bounds.settle_s / session.dt_s) :]:
        away = float(np.linalg.norm(position(now, bounds.robot) - goal))
        off = heading_difference(heading(now, bounds.robot), yaw)
        require(
            max(away, off) <= bounds.pose_m,
            f"at {now.time_s:.3g} s it is {away:.3g} m and {off:.3g} rad from its pose",
        )


def wrenches_push(session: Session, bounds: Bounds) -> None:
    """Require that a wrench forward drives a robot forward."""
    require_accepts(session, bounds.robot, BodyWrench)
    session.reset()
    tau = as_leaf(np.array([15.0, 0, 0, 0, 0, 0]))
    end = run_steps(session, 2.0, {bounds.robot: BodyWrench(tau=tau)})[-1]
    surge = velocity(end, bounds.robot)[0]
    require(surge > 0.1, f"2 s of 15 N forward leave it at a surge of {surge:.3g} m/s")


def neutral_signals_let_it_drift(session: Session, bounds: Bounds) -> None:
    """Require that with neutral signals a moving robot coasts, and slows down by drag."""
    require_accepts(session, bounds.robot, ThrusterPwm)
    require_accepts(session, bounds.robot, BodyTwist)
    robot = session.robots[bounds.robot]
    session.reset()
    fast = run_steps(session, 5.0, {bounds.robot: make_twist(bounds.speed_mps, 0, 0, 0, 0, 0)})[-1]
    signals = as_leaf(np.full(len(robot.thrusters), 1500.0))
    seen = run_steps(session, 5.0, {bounds.robot: ThrusterPwm(pwm_us=signals)})
    for now in seen:
        sent = np.asarray(now.pwm.pwm_us, float)[bounds.robot][: len(robot.thrusters)]
        require(bool(np.all(sent == 1500.0)), f"told 1500 us it was sent {sent}")
    distance_m = np.linalg.norm(position(seen[-1], bounds.robot) - position(fast, bounds.robot))
    before, after = (velocity(now, bounds.robot)[0] for now in (fast, seen[-1]))
    require(distance_m > 0.02, f"it stopped within {distance_m:.3g} m without thrust")
    require(
        after < 0.7 * before, f"its surge is {after:.3g} m/s after 5 s of drag, from {before:.3g}"
    )


def trajectories_are_followed_and_held(session: Session, bounds: Bounds) -> None:
    """Require that a JointTrajectory is followed in time, its end held, and the note says so."""
    require_accepts(session, bounds.robot, JointGoal)
    begin = _hold_start(session, bounds)
    start, yaw = position(begin, bounds.robot), heading(begin, bounds.robot)
    times = np.array([4.0, 8.0, 12.0])
    offsets = np.array([[0.8, 0.0, 0.0], [0.8, 0.6, -0.4], [0.0, 0.6, -0.4]])
    points = tuple(
        JointPoint(time_s=float(t), positions=(*map(float, start + off), yaw))
        for t, off in zip(times, offsets, strict=True)
    )
    goal = JointGoal(joint_names=("x", "y", "z", "yaw"), points=points)
    seen = run_steps(session, times[-1] + bounds.settle_s, {bounds.robot: goal})
    for now in seen:
        wanted = start + _interpolate_path(now.time_s - begin.time_s, times, offsets)
        away = float(np.linalg.norm(position(now, bounds.robot) - wanted))
        require(
            away <= bounds.track_m, f"at {now.time_s:.3g} s it is {away:.3g} m from its trajectory"
        )
    end = float(np.linalg.norm(position(seen[-1], bounds.robot) - (start + offsets[-1])))
    require(end <= bounds.pose_m, f"it does not hold the end: it is {end:.3g} m from there")
    note = seen[-1].status[bounds.robot].note
    require(
        note.startswith(ResultCode.SUCCESSFUL.name), f"having reached its goal it notes {note!r}"
    )


def _hold_start(session: Session, bounds: Bounds) -> Observation:
    """Hold a robot at its start; else a path would be joined to the next motion of its plan."""
    begin = session.reset()
    if PoseTarget not in session.robots[bounds.robot].accepts:
        return begin
    start_pose = make_pose(position(begin, bounds.robot), heading(begin, bounds.robot))
    return run_steps(session, 2.0, {bounds.robot: start_pose})[-1]


def _interpolate_path(t: float, times: Floats, offsets: Floats) -> Floats:
    """Return the point on linear segments from rest; the first ends with the speed of the next."""
    knots = np.concatenate([[0.0], times])
    rows = np.concatenate([np.zeros((1, 3)), offsets])
    return np.array([np.interp(t, knots, rows[:, i]) for i in range(3)])


def trajectories_are_replaced_smoothly(session: Session, bounds: Bounds) -> None:
    """Require that another JointTrajectory in flight is joined without a jump of the target."""
    require_accepts(session, bounds.robot, JointGoal)
    begin = _hold_start(session, bounds)
    x, y, _ = position(begin, bounds.robot)
    first = JointGoal(joint_names=("x",), points=(JointPoint(time_s=6.0, positions=(x + 1.2,)),))
    second = JointGoal(joint_names=("y",), points=(JointPoint(time_s=6.0, positions=(y + 1.0,)),))
    seen = run_steps(session, 3.0, {bounds.robot: first}) + run_steps(
        session, 4.0, {bounds.robot: second}
    )
    # A quintic from rest to rest moves at 15/8 of its mean speed.
    require_smooth(session, bounds, seen, speed_mps=0.4)


def plans_are_taken_up_again_smoothly(session: Session, bounds: Bounds) -> None:
    """Require that plan, twist, plan causes no jump, and that the other robots go on."""
    require_accepts(session, bounds.robot, BodyTwist)
    begin = session.reset()
    if begin.status[bounds.robot].command != "plan":
        raise Skipped(f"{session.robots[bounds.robot].name} has no plan")
    run_steps(session, 4.0)
    away = run_steps(session, 3.0, {bounds.robot: make_twist(0, bounds.speed_mps, 0, 0, 0, 0)})
    try:
        session.resume_plan(bounds.robot)
    except ConfigError as error:
        raise Skipped(str(error)) from error
    back = run_steps(session, 6.0)
    for now in back:
        name = now.status[bounds.robot].command
        require(name == "plan", f"after resume_plan it follows {name!r}")
    if back[0].target_m is not None:
        jump = np.linalg.norm(back[0].target_m[bounds.robot] - position(away[-1], bounds.robot))
        require(jump < 0.3, f"its plan begins {jump:.3g} m from where it was handed back")
    require_smooth(session, bounds, back, session.robots[bounds.robot].cruise_speed_mps)
    for i, status in enumerate(back[-1].status):
        require(
            i == bounds.robot or status.command == begin.status[i].command,
            f"{session.robots[i].name} follows {status.command!r} now",
        )
    distance_m = np.linalg.norm(position(back[-1], bounds.robot) - position(back[0], bounds.robot))
    require(
        distance_m > 0.3, f"it went {distance_m:.3g} m in 6 s after it was given back to its plan"
    )


def require_smooth(
    session: Session, bounds: Bounds, seen: list[Observation], speed_mps: float
) -> None:
    """Require that the target does not step, nor the velocity in the first second.

    Later a path may have corners.

    Args:
        session: session to check.
        bounds: limits of the check.
        seen: consecutive observations.
        speed_mps: max speed of the target.
    """
    for before, now in itertools.pairwise(seen):
        jolt = np.abs(velocity(now, bounds.robot) - velocity(before, bounds.robot))[:3].max()
        require(
            jolt <= bounds.jolt_mps or now.time_s > seen[0].time_s + 1.0,
            f"its velocity changed by {jolt:.3g} m/s in the step to {now.time_s:.4g} s",
        )
        if now.target_m is not None and before.target_m is not None:
            move = np.linalg.norm(now.target_m[bounds.robot] - before.target_m[bounds.robot])
            require(
                move <= speed_mps * session.dt_s + bounds.jump_m,
                f"the place aimed at moved {move:.3g} m in the step to {now.time_s:.4g} s",
            )
