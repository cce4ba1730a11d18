"""Flights of many robots in one device call."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.stack import Command, ControlParams, StackGains
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.engines import free_flight
from angler_mjx.sim.engines.free_flight import FreeFlight
from angler_mjx.sim.state import SimSpec
from angler_mjx.studies.flights.courses import START_M
from angler_mjx.world.currents import Current


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FlightSettings:
    """What each of n robots is and is told; [n] leads everywhere."""

    params: ControlParams
    plant: VehicleParams
    """The robots as they are; ``params.vehicle`` where the controllers know them well."""
    start_m: Any
    """[3] in W."""
    yaw_rad: Any
    """Heading at the start."""
    command: Command
    current: Current


def fly_robot(spec: SimSpec, settings: FlightSettings, control_steps: int) -> FreeFlight:
    """The flight of one robot."""
    return free_flight.simulate_flight(
        spec,
        settings.params,
        settings.start_m,
        settings.yaw_rad,
        settings.command,
        settings.current,
        control_steps=control_steps,
        plant=settings.plant,
    )


def build_program(
    spec: SimSpec, control_steps: int
) -> Callable[[FlightSettings, StackGains], FreeFlight]:
    """The compiled flight of any number of robots, each with gains of its own.

    It compiles once for each number.
    """

    def fly_one(settings: FlightSettings, gains: StackGains) -> FreeFlight:
        return fly_robot(replace(spec, gains=gains), settings, control_steps)

    flown: Callable[[FlightSettings, StackGains], FreeFlight] = jax.jit(jax.vmap(fly_one))
    return flown


def start_positions(n: int) -> FloatArray:
    """[n, 3] where courses begin, for n robots."""
    return np.tile(START_M, (n, 1))


def same_gains(spec: SimSpec, n: int) -> StackGains:
    """The gains of a stack for n robots."""
    like: StackGains = jax.tree.map(lambda x: jnp.full(n, x, float), spec.gains)
    return like
