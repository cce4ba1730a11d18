"""Least times and energies in level flows, a reference for planners without their code.

A vehicle moves at a constant speed through the water, free to head anywhere (Zermelo, 1931). On
uniform flow both answers are closed forms. Elsewhere `shoot_min_time_s` shoots Zermelo's extremals
from the start over a fan of headings and refines the one that is first at the goal, in flows that
change with time too; `grid` finds the same number for steady flows by another method.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

type FloatArray = NDArray[np.float64]
type Flow = Callable[[FloatArray, float], FloatArray]
"""Velocity [..., 2] of the water at positions [..., 2] and a time: m/s, m, s."""
type Bounds = tuple[tuple[float, float], tuple[float, float]]
"""(x_lo, y_lo), (x_hi, y_hi), m."""

_SLOPE_STEP_M = 1e-4


def uniform_min_time_s(
    current_mps: FloatArray, start: FloatArray, goal: FloatArray, speed: float
) -> float:
    """Return Zermelo's least time on uniform flow: |goal - start - c T| = V T; inf if unreachable.

    Args:
        current_mps: [2] c.
        start: [2] m.
        goal: [2] m.
        speed: V, speed through the water, m/s.
    """
    displacement = np.asarray(goal, float) - np.asarray(start, float)
    length = float(np.hypot(*displacement))
    if length == 0:
        return 0.0
    along = float(np.dot(displacement, current_mps)) / length
    across = float(current_mps[0] * displacement[1] - current_mps[1] * displacement[0]) / length
    if abs(across) > speed:
        return math.inf
    ground_speed = along + math.sqrt(speed**2 - across**2)
    return length / ground_speed if ground_speed > 0 else math.inf


def uniform_min_energy_j(
    current_mps: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    *,
    hotel_w: float,
    cubic_ws3pm3: float,
    speeds: tuple[float, float],
) -> tuple[float, float]:
    """Return the least energy along the line at one speed V of a range, P(V) = hotel + c V^3.

    Args:
        current_mps: [2].
        start: [2] m.
        goal: [2] m.
        hotel_w: power consumed at rest.
        cubic_ws3pm3: c.
        speeds: least and greatest V, m/s.

    Returns:
        Energy, J, and its speed, m/s; infinite if out of reach.
    """

    def energy(v: FloatArray) -> FloatArray:
        times = [uniform_min_time_s(current_mps, start, goal, float(v_mps)) for v_mps in v]
        cost: FloatArray = (hotel_w + cubic_ws3pm3 * v**3) * np.array(times)
        return cost

    low, high = speeds
    for _ in range(12):
        v = np.linspace(low, high, 41)
        cost = energy(v)
        k = int(np.argmin(cost))
        low, high = v[max(0, k - 1)], v[min(40, k + 1)]
    return float(cost[k]), float(v[k])


@dataclass(frozen=True, kw_only=True)
class _ExtremalFan:
    """Extremals: time and distance, m, of each one's nearest pass of the goal."""

    time_s: FloatArray
    miss_m: FloatArray
    side: FloatArray
    """Side of the goal that it passed, as a sign, seen along its way over ground."""


def shoot_min_time_s(
    flow: Flow,
    start: FloatArray,
    goal: FloatArray,
    speed: float,
    bounds: Bounds,
    *,
    horizon_s: float,
    step_s: float = 0.05,
    headings: int = 720,
    start_time_s: float = 0.0,
) -> float:
    """Return the least time by shooting extremals; infinite without arrival within the horizon.

    Two neighbouring headings between which the goal lies are halved until the miss vanishes. An
    extremal that meets the bounds ends there: a path along a wall is not found.

    Args:
        flow: `Flow`.
        start: [2] m.
        goal: [2] m.
        speed: speed through the water, m/s.
        bounds: `Bounds`.
        horizon_s: longest time.
        step_s: step of Runge and Kutta's fourth order.
        headings: number of headings of the fan.
        start_time_s: start time on the clock of the flow.
    """
    best, limit = math.inf, horizon_s
    while True:
        shoot = _Shooter(
            flow,
            np.asarray(start, float),
            np.asarray(goal, float),
            speed,
            bounds,
            limit,
            step_s,
            start_time_s,
        )
        time_s = _first_arrival_s(shoot, headings)
        if time_s >= best:
            return best
        best, limit = time_s, (1.0 - 1e-4) * time_s


def _first_arrival_s(shoot: "_Shooter", headings: int) -> float:
    """Return least time among the nearest passes of a fan.

    A nearer pass may hide an earlier one.
    """
    angles = np.linspace(-math.pi, math.pi, headings, endpoint=False)
    fan = shoot(angles)
    next_index = np.roll(np.arange(headings), -1)
    is_bracketing = fan.side * fan.side[next_index] < 0
    low, side = angles[is_bracketing], fan.side[is_bracketing]
    if not low.size:
        return math.inf
    high = low + 2.0 * math.pi / headings
    for _ in range(40):
        middle = 0.5 * (low + high)
        passes = shoot(middle)
        is_same_side = passes.side == side
        low, high = np.where(is_same_side, middle, low), np.where(is_same_side, high, middle)
    is_hit = passes.miss_m < 1e-3
    return float(np.min(passes.time_s[is_hit], initial=math.inf))


@dataclass(frozen=True)
class _Shooter:
    """Zermelo's extremals from a start: x' = c + V (cos, sin), and the turning of the heading."""

    flow: Flow
    start: FloatArray
    goal: FloatArray
    speed: float
    bounds: Bounds
    horizon_s: float
    step_s: float
    start_time_s: float

    def _rates(self, p: FloatArray, angle: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        h = _SLOPE_STEP_M
        dx, dy = np.array([h, 0.0]), np.array([0.0, h])
        by_x = (self.flow(p + dx, t) - self.flow(p - dx, t)) / (2 * h)
        by_y = (self.flow(p + dy, t) - self.flow(p - dy, t)) / (2 * h)
        c, s = np.cos(angle), np.sin(angle)
        ground_velocity = self.flow(p, t) + self.speed * np.stack([c, s], axis=-1)
        heading_rate = s * s * by_x[:, 1] + s * c * (by_x[:, 0] - by_y[:, 1]) - c * c * by_y[:, 0]
        return ground_velocity, heading_rate

    def __call__(self, headings: FloatArray) -> _ExtremalFan:
        """Shoot [n] headings; each keeps its nearest pass of the whole horizon."""
        n, dt = len(headings), self.step_s
        p, angle = np.tile(self.start, (n, 1)), headings.copy()
        is_inside = np.ones(n, bool)
        best = np.full(n, np.inf)
        time, side = np.full(n, np.inf), np.zeros(n)
        lo, hi = (np.asarray(x, float) for x in self.bounds)
        for k in range(math.ceil(self.horizon_s / dt)):
            t = self.start_time_s + k * dt
            v1, w1 = self._rates(p, angle, t)
            v2, w2 = self._rates(p + 0.5 * dt * v1, angle + 0.5 * dt * w1, t + 0.5 * dt)
            v3, w3 = self._rates(p + 0.5 * dt * v2, angle + 0.5 * dt * w2, t + 0.5 * dt)
            v4, w4 = self._rates(p + dt * v3, angle + dt * w3, t + dt)
            p_next = p + dt / 6.0 * (v1 + 2 * v2 + 2 * v3 + v4)
            # Nearest point of the short line from p to the end of the step.
            step_m, goal_offset = p_next - p, self.goal - p
            fraction = np.sum(step_m * goal_offset, axis=1) / np.maximum(
                np.sum(step_m * step_m, axis=1), 1e-30
            )
            fraction = np.clip(fraction, 0.0, 1.0)
            miss = np.hypot(*(goal_offset - fraction[:, None] * step_m).T)
            nearer = is_inside & (miss < best)
            best = np.where(nearer, miss, best)
            time = np.where(nearer, (k + fraction) * dt, time)
            side = np.where(
                nearer,
                np.sign(step_m[:, 0] * goal_offset[:, 1] - step_m[:, 1] * goal_offset[:, 0]),
                side,
            )
            p, angle = p_next, angle + dt / 6.0 * (w1 + 2 * w2 + 2 * w3 + w4)
            is_inside &= np.all((p >= lo) & (p <= hi), axis=1)
            if not is_inside.any():
                break
        return _ExtremalFan(time_s=time, miss_m=best, side=side)
