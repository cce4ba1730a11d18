"""Horizontal slices of the water of a world at some times, for plots: a lattice of velocities."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.world import currents
from angler_mjx.world.environment import Environment

ACROSS, SLICES = 12, 120
"""Number of points along the longer side of a slice, and max number of slices of a flight."""


@dataclass(frozen=True, kw_only=True)
class CurrentSlices:
    """Velocities of the water on the same n points in the plane in each of k slices."""

    sample: np.ndarray
    """int [k] sample of the flight."""
    time_s: np.ndarray
    """[k] their times."""
    point_m: np.ndarray
    """[k, n, 3] in W."""
    velocity_mps: np.ndarray
    """[k, n, 3] in W."""
    wet: np.ndarray
    """bool [k, n] points that lie neither in rock nor below the sea floor."""
    spacing_m: float
    """Distance between two points."""


def _sample_slices(environment: Environment, time_s: np.ndarray, z_m: np.ndarray) -> dict[str, Any]:
    """Return the fields of slices at times [k] and heights [k]."""
    grid = environment.grid
    occupied, cell = np.asarray(grid.occupied), float(grid.cell_m)
    low, size = np.asarray(grid.origin_m, float), cell * np.array(occupied.shape)
    spacing = float(max(size[:2])) / ACROSS
    east, north = (
        low[axis] + 0.5 * size[axis] + spacing * (np.arange(n) - 0.5 * (n - 1))
        for axis, n in enumerate(max(1, round(size[axis] / spacing)) for axis in (0, 1))
    )
    level = np.stack(np.meshgrid(east, north, indexing="ij"), -1).reshape(-1, 2)
    point = np.concatenate(
        [
            np.broadcast_to(level, (len(z_m), *level.shape)),
            np.broadcast_to(z_m[:, None, None], (len(z_m), len(level), 1)),
        ],
        axis=-1,
    )
    index = np.floor((point - low) / cell).astype(int)
    index = np.clip(index, 0, np.array(occupied.shape) - 1)
    wet = ~occupied[index[..., 0], index[..., 1], index[..., 2]]
    wet &= point[..., 2] > float(environment.floor_z_m)
    times = np.repeat(time_s, len(level))
    velocity = currents.velocities_at(environment.current, point.reshape(-1, 3), times)
    return {
        "point_m": point,
        "velocity_mps": velocity.reshape(point.shape),
        "wet": wet,
        "spacing_m": spacing,
    }


def slice_flight(
    environment: Environment, time_s: np.ndarray, p_m: np.ndarray, running: np.ndarray
) -> CurrentSlices:
    """Return slices at the middle height of a fleet, over its flight.

    Args:
        environment: environment of one world; host arrays.
        time_s: [T] times of the samples.
        p_m: [T, R, 3] positions of the robots, in W; NaN for diverged robots.
        running: bool [T, R] whether the episode continues; without such robots the last height is
            kept, at first the middle of the cells.
    """
    at = np.unique(np.linspace(0, len(time_s) - 1, min(len(time_s), SLICES)).astype(int))
    height = np.where(running & np.isfinite(p_m).all(axis=2), p_m[..., 2], np.nan)
    z, grid = np.empty(len(at)), environment.grid
    last = float(grid.origin_m[2] + 0.5 * grid.cell_m * grid.occupied.shape[2])
    for i, k in enumerate(at):
        heights = height[k][np.isfinite(height[k])]
        last = float(heights.mean()) if heights.size else last
        z[i] = last
    return CurrentSlices(sample=at, time_s=time_s[at], **_sample_slices(environment, time_s[at], z))
