"""Orders made ready for slots: JointTrajectories joined to what goes on, paths padded, holds."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import joint_goal
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import PoseTarget, ThrusterPwm
from angler_mjx.robot.control.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.joint_tolerance import JointTolerance, Tolerances, tolerances
from angler_mjx.robot.control.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
    replace_at,
    sample,
)
from angler_mjx.robot.control.stack import Stages
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.session.checks import CommandLimits
from angler_mjx.runs.session.interface import Floats, Order
from angler_mjx.runs.session.plan import Plan
from angler_mjx.runs.session.slots import Slots
from angler_mjx.runs.session.view import StateView
from angler_mjx.scenario.scenario import Scenario

SLACK_M = 1e-3
"""A way that just fits must not fail by rounding."""

PATH_TOLERANCE = JointTolerance(position=1.2)
"""m and rad. At 1 m the guidance waits: a robot that is farther away is being carried off."""
GOAL_TOLERANCE = JointTolerance(position=0.15)
GOAL_TIME_S = 15.0


def stacked(given: Tolerances | None, scenario: Scenario) -> Tolerances:
    """Tolerances of every robot, [R] leading.

    Raises:
        ConfigError: one is of accelerations, which nobody measures here.
    """
    chosen = given or tolerances(
        VEHICLE_JOINTS,
        default_path=PATH_TOLERANCE,
        default_goal=GOAL_TOLERANCE,
        default_goal_time_s=GOAL_TIME_S,
    )
    for key, limit in (("path", chosen.path), ("goal", chosen.goal)):
        if np.isfinite(np.asarray(limit.acceleration)).any():
            raise ConfigError(
                f"tolerances.{key}.acceleration = {np.asarray(limit.acceleration)}: accelerations "
                "are not measured; leave it out"
            )
    count = len(scenario.members())
    wide: Tolerances = jax.tree.map(
        lambda leaf: np.broadcast_to(np.asarray(leaf), (count, *np.shape(leaf))), chosen
    )
    return wide


def start_of(order: Order) -> float:
    """When an order begins, s of the session; 0: at once."""
    return order.stamp_s if isinstance(order, JointGoal) else 0.0


def ready(
    slots: Slots, view: StateView, robot: int, order: Order, limits: CommandLimits, now_s: float
) -> Any:
    """A checked order as slots take it: of fixed shapes, and joined to what goes on now."""
    if isinstance(order, JointGoal):
        return join(slots, view, robot, _without_past(order, now_s))
    order = jax.device_get(order)
    if isinstance(order, JointTrajectory):
        return join(slots, view, robot, replace(order, found=None))
    if isinstance(order, Trajectory):
        plan = Plan(time_s=np.asarray(order.time_s), position_m=np.asarray(order.position_m))
        return plan.padded(limits.way_points, view.p.dtype)
    if isinstance(order, ThrusterPwm):
        given = np.asarray(order.pwm_us)
        more = view.pwm_us.shape[-1] - given.size
        padded: Any = np.pad(given, (0, more), constant_values=NEUTRAL_US)
        return ThrusterPwm(pwm_us=padded)
    return order


def join(
    slots: Slots, view: StateView, robot: int, new: JointGoal | JointTrajectory
) -> JointTrajectory:
    """A JointTrajectory joined to the reference of now."""
    slot = jax.tree.map(lambda leaf: leaf[robot], slots.slot(JointTrajectory))
    size = slot.time_s.shape[0]
    if slots.kind(robot) is JointTrajectory:
        old, t = slot, view.clock_s[robot]
        at = np.asarray(_sample(old, t).position, float)
    else:
        at, rate = _moving(slots, view, robot)
        old, t = _straight(slot, at, rate), 0.0 * view.clock_s[robot]
    if isinstance(new, JointGoal):
        new = joint_goal.build(new, joints=VEHICLE_JOINTS, position=at.tolist(), size=size)
    cast = jax.tree.map(lambda x, like: np.asarray(x, like.dtype), _padded(new, size), slot)
    joined: JointTrajectory = jax.device_get(_join(old, t, cast))
    return joined


def compile_joins(slots: Slots, view: StateView) -> None:
    """Have compiled now what `join` needs."""
    if JointTrajectory in slots.kinds:
        nothing = JointGoal(joint_names=("x",), points=(JointPoint(time_s=1.0, positions=(0.0,)),))
        farthest(slots, view, 0)
        join(slots, view, 0, nothing)


_join = jax.jit(replace_at)
_sample = jax.jit(sample)


def hold(kinds: tuple[type, ...], view: StateView, robot: int, limits: CommandLimits) -> Any:
    """A command to stay where a robot is; every stack takes a path, not every one a pose."""
    p, yaw = view.p[robot], view.yaw_rad[robot]
    if PoseTarget in kinds:
        return PoseTarget(position_m=p, velocity_mps=0.0 * p, yaw_rad=yaw)
    here = Plan(time_s=np.zeros(1), position_m=np.asarray(p, float)[None])
    return here.padded(limits.way_points, view.p.dtype)


def along(stages: Stages, plan: Plan, view: StateView, robot: int) -> float:
    """How far along its plan a robot is, s of the plan's time."""
    if stages[0].name in ("follow", "reference"):
        return float(view.clock_s[robot])
    times = np.linspace(0.0, plan.time_s[-1], 512)
    away = np.linalg.norm(plan.at(times) - np.asarray(view.p[robot], float), axis=1)
    return float(times[np.argmin(away)])


def farthest(slots: Slots, view: StateView, robot: int) -> str:
    """Which joint is farthest from where its JointTrajectory has it, in words."""
    slot = jax.tree.map(lambda leaf: leaf[robot], slots.slot(JointTrajectory))
    wanted = np.asarray(_sample(slot, view.clock_s[robot]).position, float)
    off = np.append(view.p[robot], view.yaw_rad[robot]) - wanted
    off[3] = (off[3] + np.pi) % (2 * np.pi) - np.pi
    worst = int(np.argmax(np.abs(off)))
    return f"joint {VEHICLE_JOINTS[worst]!r} is off by {off[worst]:.3g}"


def _without_past(goal: JointGoal, now_s: float) -> JointGoal:
    """A message without the points whose time is over, by the clock of now."""
    over = now_s - goal.stamp_s if goal.stamp_s > 0 else 0.0
    if over <= 0:
        return goal
    points = [
        replace(point, time_s=point.time_s - over) for point in goal.points if point.time_s > over
    ]
    return replace(goal, points=tuple(points or [replace(goal.points[-1], time_s=0.0)]))


def _moving(slots: Slots, view: StateView, robot: int) -> tuple[Floats, Floats]:
    """Joints [4] and their rates of what goes on: the path's where there is one, else measured."""
    if slots.kind(robot) is Trajectory:
        path = jax.tree.map(lambda leaf: leaf[robot], slots.slot(Trajectory))
        plan, t = Plan(time_s=path.time_s, position_m=path.position_m), view.clock_s[robot]
        here, ahead = plan.at(t), plan.at(t + 1e-3)
        return np.append(here, view.heading_rad[robot]), np.append((ahead - here) / 1e-3, 0.0)
    return np.append(view.p[robot], view.yaw_rad[robot]), np.append(over_ground(view, robot), 0.0)


def over_ground(view: StateView, robot: int) -> Floats:
    """Velocity [3] in W."""
    w, axis = float(view.q[robot, 0]), np.asarray(view.q[robot, 1:], float)
    v = np.asarray(view.nu[robot, :3], float)
    once = 2.0 * np.cross(axis, v)
    turned: Floats = v + w * once + np.cross(axis, once)
    return turned


def _straight(like: JointTrajectory, at: Floats, rate: Floats) -> JointTrajectory:
    """A line through joints [4] with their rates, as large as ``like``."""
    time: Any = np.minimum(np.arange(like.time_s.shape[0]), 1).astype(like.time_s.dtype)
    table: Any = (at + time[:, None] * rate).astype(like.position.dtype)
    return replace(
        like,
        time_s=time,
        position=table,
        velocity=0.0 * table,
        acceleration=0.0 * table,
        degree=0 * like.degree + LINEAR,
        commanded=like.commanded | True,
    )


def _padded(new: JointTrajectory, size: int) -> JointTrajectory:
    """The same trajectory in ``size`` rows."""
    more = size - np.shape(new.time_s)[0]

    def edge(leaf: Any) -> Any:
        value = np.asarray(leaf)
        return np.pad(value, [(0, more)] + [(0, 0)] * (value.ndim - 1), mode="edge")

    rows = ("time_s", "position", "velocity", "acceleration", "degree")
    return replace(new, **{name: edge(getattr(new, name)) for name in rows})
