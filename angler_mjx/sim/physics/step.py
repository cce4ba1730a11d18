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

A vehicle with links has the velocity xi = [nu; speeds of the joints] in place of nu, with the terms
of `angler_mjx.robot.vehicles.link_motion` in M and F, those of its drag in h, and the efforts of
`angler_mjx.sim.physics.joints` beside B f_mean; its joints move by the mean of their speeds. Its M
depends on the posture, and d wants that of mid-step: M d is replaced by M d + 1/2 (M - M_before)
d_before.

Second order with one evaluation of the forces a step; convergence: docs/generated/validation.md.
The damping of small vehicles is stiff (2 D_q |omega| / I passes 100 1/s), hence its implicit
treatment.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import jax
import jax.numpy as jnp

from angler_kernels import quaternion, rigid_body, spd_solve
from angler_kernels.hull_bodies import split_buoyancy
from angler_mjx.robot.vehicles import damping
from angler_mjx.robot.vehicles import link_motion as link_terms
from angler_mjx.robot.vehicles.fins import fin_wrench
from angler_mjx.robot.vehicles.link_motion import JointMotion, LinkMotion
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.properties import GRAVITY_MPS2
from angler_mjx.robot.vehicles.trim import TrimParams, trim_change
from angler_mjx.sim.physics import joints as joint_efforts
from angler_mjx.sim.physics import rotors
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.joints import Effort, Motors, home
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
    """[6] smooth forces of the step before, with the damping of the present velocity, in F; [n] of
    a vehicle with links, those on its joints last, less M ``change`` / dt of that step."""
    thrust: jax.Array
    """[n_thruster] N, behind the rotor's lag; [3, n_thruster] states of rotors of third order, the
    thrust first; of a fin its deflection, rad, of a tank its water beyond half full, m^3, and of a
    moving mass its position, m."""
    joints: JointMotion | None = None
    """[J] motion of the joints; None of a vehicle without links."""
    change: jax.Array | None = None
    """[n] change of xi in the step before; None of a vehicle without links."""


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
        wrench = base_wrench(params, state.p, state.q, state.nu, v_c, Dv_c, water)
        v_r = state.nu[:3] - quaternion.rotate_inverse(state.q, v_c)
        nu_r = jnp.concatenate([v_r, state.nu[3:]])
        if params.fins is not None:
            wrench = wrench + fin_wrench(params.fins, state.thrust, nu_r, water.density_kgpm3)
    with jax.named_scope("multibody"):
        M_RB, dry = engine.inertia_and_force(body, state.p, state.q, state.nu)
    M, force = M_RB + params.M_A, dry + wrench
    if params.trim is not None:
        M, force = _add_trim(params.trim, state, M, force, water)
    return M, force, nu_r


def _add_trim(
    trim: TrimParams, state: VehicleState, M: jax.Array, force: jax.Array, water: Water
) -> tuple[jax.Array, jax.Array]:
    """Return inertia [6, 6] and forces [6] with those of ballast and moving masses."""
    density, gravity = water.density_kgpm3, water.gravity_mps2
    change = trim_change(trim, state.thrust, state.q, state.nu, density, gravity)
    return M + change.M, force + change.wrench


def base_wrench(
    params: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    nu: jax.Array,
    v_c: jax.Array,
    Dv_c: jax.Array,
    water: Water,
) -> jax.Array:
    """Wrench [6] of the water on the vehicle's own body; see `rigid_body.water_wrench`.

    With damping between axes and with several bodies of the hull where the vehicle has them.
    """
    wrench = rigid_body.water_wrench(
        M_A=params.M_A,
        D_l=params.D_l,
        D_q=params.D_q,
        volume=params.volume_m3,
        p_cb=params.p_cb_m,
        height=params.hull_height_m,
        z=p[2],
        q=q,
        nu=nu,
        v_c=v_c,
        Dv_c=Dv_c,
        density=water.density_kgpm3,
        gravity=water.gravity_mps2,
    )
    if params.hull_bodies is not None:
        bodies = params.hull_bodies
        wrench = wrench + split_buoyancy(
            fraction=bodies.fraction,
            offset=bodies.offset_m,
            heights=bodies.height_m,
            p_cb=params.p_cb_m,
            height=params.hull_height_m,
            z=p[2],
            q=q,
            Dv_c=Dv_c,
            displaced=water.density_kgpm3 * params.volume_m3,
            gravity=water.gravity_mps2,
        )
    if params.cross_damping is None:
        return wrench
    v_r = nu[:3] - quaternion.rotate_inverse(q, v_c)
    return wrench + damping.cross_wrench(params, jnp.concatenate([v_r, nu[3:]]))


def reset[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    p: jax.Array,
    q: jax.Array,
    current: Current,
    water: Water,
) -> VehicleState:
    """A vehicle at rest over ground at p [3], q [4], thrusters still, joints at home, at t = 0."""
    zero = jnp.zeros(6, p.dtype)
    thrust = rotors.at_rest(params, p.dtype)
    state = VehicleState(p=p, q=q, nu=zero, force_before=zero, thrust=thrust)
    if params.links is not None:
        state = replace(state, joints=home(params.links))
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
    if params.links is None:
        _, force, _ = smooth_force(engine, body, params, state, current, t, water)
    else:
        v_c, Dv_c = currents.evaluate_current(current, state.p, t)
        force = join_forces(params, state, v_c, Dv_c, water).force
        state = replace(state, change=jnp.zeros_like(force))
    return replace(state, force_before=force)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FreeStep:
    """Result of a physics step of one vehicle that touches nothing, and what else may change it."""

    state: VehicleState
    """At the end of the step."""
    M: jax.Array
    """[n, n] inertia with added mass; of a vehicle with links also what of the step acts by the
    change of velocity."""
    nu_r: jax.Array | None = None
    """[6] velocity through the water at the beginning, in F; None of a vehicle with links."""


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
    reference: JointMotion | None = None,
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
        reference: [J] that the servos of joints hold over the step; None for the home posture.

    Returns:
        The state at t + dt.
    """
    return step_freely(
        engine, body, params, state, thrust_command, current, t, dt, water, reference
    ).state


def step_freely[Body](
    engine: Multibody[Body],
    body: Body,
    params: VehicleParams,
    state: VehicleState,
    thrust_command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    water: Water,
    reference: JointMotion | None = None,
) -> FreeStep:
    """One physics step, with the inertia that contact meets; arguments as of `step`."""
    if params.links is not None:
        return _step_links(params, state, thrust_command, current, t, dt, water, reference)
    M, force, nu_r = smooth_force(engine, body, params, state, current, t, water)
    with jax.named_scope("thrusters"):
        thrust, mean_thrust = rotors.advance_rotors(params, state.thrust, thrust_command, dt)
        thrust_wrench = rigid_body.matrix_times(params.B, mean_thrust)
    with jax.named_scope("integrate"):
        forces = force, state.force_before, thrust_wrench
        if params.free_axes is not None:
            M, forces = _hold_axes(params.free_axes, M, *forces)
        if params.cross_damping is None:
            nu, force_before = rigid_body.advance_damped_velocity(
                state.nu, nu_r, M, params.D_l, params.D_q, *forces, dt
            )
        else:
            nu, force_before = damping.advance_coupled_velocity(
                params, state.nu, nu_r, M, *forces, dt
            )
        if params.free_axes is not None:
            nu = params.free_axes * nu
        p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    after = VehicleState(p=p, q=q, nu=nu, force_before=force_before, thrust=thrust)
    return FreeStep(state=after, M=M, nu_r=nu_r)


def _hold_axes(
    free: jax.Array, M: jax.Array, force: jax.Array, force_before: jax.Array, thrust: jax.Array
) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
    """Return inertia and forces of a vehicle that moves along its free axes alone.

    What holds the others takes all force along them: M_ff d_f = f_f remains.

    Args:
        free: [6] 1 for free axes, 0 for held ones.
        M: [6, 6] with added mass.
        force: [6] smooth forces.
        force_before: [6] those of the step before.
        thrust: [6] of thrusters.
    """
    kept = M * free[:, None] * free[None, :]
    held = (1.0 - free)[:, None] * jnp.eye(6, dtype=M.dtype)
    return kept + held, (free * force, free * force_before, free * thrust)


@dataclass(frozen=True, kw_only=True)
class JoinedForces:
    """Inertia and smooth forces of a vehicle with links, and what its damping depends on."""

    M: jax.Array
    """[n, n] with added mass."""
    force: jax.Array
    """[n] F: all that moves the vehicle but thrusters and efforts on joints."""
    nu_r: jax.Array
    """[6] velocity of the base through the water, in F."""
    motion: LinkMotion
    links_nu_r: jax.Array
    """[L, 6] velocities of links through the water, along their axes."""


def join_forces(
    params: VehicleParams,
    state: VehicleState,
    v_c: jax.Array,
    Dv_c: jax.Array,
    water: Water,
) -> JoinedForces:
    """Everything that moves a vehicle with links but its thrusters and motors.

    Args:
        params: of the vehicle.
        state: of the vehicle; its ``force_before`` and the thrusts of rotors are not read.
        v_c: [3] flow at the base, m/s, in W.
        Dv_c: [3] its material derivative, m/s^2, in W.
        water: the medium.
    """
    links, joints = require_links(params), require_joints(state)
    p, q, nu = state.p, state.q, state.nu
    density, gravity = water.density_kgpm3, water.gravity_mps2
    with jax.named_scope("base"):
        body = ClosedForm(gravity_mps2=gravity)
        M_base, force = body.inertia_and_force(params, p, q, nu)
        force = force + base_wrench(params, p, q, nu, v_c, Dv_c, water)
        nu_r = jnp.concatenate([nu[:3] - quaternion.rotate_inverse(q, v_c), nu[3:]])
        if params.fins is not None:
            force = force + fin_wrench(params.fins, state.thrust, nu_r, density)
        M_base = M_base + params.M_A
        if params.trim is not None:
            M_base, force = _add_trim(params.trim, state, M_base, force, water)
    with jax.named_scope("links"):
        motion = link_terms.move_links(links, joints, nu)
        inertia, wrench = link_terms.inertia_and_wrench(
            links, motion, p[2], q, v_c, Dv_c, density, gravity
        )
        links_nu_r = link_terms.relative_velocity(motion, q, v_c)
        wrench = wrench + link_terms.drag_wrench(links, links_nu_r, density)
        M = link_terms.join_bodies(motion, inertia).at[:6, :6].add(M_base)
    return JoinedForces(
        M=M + jnp.diag(jnp.concatenate([jnp.zeros_like(nu), links.armature])),
        force=link_terms.join_wrenches(motion, wrench) + _on_base(force, links),
        nu_r=nu_r,
        motion=motion,
        links_nu_r=links_nu_r,
    )


def _on_base(wrench: jax.Array, links: LinkParams) -> jax.Array:
    """A wrench [6] on the base as a force [n]."""
    return jnp.concatenate([wrench, jnp.zeros_like(links.home)])


def require_links(params: VehicleParams) -> LinkParams:
    """Return the links of a vehicle.

    Raises:
        ValueError: it has none.
    """
    if params.links is None:
        raise ValueError("the vehicle has no links")
    return params.links


def require_joints(state: VehicleState) -> JointMotion:
    """Return the motion of a vehicle's joints.

    Raises:
        ValueError: the state has none.
    """
    if state.joints is None:
        raise ValueError("the vehicle has links, and its state no joints")
    return state.joints


def _step_links(
    params: VehicleParams,
    state: VehicleState,
    thrust_command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array | float,
    water: Water,
    reference: JointMotion | None,
) -> FreeStep:
    """One physics step of a vehicle with links; see `step_freely`."""
    links, joints = require_links(params), require_joints(state)
    v_c, Dv_c = currents.evaluate_current(current, state.p, t)
    forces = join_forces(params, state, v_c, Dv_c, water)
    with jax.named_scope("thrusters"):
        thrust, mean_thrust = rotors.advance_rotors(params, state.thrust, thrust_command, dt)
        thrust_wrench = rigid_body.matrix_times(params.B, mean_thrust)
    with jax.named_scope("integrate"):
        before = jnp.zeros_like(forces.force) if state.change is None else state.change
        impulse = (1.5 * dt) * forces.force - (0.5 * dt) * state.force_before
        impulse = impulse - 0.5 * rigid_body.matrix_times(forces.M, before)
        impulse = impulse + dt * _on_base(thrust_wrench, links)
        held = home(links) if reference is None else reference
        change, damped, M = _solve_change(params, forces, joints, held, impulse, dt, water)
        nu = state.nu + change[:6]
        p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    after = VehicleState(
        p=p,
        q=q,
        nu=nu,
        force_before=forces.force + damped - rigid_body.matrix_times(forces.M, change) / dt,
        thrust=thrust,
        joints=joint_efforts.at_end(joints, change[6:], dt),
        change=change,
    )
    return FreeStep(state=after, M=M)


def _solve_change(
    params: VehicleParams,
    forces: JoinedForces,
    joints: JointMotion,
    reference: JointMotion,
    impulse: jax.Array,
    dt: jax.Array | float,
    water: Water,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Change of xi over a step, by three iterations of Newton's method.

    The first has unlimited motors and neither stops nor friction: where it ends decides which stops
    are met, which joints stick, and which motors are at their limits in the second. Where that ends
    lets go of stops that would pull, and decides again on motors that stops or friction hold back.

    Returns:
        The change [n], that of damping [n], and the inertia [n, n] with what is implicit.
    """
    links = require_links(params)
    slope = damping_slope(params, forces, water)
    implicit = forces.M + 0.5 * dt * slope
    eliminated, inertia = spd_solve.eliminate(implicit, 6), jnp.diag(implicit)[6:]
    motors = Motors(
        links=links,
        wanted=joint_efforts.wanted_speed(links, reference, joints, dt),
        begin=joints.velocity,
        weight=joint_efforts.end_weight(links.damping + links.viscous_friction, inertia, dt),
    )

    def iterate(change: jax.Array, missed: jax.Array, *efforts: Effort) -> jax.Array:
        effort, by_change = sum(e.effort for e in efforts), sum(e.by_change for e in efforts)
        right = impulse + 0.5 * dt * missed
        right = right.at[6:].add(dt * (effort + by_change * change[6:]))
        return eliminated.solve(right, jnp.asarray(dt * by_change))

    def missed_damping(change: jax.Array) -> jax.Array:
        damped = change_damping(params, forces, change, water)
        return damped + rigid_body.matrix_times(slope, change)

    still = jnp.zeros_like(impulse)
    motor = motors.effort(still[6:], None)
    change = iterate(still, still, motor)
    end = joint_efforts.at_end(joints, change[6:], dt)
    contact = joint_efforts.find_contact(links, end, inertia + dt * motor.by_change, dt)
    free = motors.servo_effort(change[6:])
    change = iterate(
        change,
        missed_damping(change),
        motors.effort(change[6:], free),
        joint_efforts.contact_effort(end, contact, None, dt),
    )
    end = joint_efforts.at_end(joints, change[6:], dt)
    acts = joint_efforts.stop_acts(end, contact)
    held = motors.servo_effort(change[6:])
    unlimited = jnp.where(acts | (contact.damper > 0), held, free)
    efforts = (
        motors.effort(change[6:], unlimited),
        joint_efforts.contact_effort(end, contact, acts, dt),
    )
    change = iterate(change, missed_damping(change), *efforts)
    by_change = dt * sum(e.by_change for e in efforts)
    M = implicit + jnp.diag(jnp.concatenate([jnp.zeros_like(impulse[:6]), by_change]))
    return change, change_damping(params, forces, change, water), M


def damping_slope(params: VehicleParams, forces: JoinedForces, water: Water) -> jax.Array:
    """Minus the derivative [n, n] of damping by xi, symmetric and never negative.

    Without damping between axes, which the iterations take as it is.
    """
    links = require_links(params)
    slope = link_terms.drag_slope(links, forces.links_nu_r, water.density_kgpm3)
    base = rigid_body.damping_slope(params.D_l, params.D_q, forces.nu_r)
    return link_terms.join_bodies(forces.motion, slope) + jnp.diag(_on_base(base, links))


def change_damping(
    params: VehicleParams, forces: JoinedForces, change: jax.Array, water: Water
) -> jax.Array:
    """Change of damping [n] where xi changes by ``change`` [n] in the present posture."""
    links, density = require_links(params), water.density_kgpm3
    base = damping.damping_wrench(params, forces.nu_r + change[:6])
    base = base - damping.damping_wrench(params, forces.nu_r)
    links_nu_r = forces.links_nu_r + link_terms.link_velocities(forces.motion, change)
    drag = link_terms.drag_wrench(links, links_nu_r, density)
    drag = drag - link_terms.drag_wrench(links, forces.links_nu_r, density)
    return link_terms.join_wrenches(forces.motion, drag) + _on_base(base, links)
