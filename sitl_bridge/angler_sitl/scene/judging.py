"""What a control period came to, for every robot of one world: as the simulator itself judges it.

The second half of a control step of `angler_mjx.sim.episode`, for vehicles that somebody else has
moved: obstacles, contact, and the account of each robot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import episode, robot
from angler_mjx.sim.detection import detect
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.world import obstacles as obstacle_motion
from angler_sitl.scene.flat import Arrays, Flat
from angler_sitl.scene.motion import (
    INPUTS,
    ONE_THREAD,
    Motion,
    signals,
)


@dataclass(frozen=True, kw_only=True)
class Judging:
    """`judge`, compiled for worlds of one shape, with few arrays in and out."""

    step: Callable[[Arrays, Arrays, NDArray[Any], NDArray[np.int32]], Arrays]
    """Constants, state, vehicles as `Motion.told` gives them, inputs of the last step: to state."""
    world: Flat
    state: Flat

    def constants(self, world: World) -> Arrays:
        """What has to be known of a world; [1] leads there."""
        return self.world.put(world)

    def begin(self, state: WorldState) -> Arrays:
        """A state as the step takes it; [1] leads there."""
        return self.state.put(state)

    def end(self, state: Arrays) -> WorldState:
        """The inverse of `begin`, as NumPy's arrays."""
        whole: WorldState = self.state.unpack(tuple(map(np.asarray, state)))
        return whole


def build(spec: SimSpec, motion: Motion, world: World, state: WorldState) -> Judging:
    """Compile for worlds like this one.

    Args:
        spec: settings.
        motion: of the vehicles.
        world: [1] leads; another of the same scenario has the same shapes.
        state: [1] leads.
    """
    of_world, of_state = Flat.of(world), Flat.of(state)
    thrusters = world.control.vehicle.B.shape[-1]
    like = motion.told(motion.begin(state.vehicles))

    def step(world: Arrays, state: Arrays, told: jax.Array, inputs: jax.Array) -> Arrays:
        # One world is not batched: that would make tracing it take half as long again.
        judged = judge(
            spec,
            jax.tree.map(lambda x: x[0], of_world.unpack(world)),
            jax.tree.map(lambda x: x[0], of_state.unpack(state)),
            jax.vmap(motion.vehicles.split)(told[:, 1:]),
            inputs[:, :thrusters],
            told[:, 0] > 0,
        )
        return of_state.pack(judged)

    inputs = jax.ShapeDtypeStruct((len(like), INPUTS), jnp.int32)
    lowered = jax.jit(step).lower(of_world.like, of_state.like, like, inputs)
    compiled: Any = lowered.compile(ONE_THREAD)
    return Judging(step=compiled, world=of_world, state=of_state)


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
