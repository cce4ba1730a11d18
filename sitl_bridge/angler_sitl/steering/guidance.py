"""Our part of the control of real autopilots: one compiled step of the stack of a level."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control import mixed, stack
from angler_mjx.robot.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import ControlMemory
from angler_mjx.sim import robot
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec, World, WorldState
from angler_mjx.world import currents
from angler_sitl.steering.autopilot_commander import EstimatedMotion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GuidanceDecision:
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
            spec: of the level, see `angler_sitl.steering.levels.build_level_spec`.
        """
        self._spec = spec
        self._sends_pwm = spec.stages[-1].gives is ThrusterPwm
        self._begin = jax.jit(partial(_reset_controllers, spec))
        self._decide = jax.jit(partial(_run_controllers, spec))

    def initialise_memory(self, worlds: World, vehicles: VehicleState) -> ControlMemory:
        """Memory of all robots at their starts, [1, R] leading."""
        memory: ControlMemory = self._begin(worlds, vehicles)
        return memory

    def decide(
        self,
        worlds: World,
        state: WorldState,
        memory: ControlMemory,
        estimate: Belief,
        command: MixedCommand,
    ) -> GuidanceDecision:
        """One control step.

        Args:
            worlds: [1] leads.
            state: the truth, for the current alone.
            memory: of the stacks.
            estimate: what the robots believe of their motion, [1, R] leading.
            command: what they are told.
        """
        if not self._sends_pwm:
            # There is a slot for signals, the last, which this level takes from nobody.
            command = MixedCommand(
                which=command.which, fresh=command.fresh, commands=command.commands[:-1]
            )
        decision: GuidanceDecision = self._decide(
            worlds, state.vehicles.p, state.step, memory, estimate, command
        )
        return decision


def _reset_controllers(spec: SimSpec, worlds: World, vehicles: VehicleState) -> ControlMemory:
    memory = jax.vmap(jax.vmap(partial(robot.reset_controllers, spec)))(
        vehicles, worlds.environment.start_yaw_rad
    )
    if spec.stages[-1].gives is not ThrusterPwm:
        return memory
    no_demand = BodyWrench(tau=jnp.full_like(vehicles.nu, jnp.nan))
    return ControlMemory(stages=memory.stages, realised=memory.realised, demanded=no_demand)


def _run_controllers(
    spec: SimSpec,
    worlds: World,
    p: jax.Array,
    step: jax.Array,
    memory: ControlMemory,
    estimate: Belief,
    command: MixedCommand,
) -> GuidanceDecision:
    def decide_world(
        world: World,
        p: jax.Array,
        step: jax.Array,
        memory: Any,
        estimate: Belief,
        command: MixedCommand,
    ) -> GuidanceDecision:
        t = step.astype(p.dtype) * spec.control_dt_s
        flow = jax.vmap(currents.velocity, (None, 0, None))(world.environment.current, p, t)
        after, target, output = jax.vmap(partial(robot.run_controllers, spec))(
            world.control,
            memory,
            estimate,
            command,
            estimate.flow if stack.wants_flow(spec.stages) else None,
        )
        begin_s = jax.vmap(partial(mixed.last_approach_s, tolerance_m=spec.goal_tolerance_m))(
            command, world.environment.goal_m
        )
        return GuidanceDecision(
            memory=after,
            target_m=target,
            output=output,
            approaching=jax.vmap(partial(robot.is_on_last_approach, spec))(after, command, begin_s),
            current_mps=flow,
        )

    decision: GuidanceDecision = jax.vmap(decide_world)(worlds, p, step, memory, estimate, command)
    return decision


def belief_from_motion(motion: EstimatedMotion, like: Any) -> Belief:
    """What autopilots believe, as controllers take it.

    They do not say how sure they are: the spreads are NaN. Nor do they know of a current: still
    water, as from every filter here.

    Args:
        motion: of each robot.
        like: [1, R, 3] array of the type that the simulation computes with.
    """
    fields: dict[str, Any] = {
        name: getattr(motion, name)[None].astype(like.dtype) for name in ("p", "q", "nu")
    }
    unknown: Any = np.full_like(fields["p"], np.nan)
    return Belief(
        **fields,
        flow=np.zeros_like(fields["p"]),
        position_std_m=unknown,
        velocity_std_mps=unknown,
        attitude_std_rad=unknown,
    )


def belief_from_truth(vehicles: VehicleState) -> Belief:
    """The truth in the same form, [1, R] leading; of a current nothing is told either."""
    fields: dict[str, Any] = {
        name: np.asarray(getattr(vehicles, name)) for name in ("p", "q", "nu")
    }
    zeros: Any = np.zeros_like(fields["p"])
    return Belief(
        **fields, flow=zeros, position_std_m=zeros, velocity_std_mps=zeros, attitude_std_rad=zeros
    )
