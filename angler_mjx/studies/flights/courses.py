"""What vehicles are told to do: places, lines, and a figure of eight in time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.commands.joint_trajectory import (
    QUINTIC,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.stack import Command
from angler_mjx.robot.vehicles.thrusters import FloatArray

START_M = (0.0, 0.0, -10.0)
"""Deep enough that the surface plays no part."""
HALF_WIDTH_M = 2.0
"""Of the figure of eight."""
RUN_UP_S = 4.0
"""From rest to full speed."""
_SUBSTEPS = 50
"""Steps of integration between two points."""
_MIN_LENGTH_M = 1e-3
"""A path of no length would have no planned speed."""


@dataclass(frozen=True, kw_only=True)
class CourseTimes:
    """When a course is told and flown."""

    flight_s: float
    point_s: float
    """Between the points that are commanded."""
    dt_s: float
    """Control period."""

    @property
    def points(self) -> int:
        """Number of points that are commanded, both ends among them."""
        return round(self.flight_s / self.point_s) + 1

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return round(self.flight_s / self.dt_s)


@dataclass(frozen=True, kw_only=True)
class FlightCourse:
    """A motion in the points that are commanded, and at every control step."""

    time_s: FloatArray
    """[n]."""
    points: FloatArray
    """[n, 3, 4] position, velocity and acceleration of x, y, z, in W, m, and heading, rad,
    unwrapped."""
    pose: FloatArray
    """[t, 4] x, y, z and heading at each control step."""
    length_m: float
    """Its length."""
    still: bool
    """Whether the vehicle is to stand still at the end."""


def hold_position(step_m: FloatArray, yaw_rad: float, times: CourseTimes) -> FlightCourse:
    """Be at a place, from the first moment on.

    Args:
        step_m: [3] from the start, in W.
        yaw_rad: heading to have.
        times: of the flight.
    """
    goal = np.concatenate([START_M + step_m, [yaw_rad]])
    points = np.zeros((times.points, 3, 4))
    points[:, 0] = goal
    return FlightCourse(
        time_s=_point_times(times),
        points=points,
        pose=np.tile(goal, (times.steps, 1)),
        length_m=float(np.linalg.norm(step_m)),
        still=True,
    )


def follow_line(step_m: FloatArray, speed_mps: float, times: CourseTimes) -> FlightCourse:
    """Go to a place [3] from the start along a line, at a speed."""
    length = float(np.linalg.norm(step_m))
    step = step_m if length > 0 else np.array([_MIN_LENGTH_M, 0.0, 0.0])
    span, n = max(length, _MIN_LENGTH_M) / speed_mps, times.points
    points = np.zeros((n, 3, 4))
    points[:, 0, :3] = START_M + np.linspace(0.0, 1.0, n)[:, None] * step
    fraction = np.minimum(times.dt_s * np.arange(times.steps) / span, 1.0)
    pose = np.zeros((times.steps, 4))
    pose[:, :3] = START_M + fraction[:, None] * step
    return FlightCourse(
        time_s=np.linspace(0.0, span, n), points=points, pose=pose, length_m=length, still=True
    )


@cache
def follow_eight(speed_mps: float, times: CourseTimes) -> FlightCourse:
    """The figure of eight at a speed."""
    pose = figure_of_eight(speed_mps, times.steps, times.dt_s)[:, 0]
    return FlightCourse(
        time_s=_point_times(times),
        points=figure_of_eight(speed_mps, times.points, times.point_s),
        pose=pose,
        length_m=float(np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1).sum()),
        still=False,
    )


def build_command(courses: Sequence[FlightCourse], *, timed: bool) -> Command:
    """The commands of n flights, on the host; [n] leads.

    Args:
        courses: n of them.
        timed: as trajectories of x, y, z and heading in time; otherwise as a planner's paths.
    """
    time = np.array([course.time_s for course in courses])
    points = np.array([course.points for course in courses])
    # Arrays of the host stand where those of JAX will.
    arrays: dict[str, Any]
    if not timed:
        flags = np.ones(len(courses), bool)
        arrays = {"time_s": time, "position_m": points[:, :, 0, :3], "found": flags}
        return Trajectory(**arrays)
    position, velocity, acceleration = np.moveaxis(points, 2, 0)
    arrays = {
        "time_s": time,
        "position": position,
        "velocity": velocity,
        "acceleration": acceleration,
        "degree": np.full(time.shape, QUINTIC, np.int32),
        "commanded": np.ones((len(courses), len(VEHICLE_JOINTS)), bool),
    }
    return JointTrajectory(joints=VEHICLE_JOINTS, **arrays)


def pose_commands(targets_m: FloatArray, yaw_rad: FloatArray) -> PoseTarget:
    """Poses to be at, [n] of them, from targets [n, 3] m in W and headings [n]."""
    position_m = jnp.asarray(targets_m, float)
    return PoseTarget(
        position_m=position_m,
        velocity_mps=jnp.zeros_like(position_m),
        yaw_rad=jnp.asarray(yaw_rad, float),
    )


def figure_of_eight(speed_mps: float, n_point: int, period_s: float) -> FloatArray:
    """Gerono's lemniscate at constant speed after a smooth start, the nose along the path.

    c(a) = w (sin a, sin a cos a), with a' = s(t) / |c'(a)| and s the speed: a quintic blend over
    ``RUN_UP_S``, then constant. Derivatives by time are worked out from those of c.

    Returns:
        [n_point, 3, 4] position, velocity and acceleration of x, y, z and heading (see
        `FlightCourse`), a row each ``period_s``, from rest.
    """
    h = period_s / _SUBSTEPS
    t = h * np.arange(_SUBSTEPS * (n_point - 1) + 1)
    x = np.clip(t / RUN_UP_S, 0.0, 1.0)
    pace = speed_mps * (10 * x**3 - 15 * x**4 + 6 * x**5)
    growth = np.where(x < 1, speed_mps * 30 * x**2 * (1 - x) ** 2 / RUN_UP_S, 0.0)
    a = _integrate_arguments(pace, h)
    curve, first, second = _evaluate_lemniscate(a)
    length = np.linalg.norm(first, axis=1)
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    a_1 = pace / length
    a_2 = growth / length - a_1 * pace * np.sum(first * second, axis=1) / length**3
    yaw = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    yaw_1 = turn / length**2 * a_1
    flat = np.zeros((len(t), 1))
    rows = slice(None, None, _SUBSTEPS)
    parts = (
        [curve + np.array(START_M[:2]), flat + START_M[2], yaw[:, None]],
        [first * a_1[:, None], flat, yaw_1[:, None]],
        [second * a_1[:, None] ** 2 + first * a_2[:, None], flat, np.gradient(yaw_1, h)[:, None]],
    )
    return np.stack([np.concatenate(part, axis=1)[rows] for part in parts], axis=1)


def _point_times(times: CourseTimes) -> FloatArray:
    return times.point_s * np.arange(times.points, dtype=np.float64)


def _integrate_arguments(pace: FloatArray, h: float) -> FloatArray:
    """a(t) [n] for speeds [n] at times h apart, by Heun's method."""

    def rate(a: float, speed: float) -> float:
        return speed / (HALF_WIDTH_M * math.hypot(math.cos(a), math.cos(2 * a)))

    a = np.zeros_like(pace)
    for i in range(len(pace) - 1):
        guess = rate(a[i], pace[i])
        a[i + 1] = a[i] + 0.5 * h * (guess + rate(a[i] + h * guess, pace[i + 1]))
    return a


def _evaluate_lemniscate(a: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The curve [n, 2] and its first two derivatives by a [n]."""
    w = HALF_WIDTH_M
    curve = np.stack([np.sin(a), 0.5 * np.sin(2 * a)], axis=1)
    first = np.stack([np.cos(a), np.cos(2 * a)], axis=1)
    second = np.stack([-np.sin(a), -2 * np.sin(2 * a)], axis=1)
    return w * curve, w * first, w * second
