"""Least time in a steady level flow on a grid: the value of Hamilton, Jacobi and Bellman.

|grad T| V - grad T . c = 1 up to the goal, T = 0 there. The scheme is semi-Lagrangian: from each
grid point the vehicle goes straight to the rim of the square around it, three cells away; between
grid points of the rim T is linear, and the position on the rim is searched among nine per cell.
"""

import math

import numpy as np

from angler_experiments.currents.zermelo import Bounds, FloatArray, Flow, uniform_min_time_s

_REACH_POINTS = 3
_OFFSETS = range(-_REACH_POINTS, _REACH_POINTS)
_RING = (
    *((_REACH_POINTS, k) for k in _OFFSETS),
    *((-k, _REACH_POINTS) for k in _OFFSETS),
    *((-_REACH_POINTS, -k) for k in _OFFSETS),
    *((k, -_REACH_POINTS) for k in _OFFSETS),
)
"""Grid points of the rim, in order around it."""
_FRACTIONS = np.linspace(0.0, 1.0, 9)


def steady_min_time_s(
    flow: Flow, start: FloatArray, goal: FloatArray, speed: float, bounds: Bounds, *, cells: int
) -> float:
    """Return the least time on a grid of square cells, of first order in their size.

    Args:
        flow: `Flow`, read at time 0.
        start: [2] m.
        goal: [2] m.
        speed: speed through the water, m/s.
        bounds: `Bounds`; no path leaves them.
        cells: number of cells along the longer side.
    """
    lo, hi = (np.asarray(x, float) for x in bounds)
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    h = float(np.max(hi - lo)) / cells
    n = np.rint((hi - lo) / h).astype(int) + 1
    x, y = np.meshgrid(*(lo[i] + h * np.arange(n[i]) for i in (0, 1)), indexing="ij")
    p = np.stack([x, y], axis=-1)
    costs = [_travel_times(flow, p, h, speed, k) for k in range(len(_RING))]
    value = np.full(tuple(n), np.inf)
    is_near_goal = np.hypot(*(p - goal).transpose(2, 0, 1)) < 5 * h
    # Around the goal the flow is taken as uniform, which is right to second order.
    for i, j in np.argwhere(is_near_goal):
        mid = np.asarray(flow(0.5 * (p[i, j] + goal), 0.0), float)
        value[i, j] = uniform_min_time_s(mid, p[i, j], goal, speed)
    for _ in range(20 * cells):
        padded = np.pad(value, _REACH_POINTS, constant_values=np.inf)
        rim = [
            padded[
                _REACH_POINTS + i : _REACH_POINTS + i + n[0],
                _REACH_POINTS + j : _REACH_POINTS + j + n[1],
            ]
            for i, j in _RING
        ]
        new = value
        for k in range(len(_RING)):
            a, b = rim[k][..., None], rim[(k + 1) % len(_RING)][..., None]
            with np.errstate(invalid="ignore"):
                interpolated = np.where(
                    _FRACTIONS == 0, a, np.where(_FRACTIONS == 1, b, a + _FRACTIONS * (b - a))
                )
            total = np.where(np.isnan(interpolated), np.inf, interpolated) + costs[k]
            new = np.minimum(new, total.min(axis=-1))
        new = np.where(is_near_goal, value, new)
        with np.errstate(invalid="ignore"):
            change = np.nanmax(np.where(np.isfinite(new), np.abs(new - value), 0.0))
        value = new
        if change < 1e-9:
            break
    start_index = np.clip((start - lo) / h, 0, n - 1 - 1e-9)
    (i, j), (u, w) = start_index.astype(int), start_index - start_index.astype(int)
    corners = value[i : i + 2, j : j + 2]
    weights = np.outer([1 - u, u], [1 - w, w])
    return float(np.sum(np.where(weights > 0, corners * weights, 0.0)))


def _travel_times(flow: Flow, p: FloatArray, h: float, speed: float, k: int) -> FloatArray:
    """Return times to positions between rim points ``k`` and the next, [x, y, fraction].

    The flow is that midway. Infinite where the flow keeps the vehicle from the position.
    """
    a, b = np.array(_RING[k], float), np.array(_RING[(k + 1) % len(_RING)], float)
    displacement = a + _FRACTIONS[:, None] * (b - a)
    length = np.hypot(*displacement.T)
    water = np.asarray(flow(p[:, :, None] + 0.5 * h * displacement, 0.0), float)
    along = np.sum(water * (displacement / length[:, None]), axis=-1)
    discriminant = speed**2 - (np.sum(water * water, axis=-1) - along**2)
    ground_speed = along + np.sqrt(np.maximum(discriminant, 0.0))
    is_reachable = (discriminant >= 0) & (ground_speed > 1e-9)
    times: FloatArray = np.where(
        is_reachable, h * length / np.where(is_reachable, ground_speed, 1.0), math.inf
    )
    return times
