"""Limits of targets, held before anything is sent: numbers, speed, fence, lead over the robot."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.runs.session.interface import Floats

DEFAULT_SPEED_MPS = 0.3
ARM_MARGIN_M = 1.0
"""Max distance from the fence at which a vehicle is armed: one at the surface floats."""
LEAD_S = 1.0
"""Max lead of a target over its robot, as a time at the max speed.

A position controller hurries after a target that is far ahead."""
_SLACK = 1e-4
"""Change by a limit, m or m/s, that is rounding."""


@dataclass(frozen=True, kw_only=True)
class Fence:
    """Box in W that targets stay in."""

    lower_m: tuple[float, float, float]
    upper_m: tuple[float, float, float]

    def __str__(self) -> str:
        """Return the box as text."""
        ranges = zip("xyz", self.lower_m, self.upper_m, strict=True)
        return ", ".join(f"{axis} {lower:g} to {upper:g}" for axis, lower, upper in ranges) + " m"

    def measure_distance(self, position_m: Floats) -> float:
        """Return the distance [m] of a position [3] from the box; 0 inside."""
        nearest = np.clip(position_m, self.lower_m, self.upper_m)
        return float(np.linalg.norm(position_m - nearest))


def parse_fence(text: str) -> Fence:
    """Parse a fence: ``XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX``, m in W.

    Raises:
        ConfigError: the text has another form.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    lower, upper = tuple(numbers[:3]), tuple(numbers[3:])
    is_box = len(numbers) == 6 and all(map(math.isfinite, numbers))
    if not is_box or not all(a < b for a, b in zip(lower, upper, strict=True)):
        raise ConfigError(
            f"--fence {format_value(text)}: give XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX in m, each minimum "
            "below its maximum, as in -5,-5,-6,5,5,-1"
        )
    return Fence(lower_m=(lower[0], lower[1], lower[2]), upper_m=(upper[0], upper[1], upper[2]))


@dataclass(frozen=True, kw_only=True)
class Setpoint:
    """Position target in W."""

    position_m: Floats
    velocity_mps: Floats
    yaw_rad: float


class SetpointGuard:
    """Guard of the targets of one robot.

    Attributes:
        counts: targets that were changed or kept back: ``not_finite``, ``step``, ``speed``,
            ``fence``, ``lead``.
    """

    def __init__(self, fence: Fence, max_speed_mps: float) -> None:
        """Set the limits.

        Raises:
            ConfigError: the speed is no number above 0.
        """
        if not 0.0 < max_speed_mps < math.inf:
            raise ConfigError(f"--max-speed {max_speed_mps:g}: give a number above 0, in m/s")
        self.fence, self.max_speed_mps = fence, max_speed_mps
        self.counts: Counter[str] = Counter()
        self._last_m: Floats | None = None

    def restart(self) -> None:
        """Forget the last target: the next one begins at the robot."""
        self._last_m = None

    def limit(self, setpoint: Setpoint, robot_m: Floats, dt_s: float) -> Setpoint | None:
        """Return the target to send; None to send none, as a number is not finite.

        The position moves at most at the max speed, stays in the fence, and leads the robot by at
        most `LEAD_S` at that speed. A robot outside the fence is led straight back to it.

        Args:
            setpoint: of the guidance.
            robot_m: [3] estimated position of the robot.
            dt_s: time since the last target.
        """
        parts = (setpoint.position_m, setpoint.velocity_mps, [setpoint.yaw_rad], robot_m)
        if not all(np.isfinite(part).all() for part in parts):
            self.counts["not_finite"] += 1
            return None
        last_m = robot_m if self._last_m is None else self._last_m
        stepped = self._shorten(setpoint.position_m - last_m, self.max_speed_mps * dt_s, "step")
        velocity = self._shorten(setpoint.velocity_mps, self.max_speed_mps, "speed")
        fenced = np.clip(last_m + stepped, self.fence.lower_m, self.fence.upper_m)
        is_fenced = np.abs(fenced - last_m - stepped) > _SLACK
        if is_fenced.any():
            self.counts["fence"] += 1
        lead = self._shorten(fenced - robot_m, self.max_speed_mps * LEAD_S, "lead")
        self._last_m = robot_m + lead
        return Setpoint(
            position_m=self._last_m,
            velocity_mps=np.where(is_fenced, 0.0, velocity),
            yaw_rad=setpoint.yaw_rad,
        )

    def _shorten(self, vector: Floats, maximum: float, reason: str) -> Floats:
        """Return a vector of at most a length, and count it if it was longer."""
        length = float(np.linalg.norm(vector))
        if length <= maximum + _SLACK:
            return vector
        self.counts[reason] += 1
        shortened: Floats = vector * (maximum / length)
        return shortened
