"""One robot alone in open water, flown by a stack of controllers: no world, no detection, no end.

What is left of a simulation for those who study controllers: a pure function of one robot, from a
command to what came of it, in the closed form of the fused engine. Batches are the caller's
``vmap``; gains, parameters and commands may all differ in it, and all have derivatives.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control import stack
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.stack import Command, ControlMemory, ControlParams
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.engines.lanes.steps import physics_step
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.robot import thrust_and_power
from angler_mjx.sim.state import SimSpec
from angler_mjx.world import currents
from angler_mjx.world.currents import Current


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FreeFlight:
    """What a robot did, at the beginning of each control step; time leads."""

    p: jax.Array
    """[n, 3] m, in W."""
    q: jax.Array
    """[n, 4] F to W."""
    nu: jax.Array
    """[n, 6] velocity over ground, in F."""
    target_m: jax.Array
    """[n, 3] position that the controllers aimed at, in W."""
    pwm_us: jax.Array
    """[n, n_thruster] signals of the step."""


def simulate_flight(
    spec: SimSpec,
    params: ControlParams,
    start_m: jax.Array,
    yaw_rad: jax.Array,
    command: Command,
    current: Current,
    *,
    control_steps: int,
    plant: VehicleParams | None = None,
) -> FreeFlight:
    """Fly one robot from rest, its state known exactly.

    Args:
        spec: settings; its stages and gains are the controllers (``dataclasses.replace`` gives
            others, traced ones too).
        params: what the controllers know of the robot.
        start_m: [3] where it begins, in W.
        yaw_rad: [] heading there; it begins level.
        command: the same in every step; a stage that takes it has its own clock.
        current: of the water.
        control_steps: length of the flight.
        plant: the robot as it is, if the controllers do not know it well.

    Returns:
        The flight, [control_steps] leading.
    """
    vehicle = params.vehicle if plant is None else plant
    engine = ClosedForm(gravity_mps2=spec.water.gravity_mps2)
    q = quaternion.from_yaw(yaw_rad)
    state = physics.reset(engine, vehicle, vehicle, start_m, q, current, spec.water)
    memory = stack.reset(spec.stages, _build_estimate(state, None), yaw_rad)
    wants_flow = stack.wants_flow(spec.stages)

    def control_step(
        carry: tuple[VehicleState, ControlMemory], i: jax.Array
    ) -> tuple[tuple[VehicleState, ControlMemory], FreeFlight]:
        state, memory = carry
        t = i.astype(state.p.dtype) * spec.control_dt_s
        flow = currents.velocity(current, state.p, t) if wants_flow else None
        action = stack.step(
            spec.stages,
            spec.gains,
            params,
            memory,
            _build_estimate(state, flow),
            command,
            spec.control_dt_s,
            spec.water.density_kgpm3,
            spec.water.gravity_mps2,
        )
        settled, _ = thrust_and_power(vehicle, action.pwm)
        seen = FreeFlight(
            p=state.p,
            q=state.q,
            nu=state.nu,
            target_m=action.target_m,
            pwm_us=action.pwm.pwm_us,
        )
        after = _advance_physics(spec, vehicle, state, settled, current, t)
        return (after, action.memory), seen

    _, flight = jax.lax.scan(control_step, (state, memory), jnp.arange(control_steps))
    return flight


def _build_estimate(state: VehicleState, flow: jax.Array | None) -> Estimate:
    return Estimate(p=state.p, q=state.q, nu=state.nu, flow=flow)


def _advance_physics(
    spec: SimSpec,
    vehicle: VehicleParams,
    state: VehicleState,
    settled: jax.Array,
    current: Current,
    t: jax.Array,
) -> VehicleState:
    """The physics steps of one control step, for thrusts [n_thruster] that are settled at."""
    step = partial(physics_step, spec.physics_dt_s, spec.water, vehicle)

    def physics_substep(i: jax.Array, state: VehicleState) -> VehicleState:
        now = t + i.astype(t.dtype) * spec.physics_dt_s
        return step(state, settled, current, now)

    after: VehicleState = jax.lax.fori_loop(0, spec.physics_steps, physics_substep, state)
    return after
