"""Rest-to-rest motion along a line with limits of speed, acceleration and jerk.

The profile of seven phases (Biagiotti and Melchiorri 2008, "Trajectory Planning for Automatic
Machines and Robots", section 3.4): jerk is +j, 0, -j, 0, -j, 0, +j. Position is a cubic in each
phase, so a trajectory of cubics between the ends of the phases holds it without error.
"""

import math
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True, kw_only=True)
class SpeedProfile:
    """Motion from rest to rest; time and length from its start."""

    knots_s: tuple[float, ...]
    """Ends of the phases, from 0 on; phases without duration are left out."""
    jerks_mps3: tuple[float, ...]
    """Jerk of each phase."""

    @property
    def duration_s(self) -> float:
        """Duration of the motion."""
        return self.knots_s[-1]

    def sample(self, time_s: float) -> tuple[float, float]:
        """Return length [m] and speed [m/s] at a time, at rest before and after the motion."""
        length, speed, acceleration = 0.0, 0.0, 0.0
        for (begin, end), jerk in zip(pairwise(self.knots_s), self.jerks_mps3, strict=True):
            t = min(max(time_s - begin, 0.0), end - begin)
            length += t * (speed + t * (acceleration / 2.0 + t * jerk / 6.0))
            speed += t * (acceleration + t * jerk / 2.0)
            acceleration += t * jerk
        return length, speed


def plan_speed(
    length_m: float, speed_mps: float, acceleration_mps2: float, jerk_mps3: float
) -> SpeedProfile:
    """Return the fastest profile over a length.

    Args:
        length_m: of the line; above 0.
        speed_mps: max speed.
        acceleration_mps2: max acceleration, also for braking.
        jerk_mps3: max jerk.
    """
    a, j = acceleration_mps2, jerk_mps3
    speed = min(speed_mps, _max_reached_speed(length_m, a, j))
    if speed * j < a * a:  # the max acceleration is not reached
        jerk_s, hold_s = math.sqrt(speed / j), 0.0
    else:
        jerk_s, hold_s = a / j, speed / a - a / j
    cruise_s = max(0.0, length_m / speed - (2.0 * jerk_s + hold_s))
    phases = (
        (jerk_s, j),
        (hold_s, 0.0),
        (jerk_s, -j),
        (cruise_s, 0.0),
        (jerk_s, -j),
        (hold_s, 0.0),
        (jerk_s, j),
    )
    knots, jerks = [0.0], []
    for duration, jerk in phases:
        if duration > 1e-9:
            knots.append(knots[-1] + duration)
            jerks.append(jerk)
    return SpeedProfile(knots_s=tuple(knots), jerks_mps3=tuple(jerks))


def _max_reached_speed(length_m: float, a: float, j: float) -> float:
    """Return the highest speed that accelerating and braking over a length can reach."""
    speed = math.cbrt(0.25 * length_m * length_m * j)  # v * 2 sqrt(v / j) = L
    if speed * j <= a * a:
        return speed
    # v (v / a + a / j) = L
    half = 0.5 * a * a / j
    return math.sqrt(half * half + a * length_m) - half
