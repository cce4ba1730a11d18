"""Random driving for studies of the physics: thruster commands that change every 0.2 s."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control import allocation
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics.step import Water

HOLD_S = 0.2


@dataclass(frozen=True, kw_only=True)
class DrivingCase:
    """How roughly the vehicles are driven."""

    name: str
    speed_mps: float
    """Amplitude of surge, sway and heave: the force that drag exerts at this speed."""
    tilt_rad: float
    """Amplitude of the moments about x and y: what holds the vehicle at this tilt."""
    moment_nm: tuple[float, float, float]
    """Amplitude of further moments about x, y, z."""
    memory: float
    """Correlation of a command with the one 0.2 s before."""


CASES = (
    DrivingCase(
        name="moderate", speed_mps=0.22, tilt_rad=0.03, moment_nm=(0.0, 0.0, 0.6), memory=0.95
    ),
    DrivingCase(name="violent", speed_mps=1.2, tilt_rad=0.0, moment_nm=(8.0, 8.0, 6.0), memory=0.5),
)


def sample_commands(
    case: DrivingCase, vehicles: VehicleParams, n: int, seed: int
) -> NDArray[np.float64]:
    """Thrusts [n_variant, n, n_thruster] N that settle random wrenches, held for 0.2 s each."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-1.0, 1.0, (n, 6)) * math.sqrt(3.0)
    for k in range(1, n):
        noise[k] = case.memory * noise[k - 1] + math.sqrt(1 - case.memory**2) * noise[k]
    linear, quadratic = np.asarray(vehicles.D_l)[:, :3], np.asarray(vehicles.D_q)[:, :3]
    force = (linear + quadratic * case.speed_mps) * case.speed_mps
    volume, p_cb = np.asarray(vehicles.volume_m3), np.asarray(vehicles.p_cb_m)
    righting = Water().density_kgpm3 * Water().gravity_mps2 * volume * p_cb[:, 2]
    moment = case.tilt_rad * righting[:, None] * np.array([1, 1, 0]) + case.moment_nm
    amplitude = np.concatenate([force, moment], axis=1)
    inverse = np.asarray(allocation.build_allocation(vehicles).B_inverse)
    thrust = np.einsum("vti,vi,ki->vkt", inverse, amplitude / 2, noise)
    ends = np.asarray(vehicles.thrust_n)[:, None, [0, -1]]
    clipped: NDArray[np.float64] = np.clip(thrust, ends[..., :1], ends[..., 1:])
    return clipped
