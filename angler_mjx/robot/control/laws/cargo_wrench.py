"""Feed-forward of the moment of a load that a robot holds below its centre of mass.

The model of the robot has its part of the load at its centre of mass, so laws know the force of the
load and nothing of its moment. This law adds the opposite of lever x (weight + drag) at the
estimated velocity and the current that the robot knows (Fossen 2021, chapter 16, on feed-forward).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import BodyWrench, Estimate
from angler_mjx.robot.control.laws import cargo_part
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CargoWrenchGains(CargoPartGains):
    """The robot's part of the load; that of the task carry where the file gives none."""


def check(gains: CargoWrenchGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("cargo_wrench", gains)


def reset(_: Estimate) -> tuple[()]:
    """Return the memory of a law that has none."""
    return ()


def step(
    gains: CargoWrenchGains,
    vehicle: VehicleParams,
    carry: tuple[()],
    estimate: Estimate,
    command: BodyWrench,
    dt: float,
    density: float,
    gravity: float,
    flow: jax.Array | None = None,
) -> tuple[tuple[()], BodyWrench]:
    """One control step.

    tau = tau_robot - [0; r x (f_g - d |v_r| v_r)] with r = (0, 0, -depth) and v_r the velocity of
    that point through the water, all in F.

    Args:
        gains: of the law.
        vehicle: not used, as the next four but the estimate and the command.
        carry: none.
        estimate: state as known to the controller.
        command: wrench for the robot and the force of the load.
        dt: s.
        density: kg/m^3.
        gravity: m/s^2.
        flow: [3] velocity of the water, m/s, in W; None for still water.
    """
    del vehicle, dt, density, gravity
    moment = cargo_part.find_wrench(gains, estimate, flow)[3:]
    return carry, BodyWrench(tau=command.tau - jnp.concatenate([jnp.zeros_like(moment), moment]))
