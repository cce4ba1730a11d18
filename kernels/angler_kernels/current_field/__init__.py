"""Velocity fields of water at one point, with the derivatives that a body in them needs."""

from angler_kernels.current_field.reference import (
    PEAK_RADIUS,
    lamb_oseen,
    lamb_oseen_circulation,
    material_derivative,
    smooth_knots,
)

__all__ = [
    "PEAK_RADIUS",
    "lamb_oseen",
    "lamb_oseen_circulation",
    "material_derivative",
    "smooth_knots",
]
