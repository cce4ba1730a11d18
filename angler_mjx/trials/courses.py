"""What the vehicles are told to do: steps of a pose, and a figure of eight in time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.control.commands import PoseTarget
from angler_mjx.control.joint_trajectory import QUINTIC, VEHICLE_JOINTS, JointTrajectory
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.trials.kinds import CRUISE_MPS
from angler_mjx.vehicles.thrusters import FloatArray

START_M = (0.0, 0.0, -10.0)
"""Deep enough that the surface plays no part."""
HALF_WIDTH_M = 2.0
"""Of the figure of eight."""
RUN_UP_S = 4.0
"""From rest to full speed."""
POINT_S = 0.25
"""Between the points of the figure of eight."""
_FINE = 50
"""Steps of integration between two points."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """A motion in time, from rest; [n] leads, time is ``i * period_s``."""

    period_s: float
    position: FloatArray
    """[n, 4] x, y, z in W, m, and heading, rad, unwrapped."""
    velocity: FloatArray
    """[n, 4]."""
    acceleration: FloatArray
    """[n, 4]."""


def pose_commands(targets_m: FloatArray, yaw_rad: FloatArray) -> PoseTarget:
    """Poses to be at, [n] of them, from targets [n, 3] m in W and headings [n]."""
    place = jnp.asarray(targets_m, float)
    return PoseTarget(
        position_m=place, velocity_mps=jnp.zeros_like(place), yaw_rad=jnp.asarray(yaw_rad, float)
    )


def line_commands(targets_m: FloatArray) -> Trajectory:
    """Straight paths from ``START_M`` to targets [n, 3], at cruise speed."""
    ends = np.asarray(targets_m, float)
    starts = np.broadcast_to(START_M, ends.shape)
    # A path of no length would have no planned speed.
    span = np.maximum(np.linalg.norm(ends - starts, axis=1), 1e-3) / CRUISE_MPS
    return Trajectory(
        time_s=jnp.asarray(np.stack([0 * span, span], axis=1), float),
        position_m=jnp.asarray(np.stack([starts, ends], axis=1), float),
        found=jnp.ones(len(ends), bool),
    )


def figure_of_eight(speed_mps: float, n_point: int, period_s: float = POINT_S) -> Course:
    """Gerono's lemniscate at constant speed after a smooth start, the nose along the path.

    c(a) = w (sin a, sin a cos a), with a' = s(t) / |c'(a)| and s the speed: a quintic blend over
    ``RUN_UP_S``, then constant. Derivatives by time are worked out from those of c.
    """
    h = period_s / _FINE
    t = h * np.arange(_FINE * (n_point - 1) + 1)
    x = np.clip(t / RUN_UP_S, 0.0, 1.0)
    pace = speed_mps * (10 * x**3 - 15 * x**4 + 6 * x**5)
    growth = np.where(x < 1, speed_mps * 30 * x**2 * (1 - x) ** 2 / RUN_UP_S, 0.0)
    a = _arguments(pace, h)
    curve, first, second = _lemniscate(a)
    length = np.linalg.norm(first, axis=1)
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    a_1 = pace / length
    a_2 = growth / length - a_1 * pace * np.sum(first * second, axis=1) / length**3
    yaw = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    yaw_1 = turn / length**2 * a_1
    flat = np.zeros((len(t), 1))
    rows = slice(None, None, _FINE)
    parts = (
        [curve + np.array(START_M[:2]), flat + START_M[2], yaw[:, None]],
        [first * a_1[:, None], flat, yaw_1[:, None]],
        [second * a_1[:, None] ** 2 + first * a_2[:, None], flat, np.gradient(yaw_1, h)[:, None]],
    )
    position, velocity, acceleration = (np.concatenate(part, axis=1)[rows] for part in parts)
    return Course(
        period_s=period_s, position=position, velocity=velocity, acceleration=acceleration
    )


def timed_command(course: Course) -> JointTrajectory:
    """A course with its rates, for those who keep time."""
    n, like = len(course.position), course.position
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=jnp.asarray(course.period_s * np.arange(n), float),
        position=jnp.asarray(like, float),
        velocity=jnp.asarray(course.velocity, float),
        acceleration=jnp.asarray(course.acceleration, float),
        degree=jnp.full(n, QUINTIC, jnp.int32),
        commanded=jnp.ones(like.shape[1], bool),
    )


def path_command(course: Course) -> Trajectory:
    """The way-points of a course, at its times."""
    n = len(course.position)
    return Trajectory(
        time_s=jnp.asarray(course.period_s * np.arange(n), float),
        position_m=jnp.asarray(course.position[:, :3], float),
        found=jnp.ones((), bool),
    )


def stacked[T](commands: Sequence[T]) -> T:
    """Commands of one type side by side, [n] leads."""
    together: T = jax.tree.map(lambda *leaves: jnp.stack(leaves), *commands)
    return together


def _arguments(pace: FloatArray, h: float) -> FloatArray:
    """a(t) [n] for speeds [n] at times h apart, by Heun's method."""

    def rate(a: float, speed: float) -> float:
        return speed / (HALF_WIDTH_M * math.hypot(math.cos(a), math.cos(2 * a)))

    a = np.zeros_like(pace)
    for i in range(len(pace) - 1):
        guess = rate(a[i], pace[i])
        a[i + 1] = a[i] + 0.5 * h * (guess + rate(a[i] + h * guess, pace[i + 1]))
    return a


def _lemniscate(a: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The curve [n, 2] and its first two derivatives by a [n]."""
    w = HALF_WIDTH_M
    curve = np.stack([np.sin(a), 0.5 * np.sin(2 * a)], axis=1)
    first = np.stack([np.cos(a), np.cos(2 * a)], axis=1)
    second = np.stack([-np.sin(a), -2 * np.sin(2 * a)], axis=1)
    return w * curve, w * first, w * second
