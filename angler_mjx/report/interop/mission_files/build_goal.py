"""JointTrajectory of a mission: when a vehicle is where, with the speeds of the firmware.

Every leg starts and ends at rest, with the limits of the firmware's way-point navigation. The
heading turns to that of the leg while the leg is flown. Positions and headings are cubics between
common times.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from angler_mjx.report.interop.mission_files.route import Circle, Position, Stop, VehicleLimits
from angler_mjx.report.interop.mission_files.speed_profile import SpeedProfile, plan_speed
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS

TURN_RATE_RADPS = math.radians(30.0)
"""Mean rate of turns at the start of a leg; a cubic from rest to rest peaks at 1.5 times that."""
_MIN_LENGTH_M = 1e-3
"""Length below which a leg is none."""
_CIRCLE_POINTS = 24
"""Points of a cubic on each turn of a circle: 0.1 mm off a circle of 10 m."""
_MIN_LEVEL_M = 0.1
"""Horizontal length of a leg below which it has no heading."""
_MIN_SEGMENT_S = 1e-6

type _Motion = Callable[[float], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, kw_only=True)
class PlannedMission:
    """Plan of a mission."""

    goal: JointGoal
    """Joints x, y, z and yaw, from time 0 at the start."""
    arrivals_s: tuple[float, ...]
    """Time of arrival at each stop; a circle begins then."""
    ends_s: tuple[float, ...]
    """Time at which each stop is left: after its hold, and its circle."""
    max_speed_mps: float
    """Max speed along the path."""

    @property
    def duration_s(self) -> float:
        """Duration from the start to the last point."""
        return self.goal.points[-1].time_s


@dataclass(frozen=True, kw_only=True)
class _Piece:
    """Motion of the position over a time, with the knots of its cubics."""

    begin_s: float
    knots_s: tuple[float, ...]
    """From `begin_s`."""
    motion: _Motion
    """Position and velocity [3] at a time from `begin_s`."""


@dataclass(frozen=True, kw_only=True)
class _Turn:
    """Turn of the heading, a cubic from rest to rest."""

    begin_s: float
    duration_s: float
    from_rad: float
    by_rad: float

    def sample(self, time_s: float) -> tuple[float, float]:
        """Return heading and rate at a time."""
        s = min(max((time_s - self.begin_s) / self.duration_s, 0.0), 1.0)
        return (
            self.from_rad + self.by_rad * s * s * (3.0 - 2.0 * s),
            self.by_rad * 6.0 * s * (1.0 - s) / self.duration_s,
        )


def build_goal(
    route: Sequence[Stop], limits: VehicleLimits, *, start_m: Position, start_yaw_rad: float
) -> PlannedMission:
    """Return the plan of a route.

    Args:
        route: stops, in order; an infinite hold ends the plan.
        limits: of the vehicle.
        start_m: position at time 0.
        start_yaw_rad: heading at time 0.
    """
    time_s, position, yaw = 0.0, np.asarray(start_m, float), start_yaw_rad
    pieces: list[_Piece] = []
    turns: list[_Turn] = []
    arrivals, ends = [], []
    max_speed = 0.0
    for stop in route:
        target = np.asarray(stop.position_m, float)
        begin_s, leg_s = time_s, 0.0
        if (length := float(np.linalg.norm(target - position))) > _MIN_LENGTH_M:
            profile = _plan_leg(target - position, length, stop.speed_mps, limits)
            pieces.append(_build_line(begin_s, position, target, profile))
            leg_s = profile.duration_s
            max_speed = max(max_speed, profile.sample(0.5 * leg_s)[1])
        level = target[:2] - position[:2]
        heading = yaw if stop.yaw_rad is None else stop.yaw_rad
        if stop.yaw_rad is None and np.hypot(*level) > _MIN_LEVEL_M:
            heading = math.atan2(level[1], level[0])
        arrivals.append(begin_s + leg_s)
        if stop.circle is not None:
            piece, speed = _build_circle(begin_s + leg_s, stop.circle, target, limits)
            pieces.append(piece)
            leg_s += piece.knots_s[-1]
            max_speed = max(max_speed, speed)
        time_s = begin_s + leg_s + (0.0 if math.isinf(stop.hold_s) else stop.hold_s)
        by = math.remainder(heading - yaw, math.tau)
        if abs(by) > 1e-6 and time_s > begin_s:
            duration = min(max(abs(by) / TURN_RATE_RADPS, 0.1), time_s - begin_s)
            turns.append(_Turn(begin_s=begin_s, duration_s=duration, from_rad=yaw, by_rad=by))
            yaw += by
        position = target
        ends.append(time_s)
    time_s = max(time_s, 1.0)  # a trajectory has an end later than its start
    points = _build_points(pieces, turns, time_s, np.asarray(start_m, float), yaw)
    return PlannedMission(
        goal=JointGoal(joint_names=VEHICLE_JOINTS, points=points),
        arrivals_s=tuple(arrivals),
        ends_s=tuple(ends),
        max_speed_mps=max_speed,
    )


def _plan_leg(
    offset: np.ndarray, length: float, speed_mps: float, limits: VehicleLimits
) -> SpeedProfile:
    """Return the profile along a leg: neither its horizontal nor its vertical part is too fast."""
    level, height = float(np.hypot(*offset[:2])) / length, float(offset[2]) / length
    vertical_mps = limits.speed_up_mps if height > 0 else limits.speed_down_mps
    speed = min(_along(level, speed_mps), _along(abs(height), vertical_mps), limits.max_speed_mps)
    acceleration = min(
        _along(level, limits.acceleration_mps2), _along(abs(height), limits.acceleration_z_mps2)
    )
    return plan_speed(length, speed, acceleration, limits.jerk_mps3)


def _along(part: float, limit: float) -> float:
    """Return the limit along a direction of which a part lies along the limited one."""
    return limit / part if part > 1e-6 else math.inf


def _build_line(
    begin_s: float, position: np.ndarray, target: np.ndarray, profile: SpeedProfile
) -> _Piece:
    direction = (target - position) / np.linalg.norm(target - position)

    def move(time_s: float) -> tuple[np.ndarray, np.ndarray]:
        length, speed = profile.sample(time_s)
        return position + length * direction, speed * direction

    return _Piece(begin_s=begin_s, knots_s=profile.knots_s, motion=move)


def _build_circle(
    begin_s: float, circle: Circle, edge: np.ndarray, limits: VehicleLimits
) -> tuple[_Piece, float]:
    """Return the motion along a circle from its edge, back to rest there, and its speed."""
    center = np.asarray(circle.center_m, float)
    radius, sign = circle.radius_m, -math.copysign(1.0, circle.turns)
    first = math.atan2(edge[1] - center[1], edge[0] - center[0])
    speed = min(limits.circle_rate_radps * radius, limits.max_speed_mps)
    length = abs(circle.turns) * math.tau * radius
    profile = plan_speed(length, speed, limits.acceleration_mps2, limits.jerk_mps3)

    def move(time_s: float) -> tuple[np.ndarray, np.ndarray]:
        path, rate = profile.sample(time_s)
        angle = first + sign * path / radius
        along = np.array([-math.sin(angle), math.cos(angle), 0.0])
        outward = np.array([math.cos(angle), math.sin(angle), 0.0])
        return center + radius * outward, sign * rate * along

    count = max(2, math.ceil(abs(circle.turns) * _CIRCLE_POINTS))
    even = np.linspace(0.0, profile.duration_s, count + 1).tolist()
    knots = tuple(sorted({*even, *profile.knots_s}))
    return _Piece(begin_s=begin_s, knots_s=knots, motion=move), speed


def _build_points(
    pieces: Sequence[_Piece],
    turns: Sequence[_Turn],
    end_s: float,
    start_m: np.ndarray,
    end_yaw_rad: float,
) -> tuple[JointPoint, ...]:
    """Return points at all knots of positions and headings, and at the end."""
    times = {0.0, end_s}
    for piece in pieces:
        times |= {piece.begin_s + knot for knot in piece.knots_s}
    for turn in turns:
        times |= {turn.begin_s, turn.begin_s + turn.duration_s}
    ordered = sorted(times)
    distinct = [
        time for time, later in pairwise([*ordered, math.inf]) if later - time > _MIN_SEGMENT_S
    ]
    distinct[0] = 0.0
    points = []
    for time in distinct:
        position, velocity = start_m, np.zeros(3)
        begun = [piece for piece in pieces if time >= piece.begin_s - _MIN_SEGMENT_S]
        if begun:
            position, velocity = begun[-1].motion(time - begun[-1].begin_s)
        yaw, rate = (turns[0].from_rad, 0.0) if turns else (end_yaw_rad, 0.0)
        begun_turns = [turn for turn in turns if time >= turn.begin_s - _MIN_SEGMENT_S]
        if begun_turns:
            yaw, rate = begun_turns[-1].sample(time)
        is_last = time == distinct[-1]
        points.append(
            JointPoint(
                time_s=time,
                positions=(*position.tolist(), yaw),
                velocities=(0.0,) * 4 if is_last else (*velocity.tolist(), rate),
            )
        )
    return tuple(points)
