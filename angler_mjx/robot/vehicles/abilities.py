"""Abilities of a vehicle by its file: speeds by thrust, by fins, or by gliding (host side)."""

from dataclasses import replace

import numpy as np

from angler_mjx.robot.vehicles.config import ParameterSet, VehicleConfig
from angler_mjx.robot.vehicles.drive import Drive, compute_drive, wrench_matrix
from angler_mjx.robot.vehicles.fins import steers_by_fins
from angler_mjx.robot.vehicles.glide import best_glide, find_mass, slower_mps
from angler_mjx.robot.vehicles.thrust_curves import thrust_ends
from angler_mjx.robot.vehicles.thrusters import FloatArray


def compute_abilities(config: VehicleConfig, chosen: ParameterSet, thrust_n: FloatArray) -> Drive:
    """Compute the abilities of a vehicle.

    Args:
        config: of the vehicle.
        chosen: parameter set.
        thrust_n: [201] of `build_thrust_tables`, or [n_t, 201].
    """
    drive = compute_drive(
        wrench_matrix(config),
        *thrust_ends(thrust_n),
        np.asarray(chosen.damping.linear_diagonal[:3], float),
        np.asarray(chosen.damping.quadratic_diagonal[:3], float),
        steers_by_fins(config),
    )
    if drive.terminal_speed_mps[0] > 0 or find_mass(config, 1) is None:
        return drive
    glides = best_glide(config, chosen)
    if glides is None:
        return drive
    fall_mps = min(abs(glide.vertical_mps) for glide in glides)
    return replace(
        drive,
        terminal_speed_mps=np.array([slower_mps(*glides), 0.0, fall_mps]),
        glides=True,
    )
