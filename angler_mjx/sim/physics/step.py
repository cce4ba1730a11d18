"""One physics step of one vehicle: the discretisation that every engine shares.

In this order, at time t with pose (p, q), velocity nu, thrusts f, and a command held over the step:

1. flow and its material derivative at p; wrench of the water at (p, q, nu), and nu_r;
2. rotors, exact: thrusts at t + dt and their mean over the step;
3. inertia and force of the dry vehicle at (p, q, nu); M = M_RB + M_A, F = all smooth forces;
4. M d = dt (3/2 F - 1/2 G + 1/2 h(d) + B f_mean), nu(t+dt) = nu + d, all in the body frame, with
   h(d) the change of damping from nu_r to nu_r + d, by two iterations of Newton's method; then
   G = F + h(d) for the next step: two-step Adams-Bashforth, with damping by the trapezoidal rule;
5. pose by the mean of nu(t) and nu(t+dt): q(t+dt) = q exp(dt omega_mean), p(t+dt) = p + dt R(q at
   mid-step) v_mean.

Second order with one evaluation of the forces a step; convergence: docs/generated/validation.md.
The damping of small vehicles is stiff (2 D_q |omega| / I passes 100 1/s), hence its implicit
treatment.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, rigid_body
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.sim.physics import rotors
from angler_mjx.world import currents
from angler_mjx.world.currents import Current


class Multibody[Body](Protocol):
    """Where engines differ: the dry vehicle."""

    def inertia_and_force(
        self, body: Body, p: jax.Array, q: jax.Array, nu: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """M_RB [6, 6] and f [6] of M_RB nu' = f + (wrenches on the vehicle), in F.

        Args:
            body: inertia of one vehicle, as the engine wants it.
            p: [3] m in W.
            q: [4].
            nu: [6] in F.
        """
        ...


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
    force_before: jax.Array
    """[6] smooth forces of the step before, with the damping of the present velocity, in F."""
    thrust: jax.Array
    """[n_thruster] N, behind the rotor's lag; [3, n_thruster] states of rotors of third order, the
    thrust first."""


def smooth_force[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    state: VehicleState,
    current: Current,
    t: jax.Array,
    water: Water,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Everything that moves one vehicle but its thrusters, at time t [].

    Returns:
        M [6, 6] with added mass, F [6] and nu_r [6], in F: without thrusters M nu' = F.
    """
    with jax.named_scope("water"):
        v_c, Dv_c = currents.evaluate_current(current, state.p, t)
        wrench = rigid_body.water_wrench(
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
        v_r = state.nu[:3] - quaternion.rotate_inverse(state.q, v_c)
        nu_r = jnp.concatenate([v_r, state.nu[3:]])
    with jax.named_scope("multibody"):
        M_RB, dry = engine.inertia_and_force(body, state.p, state.q, state.nu)
    return M_RB + params.M_A, dry + wrench, nu_r


def reset[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    current: Current,
    water: Water,
) -> VehicleState:
    """A vehicle at rest over ground at p [3], q [4], thrusters still, at t = 0."""
    zero = jnp.zeros(6, p.dtype)
    thrust = rotors.at_rest(params, p.dtype)
    state = VehicleState(p=p, q=q, nu=zero, force_before=zero, thrust=thrust)
    return start_multistep(engine, body, params, state, current, jnp.zeros((), p.dtype), water)


def start_multistep[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    state: VehicleState,
    current: Current,
    t: jax.Array,
    water: Water,
) -> VehicleState:
    """The same state with ``force_before`` evaluated at t, as a new start of the formula."""
    _, force, _ = smooth_force(engine, body, params, state, current, t, water)
    return replace(state, force_before=force)


def step[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    state: VehicleState,
    thrust_command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    water: Water,
) -> VehicleState:
    """One physics step.

    Args:
        engine: of the fleet.
        body: inertia of the dry vehicle, as the engine wants it.
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
    M, force, nu_r = smooth_force(engine, body, params, state, current, t, water)
    with jax.named_scope("thrusters"):
        thrust, mean_thrust = rotors.advance_rotors(params, state.thrust, thrust_command, dt)
        thrust_wrench = rigid_body.matrix_times(params.B, mean_thrust)
    with jax.named_scope("integrate"):
        nu, force_before = rigid_body.advance_damped_velocity(
            state.nu,
            nu_r,
            M,
            params.D_l,
            params.D_q,
            force,
            state.force_before,
            thrust_wrench,
            dt,
        )
        p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return VehicleState(p=p, q=q, nu=nu, force_before=force_before, thrust=thrust)
