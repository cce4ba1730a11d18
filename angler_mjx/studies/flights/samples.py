"""What is drawn for a flight, whoever asks for it: directions, water, vehicles as they really are.

Each function takes its numbers from the generator in one order, so a seed is the same flight in
every release.
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.current_field import lamb_oseen_circulation
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights.courses import HALF_WIDTH_M
from angler_mjx.world import currents
from angler_mjx.world.currents import Vortices

CURRENT_MPS = 0.8
"""Greatest speed of a drawn steady current."""
VORTEX_MPS = 0.4
"""Greatest speed of the vortices over the figure of eight."""
MASS_ERROR = 0.2
"""Mass and inertia are up to this share more or less than the controllers believe."""
STEP_M = 2.0
"""Longest drawn step."""
_CENTRES_M = np.array([[-1.6, 1.0], [0.2, -1.2], [1.8, 0.8]])
_CORES_M = np.array([1.2, 1.5, 1.2])
_TURNS = np.array([1.0, -1.0, 1.0])


def level_velocity(speed: float, course_rad: float) -> FloatArray:
    """[3] a level velocity of some speed, counted from x towards y, in W."""
    return speed * np.array([math.cos(course_rad), math.sin(course_rad), 0.0])


def unit_vector(direction: FloatArray) -> FloatArray:
    """[3] of length 1."""
    scaled: FloatArray = direction / np.linalg.norm(direction)
    return scaled


def perturb_vehicle(
    vehicle: VehicleParams, mass: FloatArray, thrust: FloatArray | None = None
) -> VehicleParams:
    """Vehicles [n] that are not what is believed of them; their volume stays.

    Args:
        vehicle: as is believed.
        mass: [n] factors of mass and inertia.
        thrust: [n] factors of what thrusters push; 1 if left out.
    """
    heavier = replace(
        vehicle,
        mass_kg=vehicle.mass_kg * mass,
        inertia_kgm2=vehicle.inertia_kgm2 * mass[:, None, None],
    )
    return heavier if thrust is None else replace(heavier, B=vehicle.B * thrust[:, None, None])


def min_terminal_speed_mps(vehicle: VehicleParams) -> FloatArray:
    """[n] slowest level terminal speed of vehicles [n], m/s."""
    able: FloatArray = np.asarray(vehicle.terminal_speed_mps, float)[:, :2].min(axis=1)
    return able


def build_vortices(max_mps: FloatArray) -> Vortices:
    """Three vortices about the figure of eight that turn either way.

    Args:
        max_mps: [n] greatest speed over the course.
    """
    whole = Vortices(
        centre_m=jnp.asarray(_CENTRES_M, float),
        circulation_m2ps=jnp.asarray(
            _TURNS * np.asarray(lamb_oseen_circulation(jnp.ones(3), jnp.asarray(_CORES_M))), float
        ),
        core_m=jnp.asarray(_CORES_M, float),
    )
    a = np.linspace(0.0, 2 * np.pi, 721)
    line = HALF_WIDTH_M * np.stack([np.sin(a), 0.5 * np.sin(2 * a), 0 * a], axis=1)
    at = jnp.asarray(line, float)
    flow = jax.vmap(currents.velocity, (None, 0, None))((whole,), at, jnp.zeros((), at.dtype))
    scale = jnp.asarray(max_mps / float(jnp.linalg.norm(flow, axis=1).max()), float)
    n = len(max_mps)
    return Vortices(
        centre_m=jnp.tile(whole.centre_m, (n, 1, 1)),
        circulation_m2ps=scale[:, None] * whole.circulation_m2ps,
        core_m=jnp.tile(whole.core_m, (n, 1)),
    )
