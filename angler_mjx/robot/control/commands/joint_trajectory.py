"""A motion of a robot's joints in time, with the meaning of ROS's JointTrajectory.

Follows ``trajectory_msgs/JointTrajectory`` and ros2_control's JointTrajectoryController: points
with positions, velocities and accelerations are joined by lines, cubics or quintics, and the last
one is held. A vehicle's joints are x, y, z and yaw, in W; an arm's follow. Everything here is for
one robot, on arrays of fixed size; `joint_goal` beside it makes them from messages, and
`joint_tolerance` says whether a robot keeps to them.
"""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp

from angler_kernels.table import take_row
from angler_mjx.robot.control.commands.trajectory import Trajectory, segment_at

VEHICLE_JOINTS = ("x", "y", "z", "yaw")
"""Joints of every vehicle: m along W's axes, and rad about z up, 0 = east."""

LINEAR, CUBIC, QUINTIC = 1, 3, 5
"""Degree of a segment."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class JointState:
    """Joints at one time; m or rad, and their derivatives by time in s."""

    position: jax.Array
    """[n_joint]."""
    velocity: jax.Array
    """[n_joint]."""
    acceleration: jax.Array
    """[n_joint]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class JointTrajectory:
    """Points of one robot, all joints of it; row 0 is the state from which it starts, at time 0.

    Padding repeats the last point with its time, so every row is valid.
    """

    joints: tuple[str, ...] = field(metadata={"static": True})
    """Names, in the order of the columns."""
    time_s: jax.Array
    """[n_point], at least two, increasing (equal where padded), first one 0."""
    position: jax.Array
    """[n_point, n_joint] m or rad; angles that have no end are unwrapped."""
    velocity: jax.Array
    """[n_point, n_joint]; 0 where the segments do not use it."""
    acceleration: jax.Array
    """[n_point, n_joint]; 0 where the segments do not use it."""
    degree: jax.Array
    """int32 [n_point] of the segment that begins at a point: 1, 3 or 5."""
    commanded: jax.Array
    """bool [n_joint] whether a joint was named; the others hold where they were at the start."""
    found: jax.Array | None = None
    """bool [] False where the planner found no path, as in a `Trajectory`: the robot holds its
    start. None without a planner."""


def hold_position(
    start_m: jax.Array,
    yaw_rad: jax.Array,
    n_point: int,
    arm: tuple[str, ...] = (),
    posture: jax.Array | None = None,
) -> JointTrajectory:
    """Trajectories [R] that stay where robots start: no way was found, or none is known yet.

    Args:
        start_m: [R, 3].
        yaw_rad: [R].
        n_point: rows of each.
        arm: names of the joints of arms that trajectories hold too.
        posture: [R, J] their positions; left out without joints of arms.
    """
    n_robot, joints = start_m.shape[0], (*VEHICLE_JOINTS, *arm)
    rows = [start_m, yaw_rad[:, None], *([] if posture is None else [posture])]
    pose = jnp.concatenate([row.astype(start_m.dtype) for row in rows], axis=1)
    position = jnp.repeat(pose[:, None], n_point, axis=1)
    return JointTrajectory(
        joints=joints,
        time_s=jnp.zeros((n_robot, n_point), start_m.dtype),
        position=position,
        velocity=jnp.zeros_like(position),
        acceleration=jnp.zeros_like(position),
        degree=jnp.full((n_robot, n_point), LINEAR, jnp.int32),
        commanded=jnp.ones((n_robot, len(joints)), bool),
        found=jnp.zeros((n_robot,), bool),
    )


def is_continuous(joint: str) -> bool:
    """Whether a joint is an angle without an end: a full turn leaves it where it was."""
    return joint == "yaw"


def sample_state(
    trajectory: JointTrajectory, t: jax.Array, segment_of: jax.Array | None = None
) -> JointState:
    """The reference at a time.

    Args:
        trajectory: of one robot.
        t: [] s since its start, at least 0.
        segment_of: int32 [] `segment_at` that time; looked for if left out.

    Returns:
        State of all joints; at rest at the last point once that is reached.
    """
    time = trajectory.time_s
    k = segment_at(time, t) if segment_of is None else segment_of
    begin, end = _state_at_row(trajectory, k), _state_at_row(trajectory, k + 1)
    start = take_row(time, k)
    span = take_row(time, k + 1) - start
    inside = (span > 0) & (t < time[-1])
    span = jnp.where(span > 0, span, 1.0)
    moving = interpolate_segment(
        begin, end, span, (t - start) / span, take_row(trajectory.degree, k)
    )
    return JointState(
        position=jnp.where(inside, moving.position, trajectory.position[-1]),
        velocity=jnp.where(inside, moving.velocity, 0.0),
        acceleration=jnp.where(inside, moving.acceleration, 0.0),
    )


def interpolate_segment(
    begin: JointState, end: JointState, span: jax.Array, s: jax.Array, degree: jax.Array
) -> JointState:
    r"""State between two points.

    With the mean velocity $m = \Delta / T$, the line $p_0 + m T s$ is bent by a cubic that gives
    the ends their velocities, and that by a quintic that gives them their accelerations:

    $p(s) = p_0 + \Delta s + T [d_0 s (1-s)^2 - d_1 s^2 (1-s)]
    + \frac{T^2}{2} [e_0 s^2 (1-s)^3 + e_1 s^3 (1-s)^2]$

    with $d_i = v_i - m$ and $e_i = a_i -$ the cubic's acceleration at that end. Each bend is nought
    exactly where the degree leaves it out. This is Hermite interpolation of two points; written so,
    nothing cancels near the ends.

    Args:
        begin: point at s = 0.
        end: point at s = 1.
        span: [] T, time between them, s; above 0.
        s: [] share of it that is over.
        degree: [] 1, 3 or 5.

    Returns:
        Position, velocity and acceleration [n_joint].
    """
    r = 1.0 - s
    delta = end.position - begin.position
    mean = delta / span
    cubic, quintic = degree >= CUBIC, degree >= QUINTIC
    d0, d1 = cubic * (begin.velocity - mean), cubic * (end.velocity - mean)
    e0 = quintic * (begin.acceleration + (4.0 * d0 + 2.0 * d1) / span)
    e1 = quintic * (end.acceleration - (2.0 * d0 + 4.0 * d1) / span)
    position = (
        begin.position
        + s * delta
        + span * s * r * (r * d0 - s * d1)
        + 0.5 * span * span * s * s * r * r * (r * e0 + s * e1)
    )
    velocity = (
        mean
        + r * (1.0 - 3.0 * s) * d0
        - s * (2.0 - 3.0 * s) * d1
        + 0.5 * span * s * r * (r * (2.0 - 5.0 * s) * e0 + s * (3.0 - 5.0 * s) * e1)
    )
    acceleration = (
        ((6.0 * s - 4.0) * d0 + (6.0 * s - 2.0) * d1) / span
        + (1.0 - 9.0 * s + 18.0 * s * s - 10.0 * s * s * s) * e0
        + s * (3.0 - 12.0 * s + 10.0 * s * s) * e1
    )
    return JointState(position=position, velocity=velocity, acceleration=acceleration)


def replace_at(old: JointTrajectory, t: jax.Array, new: JointTrajectory) -> JointTrajectory:
    """Join another trajectory to one that is under way.

    The reference of that moment becomes the first point of the new one. So position and velocity
    go on without a step, and acceleration too where the new segment is a quintic. Where the new
    points have positions alone, the join is a cubic that ends with the velocity of the line after
    it; ros2_control would let the velocity step there. Joints that the new one does not name stop
    at once where their reference is. A turning joint takes the shortest way to the first new point.

    Args:
        old: what is being followed.
        t: [] s since its start.
        new: what to follow from now on, of the same joints; its own row 0 is dropped.

    Returns:
        The new trajectory, its time from now; the same shapes as ``new``.
    """
    now = sample_state(old, t)
    named = new.commanded
    position = jnp.where(named, new.position[1:], now.position)
    velocity = jnp.where(named, new.velocity[1:], 0.0)
    acceleration = jnp.where(named, new.acceleration[1:], 0.0)
    # Led on to a point where they already are, joints that are not named would swing out and back.
    start_velocity = jnp.where(named, now.velocity, 0.0)
    start_acceleration = jnp.where(named, now.acceleration, 0.0)
    turning = jnp.asarray([is_continuous(joint) for joint in new.joints])
    position = position - jnp.where(turning, _whole_turns(position[0] - now.position), 0.0)
    first = new.degree[0]
    line = _line_velocity(new.time_s, position)
    after = jnp.where(first == LINEAR, jnp.where(named, line, 0.0), velocity[0])
    return replace(
        new,
        position=jnp.concatenate([now.position[None], position]),
        velocity=jnp.concatenate([start_velocity[None], after[None], velocity[1:]]),
        acceleration=jnp.concatenate([start_acceleration[None], acceleration]),
        degree=jnp.concatenate([jnp.maximum(first, CUBIC)[None], new.degree[1:]]),
    )


def from_path(path: Trajectory, yaw_rad: jax.Array) -> JointTrajectory:
    """A planner's way-points as lines of a vehicle's joints.

    At each way-point the robot looks where its next horizontal move goes, and it turns evenly in
    between; before the first such move and after the last it keeps its heading.

    Args:
        path: of one robot.
        yaw_rad: [] heading at its start.

    Returns:
        Joints x, y, z, yaw; the same rows.
    """
    point, time = path.position_m, path.time_s
    move = point[1:, :2] - point[:-1, :2]
    moves = (jnp.abs(move) > 1e-6).any(axis=1)
    safe = jnp.where(moves[:, None], move, jnp.array([1.0, 0.0], move.dtype))
    heading = jnp.arctan2(safe[:, 1], safe[:, 0])
    row = jnp.arange(moves.size)
    last = jax.lax.cummax(jnp.where(moves, row, -1))
    heading = jnp.where(last >= 0, heading[jnp.maximum(last, 0)], yaw_rad)
    yaw = jnp.unwrap(jnp.concatenate([heading, heading[-1:]]))
    yaw = yaw - _whole_turns(yaw[0] - yaw_rad)
    position = jnp.concatenate([point, yaw[:, None].astype(point.dtype)], axis=1)
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=time,
        position=position,
        velocity=jnp.zeros_like(position),
        acceleration=jnp.zeros_like(position),
        degree=jnp.full(time.shape, LINEAR, jnp.int32),
        commanded=jnp.ones(len(VEHICLE_JOINTS), bool),
        found=path.found,
    )


def _state_at_row(trajectory: JointTrajectory, k: jax.Array) -> JointState:
    return JointState(
        position=take_row(trajectory.position, k),
        velocity=take_row(trajectory.velocity, k),
        acceleration=take_row(trajectory.acceleration, k),
    )


def _line_velocity(time_s: jax.Array, position: jax.Array) -> jax.Array:
    """Velocity [n_joint] of the line after the first of the points [n - 1, n_joint]; 0 if none."""
    if position.shape[0] < 2:
        return jnp.zeros_like(position[0])
    span = time_s[2] - time_s[1]
    rate = (position[1] - position[0]) / jnp.where(span > 0, span, 1.0)
    return jnp.where(span > 0, rate, 0.0)


def _whole_turns(angle: jax.Array) -> jax.Array:
    """The multiple of a full turn that is nearest to an angle, rad."""
    return 2 * jnp.pi * jnp.round(angle / (2 * jnp.pi))
