"""Conversion of robot commands to autopilot messages, once in a control period."""

from collections.abc import Sequence
from functools import partial

import jax
import numpy as np

from angler_mjx.robot.control.commands import BodyTwist, PoseTarget, ThrusterPwm, TrackingTarget
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec
from angler_sitl.firmware.parameters import CommandLevel
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import sticks
from angler_sitl.steering.autopilot_commander import AutopilotCommander
from angler_sitl.steering.guidance import Guidance, GuidanceDecision, belief_from_truth
from angler_sitl.wire import messages
from angler_sitl.wire.link import MavlinkMessage


class CommandSender:
    """Our own controllers of all robots, and the sender of their output.

    Attributes:
        spec: of the level.
        memory: of the controllers, [1, R] leading.
        silent: indices of robots that fly on their own, in AUTO: they receive no commands.
    """

    def __init__(self, level: CommandLevel, spec: SimSpec) -> None:
        """Create the sender; nothing is compiled yet.

        Args:
            level: where commands enter.
            spec: of that level, see `angler_sitl.steering.levels.build_level_spec`.
        """
        self._level, self._guidance, self.spec = level, Guidance(spec), spec
        self.silent: frozenset[int] = frozenset()

    def reset(self, scene: AutopilotScene, command: MixedCommand) -> None:
        """Reset the controllers, with the vehicles at their starts.

        Args:
            scene: scene of the vehicles.
            command: any valid command; one decision is made and discarded, so that no later
                decision waits for a compiler.
        """
        vehicles, self.silent = scene.state.vehicles, frozenset()
        self.memory = self._guidance.initialise_memory(scene.worlds, vehicles)
        self._guidance.decide(
            scene.worlds,
            scene.state,
            self.memory,
            belief_from_truth(vehicles),
            command,
        )

    def steer(
        self,
        scene: AutopilotScene,
        pilots: Sequence[AutopilotCommander],
        robots: Sequence[RobotInfo],
        estimate: Belief,
        command: MixedCommand,
    ) -> GuidanceDecision:
        """Run one control step: decide, send to the autopilots, and set the servos of joints.

        Args:
            scene: for its constants and its clock.
            pilots: receivers of the output.
            robots: the robots that they steer.
            estimate: estimates of the robots' motion, [1, R] leading.
            command: commands of the robots, and to their joints.
        """
        decision = self._guidance.decide(scene.worlds, scene.state, self.memory, estimate, command)
        self.memory = decision.memory
        scene.command_joints(decision.memory.joints)
        for i, (pilot, robot) in enumerate(zip(pilots, robots, strict=True)):
            if i not in self.silent:
                output: Command = jax.tree.map(partial(_select_robot, i), decision.output)
                self._send_command(i, pilot, robot, scene.time_s, output)
        return decision

    def _send_command(
        self, i: int, pilot: AutopilotCommander, robot: RobotInfo, time_s: float, command: Command
    ) -> None:
        """Send the output of the controllers of robot i."""
        pilot.link.send(self._build_message(pilot, robot, time_s, command))

    def _build_message(
        self, pilot: AutopilotCommander, robot: RobotInfo, time_s: float, command: Command
    ) -> MavlinkMessage:
        match command:
            case ThrusterPwm():
                pulses = np.asarray(command.pwm_us)[: len(robot.thrusters)]
                return messages.build_override(pilot.sysid, pulses)
            case PoseTarget() | TrackingTarget():
                return messages.build_position_target(
                    pilot.sysid,
                    time_s,
                    np.asarray(command.position_m),
                    np.asarray(command.velocity_mps),
                    float(command.yaw_rad),
                )
            case BodyTwist():
                twist = np.asarray(command.nu)
                return messages.build_manual_control(
                    pilot.sysid, sticks.twist_to_sticks(self._level, robot, twist)
                )
        raise TypeError(f"no message holds a {type(command).__name__}")


def _select_robot(i: int, leaf: jax.Array) -> np.ndarray:
    row: np.ndarray = np.asarray(leaf)[0, i]
    return row
