"""From what robots are told to what their autopilots are sent, once in a control period."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from angler_mjx.robot.control.mixed import Mixed
from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec
from angler_sitl.firmware.parameters import Level
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import sticks
from angler_sitl.steering.guidance import Decision, Guidance, trusting
from angler_sitl.steering.pilot import AutopilotCommander
from angler_sitl.wire import messages
from angler_sitl.wire.link import Message


class CommandSender:
    """Our own controllers of all robots, and their voice.

    Attributes:
        memory: of the controllers, [1, R] leading.
    """

    def __init__(self, level: Level, spec: SimSpec) -> None:
        """Nothing is compiled yet.

        Args:
            level: where commands enter.
            spec: of that level, see `angler_sitl.steering.levels.spec_of`.
        """
        self._level, self._guidance = level, Guidance(spec)

    def reset(self, scene: AutopilotScene, told: Mixed) -> None:
        """Begin anew, with the vehicles at their starts.

        Args:
            scene: that they are in.
            told: anything that robots could be told; a decision is made once for nobody, so that
                none that counts waits for a compiler.
        """
        vehicles = scene.state.vehicles
        self.memory = self._guidance.begin(scene.worlds, vehicles)
        self._guidance.decide(scene.worlds, scene.state, self.memory, trusting(vehicles), told)

    def steer(
        self,
        scene: AutopilotScene,
        pilots: Sequence[AutopilotCommander],
        robots: Sequence[RobotInfo],
        known: Belief,
        told: Mixed,
    ) -> Decision:
        """One control step: decide, and send.

        Args:
            scene: for its constants and its clock.
            pilots: whom to send to.
            robots: whom they steer.
            known: what these believe of their motion, [1, R] leading.
            told: what they are told.
        """
        decision = self._guidance.decide(scene.worlds, scene.state, self.memory, known, told)
        self.memory = decision.memory
        for i, (pilot, robot) in enumerate(zip(pilots, robots, strict=True)):
            pilot.link.send(self._message(i, pilot, robot, scene.time_s, decision.output))
        return decision

    def _message(
        self, i: int, pilot: AutopilotCommander, robot: RobotInfo, time_s: float, output: Any
    ) -> Message:
        def of(leaf: Any) -> Any:
            return np.asarray(leaf)[0, i]

        if self._level == "thrusters":
            return messages.override(pilot.sysid, of(output.pwm_us)[: len(robot.thrusters)])
        if self._level == "guided":
            return messages.position_target(
                pilot.sysid,
                time_s,
                of(output.position_m),
                of(output.velocity_mps),
                float(of(output.yaw_rad)),
            )
        return messages.sticks(pilot.sysid, sticks.of_twist(self._level, robot, of(output.nu)))
