"""Integration schemes of one step of a vehicle, to compare with the simulator's own.

Each has the arguments of `angler_mjx.sim.physics.step.step` and steps the same equations; only the
formula differs. Rotor lag is exact in all of them.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, rigid_body, spd_solve, thruster
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics import step
from angler_mjx.sim.physics.mjx_engine import BodyInertia, MjxPhysics
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.world.currents import Current

type Scheme = Callable[..., VehicleState]
"""(engine, body, params, state, thrust_command, current, t, dt, water) -> state, as `step.step`."""


def accelerate(
    engine: MjxPhysics,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    thrust: jax.Array,
    current: Current,
    t: jax.Array,
    water: Water,
) -> jax.Array:
    """Return the acceleration nu' [6] under a thrust."""
    inertia, force, _ = step.smooth_force(engine, body, vehicle, state, current, t, water)
    total = force + rigid_body.matrix_times(vehicle.B, thrust)
    return spd_solve.solve(inertia, total[:, None])[:, 0]


def _euler_world(
    engine: MjxPhysics,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Step by semi-implicit Euler on the velocity in the world, as MuJoCo's default integrator."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    a = accelerate(engine, body, vehicle, state, mean, current, t, water)
    v, omega = state.nu[:3], state.nu[3:]
    v_world = quaternion.rotate(state.q, v + dt * (a[:3] + jnp.cross(omega, v)))
    omega = omega + dt * a[3:]
    q = _normalise(quaternion.multiply(state.q, quaternion.exp(dt * omega)))
    nu = jnp.concatenate([quaternion.rotate_inverse(q, v_world), omega])
    return replace(state, p=state.p + dt * v_world, q=q, nu=nu, thrust=thrust)


def _euler_body(
    engine: MjxPhysics,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Step by semi-implicit Euler on the velocity in the body."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    nu = state.nu + dt * accelerate(engine, body, vehicle, state, mean, current, t, water)
    p = state.p + dt * quaternion.rotate(state.q, nu[:3])
    q = _normalise(quaternion.multiply(state.q, quaternion.exp(dt * nu[3:])))
    return replace(state, p=p, q=q, nu=nu, thrust=thrust)


def _explicit(
    engine: MjxPhysics,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Step by our scheme with explicit damping: Adams-Bashforth for all smooth forces."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    inertia, force, _ = step.smooth_force(engine, body, vehicle, state, current, t, water)
    a, before = (spd_solve.solve(inertia, x[:, None])[:, 0] for x in (force, state.force_before))
    driven = spd_solve.solve(inertia, rigid_body.matrix_times(vehicle.B, mean)[:, None])[:, 0]
    nu = rigid_body.advance_velocity(state.nu, a, before, dt) + dt * driven
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return VehicleState(p=p, q=q, nu=nu, force_before=force, thrust=thrust)


def _heun(
    engine: MjxPhysics,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Step by Heun's method with our pose step: two evaluations of the forces per step."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    a = accelerate(engine, body, vehicle, state, mean, current, t, water)
    guess = state.nu + dt * a
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, guess, dt)
    ahead = replace(state, p=p, q=q, nu=guess)
    b = accelerate(engine, body, vehicle, ahead, mean, current, t + dt, water)
    nu = state.nu + 0.5 * dt * (a + b)
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return replace(state, p=p, q=q, nu=nu, thrust=thrust)


def _normalise(q: jax.Array) -> jax.Array:
    return q / jnp.sqrt(jnp.sum(q * q))


SCHEMES: dict[str, Scheme] = {
    "Euler, world velocity": _euler_world,
    "Euler, body velocity": _euler_body,
    "explicit AB2": _explicit,
    "ours": step.step,
    "Heun (two evaluations)": _heun,
}
