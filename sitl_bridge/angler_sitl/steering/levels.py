"""Entry levels of commands to a real autopilot: its thrusters, position targets, or sticks.

A level is a short stack of our own controllers (`angler_mjx.robot.control.stack`) above those of
the autopilot: the output of the last stage is sent. Everything is in W and F here;
`angler_sitl.wire.messages` turns it into MAVLink.

| level | our part | what is sent |
|---|---|---|
| thrusters | the scenario's controllers, whole | signals, passed through to the outputs |
| guided | guidance along paths | position with velocity and heading, GUIDED |
| poshold, althold, manual | none | sticks; a twist is a fraction of the vehicle's top speeds |

A twist at the level ``guided`` moves the target on evenly, and the target waits for a robot that
is behind. The firmware has pure velocity targets too; a vehicle reached half of one after 5 s.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    Estimate,
    PoseTarget,
    TrackingTarget,
    as_tracking,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.control.stack import NoGains, Stage, StageInput
from angler_mjx.runs.session.fleet_facts import FleetFacts
from angler_mjx.sim.state import SimSpec
from angler_sitl.firmware.parameters import LEVELS, CommandLevel

LEVEL_MODES: dict[CommandLevel, int] = {
    "thrusters": 19,
    "guided": 4,
    "poshold": 16,
    "althold": 2,
    "manual": 19,
}
"""Firmware number of the mode of each level."""

STICK_LEVELS: tuple[CommandLevel, ...] = ("poshold", "althold", "manual")

LEASH_M, LEASH_RAD = 0.5, 0.5
"""Max lead of a twist's target over a robot that does not keep up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GuidedCarry:
    """Memory of the level ``guided``."""

    position_m: jax.Array
    """[3] target of the previous step, in W."""
    yaw_rad: jax.Array
    """[] heading of the target."""
    steered: jax.Array
    """bool [] whether a twist moved the target."""


def build_level_spec(level: CommandLevel, spec: SimSpec) -> SimSpec:
    """Return the settings of the simulation with the controllers of a level.

    Args:
        level: where commands enter.
        spec: of the scenario.

    Raises:
        ConfigError: there is no such level.
    """
    if level not in LEVELS:
        raise ConfigError(f"level = {level!r}: there is {', '.join(LEVELS)}")
    if level == "thrusters":
        return spec
    last = _GUIDED if level == "guided" else _STICKS
    stack = (stages.STAGES["follow"], last)
    return replace(spec, stages=stack, gains=tuple(stage.gains() for stage in stack))


def accepted_command_types(
    level: CommandLevel, scenario_types: tuple[type, ...]
) -> tuple[type, ...]:
    """Return the command types that robots accept at a level.

    Args:
        level: where commands enter.
        scenario_types: command types of the scenario's own controllers.
    """
    if level == "thrusters":
        return scenario_types
    if level == "guided":
        return (Trajectory, JointTrajectory, TrackingTarget, PoseTarget, BodyTwist, JointGoal)
    return (BodyTwist,)


def _reset_guided(estimate: Estimate, yaw_rad: jax.Array) -> GuidedCarry:
    steered = jnp.zeros(jnp.shape(yaw_rad), bool)
    return GuidedCarry(position_m=estimate.p, yaw_rad=yaw_rad, steered=steered)


def _step_guided(
    _: NoGains,
    carry: GuidedCarry,
    inputs: StageInput,
    command: PoseTarget | TrackingTarget | BodyTwist,
) -> tuple[GuidedCarry, TrackingTarget]:
    """Return the target of one control step."""
    if isinstance(command, BodyTwist):
        target = _advance_target(carry, inputs.estimate, command, inputs.dt)
    else:
        target = as_tracking(command)
    after = GuidedCarry(
        position_m=target.position_m,
        yaw_rad=target.yaw_rad,
        steered=jnp.full_like(carry.steered, isinstance(command, BodyTwist)),
    )
    return after, target


def _advance_target(
    carry: GuidedCarry, estimate: Estimate, command: BodyTwist, dt: float
) -> TrackingTarget:
    """Advance the target by a twist, starting at the robot after any other command."""
    yaw = quaternion.yaw(estimate.q)
    velocity = quaternion.rotate(quaternion.from_yaw(yaw), command.nu[:3])
    lead = jnp.where(carry.steered, carry.position_m - estimate.p, 0.0)
    ahead = jnp.where(carry.steered, wrap_angle(carry.yaw_rad - yaw), 0.0)
    away = jnp.sqrt(jnp.sum(lead**2) + 1e-12)
    lead = lead * jnp.minimum(1.0, LEASH_M / away) + velocity * dt
    ahead = jnp.clip(ahead, -LEASH_RAD, LEASH_RAD) + command.nu[5] * dt
    still = jnp.zeros_like(yaw)
    return TrackingTarget(
        position_m=estimate.p + lead,
        velocity_mps=velocity,
        acceleration_mps2=jnp.zeros_like(velocity),
        yaw_rad=wrap_angle(yaw + ahead),
        yaw_rate_radps=command.nu[5] + still,
        yaw_acceleration_radps2=still,
    )


def _step_sticks(
    _: NoGains, carry: tuple[()], __: StageInput, command: PoseTarget | BodyTwist
) -> tuple[tuple[()], BodyTwist]:
    """Return the sticks as a twist; centred where a robot is to stay."""
    if isinstance(command, BodyTwist):
        return carry, command
    still = jnp.zeros_like(command.position_m)
    return carry, BodyTwist(nu=jnp.concatenate([still, still]))


_GUIDED = Stage(
    name="guided",
    takes=(PoseTarget, TrackingTarget, BodyTwist),
    gives=TrackingTarget,
    step=_step_guided,
    reset=_reset_guided,
)
_STICKS = Stage(
    name="sticks",
    takes=(PoseTarget, BodyTwist),
    gives=BodyTwist,
    step=_step_sticks,
    reset=lambda _, __: (),
)


def adapt_facts(level: CommandLevel, facts: FleetFacts) -> FleetFacts:
    """Return the facts of a scene's robots, with the command types of a level."""
    robots = tuple(
        replace(robot, accepts=accepted_command_types(level, robot.accepts))
        for robot in facts.robots
    )
    return replace(facts, robots=robots)
