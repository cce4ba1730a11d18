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

An autopilot knows nothing of an arm: it gets the base's part of a command, and servos of the joints
get theirs. At the level ``guided`` a target of the end effector is resolved into both.
"""

from dataclasses import replace

import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    PoseTarget,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.control.laws import guided
from angler_mjx.robot.control.laws.guided import GuidedCarry
from angler_mjx.robot.control.laws.whole_body import WholeBodyGains
from angler_mjx.robot.control.stack import NoGains, Stage, StageInput
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.config import VehicleConfig
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


def build_level_spec(
    level: CommandLevel, spec: SimSpec, *, has_end_effector: bool = False
) -> SimSpec:
    """Return the settings of the simulation with the controllers of a level.

    Args:
        level: where commands enter.
        spec: of the scenario.
        has_end_effector: whether a vehicle of the fleet has an end effector.

    Raises:
        ConfigError: there is no such level.
    """
    if level not in LEVELS:
        raise ConfigError(f"level = {level!r}: there is {', '.join(LEVELS)}")
    if level == "thrusters":
        return spec
    targets = stages.STAGES["guided"] if has_end_effector else _GUIDED
    stack = (stages.STAGES["follow"], targets if level == "guided" else _STICKS)
    of_scenario = {type(gains): gains for gains in spec.gains}
    gains = tuple(
        of_scenario.get(WholeBodyGains, stage.gains())
        if stage.gains is WholeBodyGains
        else stage.gains()
        for stage in stack
    )
    return replace(spec, stages=stack, gains=gains)


def accepted_command_types(
    level: CommandLevel, scenario_types: tuple[type, ...]
) -> tuple[type, ...]:
    """Return the command types that robots accept at a level, beside those to arms.

    Args:
        level: where commands enter.
        scenario_types: command types of the scenario's own controllers.
    """
    if level == "thrusters":
        return scenario_types
    if level == "guided":
        return (Trajectory, JointTrajectory, TrackingTarget, PoseTarget, BodyTwist, JointGoal)
    return (BodyTwist,)


def arm_command_types(level: CommandLevel, vehicle: VehicleConfig) -> tuple[type, ...]:
    """Return the command types that a vehicle accepts at a level for its arm; none without joints.

    At the level ``thrusters`` the scenario's own controllers take targets of the end effector.
    """
    if not vehicle.joints:
        return ()
    joints = (JointTarget, WholeBodyCommand)
    is_resolved = level == "guided" and vehicle.end_effector is not None
    return (EndEffectorTarget, *joints) if is_resolved else joints


def _step_guided(
    _: NoGains,
    carry: GuidedCarry,
    inputs: StageInput,
    command: PoseTarget | TrackingTarget | BodyTwist,
) -> tuple[GuidedCarry, TrackingTarget]:
    return guided.step_base(carry, inputs.estimate, command, inputs.dt)


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
    reset=guided.reset_base,
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
        replace(
            robot,
            accepts=tuple(
                dict.fromkeys(
                    [
                        *accepted_command_types(level, robot.accepts),
                        *arm_command_types(level, library.load_vehicle(robot.vehicle)),
                    ]
                )
            ),
        )
        for robot in facts.robots
    )
    return replace(facts, robots=robots)
