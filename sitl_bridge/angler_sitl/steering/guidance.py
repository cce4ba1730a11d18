"""Guidance above real autopilots: one compiled step of the controller stack of a level."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control import mixed, stack
from angler_mjx.robot.control.commands import BodyWrench, ThrusterPwm
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command, ControlMemory
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim import robot
from angler_mjx.sim.cargo import read_grips
from angler_mjx.sim.engines.mjx import mark_leader
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, SimSpec, WorldState
from angler_mjx.world import currents
from angler_sitl.steering.autopilot_commander import EstimatedMotion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GuidanceDecision:
    """Result of one control step; [1, R] leads."""

    memory: ControlMemory
    target_m: jax.Array
    """[1, R, 3] target position, in W."""
    output: Command
    """Command of the output type of the stack's last stage."""
    approaching: jax.Array
    """bool [1, R] whether a robot is on the last approach of its plan, or has none."""
    current_mps: jax.Array
    """[1, R, 3] water velocity at the robots, in W."""


class Guidance:
    """Controller stack of a level for all robots of a world, compiled once."""

    def __init__(self, spec: SimSpec) -> None:
        """Create the guidance; nothing is compiled yet.

        Args:
            spec: of the level, see `angler_sitl.steering.levels.build_level_spec`.
        """
        self._spec = spec
        self._sends_pwm = spec.stages[-1].gives is ThrusterPwm
        self._begin = jax.jit(partial(_reset_controllers, spec))
        self._decide = jax.jit(partial(_run_controllers, spec))

    def initialise_memory(self, worlds: FleetWorld, vehicles: VehicleState) -> ControlMemory:
        """Return the memory of all robots at their starts, [1, R] leading."""
        memory: ControlMemory = self._begin(worlds, vehicles)
        return memory

    def decide(
        self,
        worlds: FleetWorld,
        state: WorldState,
        memory: ControlMemory,
        estimate: Belief,
        command: MixedCommand,
    ) -> GuidanceDecision:
        """Run one control step.

        Args:
            worlds: [1] leads.
            state: the truth, for the current, and for joints and grips, which measure themselves.
            memory: of the stacks.
            estimate: estimates of the robots' motion, [1, R] leading.
            command: commands of the robots.
        """
        if not self._sends_pwm:
            # The last slot is for signals, which this level accepts from no robot.
            command = replace(command, commands=command.commands[:-1])
        decision: GuidanceDecision = self._decide(
            worlds,
            state.vehicles.p,
            state.step,
            memory,
            estimate,
            state.vehicles.joints,
            state.grips,
            command,
        )
        return decision


def _reset_controllers(spec: SimSpec, worlds: FleetWorld, vehicles: VehicleState) -> ControlMemory:
    memory: ControlMemory = jax.vmap(jax.vmap(partial(robot.reset_controllers, spec)))(
        vehicles, worlds.environment.start_yaw_rad
    )
    if spec.stages[-1].gives is not ThrusterPwm:
        return memory
    no_demand = BodyWrench(tau=jnp.full_like(vehicles.nu, jnp.nan))
    return replace(memory, demanded=no_demand)


def _run_controllers(
    spec: SimSpec,
    worlds: FleetWorld,
    p: jax.Array,
    step: jax.Array,
    memory: ControlMemory,
    estimate: Belief,
    joints: JointMotion | None,
    grips: Grips | None,
    command: MixedCommand,
) -> GuidanceDecision:
    def decide_world(
        world: FleetWorld,
        p: jax.Array,
        step: jax.Array,
        memory: ControlMemory,
        estimate: Belief,
        joints: JointMotion | None,
        grips: Grips | None,
        command: MixedCommand,
    ) -> GuidanceDecision:
        t = step.astype(p.dtype) * spec.control_dt_s
        flow = jax.vmap(currents.velocity, (None, 0, None))(world.environment.current, p, t)
        after, target, output = jax.vmap(partial(robot.run_controllers, spec))(
            mark_leader(spec, world).control,
            memory,
            estimate,
            command,
            estimate.flow if stack.wants_flow(spec.stages) else None,
            joints,
            None if grips is None else read_grips(grips, world.grip_sensors, step),
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

    decision: GuidanceDecision = jax.vmap(decide_world)(
        worlds, p, step, memory, estimate, joints, grips, command
    )
    return decision


def belief_from_motion(motion: EstimatedMotion, like: jax.Array) -> Belief:
    """Convert the autopilots' estimates to the form of the controllers.

    Autopilots report no uncertainty: the spreads are NaN. They do not estimate a current: still
    water, as from every filter here.

    Args:
        motion: of each robot.
        like: [1, R, 3] array of the type that the simulation computes with.
    """
    p, q, nu = (numbers[None].astype(like.dtype) for numbers in (motion.p, motion.q, motion.nu))
    unknown = as_leaf(np.full_like(p, np.nan))
    return Belief(
        p=as_leaf(p),
        q=as_leaf(q),
        nu=as_leaf(nu),
        flow=as_leaf(np.zeros_like(p)),
        position_std_m=unknown,
        velocity_std_mps=unknown,
        attitude_std_rad=unknown,
    )


def belief_from_truth(vehicles: VehicleState) -> Belief:
    """Return the truth in the same form, [1, R] leading; without a current either."""
    p, q, nu = (as_leaf(np.asarray(leaf)) for leaf in (vehicles.p, vehicles.q, vehicles.nu))
    zeros = as_leaf(np.zeros_like(p))
    return Belief(
        p=p,
        q=q,
        nu=nu,
        flow=zeros,
        position_std_m=zeros,
        velocity_std_mps=zeros,
        attitude_std_rad=zeros,
    )
