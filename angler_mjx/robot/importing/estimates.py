"""Estimates of what a foreign file does not state: added mass and drag."""

import math
from collections.abc import Sequence

import numpy as np

DRAG_COEFFICIENT = 1.0
"""Drag coefficient of a box by its frontal area; 0.8 to 1.05 are measured on boxy vehicles."""


def estimate_added_mass(size_m: Sequence[float], volume_m3: float, density: float) -> np.ndarray:
    """Return the added mass [6] of an ellipsoid with these proportions and this volume.

    Lamb, Hydrodynamics, 6th ed. 1932, 114 and 373; coefficients by Carlson's integral R_D.

    Args:
        size_m: edge lengths [3] of the box around it.
        volume_m3: displaced volume.
        density: of the water, kg/m^3.
    """
    from scipy.special import elliprd  # half a second

    half = np.asarray(size_m) / 2
    half = half * (volume_m3 / (4 / 3 * math.pi * np.prod(half))) ** (1 / 3)
    square, mass = half**2, density * volume_m3
    scale = 2 / 3 * np.prod(half)
    alpha = np.array(
        [scale * elliprd(square[(i + 1) % 3], square[(i + 2) % 3], square[i]) for i in range(3)]
    )
    linear = mass * alpha / (2 - alpha)
    angular = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        difference, total = square[j] - square[k], square[j] + square[k]
        spread = alpha[k] - alpha[j]
        low = 2 * difference - total * spread
        is_round = abs(difference) < 1e-9 * total
        angular.append(0.0 if is_round else mass / 5 * difference**2 * spread / low)
    return np.concatenate([linear, np.maximum(angular, 0.0)])


def estimate_quadratic_drag(size_m: Sequence[float], density: float) -> np.ndarray:
    """Return the quadratic damping [6] of a box, strip by strip in rotation.

    Args:
        size_m: edge lengths [3].
        density: of the water, kg/m^3.
    """
    x, y, z = size_m
    half = 0.5 * density * DRAG_COEFFICIENT
    linear = [half * y * z, half * x * z, half * x * y]
    # A strip at r from the axis drags by half rho Cd (omega r)^2: the sum of r^3 is b^4 / 32.
    angular = [
        half * length * (a**4 + b**4) / 32 for length, a, b in ((x, y, z), (y, x, z), (z, x, y))
    ]
    return np.array(linear + angular)
