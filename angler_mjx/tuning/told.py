"""What a vehicle is told in a flight, and where it is to be at every control step of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from angler_mjx.control.joint_trajectory import QUINTIC, VEHICLE_JOINTS, JointTrajectory
from angler_mjx.control.stack import Command
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.trials import courses
from angler_mjx.tuning.measures import Reference
from angler_mjx.vehicles.thrusters import FloatArray

FLIGHT_S = 30.0
"""A round of the figure of eight at 0.5 m/s, from rest, takes 26 s."""
_POINT_S = 0.5
"""Between the points of a course."""
_POINTS = round(FLIGHT_S / _POINT_S) + 1
_TIMES_S: FloatArray = _POINT_S * np.arange(_POINTS, dtype=np.float64)
_SHORT_M = 1e-3
"""A path of no length would have no planned speed."""


@dataclass(frozen=True, kw_only=True)
class Told:
    """One course, in the points that are commanded and at every control step."""

    time_s: FloatArray
    """[n]."""
    points: FloatArray
    """[n, 3, 4] position, velocity and acceleration of x, y, z, in W, m, and heading, rad."""
    pose: FloatArray
    """[t, 4] x, y, z and heading at each control step."""
    way_m: float
    """Its length."""
    still: bool
    """Whether the vehicle is to stand still at the end."""


def place(step_m: FloatArray, yaw_rad: float, dt: float) -> Told:
    """Be at a place, from the first moment on.

    Args:
        step_m: [3] from the start, in W.
        yaw_rad: heading to have.
        dt: control period, s.
    """
    goal = np.concatenate([courses.START_M + step_m, [yaw_rad]])
    points = np.zeros((_POINTS, 3, 4))
    points[:, 0] = goal
    return Told(
        time_s=_TIMES_S,
        points=points,
        pose=np.tile(goal, (_steps(dt), 1)),
        way_m=float(np.linalg.norm(step_m)),
        still=True,
    )


def line(step_m: FloatArray, speed_mps: float, dt: float) -> Told:
    """Go to a place [3] from the start along a line, at a speed."""
    length = float(np.linalg.norm(step_m))
    step = step_m if length > _SHORT_M else np.array([_SHORT_M, 0.0, 0.0])
    span = max(length, _SHORT_M) / speed_mps
    points = np.zeros((_POINTS, 3, 4))
    points[:, 0, :3] = courses.START_M + np.linspace(0.0, 1.0, _POINTS)[:, None] * step
    share = np.minimum(dt * np.arange(_steps(dt)) / span, 1.0)
    pose = np.zeros((_steps(dt), 4))
    pose[:, :3] = courses.START_M + share[:, None] * step
    return Told(
        time_s=np.linspace(0.0, span, _POINTS), points=points, pose=pose, way_m=length, still=True
    )


@cache
def eight(speed_mps: float, dt: float) -> Told:
    """The figure of eight at a speed."""
    coarse = courses.figure_of_eight(speed_mps, _POINTS, _POINT_S)
    fine = courses.figure_of_eight(speed_mps, _steps(dt), dt)
    return Told(
        time_s=_TIMES_S,
        points=np.stack([coarse.position, coarse.velocity, coarse.acceleration], axis=1),
        pose=fine.position,
        way_m=float(np.linalg.norm(np.diff(fine.position[:, :3], axis=0), axis=1).sum()),
        still=False,
    )


def command(told: Sequence[Told], *, timed: bool) -> Command:
    """The commands of n flights, on the host; [n] leads.

    Args:
        told: n courses.
        timed: as trajectories of x, y, z and heading in time; otherwise as a planner's paths.
    """
    time = np.array([one.time_s for one in told])
    points = np.array([one.points for one in told])
    # Arrays of the host stand where those of JAX will.
    given: dict[str, Any]
    if not timed:
        found = np.ones(len(told), bool)
        given = {"time_s": time, "position_m": points[:, :, 0, :3], "found": found}
        return Trajectory(**given)
    position, velocity, acceleration = np.moveaxis(points, 2, 0)
    given = {
        "time_s": time,
        "position": position,
        "velocity": velocity,
        "acceleration": acceleration,
        "degree": np.full(time.shape, QUINTIC, np.int32),
        "commanded": np.ones((len(told), len(VEHICLE_JOINTS)), bool),
    }
    return JointTrajectory(joints=VEHICLE_JOINTS, **given)


def reference(told: Sequence[Told], *, heading: bool) -> Reference:
    """Where n vehicles are to be, on the host; [n] leads.

    Args:
        told: n courses.
        heading: whether headings count.
    """
    still = np.array([one.still for one in told], float)
    given: dict[str, Any] = {
        "pose": np.array([one.pose for one in told]),
        "still": still,
        "heading": np.full(len(told), float(heading)),
        "way_m": np.maximum([one.way_m for one in told], 1.0),
    }
    return Reference(**given)


def _steps(dt: float) -> int:
    return round(FLIGHT_S / dt)
