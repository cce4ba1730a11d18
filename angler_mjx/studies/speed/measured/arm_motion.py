"""Speed of the equations of motion of a vehicle with an arm: many of them in still water.

Thrusts are constant, and servos turn joints to targets of their own, so that every vehicle and
every joint moves. No control, no currents, no worlds, no detection; what is else in `free_motion`.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.sim.physics import joints
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.studies.speed import flops
from angler_mjx.studies.speed.measured import free_motion
from angler_mjx.studies.speed.rows import (
    SpeedRow,
    check_repeats,
    iterate_turns,
    moved_bytes,
    peak_device_bytes,
    read_program_costs,
    seconds_of,
    summarise_rates,
)

VEHICLE, PARAMETER_SET = "bluerov2_heavy_alpha5", "wu2018"
BATTERY_V = 16.0
STEPS = 200
"""Physics steps of one call."""
CPU_VEHICLE_STEPS = 2**16
"""In one call on a CPU at most; but ``free_motion.MIN_STEPS`` always."""


def measure(*, vehicles: int, repeats: int) -> SpeedRow:
    """Time physics steps of independent vehicles with arms.

    Args:
        vehicles: in one device call, one in each world.
        repeats: timed calls, after one that is not timed.

    Returns:
        Rates in vehicle-steps/s.

    Raises:
        ConfigError: too few repeats.
        RunError: a result is not finite, or vehicles stand still or move alike.
    """
    check_repeats(repeats)
    vehicle = params.build_vehicle(library.load_vehicle(VEHICLE), PARAMETER_SET, BATTERY_V)
    n_steps = count_steps(vehicles, jax.default_backend())
    begin = sample_states(jax.random.key(0), vehicles, vehicle)
    compile_s, program = seconds_of(
        jax.jit(partial(simulate, vehicle, n_steps=n_steps)).lower(*begin).compile
    )
    total = vehicles * n_steps
    rates = []
    for counts in iterate_turns(repeats):
        taken, after = seconds_of(program, *begin)
        free_motion.require_different(begin[0], after)
        rates += [total / taken] * counts
        del after
    moved = moved_bytes(program)
    counted = flops.count_operations(
        partial(simulate, vehicle, n_steps=1), *jax.tree.map(lambda x: x[:1], begin)
    )
    seconds = n_steps * free_motion.PHYSICS_DT_S
    return SpeedRow(
        workload="dynamics_arm",
        inside=(
            f"{n_steps:,} physics steps ({seconds:g} s of simulated time) in one device call: "
            "water on base and links, multibody inertia, servos, rotors, pose; each vehicle at its "
            "own velocity under its own constant thrusts, its joints on the way to its own targets"
        ),
        worlds=vehicles,
        robots=1,
        unit="vehicle-steps/s",
        **summarise_rates(rates),
        compile_s=compile_s,
        engine="mjx",
        kernels="xla",
        flops=counted.flops,
        flops_from=counted.how,
        least_bytes=moved / total if moved else None,
        **read_program_costs(program),
        device_peak_bytes=peak_device_bytes(),
        active_share=1.0,
    )


def count_steps(vehicles: int, backend: str) -> int:
    """Return the number of physics steps of one call."""
    if backend != "cpu":
        return STEPS
    return max(free_motion.MIN_STEPS, min(STEPS, CPU_VEHICLE_STEPS // vehicles))


def sample_states(
    key: jax.Array, vehicles: int, vehicle: params.VehicleParams
) -> tuple[VehicleState, jax.Array, JointMotion]:
    """Sample vehicles, and what their thrusters and servos settle at.

    Args:
        key: for all of them.
        vehicles: N.
        vehicle: of all of them.

    Returns:
        State, [N] leading, joints at home; thrusts [N, n_thruster] in N; motion [N, J] that servos
        hold: positions within the limits, at rest.
    """
    links = physics.require_links(vehicle)
    state, thrust = free_motion.sample_states(key, vehicles, vehicle.B.shape[-1])
    home = joints.home(links)
    repeat = partial(jnp.tile, reps=(vehicles, 1))
    zero = jnp.zeros((vehicles, 6 + links.home.size))
    state = replace(
        state, joints=jax.tree.map(repeat, home), change=zero, force_before=jnp.zeros_like(zero)
    )
    return state, thrust, _sample_targets(jax.random.fold_in(key, 1), vehicles, links)


def _sample_targets(key: jax.Array, vehicles: int, links: LinkParams) -> JointMotion:
    shape = (vehicles, links.home.size)
    position = jax.random.uniform(key, shape, minval=links.lower, maxval=links.upper)
    return JointMotion(position=position, velocity=jnp.zeros(shape))


def simulate(
    vehicle: params.VehicleParams,
    state: VehicleState,
    thrust_n: jax.Array,
    targets: JointMotion,
    *,
    n_steps: int,
) -> VehicleState:
    """Take physics steps of independent vehicles.

    Args:
        vehicle: of all of them.
        state: [N] leads.
        thrust_n: [N, n_thruster] N, what the thrusters settle at.
        targets: [N, J] that servos hold.
        n_steps: physics steps.

    Returns:
        State at the end, [N] leading.
    """
    water = Water()
    dry = ClosedForm(gravity_mps2=water.gravity_mps2)

    def advance(state: VehicleState, thrust_n: jax.Array, target: JointMotion) -> VehicleState:
        t = jnp.zeros((), state.p.dtype)
        dt = free_motion.PHYSICS_DT_S
        return physics.step(dry, vehicle, vehicle, state, thrust_n, (), t, dt, water, target)

    def advance_all(_: jax.Array, now: VehicleState) -> VehicleState:
        return jax.vmap(advance)(now, thrust_n, targets)

    after: VehicleState = jax.lax.fori_loop(0, n_steps, advance_all, state)
    return after
