"""What a control period came to, for every robot of one world: as the simulator itself judges it.

The phases of a control step (`angler_mjx.sim.step`) that follow when somebody else has moved the
vehicles: obstacles, and the judgement of each robot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim import robot
from angler_mjx.sim.engines.mjx import OneWorld
from angler_mjx.sim.phase import run
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.sim.step import MEETING, OBSTACLES
from angler_sitl.scene.flat import Arrays, Flat
from angler_sitl.scene.motion import (
    INPUTS,
    ONE_THREAD,
    SceneMotion,
    signals,
)


@dataclass(frozen=True, kw_only=True)
class Judging:
    """`judge`, compiled for worlds of one shape, with few arrays in and out."""

    step: Callable[
        [Arrays, Arrays, NDArray[Any], NDArray[np.int32], NDArray[np.bool_]], tuple[Arrays, Arrays]
    ]
    """Constants, state, vehicles as `SceneMotion.told` gives them, inputs of the last step, who is
    on
    the last approach of its plan: to state and record."""
    world: Flat
    state: Flat
    record: Flat
    """What the phases record, by field; [1] leads there."""

    def constants(self, world: World) -> Arrays:
        """What has to be known of a world; [1] leads there."""
        return self.world.put(_unplanned(world))

    def begin(self, state: WorldState) -> Arrays:
        """A state as the step takes it; [1] leads there."""
        return self.state.put(state)

    def end(self, state: Arrays) -> WorldState:
        """The inverse of `begin`, as NumPy's arrays."""
        whole: WorldState = self.state.unpack(tuple(map(np.asarray, state)))
        return whole


def build(spec: SimSpec, motion: SceneMotion, world: World, state: WorldState) -> Judging:
    """Compile for worlds like this one.

    Args:
        spec: settings.
        motion: of the vehicles.
        world: [1] leads; another of the same scenario has the same shapes, but for its plans.
        state: [1] leads.
    """
    of_world, of_state = Flat.of(_unplanned(world)), Flat.of(state)
    thrusters = world.control.vehicle.B.shape[-1]
    like = motion.told(motion.begin(state.vehicles))

    records: list[Flat] = []

    def step(
        world: Arrays, state: Arrays, told: jax.Array, inputs: jax.Array, approaching: jax.Array
    ) -> tuple[Arrays, Arrays]:
        # One world is not batched: that would make tracing it take half as long again.
        judged, record = judge(
            spec,
            jax.tree.map(lambda x: x[0], of_world.unpack(world)),
            jax.tree.map(lambda x: x[0], of_state.unpack(state)),
            jax.vmap(motion.vehicles.split)(told[:, 1:]),
            inputs[:, :thrusters],
            told[:, 0] > 0,
            approaching,
        )
        record = jax.tree.map(lambda x: x[None], record)
        records.append(Flat.of(record))
        return of_state.pack(judged), records[-1].pack(record)

    inputs = jax.ShapeDtypeStruct((len(like), INPUTS), jnp.int32)
    approaching = jax.ShapeDtypeStruct((len(like),), jnp.bool_)
    lowered = jax.jit(step).lower(of_world.like, of_state.like, like, inputs, approaching)
    compiled: Any = lowered.compile(ONE_THREAD)
    return Judging(step=compiled, world=of_world, state=of_state, record=records[-1])


def _unplanned(world: World) -> World:
    """A world [1] without its plans, which have any type and length.

    The judgement needs no more of them than who is on the last approach.
    """
    robots, real = world.variant.shape, world.environment.start_m.dtype
    nothing: dict[str, Any] = {
        "time_s": np.zeros((*robots, 0), real),
        "position_m": np.zeros((*robots, 0, 3), real),
        "found": np.zeros(robots, bool),
    }
    return replace(world, path=Trajectory(**nothing))


def judge(
    spec: SimSpec,
    world: World,
    state: WorldState,
    vehicles: VehicleState,
    pulses: jax.Array,
    broken: jax.Array,
    approaching: jax.Array,
) -> tuple[WorldState, dict[str, Any]]:
    """One world at the end of a control period.

    Args:
        spec: settings.
        world: its constants.
        state: at the beginning of the period.
        vehicles: [N] at its end.
        pulses: int32 [N, n_thruster] us, as the autopilots sent them last; for the energy.
        broken: bool [N] who diverged in it.
        approaching: bool [N] who is on the last approach of its plan.

    Returns:
        The state at the end of it, and what the phases recorded.
    """
    before = state.vehicles
    t = state.step.astype(before.p.dtype) * spec.control_dt_s
    here = OneWorld(spec=spec, world=world, t=t, approaching=approaching)
    sent = signals(pulses, before.p.dtype)
    _, power = here.each(robot.thrust_and_power, here.params.vehicle, sent)
    slots = {
        "vehicle": vehicles,
        "obstacles": state.obstacles,
        "tally": state.tally,
        "before_m": before.p,
        "power_w": power,
        "broken": broken,
    }
    now, record = run(here, (OBSTACLES, *MEETING), slots)
    after = replace(
        state,
        vehicles=vehicles,
        obstacles=now["obstacles"],
        tally=now["tally"],
        step=state.step + 1,
    )
    return after, record
