"""A rigid body in moving water: the terms of Fossen's equation, and one step of time."""

from angler_kernels.rigid_body.reference import (
    added_mass_coriolis,
    advance_damped_velocity,
    advance_pose,
    advance_velocity,
    buoyancy_wrench,
    damping_slope,
    damping_wrench,
    flow_inertia_wrench,
    matrix_times,
    rigid_body_coriolis,
    submerged_fraction,
    water_wrench,
)

__all__ = [
    "added_mass_coriolis",
    "advance_damped_velocity",
    "advance_pose",
    "advance_velocity",
    "buoyancy_wrench",
    "damping_slope",
    "damping_wrench",
    "flow_inertia_wrench",
    "matrix_times",
    "rigid_body_coriolis",
    "submerged_fraction",
    "water_wrench",
]
