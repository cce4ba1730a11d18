"""Flights of many robots in one device call."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.control.stack import Command, ControlParams
from angler_mjx.engines import free_flight
from angler_mjx.engines.free_flight import Flight
from angler_mjx.sim.state import SimSpec
from angler_mjx.trials.courses import START_M
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.vehicles.thrusters import FloatArray
from angler_mjx.world.currents import Current


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Orders:
    """What each of n robots is and is told; [n] leads everywhere."""

    params: ControlParams
    plant: VehicleParams
    """The robots as they are; ``params.vehicle`` where the controllers know them well."""
    gains: tuple[Any, ...]
    """Of each stage."""
    yaw_rad: jax.Array
    """Heading at the start."""
    command: Command
    current: Current


@dataclass(frozen=True, kw_only=True)
class Track:
    """What n robots did, on the host."""

    time_s: FloatArray
    """[t]."""
    position_m: FloatArray
    """[n, t, 3] in W."""
    yaw_rad: FloatArray
    """[n, t] heading, unwrapped along t."""
    tilt_rad: FloatArray
    """[n, t] angle between the vehicle's up and W's."""
    rate_radps: FloatArray
    """[n, t] magnitude of the angular velocity."""


def program(spec: SimSpec, control_steps: int) -> Callable[[Orders], Flight]:
    """The compiled flight of any number of robots; compiles once for each number."""

    def one(orders: Orders) -> Flight:
        return free_flight.fly(
            replace(spec, gains=orders.gains),
            orders.params,
            jnp.array(START_M, orders.yaw_rad.dtype),
            orders.yaw_rad,
            orders.command,
            orders.current,
            control_steps=control_steps,
            plant=orders.plant,
        )

    flown: Callable[[Orders], Flight] = jax.jit(jax.vmap(one))
    return flown


def same_gains(spec: SimSpec, n: int) -> tuple[Any, ...]:
    """The gains of a stack for n robots."""
    like: tuple[Any, ...] = jax.tree.map(lambda x: jnp.full(n, x, float), spec.gains)
    return like


def track(spec: SimSpec, flight: Flight) -> Track:
    """A flight [n] on the host, in words of attitude that people use."""
    q = np.asarray(flight.q, float)
    w, x, y, z = np.moveaxis(q, -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return Track(
        time_s=spec.control_dt_s * np.arange(q.shape[1], dtype=np.float64),
        position_m=np.asarray(flight.p, float),
        yaw_rad=np.unwrap(yaw, axis=1),
        tilt_rad=2 * np.arcsin(np.minimum(np.hypot(x, y), 1.0)),
        rate_radps=np.linalg.norm(np.asarray(flight.nu, float)[..., 3:], axis=-1),
    )
