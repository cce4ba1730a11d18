"""Our part of the control of real autopilots: one compiled step of the stack of a level."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control import mixed, stack
from angler_mjx.robot.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.robot.control.mixed import Mixed
from angler_mjx.robot.control.stack import ControlMemory
from angler_mjx.sim import robot
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.world import currents
from angler_sitl.steering.pilot import PilotMotion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Decision:
    """What came of one control step; [1, R] leads."""

    memory: ControlMemory
    target_m: jax.Array
    """[1, R, 3] position aimed at, in W."""
    output: Any
    """A command of the type that the stack's last stage gives."""
    approaching: jax.Array
    """bool [1, R] who is on the last approach of its plan, or has none."""
    current_mps: jax.Array
    """[1, R, 3] water velocity at the robots, in W."""


class Guidance:
    """The stack of a level for all robots of a world, compiled once."""

    def __init__(self, spec: SimSpec) -> None:
        """Nothing is compiled yet.

        Args:
            spec: of the level, see `angler_sitl.steering.levels.spec_of`.
        """
        self._spec = spec
        self._signals = spec.stages[-1].gives is ThrusterPwm
        self._begin = jax.jit(partial(_begin, spec))
        self._decide = jax.jit(partial(_decide, spec))

    def begin(self, worlds: World, vehicles: VehicleState) -> ControlMemory:
        """Memory of all robots at their starts, [1, R] leading."""
        memory: ControlMemory = self._begin(worlds, vehicles)
        return memory

    def decide(
        self, worlds: World, state: WorldState, memory: ControlMemory, known: Belief, told: Mixed
    ) -> Decision:
        """One control step.

        Args:
            worlds: [1] leads.
            state: the truth, for the current alone.
            memory: of the stacks.
            known: what the robots believe of their motion, [1, R] leading.
            told: what they are told.
        """
        if not self._signals:
            # There is a slot for signals, the last, which this level takes from nobody.
            told = Mixed(which=told.which, fresh=told.fresh, commands=told.commands[:-1])
        decision: Decision = self._decide(worlds, state.vehicles.p, state.step, memory, known, told)
        return decision


def _begin(spec: SimSpec, worlds: World, vehicles: VehicleState) -> ControlMemory:
    memory = jax.vmap(jax.vmap(partial(robot.begin, spec)))(
        vehicles, worlds.environment.start_yaw_rad
    )
    if spec.stages[-1].gives is not ThrusterPwm:
        return memory
    unasked = BodyWrench(tau=jnp.full_like(vehicles.nu, jnp.nan))
    return ControlMemory(stages=memory.stages, realised=memory.realised, demanded=unasked)


def _decide(
    spec: SimSpec,
    worlds: World,
    p: jax.Array,
    step: jax.Array,
    memory: ControlMemory,
    known: Belief,
    told: Mixed,
) -> Decision:
    def one(
        world: World, p: jax.Array, step: jax.Array, memory: Any, known: Belief, told: Mixed
    ) -> Decision:
        t = step.astype(p.dtype) * spec.control_dt_s
        flow = jax.vmap(currents.velocity, (None, 0, None))(world.environment.current, p, t)
        after, target, output = jax.vmap(partial(robot.decide, spec))(
            world.control,
            memory,
            known,
            told,
            known.flow if stack.wants_flow(spec.stages) else None,
        )
        begin_s = jax.vmap(partial(mixed.last_approach_s, tolerance_m=spec.goal_tolerance_m))(
            told, world.environment.goal_m
        )
        return Decision(
            memory=after,
            target_m=target,
            output=output,
            approaching=jax.vmap(partial(robot.approaches, spec))(after, told, begin_s),
            current_mps=flow,
        )

    decision: Decision = jax.vmap(one)(worlds, p, step, memory, known, told)
    return decision


def belief_of(motion: PilotMotion, like: Any) -> Belief:
    """What autopilots believe, as controllers take it.

    They do not say how sure they are: the spreads are NaN. Nor do they know of a current: still
    water, as from every filter here.

    Args:
        motion: of each robot.
        like: [1, R, 3] array of the type that the simulation computes with.
    """
    told: dict[str, Any] = {
        name: getattr(motion, name)[None].astype(like.dtype) for name in ("p", "q", "nu")
    }
    unknown: Any = np.full_like(told["p"], np.nan)
    return Belief(
        **told,
        flow=np.zeros_like(told["p"]),
        position_std_m=unknown,
        velocity_std_mps=unknown,
        attitude_std_rad=unknown,
    )


def trusting(vehicles: VehicleState) -> Belief:
    """The truth in the same form, [1, R] leading; of a current nothing is told either."""
    told: dict[str, Any] = {name: np.asarray(getattr(vehicles, name)) for name in ("p", "q", "nu")}
    none: Any = np.zeros_like(told["p"])
    return Belief(
        **told, flow=none, position_std_m=none, velocity_std_mps=none, attitude_std_rad=none
    )
