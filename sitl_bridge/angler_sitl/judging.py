"""What a control period came to, for every robot of one world: as the simulator itself judges it.

The second half of a control step of `angler_mjx.sim.episode`, for vehicles that somebody else has
moved: obstacles, contact, and the account of each robot.
"""

from dataclasses import replace
from functools import partial

import jax

from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import episode, robot
from angler_mjx.sim.detection import detect
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.world import obstacles as obstacle_motion
from angler_sitl.motion import signals


def judge(
    spec: SimSpec,
    world: World,
    state: WorldState,
    vehicles: VehicleState,
    pulses: jax.Array,
    broken: jax.Array,
) -> WorldState:
    """One world at the end of a control period.

    Args:
        spec: settings.
        world: its constants.
        state: at the beginning of the period.
        vehicles: [N] at its end.
        pulses: int32 [N, n_thruster] us, as the autopilots sent them last; for the energy.
        broken: bool [N] who diverged in it.
    """
    environment, params = world.environment, world.control.vehicle
    lo, hi = episode.region(environment)
    before = state.vehicles
    t = state.step.astype(before.p.dtype) * spec.control_dt_s
    moving = obstacle_motion.step(
        environment.obstacles,
        state.obstacles,
        environment.current,
        t,
        spec.control_dt_s,
        lo,
        hi,
        environment.grid,
        spec.water.density_kgpm3,
        spec.water.gravity_mps2,
    )
    contact = detect(environment, params, vehicles, moving)
    _, power = jax.vmap(robot.thrust_and_power)(params, signals(pulses, before.p.dtype))
    tally = jax.vmap(partial(robot.account, spec), (0, None, None, 0, 0, 0, 0, 0, 0, None))(
        environment.goal_m, lo, hi, state.tally, before.p, vehicles.p, contact, power, broken, t
    )
    return replace(state, vehicles=vehicles, obstacles=moving, tally=tally, step=state.step + 1)
