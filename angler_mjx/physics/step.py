"""One physics step of one vehicle: the discretisation that every engine shares.

In this order, at time t with pose (p, q), velocity nu, thrusts f, and a command held over the step:

1. flow and its material derivative at p; wrench of the water at (p, q, nu);
2. rotor lag, exact: thrusts at t + dt and their mean over the step;
3. nu' by the smooth forces, and the acceleration by the mean thrusts, at (p, q, nu);
4. nu(t+dt) = nu + dt (3/2 nu' - 1/2 nu'_before) + dt (acceleration by the mean thrusts), all in the
   body frame;
5. pose by the mean of nu(t) and nu(t+dt): q(t+dt) = q exp(dt omega_mean), p(t+dt) = p + dt R(q at
   mid-step) v_mean.

Second order with one evaluation of the forces a step (docs/validation.md has the convergence).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import rigid_body, thruster
from angler_mjx.physics import mjx_engine
from angler_mjx.physics.mjx_engine import BodyInertia, MjxEngine
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.vehicles.properties import GRAVITY_MPS2
from angler_mjx.world import currents
from angler_mjx.world.currents import Current


@dataclass(frozen=True, kw_only=True)
class Water:
    """The sea as a medium."""

    density_kgpm3: float = 1000.0
    gravity_mps2: float = GRAVITY_MPS2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class VehicleState:
    """What one vehicle carries from step to step."""

    p: jax.Array
    """[3] centre of mass, m, in W."""
    q: jax.Array
    """[4] attitude, F to W."""
    nu: jax.Array
    """[6] velocity over ground, in F."""
    nu_dot: jax.Array
    """[6] nu' by the smooth forces at the step before; at rest before the first step."""
    thrust: jax.Array
    """[n_thruster] N, behind the rotor's lag."""


def water_wrench(
    params: VehicleParams,
    state: VehicleState,
    current: Current,
    t: jax.Array,
    water: Water,
) -> jax.Array:
    """Wrench [6] of the water on one vehicle at time t [], in F; see angler_kernels.rigid_body."""
    v_c, Dv_c = currents.evaluate(current, state.p, t)
    return rigid_body.water_wrench(
        M_A=params.M_A,
        D_l=params.D_l,
        D_q=params.D_q,
        volume=params.volume_m3,
        p_cb=params.p_cb_m,
        height=params.hull_height_m,
        z=state.p[2],
        q=state.q,
        nu=state.nu,
        v_c=v_c,
        Dv_c=Dv_c,
        density=water.density_kgpm3,
        gravity=water.gravity_mps2,
    )


def reset(
    engine: MjxEngine,
    body: BodyInertia,
    params: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    current: Current,
    water: Water,
) -> VehicleState:
    """A vehicle at rest over ground at p [3], q [4], thrusters still, at t = 0.

    The acceleration of the resting vehicle is evaluated, so that the first step is Euler's.
    """
    state = VehicleState(
        p=p,
        q=q,
        nu=jnp.zeros(6, p.dtype),
        nu_dot=jnp.zeros(6, p.dtype),
        thrust=jnp.zeros(params.B.shape[-1], p.dtype),
    )
    return start_multistep(engine, body, params, state, current, jnp.zeros((), p.dtype), water)


def start_multistep(
    engine: MjxEngine,
    body: BodyInertia,
    params: VehicleParams,
    state: VehicleState,
    current: Current,
    t: jax.Array,
    water: Water,
) -> VehicleState:
    """The same state with ``nu_dot`` evaluated at t, as a new start of the multistep formula."""
    wrench = water_wrench(params, state, current, t, water)
    nu_dot, _ = mjx_engine.accelerations(
        engine, body, params.M_A, state.p, state.q, state.nu, wrench, jnp.zeros_like(wrench)
    )
    return VehicleState(p=state.p, q=state.q, nu=state.nu, nu_dot=nu_dot, thrust=state.thrust)


def step(
    engine: MjxEngine,
    body: BodyInertia,
    params: VehicleParams,
    state: VehicleState,
    thrust_command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: float,
    water: Water,
) -> VehicleState:
    """One physics step.

    Args:
        engine: of the fleet.
        body: inertia of the vehicle, as the engine wants it.
        params: of the vehicle.
        state: at time t.
        thrust_command: [n_thruster] N, what the thrusters would settle at; held over the step.
        current: of the world.
        t: [] s.
        dt: s.
        water: the medium.

    Returns:
        The state at t + dt.
    """
    with jax.named_scope("water"):
        wrench = water_wrench(params, state, current, t, water)
    with jax.named_scope("thrusters"):
        thrust, mean_thrust = thruster.rotor_lag(state.thrust, thrust_command, params.tau_s, dt)
        thrust_wrench = rigid_body.matrix_times(params.B, mean_thrust)
    with jax.named_scope("multibody"):
        nu_dot, nu_dot_thrust = mjx_engine.accelerations(
            engine, body, params.M_A, state.p, state.q, state.nu, wrench, thrust_wrench
        )
    with jax.named_scope("integrate"):
        nu = rigid_body.advance_velocity(state.nu, nu_dot, state.nu_dot, dt) + dt * nu_dot_thrust
        p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return VehicleState(p=p, q=q, nu=nu, nu_dot=nu_dot, thrust=thrust)
