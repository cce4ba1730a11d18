"""Bounds of the recorded joints of arms: limits, speeds, and which robots have any."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.vehicles import library
from angler_mjx.sim.fleet import Member

MAX_JOINT_SPEED = 50.0
"""Limit of the speed of a joint, rad/s or m/s; faster means divergence."""
LIMIT_MARGIN = 0.05
"""Fraction of its range by which a joint may give way at a stop, or rounding may move it."""


@dataclass(frozen=True, kw_only=True)
class JointBounds:
    """Bounds of the joints [J] of robots [R]."""

    may_have: np.ndarray
    """bool [R] whether any vehicle that the robot can be has joints."""
    must_have: np.ndarray
    """bool [R] whether all of them have."""
    lower: np.ndarray
    """[R, J] lowest position, rad or m; inf without joints."""
    upper: np.ndarray
    """[R, J] highest position."""
    max_speed: np.ndarray
    """[R, J] speed of the servo at most, rad/s or m/s."""


def find_bounds(members: Sequence[Member], joints: int) -> JointBounds:
    """Return the bounds of the joints of a fleet.

    Args:
        members: robots.
        joints: joints of a vehicle with an arm, J.
    """
    rows = [
        [library.load_vehicle(kind.vehicle).find_joints() for kind in member.variants]
        for member in members
    ]
    lower, upper, speed = (np.full((len(rows), joints), fill) for fill in (np.inf, -np.inf, 0.0))
    for robot, arms in enumerate(rows):
        for arm in filter(None, arms):
            lower[robot] = np.minimum(lower[robot], [joint.lower for joint in arm])
            upper[robot] = np.maximum(upper[robot], [joint.upper for joint in arm])
            speeds = [joint.actuator.max_speed for joint in arm]
            speed[robot] = np.maximum(speed[robot], speeds)
    return JointBounds(
        may_have=np.array([any(arms) for arms in rows]),
        must_have=np.array([all(arms) for arms in rows]),
        lower=lower,
        upper=upper,
        max_speed=speed,
    )


def find_joint_faults(
    bounds: JointBounds,
    time_s: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    running: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return the faulty samples, bool [w, t, r], by the name of their array.

    A joint moves between two samples by the mean of their speeds, give or take the largest speed
    that it can have there.

    Args:
        bounds: bounds of the fleet.
        time_s: [t] of the samples.
        position: [w, t, r, J] rad or m.
        velocity: [w, t, r, J] rad/s or m/s.
        running: bool [w, t, r] whether the robot's episode lasts.
    """
    margin = LIMIT_MARGIN * np.where(bounds.may_have[:, None], bounds.upper - bounds.lower, 0.0)
    has_joints = np.isfinite(position).any(-1)
    is_wrong = (has_joints & ~bounds.may_have) | (running & bounds.must_have & ~has_joints)
    with np.errstate(invalid="ignore"):
        is_beyond = (position < bounds.lower - margin) | (position > bounds.upper + margin)
        is_fast = ~(np.abs(velocity) <= MAX_JOINT_SPEED)
        period = np.diff(time_s)[:, None, None]
        moved = np.diff(position, axis=1)
        speeds = velocity[:, :-1], velocity[:, 1:]
        mean = 0.5 * (speeds[0] + speeds[1])
        largest = np.maximum(np.maximum(np.abs(speeds[0]), np.abs(speeds[1])), bounds.max_speed)
        is_apart = np.abs(moved - mean * period) > largest * period + margin
    counts = running & has_joints
    apart = np.zeros_like(running)
    apart[:, 1:] = is_apart.any(-1) & counts[:, 1:] & counts[:, :-1]
    return {
        "joint_position": is_wrong
        | (counts & (is_beyond.any(-1) | ~np.isfinite(position).all(-1))),
        "joint_velocity": (np.isfinite(velocity).any(-1) != has_joints)
        | (counts & is_fast.any(-1))
        | apart,
    }
