"""Sender of the controllers' targets through the guards of their robots."""

from collections.abc import Sequence

import numpy as np

from angler_mjx.robot.control.commands import PoseTarget, TrackingTarget
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.session.interface import Floats, RobotInfo
from angler_mjx.sim.state import SimSpec
from angler_sitl.endpoints.limits import Setpoint, SetpointGuard
from angler_sitl.steering.autopilot_commander import AutopilotCommander
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.vehicle_commander import VehicleCommander


class GuardedSender(CommandSender):
    """`CommandSender` of the level ``guided``; vehicles that are not guided receive nothing.

    Attributes:
        guards: guard of each robot.
        positions_m: [R, 3] estimated positions in W, set before each step.
    """

    def __init__(self, spec: SimSpec, guards: Sequence[SetpointGuard]) -> None:
        """Create the sender; nothing is compiled yet."""
        super().__init__("guided", spec)
        self.guards = list(guards)
        self.positions_m: Floats = np.full((len(self.guards), 3), np.nan)

    def _send_command(
        self, i: int, pilot: AutopilotCommander, robot: RobotInfo, time_s: float, command: Command
    ) -> None:
        if not isinstance(pilot, VehicleCommander) or not pilot.is_guided:
            self.guards[i].restart()
            return
        if not isinstance(command, PoseTarget | TrackingTarget):
            raise TypeError(f"no target holds a {type(command).__name__}")
        wanted = Setpoint(
            position_m=np.asarray(command.position_m, float),
            velocity_mps=np.asarray(command.velocity_mps, float),
            yaw_rad=float(command.yaw_rad),
        )
        robot_m = self.positions_m[i]
        limited = self.guards[i].limit(wanted, robot_m, self.spec.control_dt_s)
        if limited is not None:
            pilot.send_target(time_s, limited.position_m, limited.velocity_mps, limited.yaw_rad)
        pilot.send_centred_sticks()
