"""What robots fly along: way-points joined by lines, or trajectories of their joints.

A plan of a fleet is one array of each field with the robots leading, so all of its robots have one
type and one number of rows; shorter ones are padded by their last row. Those who only want to know
where a plan leads, and whether there is one, ask here and not for its type.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands import joint_trajectory, trajectory
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    LINEAR,
    QUINTIC,
    VEHICLE_JOINTS,
    JointState,
    JointTrajectory,
    interpolate_segment,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.stack import Stages

type Plan = Trajectory | JointTrajectory
"""Of one robot, or with any axes leading on every leaf."""

PIECES = 8
"""Lines that a bent segment is drawn with."""
APPROACH_M = 1.0
"""The last approach begins this far outside the goal's tolerance: where the clock of `follow` waits
for a robot that is behind, so no robot that keeps to its plan is at the goal before."""


def is_found(plan: Plan) -> jax.Array:
    """Whether the planner found a way, bool with the leading axes of the plan."""
    if plan.found is not None:
        return plan.found
    return jnp.ones(plan.time_s.shape[:-1], bool)


def points_m(plan: Plan) -> jax.Array:
    """Way-points [..., n_point, 3] m, in W."""
    return plan.position_m if isinstance(plan, Trajectory) else plan.position[..., :3]


def between(plan: JointTrajectory) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return positions within the segments of plans, which divide each into `PIECES`.

    Args:
        plan: of one robot, or with any axes leading.

    Returns:
        Times [..., n_point - 1, PIECES - 1] s, p [..., n_point - 1, PIECES - 1, 3] m in W, and
        whether the segment is bent there, bool as the times: not a line, and no padding.
    """
    time, degree = plan.time_s, plan.degree[..., :-1, None]
    fraction = jnp.arange(1, PIECES, dtype=time.dtype) / PIECES
    span = (time[..., 1:] - time[..., :-1])[..., None]
    times = time[..., :-1, None] + span * fraction
    begin, end = (
        JointState(
            position=plan.position[..., rows, None, :3],
            velocity=plan.velocity[..., rows, None, :3],
            acceleration=plan.acceleration[..., rows, None, :3],
        )
        for rows in (slice(None, -1), slice(1, None))
    )
    whole = jnp.where(span > 0, span, 1.0)[..., None]
    positions_m = interpolate_segment(
        begin, end, whole, fraction[:, None], degree[..., None]
    ).position
    bent = jnp.broadcast_to((degree > LINEAR) & (span > 0), times.shape)
    return times, positions_m, bent


def length_m(plan: Plan) -> jax.Array:
    """Return the lengths [...] of plans, m; bent segments as `PIECES` lines."""
    point = points_m(plan)
    if isinstance(plan, JointTrajectory):
        _, positions_m, bent = between(plan)
        first = jnp.broadcast_to(point[..., :-1, None, :], positions_m.shape)
        inner = jnp.where(bent[..., None], positions_m, first)
        pieces = jnp.concatenate([first[..., :1, :], inner], axis=-2)
        pieces = pieces.reshape(*pieces.shape[:-3], -1, 3)
        point = jnp.concatenate([pieces, point[..., -1:, :]], axis=-2)
    leg = point[..., 1:, :] - point[..., :-1, :]
    return jnp.sum(jnp.sqrt(jnp.sum(leg * leg, axis=-1)), axis=-1)


def last_approach_s(plan: Plan, goal_m: jax.Array, tolerance_m: float) -> jax.Array:
    """Return the time [] s at which the last approach of one robot's plan to its goal begins.

    The last approach begins at the last way-point at least ``tolerance_m + APPROACH_M`` from the
    goal, or at the farthest way-point where none is so far; positions within bent segments count as
    way-points (`between`). A stay at the goal after it is part of the approach.

    Args:
        plan: of one robot.
        goal_m: [3] in W.
        tolerance_m: distance below which a robot is at its goal.

    Returns:
        Zero where the planner found no plan.
    """
    time, point = plan.time_s, points_m(plan)
    away = jnp.sqrt(jnp.sum((point - goal_m) ** 2, axis=-1))
    if isinstance(plan, JointTrajectory):
        times, positions_m, bent = between(plan)
        off = jnp.where(bent, jnp.sqrt(jnp.sum((positions_m - goal_m) ** 2, axis=-1)), 0.0)
        time = jnp.concatenate([time, times.reshape(-1)])
        away = jnp.concatenate([away, off.reshape(-1)])
    far = away >= jnp.minimum(tolerance_m + APPROACH_M, jnp.max(away))
    return jnp.max(jnp.where(far & is_found(plan), time, 0.0))


def position_at(plan: Plan, t: jax.Array) -> jax.Array:
    """Position [3] m in W of the plan of one robot at a time [] s."""
    if isinstance(plan, Trajectory):
        return trajectory.sample_reference(plan, t)[0]
    return joint_trajectory.sample_state(plan, t).position[:3]


def check_plan[P](of: Stages, plan: P, joints: tuple[str, ...] = ()) -> P:
    """A plan that controllers can fly.

    Args:
        of: the controllers, from the highest down.
        plan: of a fleet.
        joints: names of the joints of the fleet's links; a plan has all of them or none.

    Raises:
        ConfigError: no stage takes plans of its type (names the controllers and the type), or it
            is of other joints than a vehicle's.
    """
    kind = type(plan)
    names = dict.fromkeys([VEHICLE_JOINTS, (*VEHICLE_JOINTS, *joints)])
    if isinstance(plan, JointTrajectory) and plan.joints not in names:
        expected = " or ".join(map(str, names))
        raise ConfigError(f"World.path: joints = {plan.joints}: must be {expected}")
    if not any(kind in stage.takes for stage in of):
        kinds = (Trajectory, JointTrajectory)
        taken = [
            plan_type.__name__
            for plan_type in kinds
            if any(plan_type in stage.takes for stage in of)
        ]
        raise ConfigError(
            f"World.path is a {kind.__name__}: {stages.describe_stages(of)} takes "
            f"{' or '.join(taken) or 'no plan'}; choose another controller, or give plans of "
            "another type"
        )
    return plan


def of_robot(plan: Plan, i: int) -> Plan:
    """The plan of one robot of a world, whose plans [R] lead."""
    robot_plan: Plan = jax.tree.map(lambda leaf: leaf[i], plan)
    return robot_plan


def trace_path(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Where the plan of one robot leads, for pictures; bent segments as `PIECES` lines (host side).

    Args:
        plan: of arrays of NumPy, or that become such.

    Returns:
        Times [n] s and positions_m [n, 3] m in W, padding dropped.
    """
    time, point = np.asarray(plan.time_s), np.asarray(points_m(plan))
    rows = np.r_[True, np.diff(time) > 0]
    if isinstance(plan, Trajectory) or np.all(np.asarray(plan.degree) == LINEAR):
        return time[rows], point[rows]
    inner = np.arange(1, PIECES + 1) / PIECES
    k = np.flatnonzero(np.diff(time) > 0)
    times = time[k, None] + np.diff(time)[k, None] * inner
    times = np.r_[time[:1], times.ravel()]
    return times, np.asarray(joints_at(plan, times).position)[:, :3]


def to_joint_goal(plan: Plan) -> JointGoal:
    """Return one robot's plan as a message of the same motion for `joint_goal.build_trajectory`.

    Joints x, y and z of way-points; the heading too of a JointTrajectory. A message says of points,
    not of segments, what they are joined by, so a segment between two points that have more than it
    uses is divided in its middle.

    Args:
        plan: of arrays of NumPy, or that become such.
    """
    time = np.asarray(plan.time_s, float)
    rows = np.flatnonzero(np.r_[True, np.diff(time) > 0])
    if isinstance(plan, Trajectory):
        points = zip(time[rows].tolist(), np.asarray(plan.position_m)[rows].tolist(), strict=True)
        return JointGoal(
            joint_names=VEHICLE_JOINTS[:3],
            points=tuple(JointPoint(time_s=t, positions=tuple(p)) for t, p in points),
        )
    degree = np.asarray(plan.degree)[rows[1:] - 1]
    uses = np.maximum(np.r_[degree, LINEAR], np.r_[LINEAR, degree])
    divided = np.flatnonzero(np.minimum(uses[:-1], uses[1:]) > degree)
    middles = joints_at(plan, 0.5 * (time[rows[divided]] + time[rows[divided + 1]]))
    ends = _state_at_row(plan, rows)
    made = [_joint_point(time[row], ends, i, uses[i]) for i, row in enumerate(rows)]
    for i, k in enumerate(divided):
        middle = 0.5 * (time[rows[k]] + time[rows[k + 1]])
        made.append(_joint_point(middle, middles, i, degree[k]))
    return JointGoal(
        joint_names=plan.joints, points=tuple(sorted(made, key=lambda point: point.time_s))
    )


def _joint_point(time_s: float, joints: JointState, i: int, uses: int) -> JointPoint:
    """Row ``i`` of some points, with as many derivatives as a polynomial of that degree uses."""
    return JointPoint(
        time_s=float(time_s),
        positions=tuple(joints.position[i].tolist()),
        velocities=tuple(joints.velocity[i].tolist()) if uses >= CUBIC else (),
        accelerations=tuple(joints.acceleration[i].tolist()) if uses >= QUINTIC else (),
    )


def joints_at(plan: JointTrajectory, time_s: ArrayLike) -> JointState:
    """Joints [n, n_joint] of one robot at times [n] from 0, in double precision (host side)."""
    t, time = np.asarray(time_s, float)[:, None], np.asarray(plan.time_s, float)
    k = np.clip(np.searchsorted(time, t[:, 0], side="right") - 1, 0, time.size - 2)
    begin, end = (_state_at_row(plan, rows) for rows in (k, k + 1))
    span = (time[k + 1] - time[k])[:, None]
    inside = (span > 0) & (t < time[-1])
    span = np.where(span > 0, span, 1.0)
    degree = np.asarray(plan.degree)[k][:, None]
    bend: Any = interpolate_segment  # arithmetic alone: arrays of NumPy do as well
    moving: JointState = bend(begin, end, span, (t - time[k][:, None]) / span, degree)
    at: dict[str, Any] = {
        "position": np.where(inside, moving.position, np.asarray(plan.position, float)[-1]),
        "velocity": np.where(inside, moving.velocity, 0.0),
        "acceleration": np.where(inside, moving.acceleration, 0.0),
    }
    return JointState(**at)


def _state_at_row(plan: JointTrajectory, k: np.ndarray) -> JointState:
    rows: Any = [
        np.asarray(leaf, float)[k] for leaf in (plan.position, plan.velocity, plan.acceleration)
    ]
    return JointState(position=rows[0], velocity=rows[1], acceleration=rows[2])
