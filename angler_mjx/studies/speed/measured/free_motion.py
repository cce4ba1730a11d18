"""Speed of the equations of motion alone: many vehicles in still water under constant thrust.

No control, no currents, no worlds, no detection: what `sim.engines.dynamics` can do at most. Each
vehicle begins at a velocity of its own and is pushed by thrusts of its own; both are drawn on the
device, outside the timed region. All calls begin at the same state, which is left as it was.
"""

from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.sim.engines import base as engines
from angler_mjx.sim.engines import dynamics
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.studies.speed import flops
from angler_mjx.studies.speed.rows import (
    SpeedRow,
    all_finite,
    check_repeats,
    iterate_turns,
    moved_bytes,
    peak_device_bytes,
    read_program_costs,
    seconds_of,
    summarise_rates,
)

VEHICLE, PARAMETER_SET = "bluerov2_heavy", "wu2018"
PHYSICS_DT_S = 0.01
STEPS = 1000
"""Physics steps of one call."""
CPU_VEHICLE_STEPS = 2**24
"""In one call on a CPU at most, so that it takes about a second; but ``MIN_STEPS`` always."""
MIN_STEPS = 10
MOVED_M = 1e-3
"""Way in the timed region below which a vehicle counts as standing."""
SPEED_MPS = (0.1, 0.5)
"""Least and greatest speed at the beginning along each axis, either way; rad/s about each axis."""
THRUST_N = 10.0
"""Greatest thrust of a thruster, either way."""
COUNTED_SIZE = 8
"""Vehicles and steps in which operations are counted: for one step they do not depend on it."""


def measure(*, vehicles: int, repeats: int, kernels: dynamics.Kernels | None = None) -> SpeedRow:
    """Time physics steps of independent vehicles.

    Args:
        vehicles: in one device call, one in each world.
        repeats: timed calls, after one that is not timed.
        kernels: ``xla`` or ``cuda``; if None, the fused engine's own choice for the
            device.

    Returns:
        Rates in vehicle-steps/s.

    Raises:
        ConfigError: too few repeats, or kernels that need another device.
        RunError: a result is not finite, or vehicles stand still or move alike.
    """
    check_repeats(repeats)
    backend = jax.default_backend()
    kernels = kernels or engines.default_kernels("fused", backend)
    if kernels != "xla" and backend != "gpu":
        raise ConfigError(
            f"--kernels {kernels}: needs an NVIDIA GPU, and JAX computes on {backend}"
        )
    n_steps = steps_of(vehicles, backend)
    # Kernels take whole blocks of vehicles: the rest is simulated too, and not counted.
    simulated = -(-vehicles // dynamics.BLOCK) * dynamics.BLOCK if kernels != "xla" else vehicles
    model = dynamics.build_dynamics(VEHICLE, PARAMETER_SET, physics_dt_s=PHYSICS_DT_S)
    thrusters = model.vehicle.B.shape[-1]
    begin = jax.jit(sample_states, static_argnums=(1, 2))(jax.random.key(0), simulated, thrusters)
    run = jax.jit(partial(model.simulate, n_steps=n_steps, kernels=kernels))
    compile_s, program = seconds_of(run.lower(*begin).compile)
    total = vehicles * n_steps
    rates = []
    for counts in iterate_turns(repeats):
        taken, after = seconds_of(program, *begin)
        require_different(begin[0], after)
        rates += [total / taken] * counts
        del after
    moved, counted = moved_bytes(program), _count_flops(model, thrusters)
    return SpeedRow(
        workload="dynamics",
        inside=_describe_region(n_steps, simulated - vehicles),
        worlds=vehicles,
        robots=1,
        unit="vehicle-steps/s",
        **summarise_rates(rates),
        compile_s=compile_s,
        engine="fused",
        kernels=kernels,
        flops=counted.flops,
        flops_from=counted.how if kernels == "xla" else f"{counted.how}; with kernels = xla",
        least_bytes=moved / total if moved else None,
        **read_program_costs(program),
        device_peak_bytes=peak_device_bytes(),
        active_share=1.0,
    )


def steps_of(vehicles: int, backend: str) -> int:
    """Physics steps of one call."""
    if backend != "cpu":
        return STEPS
    return max(MIN_STEPS, min(STEPS, CPU_VEHICLE_STEPS // vehicles))


def sample_states(key: jax.Array, vehicles: int, thrusters: int) -> tuple[VehicleState, jax.Array]:
    """Vehicles at 20 m depth, each at its own velocity, and what their thrusters settle at.

    Args:
        key: for all of them.
        vehicles: N.
        thrusters: of each.

    Returns:
        State, [N] leading, and thrusts [N, thrusters] in N.
    """
    of_speed, of_sign, of_thrust = jax.random.split(key, 3)
    low, high = SPEED_MPS
    speed = jax.random.uniform(of_speed, (vehicles, 6), minval=low, maxval=high)
    sign = jax.random.rademacher(of_sign, (vehicles, 6), dtype=speed.dtype)
    shape = (vehicles, thrusters)
    thrust = jax.random.uniform(of_thrust, shape, minval=-THRUST_N, maxval=THRUST_N)
    state = VehicleState(
        p=jnp.tile(jnp.array([0.0, 0.0, -20.0]), (vehicles, 1)),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (vehicles, 1)),
        nu=speed * sign,
        force_before=jnp.zeros((vehicles, 6)),
        thrust=jnp.zeros(shape),
    )
    return state, thrust


def require_different(before: VehicleState, after: VehicleState) -> None:
    """Refuse vehicles whose rate would say nothing.

    Args:
        before: state at the beginning, [N] leading.
        after: at the end.

    Raises:
        RunError: a number is not finite, vehicles stood still, or they moved alike.
    """
    if not all_finite(after):
        raise RunError("the timed run holds NaN: no number is given")
    standing, alike = (int(n) for n in _count_standing_and_alike(before.p, after.p))
    if standing or alike:
        raise RunError(
            f"{standing} of {before.p.shape[0]} vehicles stood still in the timed region, {alike} "
            "moved as the one before them: no number is given"
        )


@jax.jit
def _count_standing_and_alike(before: jax.Array, after: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How many moved less than ``MOVED_M``, and how many end where their neighbour does."""
    distance = jnp.sqrt(jnp.sum((after - before) ** 2, axis=-1))
    same = jnp.all(after[1:] == after[:-1], axis=-1)
    return jnp.sum(distance < MOVED_M), jnp.sum(same)


def _count_flops(model: dynamics.Dynamics, thrusters: int) -> flops.OperationCount:
    """Operations of one physics step of one vehicle, in plain JAX."""
    begin = jax.eval_shape(
        partial(sample_states, vehicles=COUNTED_SIZE, thrusters=thrusters), jax.random.key(0)
    )
    counted = flops.count_operations(
        partial(model.simulate, n_steps=COUNTED_SIZE, kernels="xla"), *begin
    )
    each = None if counted.flops is None else counted.flops / COUNTED_SIZE**2
    return flops.OperationCount(each, counted.how)


def _describe_region(n_steps: int, uncounted: int) -> str:
    seconds = n_steps * PHYSICS_DT_S
    rest = f"; {uncounted} vehicles more to fill the last program, not counted" if uncounted else ""
    return (
        f"{n_steps:,} physics steps ({seconds:g} s of simulated time) in one device call: water, "
        "rigid body, rotors, pose; each vehicle at its own velocity under its own constant "
        f"thrusts{rest}"
    )
