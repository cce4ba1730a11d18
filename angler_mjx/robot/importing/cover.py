"""Capsules about the solids of foreign files."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from angler_mjx.robot.importing.foreign_vehicle import Shape
from angler_mjx.robot.importing.numbers import round_number, round_vector

MAX_CAPSULES = 4
"""Max number of capsules across a box."""
_SHORTEST_M = 2e-3
"""Least length of the axis of a capsule."""

type Capsule = tuple[np.ndarray, np.ndarray, float]
"""Two ends [3] of the axis, and the radius; m."""


def cover_box(half_m: Sequence[float] | np.ndarray, pose: np.ndarray) -> list[Capsule]:
    """Return capsules along the longest edges that together have the extents of a box or more.

    Args:
        half_m: half the edge lengths [3].
        pose: [4, 4] of its centre.
    """
    order = np.argsort(half_m)
    thin, middle, long = (float(half_m[i]) for i in order)
    count = min(math.ceil(middle / thin - 1e-9), MAX_CAPSULES)
    radius = max(thin, middle / count)
    reach = max(long - radius, _SHORTEST_M / 2)
    capsules = []
    for i in range(count):
        offset = np.zeros(3)
        offset[order[1]] = 0.0 if count == 1 else (middle - radius) * (2 * i / (count - 1) - 1)
        along = np.zeros(3)
        along[order[2]] = reach
        ends = [pose[:3, :3] @ (offset + sign * along) + pose[:3, 3] for sign in (-1, 1)]
        capsules.append((ends[0], ends[1], radius))
    return capsules


def cover_cylinder(radius_m: float, length_m: float, pose: np.ndarray) -> list[Capsule]:
    """Return capsules about a cylinder along z of its pose [4, 4]; a flat one as a box."""
    if length_m < 2 * radius_m:
        return cover_box((radius_m, radius_m, length_m / 2), pose)
    along = pose[:3, 2] * max(length_m / 2 - radius_m, _SHORTEST_M / 2)
    return [(pose[:3, 3] - along, pose[:3, 3] + along, radius_m)]


def cover_sphere(radius_m: float, pose: np.ndarray) -> list[Capsule]:
    """Return a ball at a pose [4, 4] as a short capsule."""
    along = pose[:3, 0] * _SHORTEST_M / 2
    return [(pose[:3, 3] - along, pose[:3, 3] + along, radius_m)]


def cover_shape(shape: Shape, pose: np.ndarray) -> list[Capsule]:
    """Return the capsules about a shape at a pose [4, 4]."""
    match shape.kind:
        case "box":
            return cover_box(shape.half_extents_m.tolist(), pose)
        case "cylinder":
            return cover_cylinder(shape.size[0], shape.size[1], pose)
    return cover_sphere(shape.size[0], pose)


def capsule_table(capsule: Capsule) -> dict[str, Any]:
    """Return the table of a capsule."""
    start, end, radius = capsule
    return {
        "from_m": round_vector(start),
        "to_m": round_vector(end),
        "radius_m": round_number(radius),
    }
