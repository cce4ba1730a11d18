"""Preparation of orders for slots: joined JointTrajectories, padded paths, holds."""

from dataclasses import replace

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import PoseTarget, ThrusterPwm, joint_goal
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_tolerance import (
    JointTolerance,
    Tolerances,
    build_tolerances,
)
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointState,
    JointTrajectory,
    replace_at,
    sample_state,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, Stages
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.command_slots import CommandSlots, widen_trajectory
from angler_mjx.runs.session.command_validation import CommandLimits
from angler_mjx.runs.session.interface import Floats, SessionCommand
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.runs.session.state_view import StateView, rotate_vectors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.fleet import list_variants

CLEARANCE_SLACK_M = 1e-3
"""Slack by which a path that exactly fits may violate the clearance, for rounding."""

PATH_TOLERANCE = JointTolerance(position=1.2)
"""m and rad. At 1 m the guidance waits: a robot that is farther away is being carried off."""
GOAL_TOLERANCE = JointTolerance(position=0.15)
GOAL_TIME_S = 15.0


def stack_tolerances(requested: Tolerances | None, scenario: Scenario) -> Tolerances:
    """Stack the tolerances of every robot, [R] leading.

    Raises:
        ConfigError: a tolerance is of accelerations, which are not measured.
    """
    joints = (*VEHICLE_JOINTS, *_arm_joints(scenario))
    resolved = requested or build_tolerances(
        joints,
        default_path=PATH_TOLERANCE,
        default_goal=GOAL_TOLERANCE,
        default_goal_time_s=GOAL_TIME_S,
    )
    for key, limit in (("path", resolved.path), ("goal", resolved.goal)):
        if np.isfinite(np.asarray(limit.acceleration)).any():
            raise ConfigError(
                f"tolerances.{key}.acceleration = {np.asarray(limit.acceleration)}: accelerations "
                "are not measured; leave it out"
            )
    resolved, count = _widen_tolerances(resolved, len(joints)), len(scenario.members())
    per_robot: Tolerances = jax.tree.map(
        lambda leaf: np.broadcast_to(np.asarray(leaf), (count, *np.shape(leaf))), resolved
    )
    return per_robot


def _arm_joints(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the joints of the arms of a fleet; none where no vehicle has one."""
    for variant in list_variants(scenario.members()):
        if joints := library.load_vehicle(variant.vehicle).find_joints():
            return tuple(joint.name for joint in joints)
    return ()


def _widen_tolerances(tolerances: Tolerances, joints: int) -> Tolerances:
    """Return tolerances of as many joints, without limit where there were only the vehicle's."""

    def widen(limits: JointState) -> JointState:
        missing = joints - len(limits.position)
        if len(limits.position) != len(VEHICLE_JOINTS) or not missing:
            return limits
        unlimited = np.full(missing, np.inf)
        wide: JointState = jax.tree.map(lambda leaf: np.append(leaf, unlimited), limits)
        return wide

    return replace(tolerances, path=widen(tolerances.path), goal=widen(tolerances.goal))


def start_time_s(order: SessionCommand) -> float:
    """Return the start time of an order, s of the session; 0: at once."""
    return order.stamp_s if isinstance(order, JointGoal) else 0.0


def prepare_command(
    slots: CommandSlots,
    view: StateView,
    robot: int,
    order: SessionCommand,
    limits: CommandLimits,
    now_s: float,
) -> Command | JointTarget:
    """Turn a checked order into slot arrays of fixed shapes, joined to the present motion."""
    if isinstance(order, WholeBodyCommand):
        base = prepare_command(slots, view, robot, order.base, limits, now_s)
        if isinstance(base, WholeBodyCommand | JointTarget):
            raise TypeError(f"a base takes no {type(base).__name__}")
        return WholeBodyCommand(base=base, joints=jax.device_get(order.joints))
    if isinstance(order, JointGoal):
        return join_trajectory(slots, view, robot, _drop_past_points(order, now_s))
    command: Command | JointTarget = jax.device_get(order)
    if isinstance(command, JointTrajectory):
        return join_trajectory(slots, view, robot, replace(command, found=None))
    if isinstance(command, Trajectory):
        plan = RobotPlan(
            time_s=np.asarray(command.time_s), position_m=np.asarray(command.position_m)
        )
        return plan.padded(limits.way_points, view.p.dtype)
    if isinstance(command, ThrusterPwm):
        pulses = np.asarray(command.pwm_us)
        padding = view.pwm_us.shape[-1] - pulses.size
        padded = np.pad(pulses, (0, padding), constant_values=NEUTRAL_US)
        return ThrusterPwm(pwm_us=as_leaf(padded))
    return command


def join_trajectory(
    slots: CommandSlots, view: StateView, robot: int, new: JointGoal | JointTrajectory
) -> JointTrajectory:
    """Join a JointTrajectory to the present reference."""
    slot = jax.tree.map(lambda leaf: leaf[robot], slots.slot(JointTrajectory))
    size = slot.time_s.shape[0]
    if slots.kind(robot) is JointTrajectory:
        old, t = _refer_arm(slot, view, robot), view.clock_s[robot]
        joint_positions = np.asarray(_sample(old, t).position, float)
    else:
        joint_positions, joint_rates = _current_joints(slots, view, robot)
        old, t = _straight_trajectory(slot, joint_positions, joint_rates), 0.0 * view.clock_s[robot]
    if isinstance(new, JointGoal):
        new = joint_goal.build_trajectory(
            new, joints=slot.joints, position=joint_positions.tolist(), size=size
        )
    new = widen_trajectory(new, slot.joints)
    cast = jax.tree.map(lambda x, like: np.asarray(x, like.dtype), _pad_trajectory(new, size), slot)
    joined: JointTrajectory = jax.device_get(_join(old, t, cast))
    return joined


def compile_joins(slots: CommandSlots, view: StateView) -> None:
    """Compile the functions of `join_trajectory`."""
    if JointTrajectory in slots.kinds:
        nothing = JointGoal(joint_names=("x",), points=(JointPoint(time_s=1.0, positions=(0.0,)),))
        describe_farthest_joint(slots, view, 0)
        join_trajectory(slots, view, 0, nothing)


_join = jax.jit(replace_at)
_sample = jax.jit(sample_state)


def hold_command(
    kinds: tuple[type, ...], view: StateView, robot: int, limits: CommandLimits
) -> Plan | PoseTarget:
    """Return a command to hold position; every stack takes a path, not every one a pose."""
    p, yaw = view.p[robot], view.yaw_rad[robot]
    if PoseTarget in kinds:
        return PoseTarget(position_m=p, velocity_mps=0.0 * p, yaw_rad=yaw)
    plan = RobotPlan(time_s=np.zeros(1), position_m=np.asarray(p, float)[None])
    return plan.padded(limits.way_points, view.p.dtype)


def plan_progress_s(stages: Stages, plan: RobotPlan, view: StateView, robot: int) -> float:
    """Return a robot's progress along its plan, s of the plan's time."""
    if stages[0].name in ("follow", "reference"):
        return float(view.clock_s[robot])
    times = np.linspace(0.0, plan.time_s[-1], 512)
    distances = np.linalg.norm(plan.at(times) - np.asarray(view.p[robot], float), axis=1)
    return float(times[np.argmin(distances)])


def describe_farthest_joint(slots: CommandSlots, view: StateView, robot: int) -> str:
    """Name the joint that deviates most from its JointTrajectory, in words."""
    slot = jax.tree.map(lambda leaf: leaf[robot], slots.slot(JointTrajectory))
    reference = np.asarray(_sample(slot, view.clock_s[robot]).position, float)
    errors = np.append(view.p[robot], view.yaw_rad[robot]) - reference[: len(VEHICLE_JOINTS)]
    errors[3] = (errors[3] + np.pi) % (2 * np.pi) - np.pi
    if view.joints is not None:
        arm = np.asarray(view.joints.position[robot]) - reference[len(VEHICLE_JOINTS) :]
        is_judged = np.asarray(slot.commanded)[len(VEHICLE_JOINTS) :]
        errors = np.append(errors, np.where(is_judged, arm, 0.0))
    worst = int(np.argmax(np.abs(errors)))
    return f"joint {slot.joints[worst]!r} is off by {errors[worst]:.3g}"


def _drop_past_points(goal: JointGoal, now_s: float) -> JointGoal:
    """Drop the points of a message whose time is over."""
    elapsed_s = now_s - goal.stamp_s if goal.stamp_s > 0 else 0.0
    if elapsed_s <= 0:
        return goal
    points = [
        replace(point, time_s=point.time_s - elapsed_s)
        for point in goal.points
        if point.time_s > elapsed_s
    ]
    return replace(goal, points=tuple(points or [replace(goal.points[-1], time_s=0.0)]))


def _current_joints(slots: CommandSlots, view: StateView, robot: int) -> tuple[Floats, Floats]:
    """Return joints [4 + J] and their rates of reference.

    The path's where there is one, else measured; those of the arm are commanded ones.
    """
    position, rate = _vehicle_joints(slots, view, robot)
    if view.joint_target is None:
        return position, rate
    target = view.joint_target
    return np.append(position, target.position[robot]), np.append(rate, target.velocity[robot])


def _vehicle_joints(slots: CommandSlots, view: StateView, robot: int) -> tuple[Floats, Floats]:
    """Return the vehicle's joints [4] and their rates of reference."""
    if slots.kind(robot) is Trajectory:
        path = jax.tree.map(lambda leaf: leaf[robot], slots.slot(Trajectory))
        plan, t = RobotPlan(time_s=path.time_s, position_m=path.position_m), view.clock_s[robot]
        position, next_position = plan.at(t), plan.at(t + 1e-3)
        return np.append(position, view.heading_rad[robot]), np.append(
            (next_position - position) / 1e-3, 0.0
        )
    return np.append(view.p[robot], view.yaw_rad[robot]), np.append(
        ground_velocity(view, robot), 0.0
    )


def _refer_arm(old: JointTrajectory, view: StateView, robot: int) -> JointTrajectory:
    """Return a trajectory whose joints that it does not name rest where they were commanded."""
    if view.joint_target is None:
        return old
    is_idle = ~np.asarray(old.commanded)
    is_idle[: len(VEHICLE_JOINTS)] = False
    target = np.append(np.zeros(len(VEHICLE_JOINTS)), view.joint_target.position[robot])
    position = np.where(is_idle, target, old.position).astype(old.position.dtype)
    velocity, acceleration = (
        as_leaf(np.where(is_idle, 0.0, leaf).astype(position.dtype))
        for leaf in (old.velocity, old.acceleration)
    )
    return replace(old, position=as_leaf(position), velocity=velocity, acceleration=acceleration)


def ground_velocity(view: StateView, robot: int) -> Floats:
    """Return the velocity [3] in W."""
    return rotate_vectors(np.asarray(view.q[robot], float), np.asarray(view.nu[robot, :3], float))


def _straight_trajectory(
    like: JointTrajectory, joint_positions: Floats, joint_rates: Floats
) -> JointTrajectory:
    """Return a straight line through joints with their rates [4 + J], as large as ``like``."""
    time = np.minimum(np.arange(like.time_s.shape[0]), 1).astype(like.time_s.dtype)
    table = as_leaf((joint_positions + time[:, None] * joint_rates).astype(like.position.dtype))
    return replace(
        like,
        time_s=as_leaf(time),
        position=table,
        velocity=0.0 * table,
        acceleration=0.0 * table,
        degree=0 * like.degree + LINEAR,
        commanded=like.commanded | True,
    )


def _pad_trajectory(new: JointTrajectory, size: int) -> JointTrajectory:
    """Pad a trajectory to ``size`` rows."""
    more = size - np.shape(new.time_s)[0]

    def edge(leaf: jax.Array) -> jax.Array:
        value = np.asarray(leaf)
        return as_leaf(np.pad(value, [(0, more)] + [(0, 0)] * (value.ndim - 1), mode="edge"))

    return replace(
        new,
        time_s=edge(new.time_s),
        position=edge(new.position),
        velocity=edge(new.velocity),
        acceleration=edge(new.acceleration),
        degree=edge(new.degree),
    )
